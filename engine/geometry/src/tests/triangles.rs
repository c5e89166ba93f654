use super::*;
use crate::{Hit, offset_origin, shadow_segment};

/// Returns the closest hit by testing every triangle in f64.
fn brute_force(triangles: &[TriangleInput], ray: &Ray) -> Option<(f64, usize)> {
    let (o, d) = (ray.origin.as_dvec3(), ray.dir.as_dvec3());
    let mut best: Option<(f64, usize)> = None;
    for (i, triangle) in triangles.iter().enumerate() {
        let [a, b, c] = triangle.vertices.map(|v| v.as_dvec3() - o);
        let n = (b - a).cross(c - a);
        let t = n.dot(a) / n.dot(d);
        let inside = [c.cross(b).dot(d), a.cross(c).dot(d), b.cross(a).dot(d)];
        let hit = inside.iter().all(|&e| e >= 0.0) || inside.iter().all(|&e| e <= 0.0);
        let visible = triangle.cull == Cull::None || n.dot(d) < 0.0;
        if hit && visible && t > 0.0 && t < f64::from(ray.t_max) && best.is_none_or(|(s, _)| t < s) {
            best = Some((t, i));
        }
    }
    best
}

#[test]
fn the_closest_hit_is_that_of_brute_force() {
    let mut random = Random(1);
    for count in [1, 2, 7, 8, 9, 40, 300, 2500] {
        let triangles = soup(&mut random, count);
        let world = world(triangles.clone(), vec![]);
        let (mut hits, mut misses) = (0, 0);
        for _ in 0..3000 {
            let mut ray = ray_at(&mut random, &world.bounds());
            if random.unit() < 0.3 {
                ray.t_max = random.between(0.0, 10.0);
            }
            let expected = brute_force(&triangles, &ray);
            let found = world.intersect(&ray);
            assert_eq!(world.occluded(&ray), found.is_some());
            match (expected, found) {
                (None, None) => misses += 1,
                (Some((t, i)), Some(hit)) => {
                    hits += 1;
                    assert!((f64::from(hit.t) - t).abs() < 1e-4 * (1.0 + t), "{t} {hit:?}");
                    let [a, b, c] = triangles[hit.primitive as usize].vertices;
                    let p = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
                    assert!(hit.primitive as usize == i || (p - ray.at(hit.t)).length() < 1e-3, "{i} {hit:?}");
                    let interaction = world.interaction(&ray, &hit);
                    assert!((interaction.position - p).abs().cmple(interaction.error * 2.0).all());
                }
                // A hit on an edge, within rounding: the f64 point must lie next to one.
                other => {
                    let (t, i) = expected.or(other.1.map(|h| (f64::from(h.t), h.primitive as usize))).expect("one hit");
                    let near = triangles[i].vertices.map(|v| (v - ray.at(t as f32)).length());
                    let sides =
                        (0..3).map(|k| (triangles[i].vertices[k] - triangles[i].vertices[(k + 1) % 3]).length());
                    let slack =
                        (0..3).zip(sides).map(|(k, s)| near[k] + near[(k + 1) % 3] - s).fold(f32::MAX, f32::min);
                    assert!(slack < 1e-4, "{other:?} slack {slack}");
                }
            }
        }
        assert!(count < 40 || (hits > 100 && misses > 100), "{count}: {hits} {misses}");
    }
}

#[test]
fn no_ray_slips_between_triangles_with_a_shared_edge_or_vertex() {
    let triangles = bumpy_sphere(24, 48, 1.5);
    let world = world(triangles.clone(), vec![]);
    let mut random = Random(2);
    for i in 0..1_000_000 {
        let origin = random.point(0.4);
        let [a, b, c] = triangles[random.bits() as usize % triangles.len()].vertices;
        let s = random.unit();
        let target = match i % 4 {
            0 => a,
            1 => a * (1.0 - s) + b * s,
            2 => b * (1.0 - s) + c * s,
            _ => c,
        };
        let ray = Ray::new(origin, (target - origin).normalize());
        let hit = world.intersect(&ray);
        assert!(hit.is_some(), "ray {i} leaks: {ray:?} to {target:?}");
        assert!(i % 8 != 0 || world.occluded(&ray), "shadow ray {i} leaks");
    }
}

