use super::*;
use crate::{Facing, Quadric, offset_origin};
use femc_math::glam::DVec3;

fn quadrics(random: &mut Random, scale: f32) -> Vec<Quadric> {
    let facing = if random.unit() < 0.5 { Facing::Outward } else { Facing::Inward };
    let mut size = || scale * random.between(0.2, 2.0);
    let (r0, r1, r2) = (size(), size(), size());
    let center = random.point(scale * 3.0);
    let (axis, end) = (random.direction(), center + random.direction() * r2);
    vec![
        Quadric::Sphere { center, radius: r0, facing },
        Quadric::Cone { start: center, end, start_radius: r0, end_radius: r0, facing },
        Quadric::Cone { start: center, end, start_radius: r0, end_radius: r1, facing },
        Quadric::Cone { start: center, end, start_radius: 0.0, end_radius: r1, facing },
        Quadric::Ring { center, normal: axis, inner: 0.3 * r1, outer: r1 },
        Quadric::Torus { center, axis, major: r0.max(r1), minor: r0.min(r1) * 0.9, facing },
    ]
}

/// Returns a function that is negative inside, positive outside, and approximates the distance near the surface. It is zero for a
/// ring.
fn signed_distance(quadric: &Quadric, p: DVec3) -> f64 {
    let axial = |origin: Vec3A, axis: DVec3| {
        let q = p - origin.as_dvec3();
        let z = q.dot(axis);
        (z, (q - axis * z).length())
    };
    match *quadric {
        Quadric::Sphere { center, radius, .. } => (p - center.as_dvec3()).length() - f64::from(radius),
        Quadric::Cone { start, end, start_radius, end_radius, .. } => {
            let way = end.as_dvec3() - start.as_dvec3();
            let (z, r) = axial(start, way.normalize());
            let slope = f64::from(end_radius) - f64::from(start_radius);
            let slope = slope / way.length();
            (r - (f64::from(start_radius) + slope * z)) / (1.0 + slope * slope).sqrt()
        }
        Quadric::Ring { .. } => 0.0,
        Quadric::Torus { center, axis, major, minor, .. } => {
            let (z, r) = axial(center, axis.as_dvec3().normalize());
            (r - f64::from(major)).hypot(z) - f64::from(minor)
        }
    }
}

/// Returns the distances at which the ray crosses the surface, by stepping and bisection.
fn crossings(quadric: &Quadric, ray: &Ray, reach: f64) -> Vec<f64> {
    let (o, d) = (ray.origin.as_dvec3(), ray.dir.as_dvec3());
    let at = |t: f64| signed_distance(quadric, o + d * t);
    let steps = 4000;
    let mut found = Vec::new();
    for i in 0..steps {
        let (mut lo, mut hi) = (reach * f64::from(i) / f64::from(steps), reach * f64::from(i + 1) / f64::from(steps));
        if (at(lo) < 0.0) != (at(hi) < 0.0) {
            let low = at(lo) < 0.0;
            for _ in 0..60 {
                let middle = 0.5 * (lo + hi);
                if (at(middle) < 0.0) == low { lo = middle } else { hi = middle }
            }
            let t = 0.5 * (lo + hi);
            let on = match *quadric {
                Quadric::Cone { start, end, .. } => {
                    let way = end.as_dvec3() - start.as_dvec3();
                    (0.0..=1.0).contains(&((o + d * t - start.as_dvec3()).dot(way) / way.length_squared()))
                }
                _ => true,
            };
            if on {
                found.push(t);
            }
        }
    }
    found
}

#[test]
fn shapes_are_hit_where_stepping_along_the_ray_finds_them() {
    let mut random = Random(10);
    let (mut hits, mut checked) = (0, 0);
    for _ in 0..60 {
        for quadric in quadrics(&mut random, 1.0) {
            if let Quadric::Ring { .. } = quadric {
                continue;
            }
            let world = world(vec![], vec![ShapeInput { shape: quadric, cull: Cull::None }]);
            for _ in 0..15 {
                let ray = ray_at(&mut random, &quadric.bounds());
                let expected = crossings(&quadric, &ray, 30.0);
                checked += 1;
                match (world.intersect(&ray), expected.first()) {
                    (Some(hit), Some(&t)) => {
                        hits += 1;
                        assert!((f64::from(hit.t) - t).abs() < 1e-5 * (1.0 + t), "{quadric:?} {ray:?} {t} {hit:?}");
                        let p = world.interaction(&ray, &hit).position.as_dvec3();
                        assert!(signed_distance(&quadric, p).abs() < 1e-5);
                        assert!((0.0..=1.0).contains(&hit.u) && (0.0..=1.0).contains(&hit.v));
                    }
                    (None, None) => {}
                    // Stepping misses anything thinner than a step; such a chord must be short.
                    (Some(hit), None) => {
                        let p = (ray.origin + ray.dir * (hit.t + 0.004)).as_dvec3();
                        assert!(signed_distance(&quadric, p).abs() < 0.02, "{quadric:?} {ray:?} {hit:?}");
                    }
                    (None, Some(t)) => panic!("missed at {t}: {quadric:?} {ray:?}"),
                }
            }
        }
    }
    assert!(hits > checked / 4, "{hits} of {checked}");
}

