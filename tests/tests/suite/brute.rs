//! Compares small rooms with images of another path tracer ([`femc_tests::brute`]), which are stored in `tests/references`.
//!
//! `cargo run --release -p femc-tests --example references` renders the images again, in some minutes.

use femc_pipeline::{Settings, StopCondition};
use femc_scene::Scene;
use femc_tests::reference::{Comparison, ROOMS, Reference, rooms_folder, scene_digest};
use femc_tests::render_frame;
use std::sync::Arc;

/// Probability of a false alarm in one comparison.
const LEVEL: f64 = 1e-4;
/// Side length of a block in pixels.
const BLOCK: usize = 8;
/// Emittance of the lamps in all rooms, lm/m2.
const EMITTANCE: f64 = 60.0;

fn room(name: &str) -> Scene {
    femc_import::load_scene_file(&rooms_folder().join(format!("{name}.mgf"))).unwrap_or_else(|e| panic!("{e}")).scene
}

/// Renders a room with `changes` to its scalars, and compares the image with the reference.
fn compare_room(name: &str, changes: &[(&str, f64)]) -> Comparison {
    let mut scene = room(name);
    for (selector, value) in changes {
        scene.set(selector, *value).unwrap_or_else(|e| panic!("{e}"));
    }
    let settings = Settings { stop: StopCondition::Spp(512), seed: 7, ..Settings::default() };
    let comparison =
        Reference::read(&rooms_folder(), name).compare(&render_frame(&Arc::new(scene), &settings, 1), BLOCK);
    println!("{name} {changes:?}: {comparison:?}");
    comparison
}

/// Checks that the room agrees, and that it does not with one percent more light or two percent less reflectance.
fn check(name: &str) {
    assert!(compare_room(name, &[]).agrees(LEVEL), "{name} is not what brute force says");
    for change in [("material.panel.ed", 1.01 * EMITTANCE), ("material.white.rd", 0.98)] {
        assert!(!compare_room(name, &[change]).agrees(LEVEL), "{name}: nobody sees {change:?}");
    }
}

#[test]
fn a_room_is_what_brute_force_says_and_a_percent_more_is_not() {
    check("box");
}

#[test]
fn rough_mirror_room_equals_brute_force_and_percent_more_fails() {
    check("glossy");
}

#[test]
fn fog_room_equals_brute_force_and_percent_more_fails() {
    check("fog");
}

#[test]
fn references_have_the_noise_that_their_notes_tell() {
    for name in ROOMS {
        let notes = std::fs::read_to_string(rooms_folder().join(format!("{name}.json"))).expect("notes");
        let notes: serde_json::Value = serde_json::from_str(&notes).expect("JSON");
        let reference = Reference::read(&rooms_folder(), name);
        for (key, value) in [("mean", reference.mean()), ("noise_relmse", reference.noise_relmse())] {
            let noted = notes[key].as_f64().expect("a number");
            assert!((value - noted).abs() <= 1e-5 * noted, "{name}: {key} is {value}, not {noted}");
        }
        let scene = scene_digest(&rooms_folder(), &room(name)).to_string();
        assert_eq!(notes["scene_blake3"], scene, "{name}: the scene is no more what the reference is of");
    }
}
