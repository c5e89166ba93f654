//! Irradiance of elements by particles.
//!
//! The light of a part is that of its particles as far as they differ from the light that the part above predicts there by more than
//! chance, and else that prediction (James and Stein's estimator, \[efron1973\]). The whole keeps its light.

use super::{Caustics, Particle};
use crate::arena::Arena;
use crate::element::{Element, PatchForm, Shape};
use crate::rays::{fog_part, leaf_part, part_count};
use crate::tuning::CAUSTIC_CHANCE;
use femc_field::NONE;
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::glam::{Vec2, Vec3A};

/// Light of the particles on elements.
#[derive(Clone, Debug, Default)]
pub struct CausticLight {
    /// Irradiance at the nodes, by element, lx.
    pub nodes: Vec<[Rgb; 4]>,
    /// Leaves with particles, and the difference between the irradiances of their parts, lx.
    pub contrast: Vec<(u32, f32)>,
}

/// Flux of the particles of a part.
#[derive(Clone, Copy, Debug, Default)]
struct PartFlux {
    flux: Rgb,
    /// Sum of the squared luminous fluxes, lm2.
    squares: f32,
}

impl PartFlux {
    fn add(&mut self, flux: Rgb) {
        self.flux += flux;
        self.squares += luminance(flux) * luminance(flux);
    }

    fn sum(parts: &[Self]) -> Self {
        let add = |sum: Self, part: &Self| Self { flux: sum.flux + part.flux, squares: sum.squares + part.squares };
        parts.iter().fold(Self::default(), add)
    }
}

impl Caustics {
    /// Returns the light of the particles on all elements.
    pub fn light(&self, arena: &Arena) -> CausticLight {
        let parts = self.part_fluxes(arena);
        let mut sums: Vec<PartFlux> = parts.iter().map(|parts| PartFlux::sum(parts)).collect();
        let has_parts = |index: usize| arena.elements[index].is_cluster() && !arena.elements[index].is_leaf();
        for index in (0..sums.len()).rev().filter(|&index| has_parts(index)) {
            sums[index] = PartFlux::sum(&arena.elements[index].children.map(|child| sums[child as usize]));
        }
        // Light of a cluster, lm, and expected irradiance at the nodes of others, lx.
        let mut expected = vec![[Rgb::ZERO; 4]; sums.len()];
        let mut light = CausticLight { nodes: vec![[Rgb::ZERO; 4]; sums.len()], contrast: Vec::new() };
        let whole = |element: &Element, flux: Rgb| {
            let scale = element.received_share() * element.size();
            let inverse = |x: f32| if x > 0.0 { 1.0 / x } else { 0.0 };
            flux * Rgb::from_array(scale.to_array().map(inverse))
        };
        for (index, element) in arena.elements.iter().enumerate() {
            let is_top = arena.elements.get(element.parent as usize).is_none_or(|above| above.radius.is_infinite());
            if is_top {
                let flux = sums[index].flux;
                expected[index] = [if element.is_cluster() { flux } else { whole(element, flux) }; 4];
            }
            let mean = expected[index];
            if luminance(mean[0] + mean[1] + mean[2] + mean[3]) <= 0.0 || element.radius.is_infinite() {
                continue;
            }
            if element.is_cluster() && element.is_leaf() {
                // The surfaces of a cluster without parts have the mean. Where that matters, it is split.
                let mean = whole(element, mean[0]);
                light.nodes[index] = [mean; 4];
                light.contrast.push((index as u32, 2.0 * luminance(mean)));
                continue;
            }
            let children = element.children.map(|child| (child, arena.elements.get(child as usize)));
            if element.is_cluster() {
                let [a, b] = children.map(|(_, part)| part.map_or(0.0, Element::size));
                let share = if a + b > 0.0 { a / (a + b) } else { 0.5 };
                let found = element.children.map(|child| sums[child as usize]);
                let flux = estimate(&[mean[0] * share, mean[0] * (1.0 - share)], &found);
                for ((child, part), flux) in children.into_iter().zip(flux) {
                    let light = part.map_or(Rgb::ZERO, |part| if part.is_cluster() { flux } else { whole(part, flux) });
                    expected[child as usize] = [light; 4];
                }
                continue;
            }
            let count = part_count(element);
            let found = estimate(&mean[..count], &parts[index][..count]);
            let nodes = node_values(element, &found);
            light.nodes[index] = nodes;
            if element.is_leaf() {
                let amounts = found.iter().map(|light| luminance(*light));
                let (low, high) = amounts.fold((f32::INFINITY, 0.0f32), |(low, high), x| (low.min(x), high.max(x)));
                light.contrast.push((index as u32, high - low));
                continue;
            }
            let predicted =
                children.map(|(_, part)| part.map_or([Rgb::ZERO; 4], |part| in_part(element, &nodes, part)));
            let means = [0, 1].map(|k| {
                let count = children[k].1.map_or(1, part_count);
                predicted[k][..count].iter().copied().sum::<Rgb>() / count as f32
            });
            let sizes = children.map(|(_, part)| part.map_or(0.0, Element::size));
            let flux = estimate(
                &[means[0] * sizes[0], means[1] * sizes[1]],
                &element.children.map(|child| sums[child as usize]),
            );
            // The prediction may be more or less than the light of both.
            let whole = luminance(found.iter().copied().sum::<Rgb>()) / count as f32 * (sizes[0] + sizes[1]);
            let scale = whole / luminance(flux[0] + flux[1]).max(f32::MIN_POSITIVE);
            for (k, (child, _)) in children.into_iter().enumerate() {
                let factor = luminance(flux[k]) / luminance(means[k] * sizes[k]).max(f32::MIN_POSITIVE);
                expected[child as usize] = if luminance(means[k]) > 0.0 {
                    predicted[k].map(|light| light * (factor * scale))
                } else {
                    [flux[k] * (scale / sizes[k].max(f32::MIN_POSITIVE)); 4]
                };
            }
        }
        light
    }

