//! Gathering of light through links, and its transport down and up the tree.

use crate::arena::Arena;
use crate::element::{Curved, Element, Patch, Shape, SurfacePart};
use crate::exits::ClusterWeights;
use crate::link::Link;
use crate::scene::Scene;
use crate::tuning::{BALANCE_VARIANCES, CURVED_NORMALS, MAX_BALANCE, MAX_ROW_SUM};
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

    /// Returns the light that an element sends toward a point, as the factors of links have it: the intensity, cd, of a wide element,
    /// else the radiosity, lx.
    pub fn sent_toward(&self, element: &Element, point: Vec3A) -> Rgb {
        if element.is_directional() {
            return self.intensity.cosine_integral((point - element.center).normalize_or(-Vec3A::Z));
        }
        self.radiosity
    }
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

/// Light of all elements.
#[derive(Clone, Debug)]
pub struct ElementLights {
    pub elements: Vec<ElementLight>,
    pub incident: Vec<IncidentLight>,
    /// Distribution of the clusters' light among their surfaces.
    pub cluster_weights: ClusterWeights,
    /// Factor of the links' light at the nodes, by element. It bounds the row sums ([`ElementLights::bound_rows`]).
    pub row_scale: Vec<[f32; 4]>,
    /// Factor of the light of lamps at the nodes, by element, and the light that rays find in addition to that, lx.
    pub lamp_scale: Vec<[f32; 4]>,
    pub lamp_correction: Vec<[Rgb; 4]>,
    /// Light that rays find at the nodes in addition to that, by element, lx; see [`crate::rays`].
    pub ray_correction: Vec<[Rgb; 4]>,
    /// Share of the light of an element that reaches other elements, by element: 1 minus what escapes, what mirrors and clear
    /// surfaces absorb, and what fog absorbs. 1 if no rays have measured it.
    pub arriving_share: Vec<[f32; 4]>,
    /// Irradiance at the nodes by light of lamps that mirrors reflect or clear solids refract, by element, lx. Empty without such light.
    pub caustics: Vec<[Rgb; 4]>,
    /// Variance of the flux that arrives by these shares, relative to its square, from the noise of the rays.
    pub share_variance: f32,
    /// Whether rays have measured the shares of all elements.
    pub has_measured_shares: bool,
    /// Factor of all light between elements. With it, as much light arrives as elements send to each other.
    pub balance: Rgb,
}

/// Luminous flux of an iteration, lm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct IterationFlux {
    /// Sum of the absolute changes of the flux that the leaves send.
    pub change: f64,
    /// Flux that all leaves send.
    pub sent: f64,
    /// Part of it that comes from light sources directly.
    pub first: f64,
}

/// Relative rounding of the sum of the changes of many numbers.
const ROUNDING: f64 = 3e-8;

impl IterationFlux {
    /// Returns an estimate of the flux that is missing, relative to all: the change by all further iterations if the light keeps
    /// its distribution. Of the sent flux, the share `1 - first / sent` is sent again after the next reflection.
    pub fn residual(&self) -> f32 {
        let lost = if self.first > 0.0 { self.first } else { self.sent };
        // Light that is large beyond measure no longer changes only because of rounding.
        let change = self.change + ROUNDING * self.sent;
        if change == 0.0 { 0.0 } else { (change / lost) as f32 }
    }
}

impl ElementLights {
    /// Number of bytes of an element's light, without the light by direction.
    pub const BYTES: usize =
        size_of::<ElementLight>() + 2 * (size_of::<[f32; 4]>() + size_of::<[Rgb; 4]>()) + size_of::<[f32; 4]>();

