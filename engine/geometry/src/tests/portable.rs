use super::*;
use crate::{Facing, Hit, Quadric, RayLanes};
use femc_math::glam::Vec3;
use femc_simd::{Lanes, WIDTH};

/// Traces the same rays with the vector kernels and the portable ones, and compares every bit of every hit.
fn assert_same_hits(world: &World, random: &mut Random, rays: usize) -> usize {
    let portable = world.clone().portable();
    let mut hits = 0;
    let mut batch = Vec::new();
    for i in 0..rays {
        let mut ray = ray_at(random, &world.bounds());
        match i % 5 {
            0 => ray.t_max = random.between(0.0, 8.0),
            1 => ray.dir = [Vec3A::X, -Vec3A::Y, Vec3A::Z][i % 3],
            2 => ray.origin = (ray.origin * 4.0).round() / 4.0,
            _ => {}
        }
        ray.time = random.unit();
        let bits = |w: &World| {
            w.intersect(&ray).map(|h| (h.t.to_bits(), h.instance, h.primitive, h.u.to_bits(), h.v.to_bits()))
        };
        let (fast, plain) = (bits(world), bits(&portable));
        assert_eq!(fast, plain, "{ray:?}");
        assert_eq!(world.occluded(&ray), portable.occluded(&ray), "{ray:?}");
        assert_eq!(world.occluded(&ray), fast.is_some(), "{ray:?}");
        hits += usize::from(fast.is_some());
        batch.push(ray);
        if batch.len() == WIDTH {
            for world in [world, &portable] {
                assert_lanes_are_single_rays(world, &batch, random);
            }
            batch.clear();
        }
    }
    hits
}

/// Traces rays side by side, without some of the lanes, and compares with one ray after the other.
fn assert_lanes_are_single_rays(world: &World, rays: &[Ray], random: &mut Random) {
    let lanes = |part: fn(&Ray) -> f32| Lanes(std::array::from_fn(|lane| part(&rays[lane])));
    let origin = [lanes(|ray| ray.origin.x), lanes(|ray| ray.origin.y), lanes(|ray| ray.origin.z)];
    let dir = [lanes(|ray| ray.dir.x), lanes(|ray| ray.dir.y), lanes(|ray| ray.dir.z)];
    let (t_max, time) = (lanes(|ray| ray.t_max), lanes(|ray| ray.time));
    let side_by_side = RayLanes { origin: &origin, dir: &dir, t_max: &t_max, time: &time };
    let used = random.between(0.0, 256.0) as u32;
    let mut hits = [Hit { t: 0.0, instance: 0, primitive: 0, u: 0.0, v: 0.0 }; WIDTH];
    let found = world.intersect_lanes(side_by_side, used, &mut hits);
    let occluded = world.occluded_lanes(side_by_side, used);
    assert_eq!((found & !used, occluded & !used), (0, 0));
    for (lane, ray) in rays.iter().enumerate().filter(|(lane, _)| used >> lane & 1 == 1) {
        let bits = |hit: Hit| (hit.t.to_bits(), hit.instance, hit.primitive, hit.u.to_bits(), hit.v.to_bits());
        let hit = (found >> lane & 1 == 1).then_some(hits[lane]);
        assert_eq!(hit.map(bits), world.intersect(ray).map(bits), "{ray:?}");
        assert_eq!(occluded >> lane & 1 == 1, world.occluded(ray), "{ray:?}");
    }
}

#[test]
fn vector_and_portable_kernels_are_bit_identical_on_scenes() {
    let mut random = Random(30);
    for count in [1, 5, 12, 36, 100, 1500, 5000] {
        let sphere = Quadric::Sphere { center: random.point(2.0), radius: 0.5, facing: Facing::Outward };
        let shapes = vec![ShapeInput { shape: sphere, cull: Cull::Back }];
        let world = world(soup(&mut random, count), shapes);
        assert!(assert_same_hits(&world, &mut random, 20_000) > 100);
    }
    let grid = bumpy_sphere(16, 16, 2.0)
        .into_iter()
        .map(|t| TriangleInput { vertices: t.vertices.map(|v| (v * 8.0).round() / 8.0), cull: Cull::None });
    assert!(assert_same_hits(&world(grid.collect(), vec![]), &mut random, 50_000) > 10_000);
}

#[test]
fn vector_and_portable_kernels_give_the_same_bits_on_instances() {
    let mut random = Random(31);
    let shared = Arc::new(Blas::build(soup(&mut random, 300), vec![]));
    let instances = (0..30)
        .map(|i| {
            let from = Affine3A::from_translation(random.point(8.0).into());
            let to = Affine3A::from_rotation_y(1.0) * Affine3A::from_scale(Vec3::splat(0.5)) * from;
            let pose = if i % 4 == 0 { Pose::Moving(vec![from, to]) } else { Pose::Fixed(from) };
            InstanceInput { blas: shared.clone(), pose }
        })
        .collect();
    assert!(assert_same_hits(&World::build(instances), &mut random, 20_000) > 5000);
}
