//! Factors between points and elements, against closed forms and quadrature in double precision.

use super::{
    GRAY, face, full_arena, gauss8, leaves_of, midpoints, oracle, outward_box, prepare, prepared_position, split,
};
use crate::arena::Arena;
use crate::element::{Element, Shape};
use crate::fog_factor::attenuated_length;
use crate::form_factor::{polygon_form_factor, solid_angle};
use crate::gather::ElementLights;
use crate::scene::Scene;
use crate::visibility::VisibilityTester;
use femc_field::SurfaceSpot;
use femc_math::glam::{DVec3, Vec3A};
use std::f64::consts::PI;

/// Returns the mean over a rectangle of the form factor to a polygon, by Gauss's rule on a grid of parts.
fn mean_form_factor(corner: DVec3, [a, b]: [DVec3; 2], normal: DVec3, polygon: &[DVec3]) -> f64 {
    const PARTS: u32 = 8;
    let corners: Vec<Vec3A> = polygon.iter().map(|corner| corner.as_vec3a()).collect();
    let mut sum = 0.0;
    for part in 0..PARTS * PARTS {
        for (x, wx) in gauss8() {
            for (y, wy) in gauss8() {
                let [u, v] = [f64::from(part % PARTS) + x, f64::from(part / PARTS) + y].map(|x| x / f64::from(PARTS));
                let point = (corner + a * u + b * v).as_vec3a();
                sum += wx * wy * f64::from(polygon_form_factor(point, normal.as_vec3a(), &corners));
            }
        }
    }
    sum / f64::from(PARTS * PARTS)
}

/// Two equal parallel rectangles of a x b at distance c: Hottel's formula \[howell2010\].
fn parallel_rectangles(a: f64, b: f64, c: f64) -> f64 {
    let (x, y) = (a / c, b / c);
    let (sx, sy) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
    let logarithm = 0.5 * ((1.0 + x * x) * (1.0 + y * y) / (1.0 + x * x + y * y)).ln();
    let arcs = x * sy * (x / sy).atan() + y * sx * (y / sx).atan() - x * x.atan() - y * y.atan();
    2.0 / (PI * x * y) * (logarithm + arcs)
}

#[test]
fn parallel_rectangles_have_hottels_form_factor() {
    for (a, b, c, known) in [(1.0, 1.0, 1.0, 0.199_824_9), (1.0, 2.0, 1.0, 0.285_875_4), (3.0, 0.5, 1.5, f64::NAN)] {
        let want = parallel_rectangles(a, b, c);
        assert!(known.is_nan() || (want - known).abs() < 1e-7, "{want}");
        // Seen from below, clockwise from above.
        let top = [[0.0, 0.0], [0.0, b], [a, b], [a, 0.0]].map(|[x, y]| DVec3::new(x, y, c));
        let found = mean_form_factor(DVec3::ZERO, [DVec3::X * a, DVec3::Y * b], DVec3::Z, &top);
        assert!((found - want).abs() < 2e-6, "{a} x {b} at {c}: {found}, not {want}");
    }
}

/// Rectangles with a common edge of length 1 at a right angle: the factor from the one of width `w` to the one of height `h`.
fn perpendicular_rectangles(w: f64, h: f64) -> f64 {
    let (w2, h2, s) = (w * w, h * h, w * w + h * h);
    let arcs = w * (1.0 / w).atan() + h * (1.0 / h).atan() - s.sqrt() * (1.0 / s.sqrt()).atan();
    let logarithm = ((1.0 + w2) * (1.0 + h2) / (1.0 + s)).ln()
        + w2 * (w2 * (1.0 + s) / ((1.0 + w2) * s)).ln()
        + h2 * (h2 * (1.0 + s) / ((1.0 + h2) * s)).ln();
    (arcs + 0.25 * logarithm) / (PI * w)
}

