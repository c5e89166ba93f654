use super::*;
use crate::{Facing, Quadric, offset_origin, shadow_segment};
use femc_math::glam::{Quat, Vec3};

fn random_pose(random: &mut Random, mirrored: bool) -> Affine3A {
    let rotation = Quat::from_axis_angle(random.direction().into(), random.between(0.0, 3.0));
    let mut scale = Vec3::splat(random.between(0.3, 3.0));
    if mirrored {
        scale.x = -scale.x;
    }
    Affine3A::from_scale_rotation_translation(scale, rotation, random.point(5.0).into())
}

#[test]
fn an_instance_is_hit_where_its_transformed_copy_is() {
    let mut random = Random(20);
    for mirrored in [false, true] {
        let triangles = soup(&mut random, 200);
        let pose = random_pose(&mut random, mirrored);
        let copy = triangles
            .iter()
            .map(|t| TriangleInput { vertices: t.vertices.map(|v| pose.transform_point3a(v)), cull: t.cull })
            .collect();
        let (instance, copy) = (placed_world(triangles, vec![], pose), world(copy, vec![]));
        let (mut hits, mut differ) = (0, 0);
        for _ in 0..20_000 {
            let ray = ray_at(&mut random, &copy.bounds());
            let (a, b) = (instance.intersect(&ray), copy.intersect(&ray));
            assert_eq!(a.is_some(), instance.occluded(&ray));
            match (a, b) {
                (Some(a), Some(b)) if a.primitive == b.primitive => {
                    hits += 1;
                    let (p, q) = (instance.interaction(&ray, &a), copy.interaction(&ray, &b));
                    assert!((a.t - b.t).abs() < 1e-2 && (p.normal - q.normal).length() < 1e-2, "{p:?} {q:?}");
                }
                (None, None) => {}
                _ => differ += 1,
            }
        }
        assert!(hits > 2000 && differ < 10, "{hits} {differ}");
    }
}

#[test]
fn a_ray_that_leaves_an_instance_does_not_hit_the_same_surface() {
    let mut random = Random(21);
    let mut tested = 0;
    for round in 0..20_000 {
        let pose = random_pose(&mut random, round % 2 == 0);
        let (triangles, shapes) = if round % 3 == 0 {
            let shape = Quadric::Sphere { center: random.point(2.0), radius: 0.7, facing: Facing::Outward };
            (vec![], vec![ShapeInput { shape, cull: Cull::None }])
        } else {
            (vec![triangle(random.point(1.0), random.point(1.0), random.point(1.0))], vec![])
        };
        let world = placed_world(triangles, shapes, pose);
        for _ in 0..4 {
            let ray = ray_at(&mut random, &world.bounds());
            let Some(hit) = world.intersect(&ray) else { continue };
            let at = world.interaction(&ray, &hit);
            if at.normal == Vec3A::ZERO {
                continue;
            }
            let mut dir = random.direction();
            if random.unit() < 0.5 {
                dir = (dir - at.normal * dir.dot(at.normal) * 0.999).normalize();
            }
            let outward = if world.pose_at(0, 0.0).matrix3.determinant() < 0.0 { -at.normal } else { at.normal };
            if round % 3 == 0 && dir.dot(outward) < 0.0 {
                dir = -dir;
            }
            let start = offset_origin(at.position, at.error, at.normal, dir);
            assert_eq!(world.intersect(&Ray::new(start, dir)), None, "{at:?} {dir:?}");
            let light = ray.origin;
            let shadow = shadow_segment((light, Vec3A::ZERO, Vec3A::ZERO), (at.position, at.error, at.normal), 0.0);
            assert!(!world.occluded(&shadow), "{at:?} {shadow:?}");
            tested += 1;
        }
    }
    assert!(tested > 15_000, "{tested}");
}

#[test]
fn moving_instance_follows_its_pose_within_its_bounds() {
    let mut random = Random(22);
    for _ in 0..30 {
        let poses: Vec<Affine3A> = (0..3).map(|_| random_pose(&mut random, false)).collect();
        let triangles = soup(&mut random, 100);
        let blas = Arc::new(Blas::build(triangles.clone(), vec![]));
        let still = Arc::new(Blas::build(soup(&mut random, 20), vec![]));
        let far = Affine3A::from_translation(Vec3::splat(40.0));
        let world = World::build(vec![
            InstanceInput { blas: still, pose: Pose::Fixed(far) },
            InstanceInput { blas: blas.clone(), pose: Pose::Moving(poses.clone()) },
        ]);
        for (i, pose) in poses.iter().enumerate() {
            assert!(world.pose_at(1, i as f32 * 0.5).abs_diff_eq(*pose, 1e-4));
        }
        let moving_bounds =
            World::build(vec![InstanceInput { blas: blas.clone(), pose: Pose::Moving(poses) }]).bounds();
        for _ in 0..200 {
            let time = random.unit();
            let pose = world.pose_at(1, time);
            for t in &triangles {
                let p = pose.transform_point3a(t.vertices[0]);
                assert!(p.cmpge(moving_bounds.min).all() && p.cmple(moving_bounds.max).all());
            }
            let fixed = World::build(vec![InstanceInput { blas: blas.clone(), pose: Pose::Fixed(pose) }]);
            let ray = Ray { time, ..ray_at(&mut random, &fixed.bounds()) };
            let (a, b) = (world.intersect(&ray), fixed.intersect(&ray));
            if let (Some(a), Some(b)) = (a, b)
                && a.instance == 1
            {
                assert!((a.t - b.t).abs() < 1e-3 * b.t);
            }
            assert_eq!(a.filter(|h| h.instance == 1).map(|h| h.primitive), b.map(|h| h.primitive));
            assert_eq!(world.occluded(&ray), a.is_some());
        }
    }
}

#[test]
fn rotations_take_the_short_way_at_constant_speed() {
    let start = Affine3A::from_rotation_z(0.0);
    let end = Affine3A::from_rotation_z(3.0);
    let world = World::build(vec![InstanceInput {
        blas: Arc::new(Blas::build(vec![], vec![])),
        pose: Pose::Moving(vec![start, end]),
    }]);
    for i in 0..=10 {
        let time = i as f32 / 10.0;
        assert!(world.pose_at(0, time).abs_diff_eq(Affine3A::from_rotation_z(3.0 * time), 1e-5), "{time}");
    }
}

#[test]
fn of_equally_near_instances_the_lowest_wins() {
    let one = triangle(Vec3A::new(-1.0, -1.0, 0.0), Vec3A::new(1.0, -1.0, 0.0), Vec3A::new(0.0, 1.0, 0.0));
    let near = |copies: usize| Arc::new(Blas::build(vec![one; copies], vec![]));
    let shift = Affine3A::from_translation(Vec3::new(0.25, 0.0, 0.0));
    let far = Affine3A::from_translation(Vec3::splat(30.0));
    for order in 0..3 {
        let mut inputs = vec![
            InstanceInput { blas: near(3), pose: Pose::Fixed(shift) },
            InstanceInput { blas: near(1), pose: Pose::Fixed(Affine3A::IDENTITY) },
            InstanceInput { blas: near(12), pose: Pose::Fixed(far) },
        ];
        inputs.rotate_left(order);
        let lowest = inputs.iter().position(|i| !matches!(i.pose, Pose::Fixed(p) if p == far));
        let hit = World::build(inputs).intersect(&Ray::new(Vec3A::new(0.1, 0.0, 2.0), -Vec3A::Z)).expect("a hit");
        assert_eq!((Some(hit.instance as usize), hit.primitive), (lowest, 0));
    }
}
