//! Light of sources on elements.

use super::{face, full_arena, leaves_of, oracle, prepare, prepared_position, split};
use crate::SolveOptions;
use crate::gather::{ElementLights, FROM_LAMPS};
use crate::lamps::LampLinkDecision;
use crate::link::Oracle;
use crate::scene::Scene;
use crate::solve::SolverState;
use crate::visibility::VisibilityTester;
use femc_math::color::luminance;
use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

/// A closed room of 2 x 2 x 2 m whose walls reflect 1 %.
fn room() -> String {
    let walls = super::outward_box([0.0; 3], [2.0; 3]);
    // The reverse order of corners turns the fronts inward.
    let turned: String = walls
        .lines()
        .map(|line| if line == "f c0 c1 c2 c3" { "f c3 c2 c1 c0\n".to_owned() } else { format!("{line}\n") })
        .collect();
    format!("m wall =\n  sides 1\n  c\n  rd 0.01\nm wall\n{turned}")
}

/// Returns the flux that all walls of a scene receive directly from its lamps, lm.
fn received(text: &str) -> f64 {
    let prepared = prepare(text);
    let options = SolveOptions { error: 0.3, ..SolveOptions::default() };
    let state = SolverState::new(&prepared, &options, &AtomicBool::new(false)).unwrap();
    let mut sum = 0.0;
    for (index, element) in state.arena.elements.iter().enumerate().filter(|(_, element)| element.is_leaf()) {
        let light = &state.lights.elements[index].total[FROM_LAMPS][..element.node_count()];
        let mean = light.iter().map(|&light| f64::from(luminance(light))).sum::<f64>() / light.len() as f64;
        sum += mean * f64::from(element.size());
    }
    sum
}

#[test]
fn a_closed_room_receives_the_flux_of_its_lamps() {
    let sphere = format!("{}m bright =\n  c\n  ed 1000\nm bright\nv s =\n  p 0.7 1.1 1.2\nsph s 0.1\n", room());
    let flux = 1000.0 * 4.0 * PI * 0.01;
    let found = received(&sphere);
    assert!((found / flux - 1.0).abs() < 0.02, "sphere: {found} lm, not {flux}");
    // A square of 0.36 m2 that faces down.
    let square = face(&[[0.5, 0.6, 1.9], [0.5, 1.2, 1.9], [1.1, 1.2, 1.9], [1.1, 0.6, 1.9]]);
    let found = received(&format!("{}m bright =\n  sides 1\n  c\n  ed 500\nm bright\n{square}", room()));
    assert!((found / 180.0 - 1.0).abs() < 0.02, "square: {found} lm, not 180");
    let both = received(&format!("{}m bright =\n  sides 2\n  c\n  ed 500\nm bright\n{square}", room()));
    assert!((both / 360.0 - 1.0).abs() < 0.03, "square that shines from both sides: {both} lm, not 360");
}

/// A small sphere above a floor: intensity times cosine over the squared distance.
#[test]
fn a_small_source_follows_the_inverse_square_law() {
    let floor = face(&[[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 4.0, 0.0], [0.0, 4.0, 0.0]]);
    let lamp = "m bright =\n  c\n  ed 1000\nm bright\nv s =\n  p 1 2 2\nsph s 0.05\n";
    let screen = face(&[[2.5, -1.0, -1.0], [2.5, 5.0, -1.0], [2.5, 5.0, 3.0], [2.5, -1.0, 3.0]]);
    let text = format!(
        "m gray =\n  sides 1\n  c\n  rd 0.5\nm gray\n{floor}{lamp}m black =\n  sides 2\n  c\n  rd 0\nm black\n{screen}"
    );
    let prepared = prepare(&text);
    let scene = Scene::new(&prepared);
    let mut arena = full_arena(&scene);
    let root = arena.roots[0];
    split(&mut arena, &scene, root, 6);
    let lights = ElementLights::new(&arena);
    let oracle = Oracle { floor: 1e6, ..oracle(&scene, &arena, &lights.elements) };
    let mut tester = VisibilityTester::default();
    let at = prepared_position(&prepared, [1.0, 2.0, 2.0]).as_dvec3();
    // Emittance over pi, times the projected area.
    let intensity = 1000.0 / PI * PI * 0.0025;
    let mut counts = [0; 2];
    for leaf in leaves_of(&arena, root) {
        let element = &arena.elements[leaf as usize];
        let x = element.center.as_dvec3().x + prepared.origin.x;
        let decision = oracle.decide_lamp_link(leaf, 0, &mut tester);
        let LampLinkDecision::Keep { link, .. } = decision else { panic!("{decision:?}") };
        for (node, light) in element.nodes().zip(link.light) {
            let way = at - node.position.as_dvec3();
            let want = if x < 2.5 { intensity * way.z / way.length().powi(3) } else { 0.0 };
            let found = f64::from(luminance(light));
            assert!((found - want).abs() <= 0.02 * want, "{}: {found} lx, not {want}", node.position);
        }
        counts[usize::from(x < 2.5)] += 1;
    }
    assert_eq!(counts, [24, 40]);
}

#[test]
fn a_lamp_below_the_floor_is_dropped() {
    let floor = face(&[[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 4.0, 0.0], [0.0, 4.0, 0.0]]);
    let text = format!(
        "m gray =\n  sides 1\n  c\n  rd 0.5\nm gray\n{floor}m bright =\n  c\n  ed 1000\nm bright\nv s =\n  p 1 2 -1\nsph s 0.05\n"
    );
    let prepared = prepare(&text);
    let scene = Scene::new(&prepared);
    let arena = full_arena(&scene);
    let lights = ElementLights::new(&arena);
    let decision =
        oracle(&scene, &arena, &lights.elements).decide_lamp_link(arena.roots[0], 0, &mut VisibilityTester::default());
    assert!(matches!(decision, LampLinkDecision::Drop), "{decision:?}");
}