#[test]
fn perpendicular_rectangles_have_the_closed_form() {
    for (w, h, known) in [(1.0, 1.0, 0.200_043_8), (1.0, 2.0, 0.232_852_6), (2.0, 1.0, 0.116_426_3)] {
        let want = perpendicular_rectangles(w, h);
        assert!((want - known).abs() < 1e-7, "{want}");
        let wall = [[0.0, 0.0], [0.0, h], [1.0, h], [1.0, 0.0]].map(|[y, z]| DVec3::new(0.0, y, z));
        // Counterclockwise as seen from x > 0 is y before z.
        let wall = [wall[0], wall[3], wall[2], wall[1]];
        let found = mean_form_factor(DVec3::ZERO, [DVec3::X * w, DVec3::Y], DVec3::Z, &wall);
        // The integrand has a kink at the common edge.
        assert!((found - want).abs() < 3e-4, "{w} {h}: {found}, not {want}");
    }
}

#[test]
fn a_cube_sends_all_light_to_its_other_five_sides() {
    let sum = parallel_rectangles(1.0, 1.0, 1.0) + 4.0 * perpendicular_rectangles(1.0, 1.0);
    assert!((sum - 1.0).abs() < 1e-12, "{sum}");
    let octant = [Vec3A::X, Vec3A::Y, Vec3A::Z].map(|axis| axis * 7.0);
    // Corners x, y, z turn counterclockwise as seen from outside.
    assert!((solid_angle(Vec3A::ZERO, &[octant[0], octant[2], octant[1]]) - 0.5 * PI as f32).abs() < 1e-5);
    assert_eq!(solid_angle(Vec3A::ZERO, &octant), 0.0, "from behind");
}

