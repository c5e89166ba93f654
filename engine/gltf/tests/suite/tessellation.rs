//! Triangles of shapes against the shapes' equations.

use super::{closest_point, spread};
use femc_geometry::{Facing, Quadric};
use femc_gltf::{Steps, Tessellation};
use femc_math::glam::{DVec3, Vec3A};
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

/// Shapes of all kinds, with both facings, tips and holes.
fn shapes() -> Vec<Quadric> {
    use Facing::{Inward, Outward};
    let center = Vec3A::new(1.0, -2.0, 0.5);
    let axis = Vec3A::new(0.48, 0.6, 0.64);
    let cone = |start_radius, end_radius, facing| Quadric::Cone {
        start: center,
        end: center + axis * 2.0,
        start_radius,
        end_radius,
        facing,
    };
    vec![
        Quadric::Sphere { center, radius: 0.7, facing: Outward },
        Quadric::Sphere { center, radius: 30.0, facing: Inward },
        cone(0.5, 0.5, Outward),
        cone(0.5, 0.2, Inward),
        cone(0.0, 0.8, Outward),
        cone(0.8, 0.0, Inward),
        Quadric::Ring { center, normal: axis, inner: 0.0, outer: 0.6 },
        Quadric::Ring { center, normal: -axis, inner: 0.4, outer: 0.6 },
        Quadric::Torus { center, axis, major: 0.9, minor: 0.2, facing: Outward },
        Quadric::Torus { center, axis, major: 0.5, minor: 0.5, facing: Inward },
    ]
}

fn cases() -> impl Iterator<Item = (Quadric, Steps, Tessellation)> {
    let shares = [0.0002, 0.002, 0.03];
    shapes().into_iter().flat_map(move |shape| {
        shares.map(|share| {
            let steps = Steps::for_deviation(&shape, share * f64::from(shape.bounds().size().length()));
            (shape, steps, Tessellation::new(&shape, steps))
        })
    })
}

fn corners(mesh: &Tessellation, triangle: [u32; 3]) -> [DVec3; 3] {
    triangle.map(|vertex| mesh.positions[vertex as usize].as_dvec3())
}

/// Returns the distance of a point from the surface without its ends, by the equations of the shapes.
fn distance(shape: &Quadric, p: DVec3) -> f64 {
    match *shape {
        Quadric::Sphere { center, radius, .. } => ((p - center.as_dvec3()).length() - f64::from(radius)).abs(),
        Quadric::Cone { start, end, start_radius, end_radius, .. } => {
            let (start, end) = (start.as_dvec3(), end.as_dvec3());
            let length = (end - start).length();
            let axis = (end - start) / length;
            let along = (p - start).dot(axis);
            let radial = (p - start - axis * along).length();
            let slope = f64::from(end_radius - start_radius) / length;
            (radial - f64::from(start_radius) - slope * along).abs() / (1.0 + slope * slope).sqrt()
        }
        Quadric::Ring { center, normal, .. } => (p - center.as_dvec3()).dot(normal.as_dvec3().normalize()).abs(),
        Quadric::Torus { center, axis, major, minor, .. } => {
            let (q, axis) = (p - center.as_dvec3(), axis.as_dvec3().normalize());
            let height = q.dot(axis);
            let radial = (q - axis * height).length() - f64::from(major);
            (radial.hypot(height) - f64::from(minor)).abs()
        }
    }
}

#[test]
fn vertices_lie_on_the_surface() {
    for (shape, _, mesh) in cases() {
        for position in &mesh.positions {
            let off = distance(&shape, position.as_dvec3());
            assert!(
                off <= 3e-7 * (3.0 + f64::from(shape.bounds().size().length())),
                "{shape:?}: {off} m at {position}"
            );
        }
    }
}

#[test]
fn surface_points_are_within_the_deviation() {
    for (shape, steps, mesh) in cases().filter(|(_, _, mesh)| mesh.triangles.len() < 10_000) {
        let deviation = steps.deviation(&shape);
        let mut largest = 0.0f64;
        for k in 0..300 {
            let [u, v, ..] = spread(k);
            // Flat rings deviate only at their rims.
            let point = shape.point_at([u, if k % 3 == 0 { 1.0 } else { v }]).0;
            let near = mesh.triangles.iter().map(|it| closest_point(corners(&mesh, *it), point).distance(point));
            largest = largest.max(near.fold(f64::INFINITY, f64::min));
        }
        assert!(largest <= deviation, "{shape:?}, {steps:?}: {largest} m, stated {deviation} m");
        assert!(
            largest >= 0.2 * deviation,
            "{shape:?}, {steps:?}: {deviation} m is stated, but only {largest} m found"
        );
    }
}