#[test]
fn rays_along_axes_to_vertices_of_a_grid_do_not_leak() {
    let mut triangles = Vec::new();
    let at = |i: i32, j: i32| Vec3A::new(i as f32, j as f32, 0.0);
    for i in -8..8 {
        for j in -8..8 {
            triangles.push(triangle(at(i, j), at(i + 1, j), at(i + 1, j + 1)));
            triangles.push(triangle(at(i, j), at(i + 1, j + 1), at(i, j + 1)));
        }
    }
    let world = world(triangles, vec![]);
    for i in -14..15 {
        for j in -14..15 {
            let origin = at(i, j) * 0.5 + Vec3A::Z * 3.0;
            let hit = world.intersect(&Ray::new(origin, -Vec3A::Z)).expect("a grid point is covered");
            assert_eq!(hit.t, 3.0);
            let slanted = Ray::new(origin + Vec3A::new(3.0, 0.0, 0.0), Vec3A::new(-1.0, 0.0, -1.0).normalize());
            assert!(world.occluded(&slanted));
        }
    }
}

#[test]
fn of_equally_near_triangles_the_lowest_index_wins() {
    let mut random = Random(3);
    let one = triangle(Vec3A::new(-1.0, -1.0, 0.3), Vec3A::new(1.0, -1.0, -0.1), Vec3A::new(0.0, 1.0, 0.2));
    for lowest in [0usize, 5, 33] {
        let mut triangles = soup(&mut random, lowest);
        for other in &mut triangles {
            other.vertices = other.vertices.map(|v| v + Vec3A::X * 50.0);
        }
        triangles.extend([one; 40]);
        let world = world(triangles, vec![]);
        let hit = world.intersect(&Ray::new(Vec3A::new(0.0, 0.0, 2.0), -Vec3A::Z)).expect("a hit");
        assert_eq!(hit.primitive as usize, lowest);
    }
}

#[test]
fn a_ray_that_leaves_a_triangle_never_hits_it_again() {
    let mut random = Random(4);
    let mut tested = 0;
    for _ in 0..4000 {
        let center = random.point(1.0) * 10.0f32.powi(random.bits() as i32 % 5 - 1);
        let size = 10.0f32.powi(random.bits() as i32 % 5 - 3);
        let vertices = [(); 3].map(|()| center + random.point(size));
        let world = world(vec![triangle(vertices[0], vertices[1], vertices[2])], vec![]);
        for _ in 0..40 {
            let target = vertices[0]
                + (vertices[1] - vertices[0]) * 0.6 * random.unit()
                + (vertices[2] - vertices[0]) * 0.4 * random.unit();
            let origin = center + random.direction() * size * 5.0;
            let ray = Ray::new(origin, (target - origin).normalize());
            let Some(hit) = world.intersect(&ray) else { continue };
            let at = world.interaction(&ray, &hit);
            if at.normal == Vec3A::ZERO {
                continue;
            }
            let mut dir = random.direction();
            if random.unit() < 0.5 {
                // A grazing ray, nearly in the plane.
                dir = (dir - at.normal * dir.dot(at.normal) * (1.0 - 10.0f32.powi(-(random.bits() as i32 % 8))))
                    .normalize();
            }
            let start = offset_origin(at.position, at.error, at.normal, dir);
            let again: Option<Hit> = world.intersect(&Ray::new(start, dir));
            assert_eq!(again, None, "{vertices:?} {at:?} {dir:?}");
            tested += 1;
        }
    }
    assert!(tested > 50_000, "{tested}");
}

#[test]
fn a_segment_between_two_triangles_is_hit_by_neither() {
    let mut random = Random(5);
    for _ in 0..200_000 {
        let place = random.point(1.0) * 10.0f32.powi(random.bits() as i32 % 4);
        let mut make = || {
            let center = place + random.point(2.0);
            let size = 10.0f32.powi(random.bits() as i32 % 4 - 2);
            [(); 3].map(|()| center + random.point(size))
        };
        let (a, b) = (make(), make());
        let (pa, pb) = (crate::triangle_interaction(&a, 0.3, 0.3), crate::triangle_interaction(&b, 0.2, 0.5));
        if pa.normal == Vec3A::ZERO || pb.normal == Vec3A::ZERO {
            continue;
        }
        let ray = shadow_segment((pa.position, pa.error, pa.normal), (pb.position, pb.error, pb.normal), 0.0);
        assert!(!world_of(a).occluded(&ray), "{a:?} {b:?} {ray:?}");
        assert!(!world_of(b).occluded(&ray), "{a:?} {b:?} {ray:?}");
    }
}

fn world_of([a, b, c]: [Vec3A; 3]) -> World {
    world(vec![triangle(a, b, c)], vec![])
}

