//! Fog of a solution in the form that is kept.

use crate::arena::Arena;
use crate::element::{Element, Kind};
use crate::gather::{FROM_ELEMENTS, Lights};
use crate::scene::Scene;
use femc_field::{FogCell, FogLeaf, FogTree};
use femc_math::Rgb;
use femc_math::glam::Vec3A;
use std::f32::consts::PI;

/// Number of points by axis at which the fog of a box is evaluated if it varies.
const GRID: u32 = 4;

/// Returns the boxes of fog with their light and coefficients. `None` if some light is not finite, or negative.
pub fn tree(scene: &Scene<'_>, arena: &Arena, lights: &Lights) -> Option<FogTree> {
    let mut cells = Vec::new();
    let mut order = vec![arena.fog];
    let mut at = 0;
    while at < order.len() {
        let index = order[at] as usize;
        let element = &arena.elements[index];
        cells.push(if element.is_leaf() {
            FogCell::Leaf(leaf(scene, element, &lights.at_nodes(index, FROM_ELEMENTS)))
        } else {
            order.extend(element.children);
            let [low, high] = element.children.map(|child| arena.elements[child as usize].center);
            let axis = (1..3).fold(0, |best, axis| if high[axis] > low[axis] { axis } else { best });
            FogCell::Cut { axis: axis as u8, at: element.center[axis] }
        });
        at += 1;
    }
    let root = &arena.elements[arena.fog as usize];
    FogTree::new([root.center - root.half, root.center + root.half], &cells)
}

/// Creates the leaf of a box of fog.
/// - `values`: a quarter of the light from all directions, at the nodes, lx.
fn leaf(scene: &Scene<'_>, element: &Element, values: &[Rgb; 4]) -> FogLeaf {
    let [middle, slopes @ ..] = Element::fog_slopes(values);
    // Slopes over whole edges.
    let [x, y, z] = slopes.map(|slope| slope * (2.0 / PI));
    let [sigma_s, sigma_t] = coefficients(scene, element);
    FogLeaf { mean: [middle / PI, x, y, z], sigma_s, sigma_t }.limited()
}

/// Returns the mean scattering and extinction coefficients of a box, 1/m.
fn coefficients(scene: &Scene<'_>, element: &Element) -> [Rgb; 2] {
    debug_assert_eq!(element.kind, Kind::Fog);
    let at = |point: Vec3A| {
        let media = &scene.prepared.media;
        [media.scattering_at(point), media.extinction_color_at(point)]
    };
    if scene.haze.is_some() {
        return at(element.center);
    }
    let mut sums = [Rgb::ZERO; 2];
    for k in 0..GRID.pow(3) {
        let place = [k % GRID, k / GRID % GRID, k / GRID.pow(2)].map(|k| (2 * k + 1) as f32 / GRID as f32 - 1.0);
        let here = at(element.center + element.half * Vec3A::from_array(place));
        sums = [sums[0] + here[0], sums[1] + here[1]];
    }
    sums.map(|sum| sum / GRID.pow(3) as f32)
}