#[test]
fn points_of_triangles_are_within_the_deviation() {
    for (shape, steps, mesh) in cases() {
        let deviation = steps.deviation(&shape);
        for (k, triangle) in (0..).zip(&mesh.triangles) {
            let [u, v, ..] = spread(k);
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let [a, b, c] = corners(&mesh, *triangle);
            let off = distance(&shape, a + (b - a) * u + (c - a) * v);
            assert!(off <= deviation, "{shape:?}: {off} m, stated {deviation} m");
        }
    }
}

#[test]
fn a_deviation_within_reach_is_kept() {
    for shape in shapes() {
        for share in [0.0005, 0.002, 0.01, 0.05] {
            let wanted = share * f64::from(shape.bounds().size().length());
            let steps = Steps::for_deviation(&shape, wanted);
            let rounding = 1e-5 * f64::from(shape.bounds().size().length());
            assert!(steps.deviation(&shape) <= wanted + rounding, "{shape:?} at {share}: {steps:?}");
        }
        let finest = Steps::for_deviation(&shape, 0.0);
        assert!(finest.around == 256 && finest.along <= 256, "{finest:?}");
    }
}

#[test]
fn areas_and_volumes_approach_closed_forms() {
    for (shape, steps, mesh) in cases() {
        let (area, volume) = mesh.triangles.iter().fold((0.0, 0.0), |(area, volume), triangle| {
            let [a, b, c] = corners(&mesh, *triangle);
            let normal = (b - a).cross(c - a);
            (area + 0.5 * normal.length(), volume + a.dot(normal) / 6.0)
        });
        let thin = match shape {
            Quadric::Sphere { radius, .. } => f64::from(radius),
            Quadric::Torus { minor, .. } => f64::from(minor),
            Quadric::Cone { start_radius, end_radius, .. } => f64::from(start_radius.max(end_radius)),
            Quadric::Ring { inner, outer, .. } => f64::from(outer - inner),
        };
        let tolerance = 4.0 * steps.deviation(&shape) / thin;
        assert!((area / shape.area() - 1.0).abs() <= tolerance, "{shape:?}: area {area}, not {}", shape.area());
        let sign = if shape.facing() == Facing::Inward { -1.0 } else { 1.0 };
        let expected = match shape {
            Quadric::Sphere { radius, .. } => TAU / 1.5 * f64::from(radius).powi(3),
            Quadric::Torus { major, minor, .. } => PI * TAU * f64::from(major) * f64::from(minor * minor),
            _ => continue,
        };
        assert!((sign * volume / expected - 1.0).abs() <= tolerance, "{shape:?}: volume {volume}, not {expected}");
    }
}

#[test]
fn triangles_face_like_the_shape() {
    for (shape, _, mesh) in cases() {
        for triangle in &mesh.triangles {
            let [a, b, c] = corners(&mesh, *triangle);
            let facing = (b - a).cross(c - a);
            let normals = triangle.map(|vertex| mesh.normals[vertex as usize].as_dvec3());
            assert!(facing.dot(normals.iter().sum()) > 0.0, "{shape:?}: {triangle:?} faces away from its normals");
            // By the equations: a small step to the front of an outward sphere leads away from its center.
            let front = (a + b + c) / 3.0 + facing.normalize();
            if let Quadric::Sphere { center, facing, .. } = shape {
                let [middle, front] = [(a + b + c) / 3.0, front].map(|p| p.distance(center.as_dvec3()));
                assert_eq!(front > middle, facing == Facing::Outward);
            }
        }
    }
}

#[test]
fn closed_shapes_have_closed_triangles_without_twins() {
    for (shape, steps, mesh) in cases() {
        assert_eq!(mesh.triangles.len() as u64, steps.triangles(&shape), "{shape:?}");
        assert_eq!(mesh.positions.len(), mesh.normals.len());
        let used: std::collections::BTreeSet<u32> = mesh.triangles.iter().flatten().copied().collect();
        assert_eq!(used.len(), mesh.positions.len(), "{shape:?}: all vertices are used");
        let mut edges: BTreeMap<(u32, u32), i32> = BTreeMap::new();
        for [a, b, c] in &mesh.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                *edges.entry((*from.min(to), *from.max(to))).or_default() += if from < to { 1 } else { -1 };
            }
        }
        if matches!(shape, Quadric::Sphere { .. } | Quadric::Torus { .. }) {
            assert!(edges.values().all(|sum| *sum == 0), "{shape:?}: each edge has a triangle on both sides");
        }
    }
}
