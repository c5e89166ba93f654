//! Laws of energy: light does not grow, and what rays measure replaces what links get wrong.

use super::{face, outward_box, prepare};
use crate::gather::{ElementLights, FROM_ELEMENTS, FROM_LAMPS};
use crate::rays::{Rays, ray_leaves};
use crate::scene::Scene;
use crate::solve::SolverState;
use crate::{GuideKind, SolveOptions, solve};
use femc_field::Leaf;
use femc_math::Rgb;
use std::f32::consts::PI;
use std::sync::atomic::AtomicBool;

static CANCEL: AtomicBool = AtomicBool::new(false);
const OPTIONS: SolveOptions = SolveOptions { error: 0.3, memory: 1 << 24, guides: GuideKind::None };

/// Returns a cube of 1 m whose inner sides have a luminance of 1 cd/m2.
fn furnace(reflectance: f64) -> String {
    // Faces that look outward, with their corners in the other order.
    let outward = outward_box([0.0; 3], [1.0; 3]);
    let inward = outward.lines().map(|line| {
        let Some(corners) = line.strip_prefix("f ") else { return format!("{line}\n") };
        let reversed: Vec<&str> = corners.split_whitespace().rev().collect();
        format!("f {}\n", reversed.join(" "))
    });
    format!("m wall =\n  sides 1\n  c\n  rd {reflectance}\n  ed {PI}\nm wall\n{}", inward.collect::<String>())
}

/// All points of a furnace receive the light of walls of radiosity `PI / (1 - reflectance)`.
#[test]
fn furnaces_that_absorb_little_converge_to_the_truth() {
    for reflectance in [0.5, 0.9, 0.985, 0.999] {
        let prepared = prepare(&furnace(reflectance));
        let solution = solve(&prepared, &OPTIONS, &CANCEL).unwrap();
        let report = &solution.report;
        assert!(report.residual < 1e-3 && report.iterations < 200, "{reflectance}: {report:?}");
        let want = PI * (reflectance / (1.0 - reflectance)) as f32;
        for leaf in &solution.field.leaves {
            let Leaf::Rectangle(nodes) = leaf else { panic!("{leaf:?}") };
            for node in nodes {
                assert!((node.y / want - 1.0).abs() < 0.01, "{reflectance}: {} instead of {want}", node.y);
            }
        }
    }
}

/// Links that bring three times the light do not make it grow: no more arrives than all elements send.
#[test]
fn light_does_not_grow_whatever_the_links_bring() {
    let prepared = prepare(&furnace(0.9));
    let scene = Scene::new(&prepared);
    let mut state = SolverState::new(&prepared, &OPTIONS, &CANCEL).unwrap();
    let SolverState { arena, lights, links, .. } = &mut state;
    links.iter_mut().for_each(|link| link.factors = link.factors.map(|factor| 3.0 * factor));
    lights.row_scale.fill([1.0; 4]);
    for _ in 0..200 {
        lights.gather(arena, links);
        let flux = lights.reflect_all(&scene, arena);
        let most = flux.first / (1.0 - 0.9);
        assert!(flux.sent <= most * 1.0001, "{} lm of at most {most}", flux.sent);
    }
    assert!((lights.balance.y - 1.0 / 3.0).abs() < 0.05, "{}", lights.balance);
}

/// Casts rays from all leaves.
fn cast(scene: &Scene<'_>, state: &SolverState) -> Rays {
    let plan = state.ray_plan(OPTIONS.memory);
    let hits = plan.cast(scene, &state.arena, 0..ray_leaves(&state.arena).len());
    plan.into_rays(vec![hits])
}

/// Returns the flux directly from lamps, lm.
fn direct_flux(state: &SolverState, lights: &ElementLights) -> f64 {
    let of = |leaf: u32| {
        let (element, nodes) =
            (&state.arena.elements[leaf as usize], lights.node_irradiance(leaf as usize, FROM_LAMPS));
        let count = element.node_count();
        f64::from(nodes[..count].iter().map(|light| light.y).sum::<f32>() / count as f32 * element.size())
    };
    ray_leaves(&state.arena).into_iter().map(of).sum()
}

