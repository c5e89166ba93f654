//! Tests of the solver's kernels against closed forms, quadrature in double precision, and laws of conservation. No test computes
//! its expected value with a function that it checks.

#![expect(clippy::disallowed_methods, reason = "references may differ in their last bits between platforms")]

mod bounds;
mod caustics;
mod clusters;
mod elements;
mod energy;
mod factors;
mod lamps;
mod light;
mod links;
mod steps;

use crate::arena::Arena;
use crate::gather::ElementLight;
use crate::link::Oracle;
use crate::scene::Scene;
use femc_field::Harmonics;
use femc_import::{Bundle, load_scene};
use femc_math::glam::{DVec3, Vec3A};
use femc_prepared::{FrameSpec, Prepared, SceneSource, prepare_frame};
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Material that reflects half of the light, visible from its front.
const GRAY: &str = "m gray =\n  sides 1\n  c\n  rd 0.5\nm gray\n";

/// Prepares a scene of the scene format; a camera is added.
fn prepare(text: &str) -> Prepared {
    let text = format!("camera main =\n  origin .31 .42 .23\n  target .8 .6 .7\n  film 8 8\n{text}");
    let bundle = Bundle(BTreeMap::from([("a.mgf".to_owned(), text.into_bytes())]));
    let scene = load_scene(&bundle, "a.mgf").unwrap_or_else(|error| panic!("{error}")).scene;
    let spec = FrameSpec { camera: None, size: None, frame: 1, filter_radius: 0.5 };
    prepare_frame(&SceneSource::new(scene.into()), &spec, None).unwrap()
}

/// Returns the description of a polygon, whose front sees its corners counterclockwise.
fn face(corners: &[[f64; 3]]) -> String {
    let (mut text, mut names) = (String::new(), String::from("f"));
    for (k, [x, y, z]) in corners.iter().enumerate() {
        write!(text, "v c{k} =\n  p {x} {y} {z}\n").unwrap();
        write!(names, " c{k}").unwrap();
    }
    text + &names + "\n"
}

/// Returns the description of an axis-aligned box whose faces look outward.
fn outward_box([x0, y0, z0]: [f64; 3], [x1, y1, z1]: [f64; 3]) -> String {
    [
        [[x0, y0, z0], [x0, y1, z0], [x1, y1, z0], [x1, y0, z0]],
        [[x0, y0, z1], [x1, y0, z1], [x1, y1, z1], [x0, y1, z1]],
        [[x0, y0, z0], [x1, y0, z0], [x1, y0, z1], [x0, y0, z1]],
        [[x0, y1, z0], [x0, y1, z1], [x1, y1, z1], [x1, y1, z0]],
        [[x0, y0, z0], [x0, y0, z1], [x0, y1, z1], [x0, y1, z0]],
        [[x1, y0, z0], [x1, y1, z0], [x1, y1, z1], [x1, y0, z1]],
    ]
    .iter()
    .map(|corners| face(corners))
    .collect()
}

/// Converts a position of the description to the prepared frame.
fn prepared_position(prepared: &Prepared, position: [f64; 3]) -> Vec3A {
    (DVec3::from_array(position) - prepared.origin).as_vec3a()
}

/// Creates the roots of all surfaces, with all clusters split.
fn full_arena(scene: &Scene<'_>) -> Arena {
    let mut arena = Arena::new(scene);
    let mut index = 0;
    while index < arena.elements.len() {
        if arena.elements[index].is_cluster() {
            arena.ensure_children(scene, index as u32);
        }
        index += 1;
    }
    arena
}

/// Splits an element and its parts `depth` times.
fn split(arena: &mut Arena, scene: &Scene<'_>, index: u32, depth: u32) {
    if depth > 0 {
        let (children, _) = arena.ensure_children(scene, index);
        children.into_iter().for_each(|child| split(arena, scene, child, depth - 1));
    }
}

/// Returns the leaves under an element.
fn leaves_of(arena: &Arena, index: u32) -> Vec<u32> {
    let element = &arena.elements[index as usize];
    if element.is_leaf() {
        return vec![index];
    }
    element.children.into_iter().flat_map(|child| leaves_of(arena, child)).collect()
}

/// Creates an oracle that allows an error of 1 and splits without limits.
fn oracle<'a>(scene: &'a Scene<'a>, arena: &'a Arena, lights: &'a [ElementLight]) -> Oracle<'a> {
    Oracle {
        scene,
        arena,
        lights,
        intensity: &[Harmonics::ZERO; 1 << 10],
        error: 1.0,
        floor: 0.0,
        max_reference: f32::INFINITY,
        fog_floor: 0.0,
        unit_area: 1.0,
        unit_volume: 1.0,
        min_area: 0.0,
        min_volume: 0.0,
        element_budget_exhausted: false,
        link_budget_exhausted: false,
    }
}

/// Returns the midpoints of `count` equal parts of [0, 1].
fn midpoints(count: u32) -> impl Iterator<Item = f64> + Clone {
    (0..count).map(move |k| (f64::from(k) + 0.5) / f64::from(count))
}

/// Returns nodes and weights of Gauss and Legendre's rule with eight points on [0, 1].
fn gauss8() -> [(f64, f64); 8] {
    let half = [
        (0.183_434_642_495_649_8, 0.362_683_783_378_362_0),
        (0.525_532_409_916_329_0, 0.313_706_645_877_887_3),
        (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
        (0.960_289_856_497_536_3, 0.101_228_536_290_376_3),
    ];
    std::array::from_fn(|k| {
        let (x, weight) = half[k / 2];
        (0.5 + if k % 2 == 0 { 0.5 * x } else { -0.5 * x }, 0.5 * weight)
    })
}
