//! Gathering of light through links, and its transport down and up the tree.

use crate::arena::Arena;
use crate::element::{Curved, Element, Patch, Shape, SurfacePart};
use crate::link::Link;
use crate::scene::Scene;
use crate::tuning::{CURVED_NORMALS, MAX_REFLECTED_SHARE, MAX_ROW_SUM};
use femc_field::{Harmonics, NONE};
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::glam::{Vec2, Vec3A};
use rayon::prelude::*;
use std::f32::consts::PI;

/// The light of an element.
#[derive(Clone, Copy, Debug)]
pub struct ElementLight {
    /// Irradiance at the nodes, lx, received through the element's own links from light sources, and from elements.
    pub gathered: [[Rgb; 4]; 2],
    /// Irradiance at the nodes including that of the elements above it, lx.
    pub total: [[Rgb; 4]; 2],
    /// Mean radiosity, lx; for fog per m.
    pub radiosity: Rgb,
    /// Bounds of the radiosity's luminance over the parts.
    pub darkest: f32,
    pub brightest: f32,
    /// Mean irradiance, by luminance, and the mean irradiance of the darkest part.
    pub mean: f32,
    pub min_mean: f32,
    /// Intensity by direction that wide elements send, cd.
    pub intensity: Harmonics,
}

impl ElementLight {
    pub const ZERO: Self = Self {
        gathered: [[Rgb::ZERO; 4]; 2],
        total: [[Rgb::ZERO; 4]; 2],
        radiosity: Rgb::ZERO,
        darkest: 0.0,
        brightest: 0.0,
        mean: 0.0,
        min_mean: 0.0,
        intensity: Harmonics::ZERO,
    };
}

/// Arriving light of a wide element by direction, from sources and from elements: through its own links, and including that of the
/// elements above.
#[derive(Clone, Copy, Debug)]
pub struct IncidentLight {
    pub gathered: [Harmonics; 2],
    pub total: [Harmonics; 2],
    /// Light of a ball that rays find in addition to that of the links.
    pub ray_correction: Harmonics,
}

impl IncidentLight {
    pub const ZERO: Self =
        Self { gathered: [Harmonics::ZERO; 2], total: [Harmonics::ZERO; 2], ray_correction: Harmonics::ZERO };
}

/// Indices of the kinds of light.
pub const FROM_LAMPS: usize = 0;
pub const FROM_ELEMENTS: usize = 1;

/// Treatment of irradiance that exceeds the possible maximum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EnergyBound {
    /// No bound: the irradiance stays.
    None,
    /// The excess is removed from now on, so that light cannot grow from reflection to reflection.
    RowSums,
}

/// Light of all elements.
#[derive(Clone, Debug)]
pub struct ElementLights {
    pub elements: Vec<ElementLight>,
    pub incident: Vec<IncidentLight>,
    /// Accepted share of the links' light at the nodes, by element, see [`ElementLights::row_sum`].
    pub accepted: Vec<[f32; 4]>,
    /// Light that rays find at the nodes in addition to that, by element, lx; see [`crate::rays`].
    pub ray_correction: Vec<[Rgb; 4]>,
}

impl ElementLights {
    /// Number of bytes of an element's light, without the light by direction.
    pub const BYTES: usize = size_of::<ElementLight>() + size_of::<[f32; 4]>() + size_of::<[Rgb; 4]>();

    pub fn new(arena: &Arena) -> Self {
        let count = arena.elements.len();
        Self {
            elements: vec![ElementLight::ZERO; count],
            incident: vec![IncidentLight::ZERO; arena.directional_count],
            accepted: vec![[1.0; 4]; count],
            ray_correction: vec![[Rgb::ZERO; 4]; count],
        }
    }

    /// Allocates new elements, which begin with their parents' light.
    pub fn grow(&mut self, arena: &Arena) {
        for element in &arena.elements[self.elements.len()..] {
            let parent = self.elements[element.parent as usize];
            let ElementLight { radiosity, darkest, brightest, mean, min_mean: least, .. } = parent;
            self.elements.push(ElementLight {
                radiosity,
                darkest,
                brightest,
                mean,
                min_mean: least,
                ..ElementLight::ZERO
            });
            let taken = self.accepted[element.parent as usize].into_iter().fold(1.0, f32::min);
            self.accepted.push([taken; 4]);
        }
        self.incident.resize(arena.directional_count, IncidentLight::ZERO);
        self.ray_correction.resize(arena.elements.len(), [Rgb::ZERO; 4]);
    }

    /// Accepts all light of the links.
    pub fn accept_all(&mut self) {
        self.accepted.fill([1.0; 4]);
    }

