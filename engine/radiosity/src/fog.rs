//! Fog of a solution in the form that is kept.

use crate::arena::Arena;
use crate::element::Element;
use crate::form_factor::mean_direction_to;
use crate::gather::{ElementLights, FROM_ELEMENTS};
use crate::link::Link;
use crate::scene::Scene;
use crate::tuning::FOG_GRID;
use femc_field::{FogCell, FogLeaf, FogTree};
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use std::f32::consts::PI;

/// Returns the boxes of fog with their light and coefficients. `None` if some light is not finite, or negative.
pub fn fog_tree(scene: &Scene<'_>, arena: &Arena, lights: &ElementLights, links: &[Link]) -> Option<FogTree> {
    let directions = mean_directions(arena, lights, links);
    let mut cells = Vec::new();
    let mut order = vec![arena.fog];
    let mut at = 0;
    while at < order.len() {
        let index = order[at] as usize;
        let element = &arena.elements[index];
        cells.push(if element.is_leaf() {
            FogCell::Leaf(fog_leaf(scene, element, &lights.node_irradiance(index, FROM_ELEMENTS), directions[index]))
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
/// - `values`: a quarter of the light from all directions, at the nodes, lx;
/// - `direction`: output of [`mean_directions`].
fn fog_leaf(scene: &Scene<'_>, element: &Element, values: &[Rgb; 4], direction: Vec3A) -> FogLeaf {
    let [middle, slopes @ ..] = Element::fog_slopes(values);
    // Slopes over whole edges.
    let [x, y, z] = slopes.map(|slope| slope * (2.0 / PI));
    let [sigma_s, sigma_t] = coefficients(scene, element);
    let anisotropy = direction * (3.0 * scene.prepared.media.mean_cosine_at(element.center));
    FogLeaf { mean: [middle / PI, x, y, z], anisotropy, sigma_s, sigma_t }.limit_slopes()
}

/// Returns by element the mean of the unit propagation directions of the light that a box of fog receives from elements, weighted by
/// luminance; zero for elements that are not fog.
fn mean_directions(arena: &Arena, lights: &ElementLights, links: &[Link]) -> Vec<Vec3A> {
    // Sums of the light, and of the light times its direction.
    let mut sums = vec![(0.0f32, Vec3A::ZERO); arena.elements.len()];
    for row in links.chunk_by(|a, b| a.receiver == b.receiver) {
        let index = row[0].receiver as usize;
        let p = &arena.elements[index];
        if !p.is_volume() {
            continue;
        }
        let (light, direction) = &mut sums[index];
        for link in row {
            let q = &arena.elements[link.source as usize];
            let factor = link.factors.iter().sum::<f32>() * 0.25;
            let sent = luminance(lights.sent_toward(link.source as usize, q, p.center)) * factor;
            *light += sent;
            *direction += sent * mean_propagation(q, p.center);
        }
    }
    for index in 0..arena.elements.len() {
        let element = &arena.elements[index];
        let Some(above) = arena.elements.get(element.parent as usize).filter(|_| element.is_volume()) else { continue };
        let (light, direction) = match above.directional() {
            Some(directional) => {
                let arriving = &lights.incident[directional].total[FROM_ELEMENTS];
                (luminance(arriving.total()) * 0.25, arriving.luminance_vector() * -0.25)
            }
            None => sums[element.parent as usize],
        };
        (sums[index].0, sums[index].1) = (sums[index].0 + light, sums[index].1 + direction);
    }
    let mean = |(light, direction): (f32, Vec3A)| {
        // Rounding may make the sum longer than the light.
        let mean = if light > 0.0 { direction / light } else { Vec3A::ZERO };
        if mean.is_finite() { mean.clamp_length_max(1.0) } else { Vec3A::ZERO }
    };
    sums.into_iter().map(mean).collect()
}

/// Returns the mean of the propagation directions of light from an element at a point.
fn mean_propagation(q: &Element, point: Vec3A) -> Vec3A {
    if let Some(patch) = q.patch() {
        let mean = mean_direction_to(point, patch.polygon());
        if mean != Vec3A::ZERO {
            return -mean;
        }
    }
    let way = point - q.center;
    // The light of an element around the point comes from all sides.
    way / (way.length_squared() + q.radius * q.radius).sqrt().max(f32::MIN_POSITIVE)
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