#[test]
fn a_ring_is_hit_between_its_radii_only() {
    let shape = Quadric::Ring { center: Vec3A::new(1.0, 2.0, 3.0), normal: Vec3A::Z, inner: 0.5, outer: 1.0 };
    let world = world(vec![], vec![ShapeInput { shape, cull: Cull::Back }]);
    for (x, hit) in [(0.0, false), (0.49, false), (0.51, true), (0.99, true), (1.01, false)] {
        let down = Ray::new(Vec3A::new(1.0 + x, 2.0, 5.0), -Vec3A::Z);
        assert_eq!(world.intersect(&down).map(|h| h.t), hit.then_some(2.0), "{x}");
        assert!(!world.occluded(&Ray::new(Vec3A::new(1.0 + x, 2.0, 1.0), Vec3A::Z)), "seen from behind at {x}");
    }
}

#[test]
fn normals_face_front_and_positions_are_within_the_error_bound() {
    let mut random = Random(11);
    for power in [-2, 0, 2] {
        let scale = 10.0f32.powi(power);
        for _ in 0..200 {
            for quadric in quadrics(&mut random, scale) {
                let world = world(vec![], vec![ShapeInput { shape: quadric, cull: Cull::Back }]);
                let ray = ray_at(&mut random, &quadric.bounds());
                let Some(hit) = world.intersect(&ray) else { continue };
                let at = world.interaction(&ray, &hit);
                assert!((at.normal.length() - 1.0).abs() < 1e-5);
                assert!(at.normal.dot(ray.dir) < 1e-3, "one-sided, so seen from the front: {quadric:?} {at:?}");
                let distance = signed_distance(&quadric, at.position.as_dvec3()).abs();
                assert!(
                    distance <= 1.001 * f64::from(at.normal.abs().dot(at.error)),
                    "{quadric:?} {distance:e} {at:?}"
                );
                assert!((at.position - ray.at(hit.t)).length() < 1e-5 * (scale + hit.t + at.position.length()));
            }
        }
    }
}

#[test]
fn a_ray_that_leaves_a_convex_shape_outward_never_hits_it_again() {
    let mut random = Random(12);
    let mut tested = 0;
    for round in 0..3000 {
        let scale = 10.0f32.powi(round % 6 - 3);
        let all = quadrics(&mut random, scale);
        for (kind, quadric) in all.into_iter().enumerate() {
            let world = world(vec![], vec![ShapeInput { shape: quadric, cull: Cull::None }]);
            for _ in 0..4 {
                let ray = ray_at(&mut random, &quadric.bounds());
                let Some(hit) = world.intersect(&ray) else { continue };
                let at = world.interaction(&ray, &hit);
                let outward = if quadric.facing() == Facing::Inward { -at.normal } else { at.normal };
                let mut dir = random.direction();
                if random.unit() < 0.5 {
                    let off = 1.0 - 10.0f32.powi(-(random.bits() as i32 % 8));
                    dir = (dir - outward * dir.dot(outward) * off).normalize();
                }
                let side = dir.dot(outward);
                let start = offset_origin(at.position, at.error, at.normal, dir);
                let again = world.intersect(&Ray::new(start, dir));
                tested += 1;
                // A ray that starts just above a convex surface and sinks by less than this stays above it.
                if kind == 4 || (side > 0.0 && kind != 5) {
                    assert_eq!(again, None, "{quadric:?} {at:?} {dir:?}");
                } else if let Some(again) = again {
                    // From inside, or around a torus, the distance to the next crossing must be larger than a rounding error.
                    let chord = if kind == 0 { side.abs() * scale * 0.2 } else { 0.0 };
                    assert!(again.t >= chord && again.t > 0.0, "{quadric:?} {at:?} {dir:?} {again:?}");
                    let far = start.as_dvec3() + dir.as_dvec3() * (0.5 * f64::from(again.t));
                    let starts_outside = signed_distance(&quadric, start.as_dvec3()) > 0.0;
                    assert_eq!(
                        signed_distance(&quadric, far) > 0.0,
                        starts_outside,
                        "crossed a surface unseen: {quadric:?}"
                    );
                }
            }
        }
    }
    assert!(tested > 20_000, "{tested}");
}