/// Sums the factor of all leaves of a source at a point of a receiver.
fn factor_of(world: (&Scene<'_>, &Arena), p: &Element, root: u32, node: &SurfaceSpot) -> f64 {
    let (scene, arena) = world;
    let lights = ElementLights::new(arena);
    let oracle = oracle(scene, arena, &lights.elements);
    let mut tester = VisibilityTester::default();
    let leaves = leaves_of(arena, root);
    leaves.iter().map(|&q| f64::from(oracle.factor(p, &arena.elements[q as usize], node, &mut tester))).sum()
}

#[test]
fn coaxial_discs_have_their_form_factor() {
    for (r1, r2, h, want) in [(1.0, 1.0, 1.0, 0.381_966), (1.0, 2.0, 1.0, 0.763_932), (0.5, 1.0, 2.0, 0.192_236)] {
        let text = format!(
            "{GRAY}v a =\n  p 0 0 0\n  n 0 0 1\nring a 0 {r1}\nv b =\n  p 0 0 {h}\n  n 0 0 -1\nring b 0 {r2}\n"
        );
        let prepared = prepare(&text);
        let scene = Scene::new(&prepared);
        let mut arena = full_arena(&scene);
        let [a, b] = [0, 1].map(|surface| arena.roots[surface]);
        split(&mut arena, &scene, a, 5);
        split(&mut arena, &scene, b, 9);
        let world = (&scene, &arena);
        let middle = SurfaceSpot {
            position: prepared_position(&prepared, [0.0; 3]),
            normal: Vec3A::Z,
            ..SurfaceSpot::default()
        };
        let p = &arena.elements[leaves_of(&arena, a)[0] as usize];
        let (at_middle, exact) = (factor_of(world, p, b, &middle), r2 * r2 / (r2 * r2 + h * h));
        assert!((at_middle / exact - 1.0).abs() < 2e-3, "{at_middle}, not {exact}");
        let (mut sum, mut area) = (0.0, 0.0);
        for leaf in leaves_of(&arena, a) {
            let element = &arena.elements[leaf as usize];
            let mean = element.nodes().map(|node| factor_of(world, element, b, &node)).sum::<f64>() / 4.0;
            (sum, area) = (sum + mean * f64::from(element.size()), area + f64::from(element.size()));
        }
        assert!((sum / area / want - 1.0).abs() < 3e-3, "{r1} {r2} {h}: {}, not {want}", sum / area);
    }
}

/// Number of points by axis of the references.
const POINTS: u32 = 64;
const SIGMA: f64 = 0.7;

/// Returns the factor of a parallelogram in fog, by quadrature.
/// - `at`: the point, and its normal on a surface; without one, the point is in the fog.
fn patch_reference((point, normal): (DVec3, Option<DVec3>), [corner, a, b]: [DVec3; 3]) -> f64 {
    let (facing, area) = (a.cross(b).normalize(), a.cross(b).length());
    let kernel = |u: f64, v: f64| {
        let way = corner + a * u + b * v - point;
        let (distance, dir) = (way.length(), way.normalize());
        let cosine = normal.map_or(0.25, |normal| normal.dot(dir).max(0.0));
        cosine * (-facing.dot(dir)).max(0.0) / (PI * distance * distance) * (-SIGMA * distance).exp()
    };
    let sum: f64 =
        midpoints(POINTS).flat_map(|u| midpoints(POINTS).map(move |v| (u, v))).map(|(u, v)| kernel(u, v)).sum();
    sum * area / f64::from(POINTS * POINTS)
}

/// Returns the factor of a box of fog, by quadrature: a quarter of the light from all directions, or the irradiance of a surface.
fn box_reference((point, normal): (DVec3, Option<DVec3>), low: DVec3, high: DVec3) -> f64 {
    let mut sum = 0.0;
    for x in midpoints(POINTS) {
        for y in midpoints(POINTS) {
            for z in midpoints(POINTS) {
                let way = low + (high - low) * DVec3::new(x, y, z) - point;
                let distance = way.length();
                let cosine = normal.map_or(0.25, |normal| normal.dot(way / distance).max(0.0));
                sum += cosine / (PI * distance * distance) * (-SIGMA * distance).exp();
            }
        }
    }
    let size = high - low;
    sum * size.x * size.y * size.z / f64::from(POINTS.pow(3))
}

/// A floor and a wall in fog that fills all space.
#[test]
fn surfaces_in_fog_are_attenuated_like_the_quadrature() {
    let floor = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
    for (distance, size) in [(0.6, 1.0), (2.0, 1.0), (4.0, 0.5), (3.0, 6.0)] {
        let wall = [[-distance, 0.0, 0.0], [-distance, size, 0.0], [-distance, size, size], [-distance, 0.0, size]];
        let text = format!("medium haze =\n  sigma_s 0.7\nmglobal haze\n{GRAY}{}{}", face(&floor), face(&wall));
        let prepared = prepare(&text);
        let scene = Scene::new(&prepared);
        let mut arena = full_arena(&scene);
        let (p, q) = (arena.roots[0], arena.roots[1]);
        let place = |point: [f64; 3]| DVec3::from_array(point) - prepared.origin;
        let edges = [place(wall[0]), DVec3::Y * size, DVec3::Z * size];
        let lights = ElementLights::new(&arena);
        let element = &arena.elements[p as usize];
        for node in element.nodes() {
            let reference = patch_reference((node.position.as_dvec3(), Some(DVec3::Z)), edges);
            let found = factor_of((&scene, &arena), element, q, &node);
            assert!((found / reference - 1.0).abs() < 0.02, "{distance} {size}: {found}, not {reference}");
        }
        assert_eq!(lights.elements.len(), arena.elements.len());
        // At points of the fog.
        let fog = arena.fog;
        split(&mut arena, &scene, fog, 3);
        let volume = &arena.elements[leaves_of(&arena, fog)[0] as usize];
        let spot = SurfaceSpot { position: place([0.3, 0.4, 0.5]).as_vec3a(), ..SurfaceSpot::default() };
        let reference = patch_reference((spot.position.as_dvec3(), None), edges);
        let found = factor_of((&scene, &arena), volume, q, &spot);
        assert!((found / reference - 1.0).abs() < 0.02, "fog, {distance} {size}: {found}, not {reference}");
    }
}

#[test]
fn boxes_of_fog_send_what_the_quadrature_over_their_volume_says() {
    let text = format!(
        "medium haze =\n  sigma_s 0.7\nmglobal haze\n{GRAY}{}",
        face(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    );
    let prepared = prepare(&text);
    let scene = Scene::new(&prepared);
    let mut arena = full_arena(&scene);
    let floor = arena.roots[0];
    let fog = arena.fog;
    split(&mut arena, &scene, fog, 6);
    let p = &arena.elements[floor as usize];
    let lights = ElementLights::new(&arena);
    let oracle = oracle(&scene, &arena, &lights.elements);
    let mut tester = VisibilityTester::default();
    let mut checked = [0; 2];
    for leaf in leaves_of(&arena, fog).into_iter().step_by(3) {
        let q = &arena.elements[leaf as usize];
        let (low, high) = ((q.center - q.half_extent).as_dvec3(), (q.center + q.half_extent).as_dvec3());
        let node = p.node(1);
        // The quadrature is exact for points that are not at the box.
        let distance = node.position.distance(q.center);
        if distance < 1.3 * q.radius || high.z < f64::from(node.position.z) {
            continue;
        }
        checked[usize::from(distance > 3.0 * q.radius)] += 1;
        let inside = SurfaceSpot { normal: Vec3A::ZERO, ..node };
        for (spot, normal, receiver) in [(node, Some(DVec3::Z), p), (inside, None, q)] {
            let reference = box_reference((spot.position.as_dvec3(), normal), low, high);
            let found = f64::from(oracle.factor_from_fog(receiver, q, &spot, &mut tester));
            // Beyond three radii a box is one point, also if the horizon cuts it.
            let is_cut = low.z < f64::from(node.position.z) && normal.is_some();
            let slack = if is_cut {
                0.3
            } else if distance > 3.0 * q.radius {
                0.08
            } else {
                0.03
            };
            assert!((found - reference).abs() < slack * reference + 1e-6, "{q:?}: {found}, not {reference}");
        }
    }
    assert!(checked[0] > 3 && checked[1] > 3, "{checked:?}");
}

#[test]
fn attenuated_length_is_the_integral_of_the_transmittance() {
    for extinction in [0.01f32, 0.3, 1.0, 7.0] {
        for distance in [0.0f32, 0.01, 0.349, 0.351, 2.0, 30.0] {
            let (sigma, length) = (f64::from(extinction), f64::from(distance));
            const STEPS: u32 = 20_000;
            let sum: f64 = midpoints(STEPS).map(|t| (-sigma * length * t).exp()).sum();
            let want = sum * length / f64::from(STEPS);
            let found = f64::from(attenuated_length(extinction, distance));
            assert!((found - want).abs() <= 2e-5 * want, "{extinction} {distance}: {found}, not {want}");
        }
    }
}

/// From far away, a cluster or a curved element receives 1 / d2 of the intensity, and a sphere sends its area's share.
#[test]
fn directional_factors_fall_with_the_squared_distance() {
    let text = format!("{GRAY}{}v s =\n  p 9 0 0\nsph s 0.5\n", outward_box([0.0; 3], [0.5, 0.5, 0.5]));
    let prepared = prepare(&text);
    let scene = Scene::new(&prepared);
    let arena = full_arena(&scene);
    let lights = ElementLights::new(&arena);
    let oracle = oracle(&scene, &arena, &lights.elements);
    let mut tester = VisibilityTester::default();
    let sphere = &arena.elements[arena.roots[6] as usize];
    let wall = &arena.elements[arena.roots[5] as usize];
    assert!(wall.normal() == Vec3A::X && matches!(sphere.shape, Shape::Curved(_)));
    let node = wall.center_spot();
    let way = (sphere.center - node.position).as_dvec3();
    let want = way.normalize().x / way.length_squared();
    let found = f64::from(oracle.factor(wall, sphere, &node, &mut tester));
    assert!((found / want - 1.0).abs() < 1e-5, "{found}, not {want}");
    // The other way round, the light of the wall at the sphere's center, on a surface that faces the wall.
    let back = f64::from(oracle.factor(sphere, wall, &sphere.node(0), &mut tester));
    let way = (wall.center - sphere.center).as_dvec3();
    let want = 0.25 * -way.normalize().x / (PI * way.length_squared());
    assert!((back / want - 1.0).abs() < 1e-4, "{back}, not {want}");
}