    /// Returns the greatest irradiance of a point if all elements have radiosity 1 and the fog emits in proportion to its extinction.
    /// It is 1 in a closed scene with exact links. The bound is [`MAX_ROW_SUM`]. Scenes that reflect most of their light have a
    /// lower bound, so that light cannot grow.
    pub fn row_sum(&mut self, scene: &Scene<'_>, arena: &Arena, links: &[Link], bound_action: EnergyBound) -> f32 {
        let (of, arriving) = (self.elements.clone(), self.incident.clone());
        for index in (0..arena.elements.len()).rev() {
            let element = &arena.elements[index];
            if !element.is_leaf() {
                self.pull(arena, index);
                continue;
            }
            let light = &mut self.elements[index];
            light.radiosity = match &element.shape {
                Shape::Volume(_) => Rgb::splat(scene.prepared.media.extinction_at(element.center)),
                Shape::Patch(_) | Shape::Curved(_) | Shape::Cluster(_) => Rgb::ONE,
            };
            if let Shape::Curved(curved) = &element.shape {
                light.intensity = curved_intensity(scene, &curved.part, |_| Rgb::ONE);
            }
        }
        self.gather(arena, links);
        self.push_all(arena);
        let albedo = |element: &Element| match &element.shape {
            Shape::Cluster(_) => 0.0,
            Shape::Volume(fog) => {
                let extinction = scene.prepared.media.extinction_at(element.center);
                fog.sigma_s.max_element() / extinction.max(f32::MIN_POSITIVE)
            }
            Shape::Patch(Patch { part, .. }) | Shape::Curved(Curved { part, .. }) => {
                (part.reflectance + part.transmittance).max_element()
            }
        };
        let greatest = arena.elements.iter().map(albedo).fold(0.0, f32::max);
        let bound = (MAX_REFLECTED_SHARE / greatest.max(f32::MIN_POSITIVE)).clamp(1.0, MAX_ROW_SUM);
        let mut most = 0.0f32;
        for (index, element) in arena.elements.iter().enumerate().filter(|(_, element)| element.is_leaf()) {
            let received = match element.directional() {
                Some(directional) => [self.incident[directional].total[FROM_ELEMENTS].total().y * 0.25; 4],
                None => self.elements[index].total[FROM_ELEMENTS].map(|light| light.y),
            };
            most = received[..element.node_count()].iter().copied().fold(most, f32::max);
            if bound_action == EnergyBound::RowSums {
                for (taken, received) in self.accepted[index].iter_mut().zip(received) {
                    *taken = taken.min(bound / received.max(f32::MIN_POSITIVE));
                }
            }
        }
        (self.elements, self.incident) = (of, arriving);
        most
    }

    /// Gathers irradiance through all links, which are sorted by receiver. The light of each receiver is added in the links' order.
    pub fn gather(&mut self, arena: &Arena, links: &[Link]) {
        let rows: Vec<&[Link]> = links.chunk_by(|a, b| a.receiver == b.receiver).collect();
        let lights = &self.elements;
        let gathered: Vec<([Rgb; 4], Harmonics)> =
            rows.par_iter().with_min_len(64).map(|row| gather_row(arena, lights, row)).collect();
        for light in &mut self.elements {
            light.gathered[FROM_ELEMENTS] = [Rgb::ZERO; 4];
        }
        for arriving in &mut self.incident {
            arriving.gathered[FROM_ELEMENTS] = Harmonics::ZERO;
        }
        for (row, (nodes, arriving)) in rows.iter().zip(gathered) {
            let receiver = row[0].receiver as usize;
            self.elements[receiver].gathered[FROM_ELEMENTS] = nodes;
            if let Some(directional) = arena.elements[receiver].directional() {
                self.incident[directional].gathered[FROM_ELEMENTS] = arriving;
            }
        }
    }

    /// Transports arriving light down the tree, and sent light up. Returns the change of the light that leaves all elements, and
    /// the total, lm. The changes are sums of the absolute changes of the leaves.
    pub fn push_pull(&mut self, scene: &Scene<'_>, arena: &Arena) -> (f64, f64) {
        self.push_all(arena);
        let (mut change, mut whole) = (0.0, 0.0);
        for index in (0..arena.elements.len()).rev() {
            let before = self.elements[index].radiosity;
            if arena.elements[index].is_leaf() {
                self.reflect(scene, arena, index);
                let now = self.elements[index].radiosity;
                let element = &arena.elements[index];
                // A box of fog sends in all directions four times as much as a surface of its radiosity.
                let size = f64::from(if element.is_volume() { 4.0 * element.size() } else { element.size() });
                change += size * f64::from(luminance((now - before).abs()));
                whole += size * f64::from(luminance(now));
            } else {
                self.pull(arena, index);
            }
        }
        (change, whole)
    }

