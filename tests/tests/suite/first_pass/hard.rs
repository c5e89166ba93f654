//! Scenes that break finite elements. The solver must terminate and report its failures.

use super::{CAMERA, cube};
use femc_field::Leaf;
use femc_pipeline::radiosity::SolveOptions;
use femc_tests::closed_forms::SolvedScene;
use femc_tests::irradiance::{IrradiancePoint, compare, sample_points};
use femc_tests::two_rooms::{WALL, two_rooms};
use std::fmt::Write as _;

const LAMP: &str = "m lamp =\n  ed 100\nv l =\n  p .5 .5 .5\nsph l .05\n";

/// Solves a scene within a memory limit in bytes, and checks every number of its light.
fn solve(text: &str, error: f32, memory: usize) -> SolvedScene {
    let solved = SolvedScene::new(text, &SolveOptions { error, memory, ..SolveOptions::default() });
    for leaf in solved.field.leaves.iter().chain(&solved.direct.leaves) {
        let is_number = match leaf {
            Leaf::Triangle(values) => values.iter().all(|value| value.is_finite()),
            Leaf::Rectangle(values) => values.iter().all(|value| value.is_finite()),
            Leaf::Curved(light) => light.total().is_finite(),
        };
        assert!(is_number, "{leaf:?}");
    }
    assert!(solved.field.fog.leaves().flat_map(|leaf| leaf.mean).all(|value| value.is_finite()));
    solved
}

/// Returns scenes with their names.
fn scenes() -> Vec<(&'static str, String)> {
    let mut needles = cube();
    for k in 0..40 {
        let [x, z] = [0.02 * f64::from(k) + 0.1, 0.01 * f64::from(k) + 0.05];
        let _ = writeln!(
            needles,
            "v a =\n  p {x} .05 {z}\nv b =\n  p {x} .95 {z}\nv c =\n  p {} .5 {z}\nf a b c",
            x + 1e-5
        );
    }
    let mut sizes = String::new();
    for (name, [x, y, z]) in
        [("a", [-500., -500., 0.]), ("b", [500., -500., 0.]), ("c", [500., 500., 0.]), ("d", [-500., 500., 0.])]
    {
        let _ = writeln!(sizes, "v {name} =\n  p {x} {y} {z}");
    }
    sizes.push_str("f a b c d\nv e =\n  p .5 .5 .001\nsph e .0005\nv g =\n  p .501 .5 .001\nsph g .0004\n");
    // The same faces twice, flipped, and in part.
    let overlapping = format!("{0}f p2 p1 p0\nf p0 p3 p2\nv q =\n  p .5 .5 0\nf p0 p1 q\n{0}", cube());
    let open = "v a =\n  p 0 0 0\nv b =\n  p 1 0 0\nv c =\n  p 1 1 .2\nv d =\n  p 0 1 0\nf a b c\nf a c d\nf a b d\n"
        .to_owned();
    let closed = format!("{0}v s =\n  p .5 .5 .5\nsph s -.2\nsph s .2\n", cube());
    ["needles", "sizes of 1e6 to 1", "overlapping faces", "an open mesh", "a lamp in a closed box"]
        .into_iter()
        .zip([needles, sizes, overlapping, open, closed].map(|faces| format!("{CAMERA}{LAMP}m w =\n  rd .5\n{faces}")))
        .collect()
}

#[test]
fn hard_scenes_stay_in_link_budget_and_report_refused_links() {
    const BUDGET: usize = 1 << 20;
    for (what, text) in scenes() {
        let wide = solve(&text, 0.1, 1 << 30).report;
        let narrow = solve(&text, 0.03, BUDGET).report;
        println!(
            "{what}: {} B, {} refused; {} B, {} refused",
            wide.bytes, wide.inexact_links, narrow.bytes, narrow.inexact_links
        );
        assert!(narrow.bytes < 3 * BUDGET, "{what}: {narrow:?}");
        assert!(narrow.bytes < BUDGET || narrow.inexact_links > 0, "{what}: {narrow:?}");
        assert!(wide.bytes < 1 << 28 && wide.residual < 1e-3, "{what}: {wide:?}");
    }
}

/// Without absorption, light grows without bound. The iterations end, and the residual reports that the light has not converged.
#[test]
fn a_closed_room_that_takes_nothing_ends_and_says_so() {
    let room = |reflectance: f64| format!("{CAMERA}m w =\n  sides 1\n  rd {reflectance}\n  ed 1\n{}", cube());
    let grown = solve(&room(1.0), 0.3, 1 << 30).report;
    println!("{grown:?}");
    assert!(grown.residual > 0.01, "{grown:?}");
    let bright = solve(&room(0.99), 0.3, 1 << 30).report;
    println!("{bright:?}");
    assert!(bright.residual <= 1e-4 && bright.iterations < grown.iterations, "{bright:?}");
}

/// The far room is lit through an opening that fills 1 % of its view. Its light is below the fraction of the global mean that
/// errors refer to, so too little of it is found. No part of it counts as dark.
#[test]
fn two_rooms_that_an_opening_joins_are_both_lit() {
    let text = two_rooms();
    let scene = femc_tests::parse_scene(&text);
    let points = sample_points(&scene, 300, 2048).unwrap_or_else(|e| panic!("{e}"));
    let solution = super::solve_to(&text, 0.1);
    let solved = solve(&text, 0.1, 1 << 30);
    let inside = |far: bool, point: &&IrradiancePoint| {
        let at = solved.prepared.origin + point.position.as_dvec3() + 0.01 * point.normal.as_dvec3();
        let is_inside = at.min_element() > 0.0 && at.x < 2.0 * WALL && at.y < 4.0 && at.z < 3.0;
        is_inside && (at.x > WALL) == far
    };
    for (far, rms, least) in [(false, 0.08, 0.8), (true, 0.7, 0.1)] {
        let side: Vec<IrradiancePoint> = points.iter().filter(|point| inside(far, point)).copied().collect();
        let all = compare(&scene, &solution, &side).unwrap_or_else(|e| panic!("{e}"));
        println!("far {far}: {all:?}");
        assert!(side.len() > 50 && all.relmse.max(0.0).sqrt() < rms, "far {far}: {all:?}");
        for point in side.iter().filter(|point| point.irradiance[0] > 4.0 * point.irradiance[1]) {
            let one = compare(&scene, &solution, &[*point]).unwrap_or_else(|e| panic!("{e}"));
            assert!(one.mean_ratio > least, "{point:?} is dark: {one:?}");
        }
    }
}