/// A lamp over a floor: shadow rays correct light that is half too bright, and light that is missing.
#[test]
fn shadow_rays_correct_the_light_of_lamps() {
    let floor = face(&[[-2.0, -2.0, 0.0], [2.0, -2.0, 0.0], [2.0, 2.0, 0.0], [-2.0, 2.0, 0.0]]);
    let lamp = face(&[[-0.1, -0.1, 1.0], [-0.1, 0.1, 1.0], [0.1, 0.1, 1.0], [0.1, -0.1, 1.0]]);
    let prepared = prepare(&format!(
        "m gray =\n  sides 1\n  c\n  rd 0.5\nm gray\n{floor}m bright =\n  sides 1\n  c\n  ed 1000\nm bright\n{lamp}"
    ));
    let scene = Scene::new(&prepared);
    let state = SolverState::new(&prepared, &OPTIONS, &CANCEL).unwrap();
    let truth = direct_flux(&state, &state.lights);
    // 40 lm leave the lamp; 4 m x 4 m of floor receive most of them.
    assert!((30.0..40.0).contains(&truth), "{truth} lm");
    let rays = cast(&scene, &state);
    for wrong in [1.5f32, 0.0] {
        let mut lights = state.lights.clone();
        for light in &mut lights.elements {
            light.total[FROM_LAMPS] = light.total[FROM_LAMPS].map(|light| light * Rgb::splat(wrong));
        }
        rays.correct_lamps(&state.arena, &mut lights, OPTIONS.error);
        let found = direct_flux(&state, &lights);
        assert!((found / truth - 1.0).abs() < 0.03, "{wrong}: {found} lm instead of {truth} lm");
    }
}

/// All rays in a closed room hit something; above an open floor, none does.
#[test]
fn rays_measure_the_share_of_light_that_arrives() {
    let of = |text: &str| {
        let prepared = prepare(text);
        let (scene, mut state) = (Scene::new(&prepared), SolverState::new(&prepared, &OPTIONS, &CANCEL).unwrap());
        let rays = cast(&scene, &state);
        rays.measure_arriving_shares(&state.arena, &mut state.lights);
        assert!(state.lights.has_measured_shares);
        let leaves = ray_leaves(&state.arena);
        leaves.iter().map(|&leaf| state.lights.arriving_share[leaf as usize]).collect::<Vec<_>>()
    };
    let floor = face(&[[-2.0, -2.0, 0.0], [2.0, -2.0, 0.0], [2.0, 2.0, 0.0], [-2.0, 2.0, 0.0]]);
    let open = of(&format!("m gray =\n  sides 1\n  c\n  rd 0.5\n  ed 1\nm gray\n{floor}"));
    assert!(!open.is_empty() && open.iter().all(|shares| *shares == [0.0; 4]), "{open:?}");
    let closed = of(&furnace(0.5));
    assert!(closed.iter().flatten().all(|share| (share - 1.0).abs() < 1e-6), "{closed:?}");
    let foggy = of(&format!("{}{FOG}", furnace(0.5)));
    assert!(foggy.len() > closed.len(), "no leaves of fog");
    assert!(foggy.iter().flatten().all(|share| (share - 1.0).abs() < 1e-5), "{foggy:?}");
}

/// A closed box of two-sided faces above a floor: what the clusters that contain the whole box receive goes to its outsides alone. All
/// light of a cluster is distributed.
#[test]
fn light_of_a_cluster_does_not_reach_the_inside_of_a_box() {
    let inner = outward_box([0.4; 3], [0.6; 3]);
    let floor = face(&[[-1.0, -1.0, 0.0], [2.0, -1.0, 0.0], [2.0, 2.0, 0.0], [-1.0, 2.0, 0.0]]);
    let prepared = prepare(&format!("m wood =\n  c\n  rd 0.9\nm wood\n{floor}{inner}"));
    let scene = Scene::new(&prepared);
    let mut state = SolverState::new(&prepared, &OPTIONS, &CANCEL).unwrap();
    state.arena = super::full_arena(&scene);
    state.lights = ElementLights::new(&state.arena);
    let rays = cast(&scene, &state);
    let SolverState { arena, lights, .. } = &mut state;
    lights.cluster_weights = crate::exits::ClusterWeights::from_exit_shares(arena, rays.exit_shares(arena));
    let middle = super::prepared_position(&prepared, [0.5; 3]);
    let is_of_box = |index: usize| arena.elements[index].center.distance(middle) < 0.11;
    let (mut inside, mut outside) = (0, 0);
    let mut sums = vec![[0.0f32; 2]; arena.elements.len()];
    for &root in &arena.roots {
        let element = &arena.elements[root as usize];
        let is_inside = is_of_box(root as usize) && (middle - element.center).dot(element.normal()) > 0.0;
        for (cluster, weight) in lights.cluster_weights.clusters_of(arena, root as usize) {
            sums[cluster as usize][0] += element.size();
            sums[cluster as usize][1] += element.size() * weight;
            let has_whole_box = arena.roots.iter().filter(|&&other| is_of_box(other as usize)).all(|&other| {
                crate::exits::clusters_around(arena, arena.elements[other as usize].parent).any(|it| it == cluster)
            });
            if has_whole_box && is_inside {
                assert_eq!(weight, 0.0, "{} in {cluster}", element.center);
                inside += 1;
            } else if is_of_box(root as usize) {
                outside += i32::from(weight > 0.0);
            }
        }
    }
    assert!(inside >= 6 && outside >= 6, "{inside} {outside}");
    for [area, weighted] in sums.into_iter().filter(|[area, _]| *area > 0.0) {
        assert!((weighted / area - 1.0).abs() < 1e-4, "{weighted} of {area}");
    }
}