#[test]
fn one_sided_triangles_are_not_there_from_behind() {
    let [a, b, c] = [Vec3A::ZERO, Vec3A::X, Vec3A::Y];
    let one_sided = TriangleInput { vertices: [a, b, c], cull: Cull::Back };
    let behind = triangle(a - Vec3A::Z, b - Vec3A::Z, c - Vec3A::Z);
    let world = world(vec![one_sided, behind], vec![]);
    let at = Vec3A::new(0.2, 0.2, 0.0);
    let from_front = Ray::new(at + Vec3A::Z, -Vec3A::Z);
    let from_back = Ray::new(at - Vec3A::Z * 0.5, Vec3A::Z);
    assert_eq!(world.intersect(&from_front).map(|h| h.primitive), Some(0));
    assert_eq!(world.intersect(&from_back), None);
    assert!(world.occluded(&from_front) && !world.occluded(&from_back));
    assert_eq!(world.interaction(&from_front, &world.intersect(&from_front).expect("hit")).normal, Vec3A::Z);
}

#[test]
fn degenerate_triangles_are_never_hit_and_keep_their_index() {
    let [a, b, c] = [Vec3A::ZERO, Vec3A::X, Vec3A::Y];
    let bad =
        [triangle(a, b, b), triangle(a, b, b * 2.0), triangle(a, b * f32::NAN, c), triangle(a, b * f32::INFINITY, c)];
    let mut triangles = bad.to_vec();
    triangles.push(triangle(a, b, c));
    let everything = world(triangles, vec![]);
    let ray = Ray::new(Vec3A::new(0.2, 0.2, 1.0), -Vec3A::Z);
    assert_eq!(everything.intersect(&ray).map(|h| h.primitive), Some(4));
    let nothing = world(bad.to_vec(), vec![]);
    assert!(nothing.bounds().is_empty());
    assert_eq!(nothing.intersect(&ray), None);
    assert!(!world(vec![], vec![]).occluded(&ray));
    assert!(!World::build(vec![]).occluded(&ray));
    for dir in [Vec3A::NAN, Vec3A::ZERO] {
        assert_eq!(everything.intersect(&Ray::new(Vec3A::ZERO, dir)), None);
    }
}

#[test]
fn the_tree_does_not_depend_on_the_number_of_threads() {
    // Enough triangles for parallel splits.
    let triangles = bumpy_sphere(100, 120, 1.0);
    let build = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| Blas::build(triangles.clone(), vec![]))
    };
    let one = build(1);
    for threads in [2, 5] {
        let other = build(threads);
        assert_eq!(one.tree.nodes.len(), other.tree.nodes.len());
        for (a, b) in one.tree.nodes.iter().zip(&other.tree.nodes) {
            assert_eq!(a.children, b.children);
            assert_eq!(
                a.planes.map(|p| p.map(|l| l.0.map(f32::to_bits))),
                b.planes.map(|p| p.map(|l| l.0.map(f32::to_bits)))
            );
        }
        assert!(one.blocks.iter().zip(&other.blocks).all(|(a, b)| a.primitives == b.primitives));
    }
}

#[test]
fn a_chain_of_nested_triangles_does_not_overflow_the_stack() {
    // Each triangle is larger than all before by a factor, so binary trees of least area are chains.
    let triangles: Vec<TriangleInput> = (0..1000)
        .map(|i| {
            let s = 1.05f32.powi(i);
            triangle(Vec3A::new(s, 0.0, 0.0), Vec3A::new(0.0, s, 0.0), Vec3A::new(0.0, 0.0, s))
        })
        .collect();
    let world = world(triangles, vec![]);
    let hit = world.intersect(&Ray::new(Vec3A::ZERO, Vec3A::ONE.normalize())).expect("a hit");
    assert_eq!(hit.primitive, 0);
    let back = Ray::new(Vec3A::splat(1e25), -Vec3A::ONE.normalize());
    assert_eq!(world.intersect(&back).map(|h| h.primitive), Some(999));
}

#[test]
fn flat_and_stacked_meshes_build_and_are_hit() {
    let at = |i: usize, j: usize| Vec3A::new(i as f32, j as f32, 2.0);
    let mut flat = Vec::new();
    for i in 0..60 {
        for j in 0..60 {
            flat.push(triangle(at(i, j), at(i + 1, j), at(i + 1, j + 1)));
            flat.push(triangle(at(i, j), at(i + 1, j + 1), at(i, j + 1)));
        }
    }
    let flat = world(flat, vec![]);
    let stacked = world(vec![triangle(at(0, 0), at(40, 0), at(0, 40)); 20_000], vec![]);
    let mut random = Random(6);
    for _ in 0..2000 {
        let ray = Ray::new(Vec3A::new(random.between(0.1, 19.0), random.between(0.1, 19.0), 5.0), -Vec3A::Z);
        assert_eq!(flat.intersect(&ray).map(|h| h.t), Some(3.0));
        assert_eq!(stacked.intersect(&ray).map(|h| (h.t, h.primitive)), Some((3.0, 0)));
    }
}
