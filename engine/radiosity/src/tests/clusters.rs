//! Clusters without parts, which stand for many small surfaces.

use super::{GRAY, face, outward_box, prepare};
use crate::arena::Arena;
use crate::element::Shape;
use crate::gather::{FROM_ELEMENTS, FROM_LAMPS};
use crate::scene::Scene;
use crate::solve;
use crate::solve::{GuideKind, SolveOptions, SolverState};
use femc_field::Leaf;
use femc_math::color::luminance;
use femc_math::glam::{Vec2, Vec3A};
use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

const OPTIONS: SolveOptions = SolveOptions { error: 1.0, memory: 1 << 30, guides: GuideKind::None };
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
    text + &floor_and_lamp()
}

fn floor_and_lamp() -> String {
    let mut text = face(&[[-10.0, -10.0, 0.0], [10.0, -10.0, 0.0], [10.0, 10.0, 0.0], [-10.0, 10.0, 0.0]]);
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
        let Leaf::Rectangle(light) = solution.field.direct[solution.field.cells[root as usize].next as usize] else {
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

/// 64 balls of 2 cm above a floor, below a lamp, are few clusters. The mean irradiance of a ball, which is convex, is a fourth of that of
/// a surface that faces the light. Balls reflect half of it.
#[test]
fn small_balls_reflect_half_of_what_they_receive() {
    let mut text = GRAY.to_owned();
    for k in 0..64 {
        let [x, y] = [2.0 + 0.2 * f64::from(k % 8), 0.2 * f64::from(k / 8)];
        text += &format!("v b{k} =\n  p {x} {y} 0.5\nsph b{k} .02\n");
    }
    text += &floor_and_lamp();
    let prepared = prepare(&text);
    let state = SolverState::new(&prepared, &OPTIONS, &CANCEL).unwrap();
    let mut members = 0;
    for (index, element) in state.arena.elements.iter().enumerate() {
        members += state.arena.members(element).len();
        let Shape::Cluster(cluster) = &element.shape else { continue };
        if !element.is_leaf() {
            continue;
        }
        let (light, directional) = (&state.lights.elements[index], cluster.directional as usize);
        let arriving = [FROM_LAMPS, FROM_ELEMENTS]
            .map(|from| luminance(state.lights.directional_irradiance(directional, index, from).total()));
        let [mean, radiosity] = [light.mean, luminance(light.radiosity)];
        let want = 0.25 * (arriving[0] + arriving[1]);
        assert!((mean / want - 1.0).abs() < 0.02, "{mean} lx instead of {want} lx");
        assert!((radiosity / mean - 0.5).abs() < 1e-4, "{radiosity} lx of {mean} lx");
        // Of the light by direction, the whole flux is pi times the constant part.
        let flux = PI as f32 * luminance(state.lights.intensity[directional].total());
        assert!((flux / (radiosity * cluster.area) - 1.0).abs() < 1e-4, "{flux} lm");
    }
    assert!(members > 32, "{members} balls in clusters");
}

/// Rays begin on the surfaces of a cluster in proportion to their areas.
#[test]
fn points_of_a_cluster_are_spread_over_its_area() {
    let mut text = GRAY.to_owned();
    for k in 0..8 {
        let (x, size) = (f64::from(k), 0.1 * f64::from(k + 1));
        text += &face(&[[x, 0.0, 0.0], [x + size, 0.0, 0.0], [x + size, 1.0, 0.0], [x, 1.0, 0.0]]);
    }
    let prepared = prepare(&text);
    let scene = Scene::new(&prepared);
    let arena = Arena::new(&scene);
    let Shape::Cluster(cluster) = &arena.elements[arena.surfaces as usize].shape else { panic!("no cluster") };
    let mut counts = [0u32; 8];
    let count = 3600;
    for k in 0..count {
        let u = (k as f32 + 0.5) / count as f32;
        let spot = arena.point_of_cluster(&scene, cluster, u, Vec2::splat(0.5));
        counts[(f64::from(spot.position.x) + prepared.origin.x) as usize] += 1;
    }
    // The areas are 0.1 to 0.8 m2 of 3.6 m2.
    for (k, found) in (1..).zip(counts) {
        assert!(found.abs_diff(100 * k) <= 2, "{found} points of surface {k}");
    }
}

/// The normals of each part of a ball are in the part's cone of normals.
#[test]
fn normals_of_curved_parts_are_in_their_cones() {
    let prepared = prepare(&format!("{GRAY}v b =\n  p 0 0 0\nsph b 1\n"));
    let scene = Scene::new(&prepared);
    let mut arena = Arena::new(&scene);
    let mut parts = 0;
    let mut index = 0;
    while index < arena.elements.len() {
        if let Shape::Curved(curved) = &arena.elements[index].shape {
            let cone = arena.elements[index].normals();
            for normal in arena.curved_normals(curved) {
                let angle = normal.dot(cone.axis).clamp(-1.0, 1.0).acos();
                assert!(angle <= cone.angle + 1e-3, "{angle} beyond {} of element {index}", cone.angle);
            }
            parts += 1;
            arena.ensure_children(&scene, index as u32);
        }
        index += 1;
    }
    assert!(parts > 2, "{parts} curved elements");
}