    pub fn new(arena: &Arena) -> Self {
        let count = arena.elements.len();
        Self {
            elements: vec![ElementLight::ZERO; count],
            incident: vec![IncidentLight::ZERO; arena.directional_count],
            cluster_weights: ClusterWeights::new(arena),
            row_scale: vec![[1.0; 4]; count],
            lamp_scale: vec![[1.0; 4]; count],
            lamp_correction: vec![[Rgb::ZERO; 4]; count],
            ray_correction: vec![[Rgb::ZERO; 4]; count],
            arriving_share: vec![[1.0; 4]; count],
            caustics: Vec::new(),
            share_variance: 0.0,
            has_measured_shares: false,
            balance: Rgb::ONE,
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
            let (above, count) = (element.parent as usize, arena.elements[element.parent as usize].node_count());
            let mean = |nodes: &[f32; 4]| [nodes[..count].iter().sum::<f32>() / count as f32; 4];
            self.row_scale.push(mean(&self.row_scale[above]));
            self.lamp_scale.push(mean(&self.lamp_scale[above]));
            self.arriving_share.push(mean(&self.arriving_share[above]));
            if !self.caustics.is_empty() {
                let (whole, nodes) = (&arena.elements[above], self.caustics[above]);
                let at = |node: usize| whole.interpolate(&nodes, whole.node_in_parent(element, node)).max(Rgb::ZERO);
                let is_linear = !element.is_directional() && !whole.is_directional();
                let count = element.node_count();
                self.caustics.push(if is_linear { [0, 1, 2, 3].map(|node| at(node.min(count - 1))) } else { nodes });
            }
        }
        self.incident.resize(arena.directional_count, IncidentLight::ZERO);
        self.ray_correction.resize(arena.elements.len(), [Rgb::ZERO; 4]);
        self.lamp_correction.resize(arena.elements.len(), [Rgb::ZERO; 4]);
    }

    /// Returns the irradiance by the links if each surface has a radiosity of 1 lx and each point of fog receives as much as a
    /// surface, as `total` of [`FROM_ELEMENTS`]: the row sums of the links. With exact links, it is the share of the elements'
    /// light among all directions, which is at most 1.
    fn unit_irradiance(&self, scene: &Scene<'_>, arena: &Arena, links: &[Link]) -> Self {
        let mut unit = Self { cluster_weights: self.cluster_weights.clone(), ..Self::new(arena) };
        for index in (0..arena.elements.len()).rev() {
            let element = &arena.elements[index];
            if !element.is_leaf() {
                unit.pull(arena, index);
                continue;
            }
            let light = &mut unit.elements[index];
            light.radiosity = if let Shape::Volume(fog) = &element.shape { fog.sigma_s } else { Rgb::ONE };
            if let Shape::Curved(curved) = &element.shape {
                light.intensity = curved_intensity(scene, &curved.part, |_| Rgb::ONE);
            }
        }
        unit.gather(arena, links);
        unit.push_all(arena);
        unit
    }

    /// Scales the links' light where the row sums exceed [`MAX_ROW_SUM`]. Returns the greatest row sum before that.
    pub fn bound_rows(&mut self, scene: &Scene<'_>, arena: &Arena, links: &[Link]) -> f32 {
        let unit = self.unit_irradiance(scene, arena, links);
        let mut most = 0.0f32;
        for (index, element) in arena.elements.iter().enumerate().filter(|(_, element)| element.is_leaf()) {
            let sums = unit.row_sums(element, index);
            most = sums[..element.node_count()].iter().copied().fold(most, f32::max);
            self.row_scale[index] = sums.map(|sum| MAX_ROW_SUM / sum.max(MAX_ROW_SUM));
        }
        most
    }