/// Fog that absorbs nothing, everywhere.
const FOG: &str = "medium fog =\n  c\n  sigma_s 1\nmglobal fog\n";

/// Links bring half of the light to the fog of an evenly lit box. Rays find the rest.
#[test]
fn rays_correct_the_light_in_fog() {
    let prepared = prepare(&format!("{}{FOG}", furnace(0.5)));
    let scene = Scene::new(&prepared);
    let mut state = SolverState::new(&prepared, &OPTIONS, &CANCEL).unwrap();
    let rays = cast(&scene, &state);
    let SolverState { arena, lights, links, .. } = &mut state;
    let is_fog = |index: u32| arena.elements[index as usize].is_volume();
    let boxes: Vec<u32> = ray_leaves(arena).into_iter().filter(|&leaf| is_fog(leaf)).collect();
    let light_of_fog = |lights: &ElementLights| {
        let of = |&leaf: &u32| {
            let nodes = lights.node_irradiance(leaf as usize, FROM_ELEMENTS);
            nodes.iter().map(|light| light.y).sum::<f32>() * arena.elements[leaf as usize].size()
        };
        boxes.iter().map(of).sum::<f32>()
    };
    let truth = light_of_fog(lights);
    links.iter_mut().filter(|link| is_fog(link.receiver)).for_each(|link| link.factors = link.factors.map(|f| 0.5 * f));
    lights.gather(arena, links);
    let halved = light_of_fog(lights) / truth;
    assert!(boxes.len() > 8 && (halved - 0.5).abs() < 0.01, "{} boxes, {halved}", boxes.len());
    // All elements still send the light of the first solution.
    rays.correct(arena, lights, OPTIONS.error);
    let ratio = light_of_fog(lights) / truth;
    assert!((ratio - 1.0).abs() < 0.05, "{ratio}");
}

/// Two small clouds in opposite corners: none of the nodes of the box around both is in fog, but rays hit it there.
#[test]
fn fog_between_the_nodes_of_a_box_leaves_light_finite() {
    let cloud = |low: f64, high: f64| format!("mbox fog {low} {low} {low} {high} {high} {high}\n");
    let fog = format!("medium fog =\n  c\n  sigma_s 8\n{}{}", cloud(0.01, 0.15), cloud(0.85, 0.99));
    let prepared = prepare(&format!("{}{fog}", furnace(0.5)));
    let scene = Scene::new(&prepared);
    let mut state = SolverState::new(&prepared, &OPTIONS, &CANCEL).unwrap();
    let rays = cast(&scene, &state);
    let SolverState { arena, lights, .. } = &mut state;
    let correction = rays.correct(arena, lights, OPTIONS.error);
    assert!(
        correction.ratio.is_finite() && correction.changed.is_finite(),
        "{} {}",
        correction.ratio,
        correction.changed
    );
    for leaf in ray_leaves(arena) {
        let nodes = lights.node_irradiance(leaf as usize, FROM_ELEMENTS);
        assert!(nodes.iter().all(|light| light.is_finite()), "{leaf}: {nodes:?}");
    }
    assert!(solve(&prepared, &OPTIONS, &CANCEL).unwrap().verify(&prepared).is_ok());
}
