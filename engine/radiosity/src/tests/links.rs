//! Decisions on links, estimates of their errors against the true errors, and visibility.

use super::{GRAY, face, full_arena, leaves_of, midpoints, oracle, outward_box, prepare, prepared_position, split};
use crate::gather::{ElementLight, ElementLights};
use crate::link::{LinkDecision, Oracle};
use crate::scene::Scene;
use crate::visibility::VisibilityTester;
use femc_field::SurfaceSpot;
use femc_math::Rgb;
use femc_math::glam::{DVec3, Vec3A};
use std::f64::consts::PI;

/// Light of an element with this radiosity everywhere.
fn bright(radiosity: f32) -> ElementLight {
    ElementLight { radiosity: Rgb::splat(radiosity), darkest: radiosity, brightest: radiosity, ..ElementLight::ZERO }
}

/// Returns the irradiance of a point with normal z from a parallelogram of radiosity 1, by quadrature.
fn irradiance(point: DVec3, [corner, a, b]: [DVec3; 3]) -> f64 {
    const COUNT: u32 = 48;
    let facing = a.cross(b);
    let kernel = |u: f64, v: f64| {
        let way = corner + a * u + b * v - point;
        way.z.max(0.0) * (-facing.dot(way)).max(0.0) / (PI * way.length_squared() * way.length_squared())
    };
    let sum: f64 =
        midpoints(COUNT).flat_map(|u| midpoints(COUNT).map(move |v| (u, v))).map(|(u, v)| kernel(u, v)).sum();
    sum / f64::from(COUNT * COUNT)
}