#[test]
fn inside_a_closed_shape_every_ray_is_stopped() {
    let mut random = Random(13);
    for round in 0..40_000 {
        let scale = 10.0f32.powi(round % 4 - 1);
        let all = quadrics(&mut random, scale);
        let (sphere, torus) = (all[0], all[5]);
        for quadric in [sphere, torus] {
            let start = match quadric {
                Quadric::Sphere { center, radius, .. } => {
                    center + random.direction() * radius * random.between(0.0, 0.999)
                }
                Quadric::Torus { center, axis, major, minor, .. } => {
                    let out = axis.any_orthonormal_vector();
                    center + out * (major + minor * random.between(-0.99, 0.99))
                }
                _ => continue,
            };
            let world = world(vec![], vec![ShapeInput { shape: quadric, cull: Cull::None }]);
            assert!(world.occluded(&Ray::new(start, random.direction())), "{quadric:?} {start:?}");
        }
    }
}

#[test]
fn shapes_and_triangles_share_a_tree() {
    let mut random = Random(14);
    let triangles = soup(&mut random, 50);
    let shapes: Vec<ShapeInput> =
        (0..10).flat_map(|_| quadrics(&mut random, 0.5)).map(|shape| ShapeInput { shape, cull: Cull::None }).collect();
    let both = world(triangles.clone(), shapes.clone());
    let parts = [world(triangles.clone(), vec![]), world(vec![], shapes)];
    for _ in 0..20_000 {
        let ray = ray_at(&mut random, &both.bounds());
        let [a, b] = [0, 1].map(|i| parts[i].intersect(&ray));
        let b = b.map(|mut h| {
            h.primitive += triangles.len() as u32;
            h
        });
        let nearest = match (a, b) {
            (Some(a), Some(b)) => Some(if a.t <= b.t { a } else { b }),
            (a, b) => a.or(b),
        };
        assert_eq!(both.intersect(&ray), nearest);
        assert_eq!(both.occluded(&ray), nearest.is_some());
    }
}

#[test]
fn parameters_name_the_point_that_has_them() {
    let mut random = Random(29);
    for _ in 0..50 {
        for quadric in quadrics(&mut random, 1.0) {
            for k in 1..8 {
                let uv = [f64::from(k) / 8.3, f64::from(k * 3 % 8) / 8.0 + 0.02];
                let (point, normal) = quadric.point_at(uv);
                let found = quadric.nearest(point);
                assert!(
                    (found.position - point).length() < 1e-9 && (found.normal - normal).length() < 1e-9,
                    "{quadric:?}"
                );
                assert!(
                    (found.uv[0] - uv[0]).abs() < 1e-9 && (found.uv[1] - uv[1]).abs() < 1e-9,
                    "{quadric:?}: {uv:?} {:?}",
                    found.uv
                );
                let share = quadric.share_below(uv[1]);
                assert!((quadric.parameter_at_share(share) - uv[1]).abs() < 1e-9);
            }
            // A step of the share covers that share of the area at any position.
            for share in [0.1, 0.3, 0.8] {
                let area = band_area(&quadric, share, 1e-4);
                assert!((area / (quadric.area() * 1e-4) - 1.0).abs() < 1e-3, "{quadric:?}");
            }
        }
    }
}

/// Returns the area of a band around a share of the area.
fn band_area(quadric: &Quadric, share: f64, width: f64) -> f64 {
    let at = |u: f64, share: f64| quadric.point_at([u, quadric.parameter_at_share(share.clamp(0.0, 1.0))]).0;
    let step = 1e-4;
    let along = (at(step, share) - at(0.0, share)) / step;
    let across = at(0.0, share + 0.5 * width) - at(0.0, share - 0.5 * width);
    along.cross(across).length()
}

#[test]
fn bisection_has_the_same_bits_from_the_closed_form() {
    let mut random = Random(12);
    for _ in 0..20 {
        for quadric in quadrics(&mut random, 1.0) {
            let dyadic = (0..=64u32).map(|k| f64::from(k) / 64.0);
            let tiny = (1..60).flat_map(|k| [0.5f64.powi(k), 1.0 - 0.5f64.powi(k)]);
            let shares: Vec<f64> = (0..200).map(|_| f64::from(random.unit())).chain(dyadic).chain(tiny).collect();
            for share in shares {
                let (found, whole) = (quadric.parameter_at_share(share), quadric.bisect_share(share, [0.0, 1.0], 52));
                assert_eq!(found.to_bits(), whole.to_bits(), "{quadric:?}: {share}");
            }
        }
    }
}
