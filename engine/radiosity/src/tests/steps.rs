//! Bytes of the steps: what is decoded and encoded again is equal, and damage is found.

use super::{face, prepare};
use crate::solve::SolverState;
use crate::{CastingState, GuideKind, RAY_ROUNDS, RayHits, Solution, SolveOptions, solve};
use femc_prepared::Prepared;
use std::sync::atomic::AtomicBool;

static CANCEL: AtomicBool = AtomicBool::new(false);
const OPTIONS: SolveOptions = SolveOptions { error: 2.0, memory: 1 << 22, guides: GuideKind::None };

/// A floor, a screen, a ball, a lamp in glass and fog: elements of all shapes.
fn world() -> Prepared {
    prepare(&format!(
        "medium haze =\n  sigma_s 0.1\nmbox haze -2 -2 0 2 2 2\nm gray =\n  sides 2\n  c\n  rd 0.6\nm gray\n{}{}\
         v s =\n  p 0.5 -0.5 0.4\nsph s 0.3\nm bright =\n  c\n  ed 2000\nm bright\nv l =\n  p -1 1.5 1\nsph l 0.2\n\
         m glass =\n  sides 1\n  ir 1.5 0\n  c\n  ts 1 0\nm glass\nsph l 0.3\n",
        face(&[[-2.0, -2.0, 0.0], [2.0, -2.0, 0.0], [2.0, 2.0, 0.0], [-2.0, 2.0, 0.0]]),
        face(&[[-2.0, 0.5, 0.0], [1.6, 0.5, 0.0], [1.6, 0.5, 2.0]]),
    ))
}

fn casting(world: &Prepared) -> CastingState {
    let state = SolverState::new(world, &OPTIONS, &CANCEL).unwrap();
    state.plan_rays(world, &OPTIONS)
}

#[test]
fn the_state_is_encoded_without_loss() {
    let world = world();
    let state = SolverState::new(&world, &OPTIONS, &CANCEL).unwrap();
    let (elements, links) = (state.encode_elements(), state.encode_links());
    let again = SolverState::decode(&world, &elements, &links).unwrap();
    assert!(
        state.lights.caustics.iter().flatten().any(|light| light.x > 0.0)
            && again.lights.caustics == state.lights.caustics
    );
    assert!(again.encode_elements() == elements && again.encode_links() == links);
    assert_eq!(again.report().rays, state.report().rays);
    let [before, after] = [&state, &again].map(|state| {
        let lights = &state.lights.elements;
        lights.iter().map(|light| format!("{:?} {:?}", light.total, light.radiosity)).collect::<Vec<_>>()
    });
    assert_eq!(before, after, "light that is not stored follows from what is");
    for end in [0, 1, 8, elements.len() / 2, elements.len() - 1] {
        assert!(SolverState::decode(&world, &elements[..end], &links).is_err(), "{end} bytes");
    }
    for end in [0, 1, 8, links.len() / 2, links.len() - 1] {
        assert!(SolverState::decode(&world, &elements, &links[..end]).is_err(), "{end} bytes");
    }
}

#[test]
fn hits_of_blocks_are_encoded_without_loss() {
    let world = world();
    let before = casting(&world);
    let whole = format!("{:?}", before.cast(&world, 0, 1));
    let blocks: Vec<RayHits> = (0..3).map(|block| before.cast(&world, block, 3)).collect();
    let bytes: Vec<Vec<u8>> = blocks.iter().map(RayHits::encode).collect();
    for (block, bytes) in blocks.iter().zip(&bytes) {
        let again = RayHits::decode(bytes).unwrap();
        assert_eq!(format!("{again:?}"), format!("{block:?}"));
        assert!((0..bytes.len()).step_by(97).all(|end| RayHits::decode(&bytes[..end]).is_err()));
    }
    assert_eq!(format!("{:?}", casting(&world).cast(&world, 0, 1)), whole, "rays depend on the elements alone");
    let decoded: Vec<RayHits> = bytes.iter().map(|bytes| RayHits::decode(bytes).unwrap()).collect();
    let reversed = decoded.iter().rev().cloned().collect();
    assert!(before.apply_hits(&world, &OPTIONS, reversed, &CANCEL).unwrap().is_none(), "blocks in the wrong order");
    assert!(
        before.apply_hits(&world, &OPTIONS, decoded[..2].to_vec(), &CANCEL).unwrap().is_none(),
        "a block is missing"
    );
    let after = before.apply_hits(&world, &OPTIONS, decoded, &CANCEL).unwrap().expect("all hits");
    assert!(RayHits::decode(&after.encode_links()).is_err());
}

/// A foggy room with a lamp and a mirror.
fn room() -> Prepared {
    let corner = |x: f64, y: f64, z: f64| [x, y, z];
    let walls = [
        [corner(-1.0, -1.0, 0.0), corner(1.0, -1.0, 0.0), corner(1.0, 1.0, 0.0), corner(-1.0, 1.0, 0.0)],
        [corner(-1.0, -1.0, 2.0), corner(-1.0, 1.0, 2.0), corner(1.0, 1.0, 2.0), corner(1.0, -1.0, 2.0)],
        [corner(-1.0, 1.0, 0.0), corner(1.0, 1.0, 0.0), corner(1.0, 1.0, 2.0), corner(-1.0, 1.0, 2.0)],
    ];
    let lamp = face(&[[-0.3, -0.3, 1.98], [-0.3, 0.3, 1.98], [0.3, 0.3, 1.98], [0.3, -0.3, 1.98]]);
    let mirror = face(&[[-0.9, -0.5, 0.1], [-0.5, -0.5, 0.1], [-0.5, 0.5, 0.1], [-0.9, 0.5, 0.1]]);
    prepare(&format!(
        "medium fog =\n  sigma_s 0.1\n  phase hg 0.4\nmbox fog -1 -1 0 1 1 2\nm wall =\n  sides 2\n  c\n  rd 0.6\nm wall\n{}\
         m mirror =\n  sides 2\n  c\n  rs 0.8 0\nm mirror\n{mirror}m lamp =\n  sides 2\n  c\n  ed 300\nm lamp\n{lamp}",
        walls.iter().map(|wall| face(wall)).collect::<String>()
    ))
}

/// Steps whose states travel as bytes have the solution of one process, to the bit, also if the last rays are not needed.
#[test]
fn steps_through_bytes_have_the_solution_of_one_process() {
    let world = room();
    for guides in [GuideKind::None, GuideKind::Tables] {
        let options = SolveOptions { error: 1.0, memory: 1 << 24, guides };
        let whole = solve(&world, &options, &CANCEL).unwrap();
        let start = SolverState::new(&world, &options, &CANCEL).unwrap();
        let (mut elements, links) = (start.encode_elements(), start.encode_links());
        for _ in 0..RAY_ROUNDS {
            let state = SolverState::decode(&world, &elements, &links).unwrap();
            let casting = state.plan_rays(&world, &options);
            let cast = |block: u32| RayHits::decode(&casting.cast(&world, block, 3).encode()).unwrap();
            let hits: Vec<RayHits> = (0..3).map(cast).collect();
            let corrected = casting.apply_hits(&world, &options, hits, &CANCEL).unwrap().expect("all hits");
            elements = corrected.encode_elements();
        }
        let found = SolverState::decode(&world, &elements, &links).unwrap().solution(&world, &options);
        let text = |solution: &Solution| format!("{:?}", solution.field);
        assert!(text(&found) == text(&whole), "guides: {guides:?}");
        assert_eq!(found.field.tables.is_empty(), guides != GuideKind::Tables);
    }
}