    /// Returns the row sums at the nodes of a leaf; see [`ElementLights::unit_irradiance`], whose result this is.
    fn row_sums(&self, element: &Element, index: usize) -> [f32; 4] {
        match element.directional() {
            Some(directional) => [luminance(self.incident[directional].total[FROM_ELEMENTS].total()) * 0.25; 4],
            None => self.elements[index].total[FROM_ELEMENTS].map(luminance),
        }
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

    /// Transports arriving light down the tree, and sent light up.
    pub fn push_pull(&mut self, scene: &Scene<'_>, arena: &Arena) -> IterationFlux {
        self.push_all(arena);
        self.balance_flux(scene, arena);
        let mut flux = IterationFlux::default();
        for index in (0..arena.elements.len()).rev() {
            let before = self.elements[index].radiosity;
            if arena.elements[index].is_leaf() {
                self.reflect(scene, arena, index);
                let element = &arena.elements[index];
                let size = f64::from(element.sending_size());
                let now = self.elements[index].radiosity;
                flux.change += size * f64::from(luminance((now - before).abs()));
                flux.sent += size * f64::from(luminance(now));
                flux.first += size * f64::from(luminance(self.first_radiosity(element, index)));
            } else {
                self.pull(arena, index);
            }
        }
        flux
    }

    /// Sets the factor of all light between elements: as much arrives as the elements send to each other, except for a difference
    /// that may be the noise of the rays. In any case, no more arrives than all light that they send.
    fn balance_flux(&mut self, scene: &Scene<'_>, arena: &Arena) {
        self.balance = Rgb::ONE;
        let (mut all, mut sent, mut received) = ([0.0f64; 3], [0.0f64; 3], [0.0f64; 3]);
        for (index, element) in arena.elements.iter().enumerate().filter(|(_, element)| element.is_leaf()) {
            // Light that a mirror passes on may arrive several times.
            let shares = &self.arriving_share[index][..element.node_count()];
            let most = shares.iter().copied().fold(1.0, f32::max);
            let whole = self.elements[index].radiosity * (most * element.sending_size());
            let leaving = self.arriving_radiosity(element, index) * element.sending_size();
            let arriving =
                self.mean_irradiance_from_elements(scene, element, index) * (element.received_share() * element.size());
            for (sums, light) in [(&mut all, whole), (&mut sent, leaving), (&mut received, arriving)] {
                sums.iter_mut().zip(light.to_array()).for_each(|(sum, value)| *sum += f64::from(value));
            }
        }
        // Rays correct the luminance, so the luminance is balanced.
        let luminance_of = |sums: [f64; 3]| f64::from(luminance(Rgb::from_array(sums.map(|sum| sum as f32))));
        let [leaving, arriving] = [sent, received].map(luminance_of);
        let mut measured = 1.0;
        if self.has_measured_shares && leaving > 0.0 && arriving > 0.0 {
            let difference = leaving / arriving - 1.0;
            let noise = f64::from(BALANCE_VARIANCES * self.share_variance);
            let sure = (1.0 - noise / (difference * difference).max(f64::MIN_POSITIVE)).max(0.0);
            measured = (1.0 + sure * difference).min(MAX_BALANCE);
        }
        let factor = |k: usize| {
            let most = if all[k] > 0.0 && received[k] > 0.0 { all[k] / received[k] } else { 1.0 };
            measured.min(most) as f32
        };
        self.balance = Rgb::from_array([0, 1, 2].map(factor));
    }

    /// Returns the mean radiosity of a leaf that arrives at other elements, lx; for fog per m.
    fn arriving_radiosity(&self, element: &Element, index: usize) -> Rgb {
        let (shares, count) = (self.arriving_share[index], element.node_count());
        let mean = shares[..count].iter().sum::<f32>() / count as f32;
        let radiosity = self.elements[index].radiosity * mean;
        if element.patch().is_none() || shares[1..count].iter().all(|share| *share == shares[0]) {
            return radiosity;
        }
        // The parts differ in radiosity and in the share that arrives.
        let parts = self.part_radiosity(element, index);
        let uneven: Rgb = parts[..count].iter().zip(shares).map(|(light, share)| *light * (share - mean)).sum();
        (radiosity + uneven / count as f32).max(Rgb::ZERO)
    }

    /// Returns the radiosity of the parts of a leaf, each at its node, lx. For fog, it is what a surface that reflects everything
    /// would send: a quarter of the light from all directions.
    pub fn part_radiosity(&self, element: &Element, index: usize) -> [Rgb; 4] {
        let (reflectance, sent) = match &element.shape {
            Shape::Patch(patch) => (patch.part.reflectance, self.elements[index].radiosity),
            Shape::Volume(fog) => {
                let scattered = self.elements[index].radiosity / fog.sigma_s.max(Rgb::splat(f32::MIN_POSITIVE));
                (Rgb::ONE, scattered)
            }
            Shape::Curved(_) | Shape::Cluster(_) => return [self.elements[index].radiosity; 4],
        };
        let [lamps, elements] = [FROM_LAMPS, FROM_ELEMENTS].map(|from| self.node_irradiance(index, from));
        let irradiance: [Rgb; 4] = std::array::from_fn(|node| (lamps[node] + elements[node]).max(Rgb::ZERO));
        let count = element.node_count();
        let mean = irradiance[..count].iter().copied().sum::<Rgb>() / count as f32;
        irradiance.map(|irradiance| (sent + reflectance * (irradiance - mean)).max(Rgb::ZERO))
    }

    /// Returns the mean irradiance of a leaf from elements, without caustics, lx.
    fn mean_irradiance_from_elements(&self, scene: &Scene<'_>, element: &Element, index: usize) -> Rgb {
        if let Shape::Curved(curved) = &element.shape {
            let arriving = self.directional_irradiance_from_elements(curved, index);
            let at = |normal: Vec3A| arriving.cosine_integral(normal);
            return curved_normals(scene, &curved.part).map(at).sum::<Rgb>() / CURVED_NORMALS as f32;
        }
        let nodes = self.node_irradiance_from_elements(index);
        let count = element.node_count();
        nodes[..count].iter().copied().sum::<Rgb>() / count as f32
    }

    /// Returns the radiosity of a leaf by light that it receives and reflects from light sources, directly or as caustics, lx; for fog
    /// per m.
    fn first_radiosity(&self, element: &Element, index: usize) -> Rgb {
        let mut nodes = self.node_irradiance(index, FROM_LAMPS);
        nodes.iter_mut().zip(self.caustic_irradiance(index)).for_each(|(light, caustic)| *light += caustic);
        let mean = || nodes[..element.node_count()].iter().copied().sum::<Rgb>() / element.node_count() as f32;
        match &element.shape {
            Shape::Patch(patch) => patch.part.reflectance * mean(),
            Shape::Volume(fog) => fog.sigma_s * mean(),
            Shape::Curved(curved) => {
                let direct = self.directional_irradiance(curved, index, FROM_LAMPS).total() * 0.25;
                curved.part.reflectance * (direct + self.caustic_irradiance(index)[0])
            }
            Shape::Cluster(_) => Rgb::ZERO,
        }
    }

    /// Returns the numbers that determine the light of the next iteration: the radiosity of leaves by channel, lx, and then the
    /// intensity of curved leaves, cd.
    pub fn sent_light(&self, arena: &Arena) -> Vec<f32> {
        let leaves = || arena.elements.iter().zip(&self.elements).filter(|(element, _)| element.is_leaf());
        let radiosity = leaves().flat_map(|(_, light)| light.radiosity.to_array());
        let curved = leaves().filter(|(element, _)| matches!(element.shape, Shape::Curved(_)));
        let intensity = curved.flat_map(|(_, light)| light.intensity.0.iter().flat_map(|part| part.to_array()));
        radiosity.chain(intensity).collect()
    }

    /// Returns the weights of the numbers of [`ElementLights::sent_light`] in a sum of flux: m2, for fog m3. The intensity of a curved
    /// leaf belongs to its radiosity and has no weight.
    pub fn sent_light_weights(arena: &Arena) -> Vec<f32> {
        let leaves = || arena.elements.iter().filter(|element| element.is_leaf());
        let curved = leaves().filter(|element| matches!(element.shape, Shape::Curved(_))).count();
        leaves().flat_map(|element| [element.sending_size(); 3]).chain(std::iter::repeat_n(0.0, 27 * curved)).collect()
    }

    /// Sets the output of [`ElementLights::sent_light`].
    pub fn set_sent_light(&mut self, arena: &Arena, numbers: &[f32]) {
        let mut numbers = numbers.iter().copied();
        let mut color = || Rgb::from_array(std::array::from_fn(|_| numbers.next().unwrap_or(0.0)));
        for (element, light) in arena.elements.iter().zip(&mut self.elements).filter(|(element, _)| element.is_leaf()) {
            light.radiosity = color().max(Rgb::ZERO);
            debug_assert!(!element.is_cluster() || light.radiosity == Rgb::ZERO);
        }
        for (element, light) in arena.elements.iter().zip(&mut self.elements).filter(|(element, _)| element.is_leaf()) {
            if matches!(element.shape, Shape::Curved(_)) {
                light.intensity.0.iter_mut().for_each(|part| *part = color());
            }
        }
        for index in (0..arena.elements.len()).rev().filter(|&index| !arena.elements[index].is_leaf()) {
            self.pull(arena, index);
        }
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
                let light = self.light_from_clusters(arena, index).unwrap_or(self.incident[above].total);
                (0..2).for_each(|kind| arriving.total[kind] += light[kind]);
            }
            self.incident[directional] = arriving;
            return;
        }
        let mut whole = self.elements[index].gathered;
        let from_clusters = self.light_from_clusters(arena, index);
        if let Some(above) = parent {
            for kind in [FROM_LAMPS, FROM_ELEMENTS] {
                for (node, value) in whole[kind].iter_mut().enumerate().take(element.node_count()) {
                    *value += match above.directional() {
                        Some(directional) => {
                            let light = match &from_clusters {
                                Some(light) => &light[kind],
                                None => &self.incident[directional].total[kind],
                            };
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

    /// Returns the light by direction, from sources and from elements, that a whole surface receives from the clusters around it.
    /// `None` for other elements.
    fn light_from_clusters(&self, arena: &Arena, index: usize) -> Option<[Harmonics; 2]> {
        let mut light = None;
        for (cluster, weight) in self.cluster_weights.clusters_of(arena, index) {
            let gathered = self.incident[arena.elements[cluster as usize].directional()?].gathered;
            let sum = light.get_or_insert([Harmonics::ZERO; 2]);
            (0..2).for_each(|kind| sum[kind] += gathered[kind] * Rgb::splat(weight));
        }
        light
    }

    /// Returns the irradiance at an element's nodes from sources, or from elements and as caustics.
    pub fn node_irradiance(&self, index: usize, from: usize) -> [Rgb; 4] {
        if from == FROM_LAMPS {
            let mut values = self.elements[index].total[from];
            let beyond = self.lamp_scale[index].into_iter().zip(self.lamp_correction[index]);
            values.iter_mut().zip(beyond).for_each(|(value, (scale, more))| *value = *value * scale + more);
            return values;
        }
        let mut values = self.node_irradiance_from_elements(index);
        values.iter_mut().zip(self.caustic_irradiance(index)).for_each(|(value, caustic)| *value += caustic);
        values
    }

    fn node_irradiance_from_elements(&self, index: usize) -> [Rgb; 4] {
        let mut values = self.elements[index].total[FROM_ELEMENTS];
        let beyond = self.row_scale[index].into_iter().zip(self.ray_correction[index]);
        values
            .iter_mut()
            .zip(beyond)
            .for_each(|(value, (scale, more))| *value = (*value * scale + more) * self.balance);
        values
    }

    /// Returns the irradiance at an element's nodes by caustics, lx.
    fn caustic_irradiance(&self, index: usize) -> [Rgb; 4] {
        self.caustics.get(index).copied().unwrap_or([Rgb::ZERO; 4])
    }

    /// Returns the light by direction that a curved element receives from sources, or from elements and as caustics.
    pub fn directional_irradiance(&self, element: &Curved, index: usize, from: usize) -> Harmonics {
        if from == FROM_LAMPS {
            return self.incident[element.directional as usize].total[from] * Rgb::splat(self.lamp_scale[index][0])
                + Harmonics::from_irradiance(self.lamp_correction[index][0]);
        }
        self.directional_irradiance_from_elements(element, index)
            + Harmonics::from_irradiance(self.caustic_irradiance(index)[0])
    }

    fn directional_irradiance_from_elements(&self, element: &Curved, index: usize) -> Harmonics {
        let IncidentLight { total: whole, ray_correction: more, .. } = self.incident[element.directional as usize];
        (whole[FROM_ELEMENTS] * Rgb::splat(self.row_scale[index][0]) + more) * self.balance
    }

    /// Computes the light that a leaf sends from the light that it receives.
    fn reflect(&mut self, scene: &Scene<'_>, arena: &Arena, index: usize) {
        let element = &arena.elements[index];
        let behind = element.surface_part().map_or(Rgb::ZERO, |part| self.back_irradiance(scene, arena, element, part));
        let [of_lamps, of_elements] = [FROM_LAMPS, FROM_ELEMENTS].map(|from| self.node_irradiance(index, from));
        let (reflectance, transmittance) = match &element.shape {
            Shape::Curved(curved) => return self.reflect_curved(scene, curved, behind, index),
            Shape::Patch(Patch { part, .. }) => (part.reflectance, part.transmittance),
            Shape::Volume(fog) => (fog.sigma_s, Rgb::ZERO),
            Shape::Cluster(_) => (Rgb::ZERO, Rgb::ZERO),
        };
        let light = &mut self.elements[index];
        let (mut sum, mut mean, mut darkest, mut brightest) = (Rgb::ZERO, 0.0, f32::INFINITY, 0.0f32);
        for (of_lamps, of_elements) in of_lamps.into_iter().zip(of_elements).take(element.node_count()) {
            let irradiance = (of_lamps + of_elements).max(Rgb::ZERO);
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
        let arriving = self.directional_irradiance(curved, index, FROM_LAMPS)
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
            let of = |from: usize| self.directional_irradiance(other, index as usize, from).total();
            return (of(FROM_LAMPS) + of(FROM_ELEMENTS)) * 0.25;
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
    for normal in curved_normals(scene, part) {
        sent += Harmonics::from_direction(normal, radiosity(normal) * (part.area / (PI * CURVED_NORMALS as f32)));
    }
    sent
}

/// Returns the normals at evenly distributed points of a curved element.
fn curved_normals(scene: &Scene<'_>, part: &SurfacePart) -> impl Iterator<Item = Vec3A> {
    (0..CURVED_NORMALS).map(move |k| {
        let place = Vec2::new((k % 4) as f32 + 0.5, (k / 4) as f32 + 0.5) * 0.25;
        part.point_at(scene, place).normal
    })
}

fn gather_row(arena: &Arena, lights: &[ElementLight], row: &[Link]) -> ([Rgb; 4], Harmonics) {
    let p = &arena.elements[row[0].receiver as usize];
    let (mut nodes, mut arriving) = ([Rgb::ZERO; 4], Harmonics::ZERO);
    for link in row {
        let (q, light) = (&arena.elements[link.source as usize], &lights[link.source as usize]);
        let sent = light.sent_toward(q, p.center);
        if p.is_directional() {
            let dir = (q.center - p.center).normalize_or(Vec3A::Z);
            arriving += Harmonics::from_direction(dir, sent * link.factors[0]);
        } else {
            for (node, factor) in nodes.iter_mut().zip(link.factors) {
                *node += sent * factor;
            }
        }
    }
    (nodes, arriving)
}
