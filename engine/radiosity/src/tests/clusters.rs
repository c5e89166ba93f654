//! Clusters without parts, which stand for many small surfaces.

use super::{GRAY, face, outward_box, prepare};
use crate::solve;
use crate::solve::{SolveOptions, SolverState};
use femc_field::Leaf;
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

const OPTIONS: SolveOptions = SolveOptions { error: 1.0, memory: 1 << 30, guides: false };
static CANCEL: AtomicBool = AtomicBool::new(false);

/// Height of the lamp, m, and its area, m2.
const LAMP: [f64; 2] = [6.0, 0.04];

/// 64 boxes of 5 cm above a floor of 20 m x 20 m, 2 m to the side of a lamp of 10,000 lm/m2 that looks down.
fn boxes() -> String {
    let mut text = GRAY.to_owned();
    for k in 0..64 {
        let [x, y] = [2.0 + 0.2 * f64::from(k % 8), 0.2 * f64::from(k / 8)];
        text += &outward_box([x, y, 0.5], [x + 0.05, y + 0.05, 0.55]);
    }
    text += &face(&[[-10.0, -10.0, 0.0], [10.0, -10.0, 0.0], [10.0, 10.0, 0.0], [-10.0, 10.0, 0.0]]);
    let [z, half] = [LAMP[0], 0.5 * LAMP[1].sqrt()];
    text += "m bright =\n  sides 1\n  c\n  ed 10000\nm bright\n";
    text + &face(&[[-half, -half, z], [-half, half, z], [half, half, z], [half, -half, z]])
}

/// Most boxes have no elements of their own, and their sides receive the light of their cluster by their normals.
#[test]
fn small_surfaces_far_from_a_lamp_share_one_element() {
    let prepared = prepare(&boxes());
    let state = SolverState::new(&prepared, &OPTIONS, &CANCEL).unwrap();
    let elements = &state.arena.elements;
    let is_box = |center: Vec3A| center.as_dvec3().z + prepared.origin.z > 0.4;
    let leaves = elements.iter().filter(|element| element.is_leaf() && is_box(element.center)).count();
    let members: usize = elements.iter().map(|element| state.arena.members(element).len()).sum();
    assert!(members > 300 && leaves < 100, "{members} of 385 surfaces in clusters, {leaves} leaves of boxes");
    assert!(state.links.iter().all(|link| link.factors != [0.0; 4]), "links without light");
    let solution = solve(&prepared, &OPTIONS, &CANCEL).unwrap();
    let (mut tops, mut found, mut wanted) = (0, 0.0, 0.0);
    for (surface, &root) in solution.field.roots.iter().enumerate() {
        let spot = solution.field.surfaces[surface].point_at([0.5; 2].into());
        let position = spot.position.as_dvec3() + prepared.origin;
        let Leaf::Rectangle(light) = solution.direct[solution.field.cells[root as usize].next as usize] else {
            continue;
        };
        let light = f64::from(luminance(light[0]));
        if position.z < 0.4 {
            continue;
        }
        if spot.normal.z > 0.9 {
            let way = LAMP[0] - position.z;
            let distance2 = position.x * position.x + position.y * position.y + way * way;
            let want = 10_000.0 * LAMP[1] / PI * way * way / (distance2 * distance2);
            assert!((light / want - 1.0).abs() < 0.2, "{light} lx instead of {want} lx at {position}");
            (tops, found, wanted) = (tops + 1, found + light, wanted + want);
        } else if spot.normal.z < -0.9 {
            assert!(light < 0.5, "{light} lx from below at {position}");
        }
    }
    assert!(tops == 64 && (found / wanted - 1.0_f64).abs() < 0.1, "{tops} tops: {found} lx instead of {wanted} lx");
}