    /// Transports arriving light down the tree.
    pub fn push_all(&mut self, arena: &Arena) {
        (0..arena.elements.len()).for_each(|index| self.push(arena, index));
    }

    fn push(&mut self, arena: &Arena, index: usize) {
        let element = &arena.elements[index];
        let parent = arena.elements.get(element.parent as usize);
        if let Some(directional) = element.directional() {
            let mut arriving = self.incident[directional];
            arriving.total = arriving.gathered;
            if let Some(above) = parent.and_then(Element::directional) {
                let above = self.incident[above].total;
                (0..2).for_each(|kind| arriving.total[kind] += above[kind]);
            }
            self.incident[directional] = arriving;
            return;
        }
        let mut whole = self.elements[index].gathered;
        if let Some(above) = parent {
            for kind in [FROM_LAMPS, FROM_ELEMENTS] {
                for (node, value) in whole[kind].iter_mut().enumerate().take(element.node_count()) {
                    *value += match above.directional() {
                        Some(directional) => {
                            let light = &self.incident[directional].total[kind];
                            match &element.shape {
                                // A point of fog receives a quarter of the light from all directions.
                                Shape::Volume(_) => (light.total() * 0.25).max(Rgb::ZERO),
                                _ => light.cosine_integral(element.node(node).normal),
                            }
                        }
                        None => above.interpolate(
                            &self.elements[element.parent as usize].total[kind],
                            above.node_in_parent(element, node),
                        ),
                    };
                }
            }
        }
        self.elements[index].total = whole;
    }

    /// Returns the irradiance at an element's nodes from sources or from elements.
    pub fn node_irradiance(&self, index: usize, from: usize) -> [Rgb; 4] {
        let mut values = self.elements[index].total[from];
        if from == FROM_ELEMENTS {
            let beyond = self.accepted[index].into_iter().zip(self.ray_correction[index]);
            values.iter_mut().zip(beyond).for_each(|(value, (taken, more))| *value = *value * taken + more);
        }
        values
    }

    /// Returns the light by direction that a curved element receives from sources or from elements.
    pub fn directional_irradiance(&self, element: &Curved, index: usize, from: usize) -> Harmonics {
        let IncidentLight { total: whole, ray_correction: more, .. } = self.incident[element.directional as usize];
        if from == FROM_ELEMENTS { whole[from] * Rgb::splat(self.accepted[index][0]) + more } else { whole[from] }
    }

    /// Computes the light that a leaf sends from the light that it receives.
    fn reflect(&mut self, scene: &Scene<'_>, arena: &Arena, index: usize) {
        let element = &arena.elements[index];
        let behind = element.surface_part().map_or(Rgb::ZERO, |part| self.back_irradiance(scene, arena, element, part));
        let of_elements = self.node_irradiance(index, FROM_ELEMENTS);
        let (reflectance, transmittance) = match &element.shape {
            Shape::Curved(curved) => return self.reflect_curved(scene, curved, behind, index),
            Shape::Patch(Patch { part, .. }) => (part.reflectance, part.transmittance),
            Shape::Volume(fog) => (fog.sigma_s, Rgb::ZERO),
            Shape::Cluster(_) => (Rgb::ZERO, Rgb::ZERO),
        };
        let light = &mut self.elements[index];
        let (mut sum, mut mean, mut darkest, mut brightest) = (Rgb::ZERO, 0.0, f32::INFINITY, 0.0f32);
        for (node, of_elements) in of_elements.into_iter().enumerate().take(element.node_count()) {
            let irradiance = (light.total[FROM_LAMPS][node] + of_elements).max(Rgb::ZERO);
            let radiosity = reflectance * irradiance + transmittance * behind;
            let value = luminance(radiosity);
            (darkest, brightest) = (darkest.min(value), brightest.max(value));
            (sum, mean) = (sum + radiosity, mean + luminance(irradiance));
        }
        let share = 1.0 / element.node_count() as f32;
        (light.radiosity, light.mean) = (sum * share, mean * share);
        light.min_mean = light.mean;
        (light.darkest, light.brightest) = (darkest, brightest);
    }

    fn reflect_curved(&mut self, scene: &Scene<'_>, curved: &Curved, behind: Rgb, index: usize) {
        let arriving = self.incident[curved.directional as usize].total[FROM_LAMPS]
            + self.directional_irradiance(curved, index, FROM_ELEMENTS);
        let (mut sum, mut mean) = (Rgb::ZERO, 0.0);
        let sent = curved_intensity(scene, &curved.part, |normal| {
            let irradiance = arriving.cosine_integral(normal);
            let radiosity = curved.part.reflectance * irradiance + curved.part.transmittance * behind;
            (sum, mean) = (sum + radiosity, mean + luminance(irradiance));
            radiosity
        });
        let light = &mut self.elements[index];
        light.intensity = sent;
        light.radiosity = sum / CURVED_NORMALS as f32;
        light.mean = mean / CURVED_NORMALS as f32;
        light.min_mean = light.mean;
        (light.darkest, light.brightest) = (0.0, 2.0 * luminance(light.radiosity));
    }

