//! Fog of a solution in the form that is kept.

use crate::arena::Arena;
use crate::element::Element;
use crate::gather::{ElementLights, FROM_ELEMENTS};
use crate::scene::Scene;
use crate::tuning::FOG_GRID;
use femc_field::{FogCell, FogLeaf, FogTree};
use femc_math::Rgb;
use femc_math::glam::Vec3A;
use std::f32::consts::PI;

/// Returns the boxes of fog with their light and coefficients. `None` if some light is not finite, or negative.
pub fn fog_tree(scene: &Scene<'_>, arena: &Arena, lights: &ElementLights) -> Option<FogTree> {
    let mut cells = Vec::new();
    let mut order = vec![arena.fog];
    let mut at = 0;
    while at < order.len() {
        let index = order[at] as usize;
        let element = &arena.elements[index];
        cells.push(if element.is_leaf() {
            FogCell::Leaf(fog_leaf(scene, element, &lights.node_irradiance(index, FROM_ELEMENTS)))
        } else {
            order.extend(element.children);
            let [low, high] = element.children.map(|child| arena.elements[child as usize].center);
            let axis = (1..3).fold(0, |best, axis| if high[axis] > low[axis] { axis } else { best });
            FogCell::Split { axis: axis as u8, at: element.center[axis] }
        });
        at += 1;
    }
    let root = &arena.elements[arena.fog as usize];
    FogTree::new([root.center - root.half_extent, root.center + root.half_extent], &cells)
}

/// Creates the leaf of a box of fog.
/// - `values`: a quarter of the light from all directions, at the nodes, lx.
fn fog_leaf(scene: &Scene<'_>, element: &Element, values: &[Rgb; 4]) -> FogLeaf {
    let [middle, slopes @ ..] = Element::fog_slopes(values);
    // Slopes over whole edges.
    let [x, y, z] = slopes.map(|slope| slope * (2.0 / PI));
    let [sigma_s, sigma_t] = coefficients(scene, element);
    FogLeaf { mean: [middle / PI, x, y, z], sigma_s, sigma_t }.limit_slopes()
}

/// Returns the mean scattering and extinction coefficients of a box, 1/m.
fn coefficients(scene: &Scene<'_>, element: &Element) -> [Rgb; 2] {
    debug_assert!(element.is_volume());
    let at = |point: Vec3A| {
        let media = &scene.prepared.media;
        [media.scattering_at(point), media.extinction_color_at(point)]
    };
    if scene.uniform_extinction.is_some() {
        return at(element.center);
    }
    let mut sums = [Rgb::ZERO; 2];
    for k in 0..FOG_GRID.pow(3) {
        let place = [k % FOG_GRID, k / FOG_GRID % FOG_GRID, k / FOG_GRID.pow(2)]
            .map(|k| (2 * k + 1) as f32 / FOG_GRID as f32 - 1.0);
        let here = at(element.center + element.half_extent * Vec3A::from_array(place));
        sums = [sums[0] + here[0], sums[1] + here[1]];
    }
    sums.map(|sum| sum / FOG_GRID.pow(3) as f32)
}