    /// Returns the flux of the particles in each part of each element of a surface or of fog.
    fn part_fluxes(&self, arena: &Arena) -> Vec<[PartFlux; 4]> {
        let mut parts = vec![[PartFlux::default(); 4]; arena.elements.len()];
        for &Particle { surface, place, flux } in &self.particles {
            if surface == NONE {
                let mut index = arena.fog;
                while index != NONE {
                    let element = &arena.elements[index as usize];
                    parts[index as usize][fog_part(element, place)].add(flux);
                    let second = &arena.elements.get(element.children[1] as usize);
                    index = second.map_or(NONE, |second| {
                        let is_first = place.cmplt(second.center - second.half_extent).any();
                        element.children[usize::from(!is_first)]
                    });
                }
                continue;
            }
            let root = arena.roots[surface as usize];
            if arena.elements.get(root as usize).is_some_and(Element::is_cluster) {
                parts[root as usize][0].add(flux);
            }
            for (index, local) in arena.parts_at(root, Vec2::new(place.x, place.y)) {
                parts[index as usize][leaf_part(&arena.elements[index as usize], local)].add(flux);
            }
        }
        parts
    }
}

/// Barycentric coordinate of the center of a third of a triangle (the points nearest to one corner), for that corner.
const TRIANGLE_PART: f32 = 11.0 / 18.0;
/// A node of an element and the center of the node's part have different distances from the middle of the element. These are the
/// distances of the nodes, divided by the distances of the centers: for triangles, and for rectangles.
const TRIANGLE_NODES: f32 = (2.0 / 3.0 - 1.0 / 3.0) / (TRIANGLE_PART - 1.0 / 3.0);
const RECTANGLE_NODES: f32 = 1.154_700_5;