/// A floor of 1 m2 and parallelograms at several distances and angles.
#[test]
fn estimated_errors_of_links_are_no_less_than_the_true_ones() {
    let sources = [
        [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]],
        [[0.2, 0.3, 0.4], [0.0, 0.3, 0.0], [0.3, 0.0, 0.0]],
        [[-0.5, 0.0, 0.2], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [[-3.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [[0.0, 0.0, 20.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]],
        [[-2.0, -2.0, 3.0], [0.0, 5.0, 0.0], [5.0, 0.0, 0.0]],
    ];
    let mut relative = Vec::new();
    for [corner, a, b] in sources.map(|source| source.map(DVec3::from_array)) {
        let corners = [corner, corner + a, corner + a + b, corner + b].map(|corner| corner.to_array());
        let floor = face(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
        let prepared = prepare(&format!("{GRAY}{floor}{}", face(&corners)));
        let scene = Scene::new(&prepared);
        let arena = full_arena(&scene);
        let [p, q] = [0, 1].map(|surface| arena.roots[surface]);
        let mut lights = ElementLights::new(&arena).elements;
        lights[q as usize] = bright(1.0);
        let oracle = oracle(&scene, &arena, &lights);
        let estimate = oracle.estimate(&oracle.pair(p, q), &mut VisibilityTester::default());
        let element = &arena.elements[p as usize];
        let (mut squares, mut mean) = (0.0, 0.0);
        for u in midpoints(12) {
            for v in midpoints(12) {
                let point = DVec3::new(u, v, 0.0);
                let truth = irradiance(point, [corner, a, b]);
                // The first corner of the floor is the origin of its coordinates, up to a turn by symmetry of the patch.
                let place = prepared_position(&prepared, point.to_array());
                let local = scene.surfaces[0].parameters(place, [0.0; 2]);
                let values = estimate.factors.map(Rgb::splat);
                let found = f64::from(element.interpolate(&values, Vec3A::new(local.x, local.y, 0.0)).x);
                squares += (found - truth).powi(2) / 144.0;
                mean += truth / 144.0;
            }
        }
        let errors = f64::from(estimate.errors[0] + estimate.errors[1]);
        assert!(squares.sqrt() <= errors, "{corner}: an error of {}, estimated as {errors}", squares.sqrt());
        assert!((f64::from(estimate.mean) / mean - 1.0).abs() < 0.1 + squares.sqrt() / mean, "{corner}: {mean}");
        relative.push(errors / mean);
    }
    // The estimate tells near pairs from far ones: a small source right above the floor, and one at twenty times its size.
    assert!(relative[1] > 1.0 && relative[4] < 0.1 && relative[1] > 20.0 * relative[4], "{relative:?}");
}

/// Returns the world of a floor of 1 m2, a ceiling 1 m above it that faces it, and more.
fn floor_and_ceiling(more: &str) -> String {
    let floor = face(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
    let ceiling = face(&[[0.0, 0.0, 1.0], [0.0, 1.0, 1.0], [1.0, 1.0, 1.0], [1.0, 0.0, 1.0]]);
    format!("{GRAY}{floor}{ceiling}m black =\n  sides 2\n  c\n  rd 0\nm black\n{more}")
}

/// Decides on the link from the ceiling to the floor.
fn decide(more: &str, ceiling: ElementLight, error: f32) -> LinkDecision {
    let prepared = prepare(&floor_and_ceiling(more));
    let scene = Scene::new(&prepared);
    let arena = full_arena(&scene);
    let mut lights = ElementLights::new(&arena).elements;
    lights[arena.roots[1] as usize] = ceiling;
    let oracle = Oracle { error, floor: 1.0, ..oracle(&scene, &arena, &lights) };
    oracle.decide(arena.roots[0], arena.roots[1], &mut VisibilityTester::default())
}

#[test]
fn links_are_kept_split_or_dropped_by_their_error() {
    let exact = decide("", bright(1.0), 4.0);
    let LinkDecision::Keep { link, is_inexact: false, .. } = exact else { panic!("{exact:?}") };
    let mean = link.factors.iter().sum::<f32>() / 4.0;
    assert!((mean - 0.199_825).abs() < 0.01, "{link:?}");
    assert!(matches!(decide("", bright(1.0), 0.01), LinkDecision::SplitReceiver | LinkDecision::SplitSource));
    let dark = decide("", ElementLight::ZERO, 1e-6);
    assert!(matches!(dark, LinkDecision::Keep { link, is_inexact: false, .. } if link.factors == [0.0; 4]), "{dark:?}");
    // Uneven light of the source is an error of the source.
    let uneven = ElementLight { darkest: 0.0, brightest: 2.0, ..bright(1.0) };
    assert!(matches!(decide("", uneven, 0.2), LinkDecision::SplitSource));
}

#[test]
fn a_hidden_source_sends_nothing_and_a_half_hidden_one_half() {
    let cover = |x: f64| face(&[[-1.0, -1.0, 0.98], [x, -1.0, 0.98], [x, 2.0, 0.98], [-1.0, 2.0, 0.98]]);
    let hidden = decide(&cover(2.0), bright(1.0), 4.0);
    assert!(matches!(hidden, LinkDecision::Keep { link, .. } if link.factors == [0.0; 4]), "{hidden:?}");
    let prepared = prepare(&floor_and_ceiling(&cover(0.5)));
    let scene = Scene::new(&prepared);
    let mut arena = full_arena(&scene);
    let [floor, ceiling] = [0, 1].map(|surface| arena.roots[surface]);
    split(&mut arena, &scene, floor, 6);
    let mut lights = ElementLights::new(&arena).elements;
    lights[ceiling as usize] = bright(1.0);
    let mut sums = [0.0f64; 2];
    let exact =
        Oracle { floor: 0.4, link_budget_exhausted: true, unit_area: 1.0 / 64.0, ..oracle(&scene, &arena, &lights) };
    let mut tester = VisibilityTester::default();
    for leaf in leaves_of(&arena, floor) {
        let open = exact.estimate(&exact.pair(leaf, ceiling), &mut tester).factors;
        let LinkDecision::Keep { link, .. } = exact.decide(leaf, ceiling, &mut tester) else { panic!("{leaf}") };
        sums = [sums[0] + f64::from(open.iter().sum::<f32>()), sums[1] + f64::from(link.factors.iter().sum::<f32>())];
    }
    // 64 times at least 4 stratified rays: the standard deviation is below 0.03.
    assert!((sums[1] / sums[0] - 0.5).abs() < 0.1, "{sums:?}");
    assert!(tester.rays > 4 * 64, "{}", tester.rays);
}

#[test]
fn elements_that_cannot_see_each_other_are_dropped() {
    let prepared = prepare(&format!("{GRAY}{}", outward_box([0.0; 3], [1.0, 2.0, 3.0])));
    let scene = Scene::new(&prepared);
    let mut arena = full_arena(&scene);
    let lights = vec![bright(1.0); arena.elements.len()];
    let mut tester = VisibilityTester::default();
    let outside = oracle(&scene, &arena, &lights);
    for (p, q) in arena.roots.iter().flat_map(|&p| arena.roots.iter().map(move |&q| (p, q))) {
        let decision = outside.decide(p, q, &mut tester);
        assert!(matches!(decision, LinkDecision::Drop), "faces of a convex box: {p} {q} {decision:?}");
    }
    assert!(matches!(outside.decide(arena.root, arena.root, &mut tester), LinkDecision::SplitBoth));
    assert_eq!(tester.rays, 0, "geometry alone decides");
    // A part of a plane sees no other part of it.
    let root = arena.roots[0];
    split(&mut arena, &scene, root, 1);
    let [a, b] = arena.elements[root as usize].children;
    let lights = vec![bright(1.0); arena.elements.len()];
    assert!(matches!(oracle(&scene, &arena, &lights).decide(a, b, &mut tester), LinkDecision::Drop));
}

#[test]
fn without_memory_links_stay_inexact() {
    let prepared = prepare(&floor_and_ceiling(""));
    let scene = Scene::new(&prepared);
    let arena = full_arena(&scene);
    let lights = vec![bright(1.0); arena.elements.len()];
    let [p, q] = [0, 1].map(|surface| arena.roots[surface]);
    let mut tester = VisibilityTester::default();
    let full = Oracle { error: 1e-4, element_budget_exhausted: true, ..oracle(&scene, &arena, &lights) };
    let full = Oracle { floor: 1.0, ..full };
    assert!(matches!(full.decide(p, q, &mut tester), LinkDecision::Keep { is_inexact: true, .. }));
    assert!(full.may_split(arena.root), "clusters have parts already");
    let full = Oracle { link_budget_exhausted: true, ..full };
    assert!(!full.may_split(arena.root));
    let small = Oracle { min_area: 2.0, ..oracle(&scene, &arena, &lights) };
    assert!(!small.may_split(p));
}

/// A black screen, a pane that lets 60 % through, and fog in a box of 1 m.
#[test]
fn screens_stop_light_and_panes_and_fog_attenuate_it() {
    let wall = |x: f64| face(&[[x, -1.0, -1.0], [x, 1.0, -1.0], [x, 1.0, 1.0], [x, -1.0, 1.0]]);
    let text = format!(
        "medium haze =\n  sigma_s 0.5\nmbox haze 4 -1 -1 5 1 1\n\
         m black =\n  sides 2\n  c\n  rd 0\nm black\n{}m pane =\n  sides 2\n  c\n  ts 0.6 0\nm pane\n{}",
        wall(1.0),
        wall(3.0)
    );
    let prepared = prepare(&text);
    let scene = Scene::new(&prepared);
    let spot =
        |x: f64, y: f64| SurfaceSpot { position: prepared_position(&prepared, [x, y, 0.1]), ..SurfaceSpot::default() };
    let mut tester = VisibilityTester::default();
    let mut share = |from: SurfaceSpot, to: SurfaceSpot| {
        [tester.visibility(&scene, &from, &to), tester.transmittance(&scene, &from, &to)]
    };
    assert_eq!(share(spot(0.0, 0.0), spot(2.0, 0.0)), [0.0; 2], "behind the screen");
    assert_eq!(share(spot(0.0, 1.5), spot(2.0, 1.5)), [1.0; 2], "beside the screen");
    assert_eq!(share(spot(0.0, 0.0), spot(0.9, 0.0)), [1.0; 2], "before the screen");
    let [pane, both] = share(spot(2.0, 0.0), spot(3.9, 0.0));
    assert!((pane - 0.6).abs() < 1e-5 && pane == both, "{pane}");
    // From 3.5 to 4.6 in x and 0.55 in y: the part in the fog is 6 / 11 of the way.
    let (from, to) = (spot(3.5, 0.0), spot(4.6, 0.55));
    let [open, foggy] = share(from, to);
    let length = (1.1f64 * 1.1 + 0.55 * 0.55).sqrt() * 6.0 / 11.0;
    assert!(open == 1.0 && (f64::from(foggy) - (-0.5 * length).exp()).abs() < 1e-5, "{foggy}");
}