    /// Returns the mean irradiance of the other side if the surface transmits light.
    fn back_irradiance(&self, scene: &Scene<'_>, arena: &Arena, element: &Element, part: &SurfacePart) -> Rgb {
        if part.transmittance == Rgb::ZERO {
            return Rgb::ZERO;
        }
        let other = scene.other_side(part.surface);
        let root = if other == NONE { NONE } else { arena.roots[other as usize] };
        if root == NONE {
            return Rgb::ZERO;
        }
        // Both sides are split alike, though one may be split further.
        let middle = if element.is_triangle() { Vec2::splat(1.0 / 3.0) } else { Vec2::splat(0.5) };
        let (index, _) = arena.element_at(root, part.outline.point_at(middle), 0.0);
        let other = &arena.elements[index as usize];
        if let Shape::Curved(other) = &other.shape {
            let sources = self.incident[other.directional as usize].total[FROM_LAMPS];
            return (sources + self.directional_irradiance(other, index as usize, FROM_ELEMENTS)).total() * 0.25;
        }
        let [sources, elements] = [FROM_LAMPS, FROM_ELEMENTS].map(|from| self.node_irradiance(index as usize, from));
        let sum: Rgb = (0..other.node_count()).map(|node| sources[node] + elements[node]).sum();
        (sum / other.node_count() as f32).max(Rgb::ZERO)
    }

    fn pull(&mut self, arena: &Arena, index: usize) {
        let element = &arena.elements[index];
        let [a, b] = element.children.map(|child| (&arena.elements[child as usize], self.elements[child as usize]));
        let mut out = self.elements[index];
        let size = a.0.size() + b.0.size();
        let [wa, wb] = [a, b].map(|(part, _)| if size > 0.0 { part.size() / size } else { 0.5 });
        if element.is_directional() {
            out.intensity = Harmonics::ZERO;
            for (part, light) in [a, b] {
                match &part.shape {
                    Shape::Cluster(_) | Shape::Curved(_) => out.intensity += light.intensity,
                    Shape::Patch(patch) => {
                        let nodes = patch.nodes();
                        let amount = light.radiosity * (patch.part.area / (PI * nodes.len() as f32));
                        for node in nodes {
                            out.intensity += Harmonics::from_direction(node.normal, amount);
                        }
                    }
                    Shape::Volume(_) => {}
                }
            }
        }
        out.radiosity = a.1.radiosity * wa + b.1.radiosity * wb;
        out.mean = a.1.mean * wa + b.1.mean * wb;
        out.min_mean = a.1.min_mean.min(b.1.min_mean);
        out.darkest = a.1.darkest.min(b.1.darkest);
        out.brightest = a.1.brightest.max(b.1.brightest);
        self.elements[index] = out;
    }
}

/// Returns the intensity of a curved element by direction, cd, from the radiosity at points around it.
fn curved_intensity(scene: &Scene<'_>, part: &SurfacePart, mut radiosity: impl FnMut(Vec3A) -> Rgb) -> Harmonics {
    let mut sent = Harmonics::ZERO;
    for k in 0..CURVED_NORMALS {
        let place = Vec2::new((k % 4) as f32 + 0.5, (k / 4) as f32 + 0.5) * 0.25;
        let normal = part.point_at(scene, place).normal;
        sent += Harmonics::from_direction(normal, radiosity(normal) * (part.area / (PI * CURVED_NORMALS as f32)));
    }
    sent
}

fn gather_row(arena: &Arena, lights: &[ElementLight], row: &[Link]) -> ([Rgb; 4], Harmonics) {
    let p = &arena.elements[row[0].receiver as usize];
    let (mut nodes, mut arriving) = ([Rgb::ZERO; 4], Harmonics::ZERO);
    for link in row {
        let (q, light) = (&arena.elements[link.source as usize], &lights[link.source as usize]);
        let way: Vec3A = q.center - p.center;
        let sent = if q.is_directional() {
            light.intensity.cosine_integral(-way.normalize_or(Vec3A::Z))
        } else {
            light.radiosity
        };
        if p.is_directional() {
            arriving += Harmonics::from_direction(way.normalize_or(Vec3A::Z), sent * link.factors[0]);
        } else {
            for (node, factor) in nodes.iter_mut().zip(link.factors) {
                *node += sent * factor;
            }
        }
    }
    (nodes, arriving)
}