/// Returns the values at the nodes of a linear function with these means over the parts of an element.
fn node_values(element: &Element, parts: &[Rgb]) -> [Rgb; 4] {
    let mean = parts.iter().copied().sum::<Rgb>() / parts.len() as f32;
    let mut nodes = match &element.shape {
        Shape::Curved(_) | Shape::Cluster(_) => return [mean; 4],
        Shape::Volume(_) => [0, 1, 2, 3].map(|k| parts[k]),
        Shape::Patch(patch) if patch.form == PatchForm::Triangle => {
            [0, 1, 2, 2].map(|k| mean + (parts[k] - mean) * TRIANGLE_NODES)
        }
        Shape::Patch(_) => {
            let slope = |plus: [usize; 2], minus: [usize; 2]| {
                (parts[plus[0]] + parts[plus[1]] - parts[minus[0]] - parts[minus[1]]) * 0.25
            };
            let x = slope([1, 3], [0, 2]) * RECTANGLE_NODES;
            let y = slope([2, 3], [0, 1]) * RECTANGLE_NODES;
            let both = slope([0, 3], [1, 2]) * (RECTANGLE_NODES * RECTANGLE_NODES);
            [mean - x - y + both, mean + x - y - both, mean - x + y - both, mean + x + y + both]
        }
    };
    nodes.iter_mut().for_each(|light| *light = light.max(Rgb::ZERO));
    let sum = nodes[..element.node_count()].iter().copied().sum::<Rgb>() / element.node_count() as f32;
    let scale = luminance(mean) / luminance(sum).max(f32::MIN_POSITIVE);
    nodes.map(|light| light * scale)
}

/// Returns the values of a linear function of an element at the centers of the parts of a child.
fn in_part(element: &Element, nodes: &[Rgb; 4], child: &Element) -> [Rgb; 4] {
    let near = 0.5 * (1.0 - TRIANGLE_PART);
    [0, 1, 2, 3].map(|k| {
        let place = match &child.shape {
            _ if element.is_directional() => return nodes[0],
            Shape::Patch(patch) => {
                let center = match (patch.form, k) {
                    (PatchForm::Triangle, 0) => Vec2::splat(near),
                    (PatchForm::Triangle, 1) => Vec2::new(TRIANGLE_PART, near),
                    (PatchForm::Triangle, _) => Vec2::new(near, TRIANGLE_PART),
                    _ => Vec2::new((k % 2) as f32, (k / 2) as f32) * 0.5 + 0.25,
                };
                let local = patch.part.in_parent.point_at(center);
                Vec3A::new(local.x, local.y, 0.0)
            }
            _ => element.node_in_parent(child, k.min(child.node_count() - 1)),
        };
        element.interpolate(nodes, place).max(Rgb::ZERO)
    })
}

/// Returns the light of the parts of a whole, which keeps its light.
/// - `expected`: light that is expected of each part;
/// - `found`: flux of the particles of each part.
fn estimate(expected: &[Rgb], found: &[PartFlux]) -> Vec<Rgb> {
    let all = PartFlux::sum(found);
    let whole: Rgb = expected.iter().copied().sum();
    let (amount, flux) = (luminance(whole), luminance(all.flux));
    if amount <= 0.0 || flux <= 0.0 || all.squares <= 0.0 {
        return expected.to_vec();
    }
    // Number of equal particles with the same variance.
    let number = flux * flux / all.squares;
    let least = 0.1 / expected.len() as f32;
    let deviation: f32 = expected
        .iter()
        .zip(found)
        .map(|(expected, found)| {
            let (before, after) = (luminance(*expected) / amount, luminance(found.flux) / flux);
            (after - before) * (after - before) * number / before.max(least)
        })
        .sum();
    let freedom = (expected.len() - 1) as f32;
    let sure = (1.0 - CAUSTIC_CHANCE * freedom / deviation.max(f32::MIN_POSITIVE)).max(0.0);
    let scale = amount / flux;
    expected.iter().zip(found).map(|(expected, found)| *expected * (1.0 - sure) + found.flux * (scale * sure)).collect()
}
