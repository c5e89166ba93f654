//! Gathering of light through links, and its transport down and up the tree.

use crate::arena::Arena;
use crate::element::{Cluster, Curved, Element, Patch, Shape, SurfacePart};
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
    /// Irradiance at the nodes, lx: from light sources, and from elements. It includes light that comes through links of the elements
    /// above.
    pub total: [[Rgb; 4]; 2],
    /// Mean radiosity, lx; for fog per m.
    pub radiosity: Rgb,
    /// Bounds of the radiosity's luminance over the parts.
    pub darkest: f32,
    pub brightest: f32,
    /// Mean irradiance, by luminance, and the mean irradiance of the darkest part.
    pub mean: f32,
    pub min_mean: f32,
}

impl ElementLight {
    pub const ZERO: Self = Self {
        total: [[Rgb::ZERO; 4]; 2],
        radiosity: Rgb::ZERO,
        darkest: 0.0,
        brightest: 0.0,
        mean: 0.0,
        min_mean: 0.0,
    };
}

/// Light that arrives at a wide element, by direction.
#[derive(Clone, Copy, Debug)]
pub struct IncidentLight {
    /// Light from light sources, and from elements. It includes light that comes through links of the elements above.
    pub total: [Harmonics; 2],
    /// Light of a ball that rays find in addition to that of the links.
    pub ray_correction: Harmonics,
}

impl IncidentLight {
    pub const ZERO: Self = Self { total: [Harmonics::ZERO; 2], ray_correction: Harmonics::ZERO };
}

/// Indices of the kinds of light.
pub const FROM_LAMPS: usize = 0;
pub const FROM_ELEMENTS: usize = 1;

/// Light of all elements.
#[derive(Clone, Debug)]
pub struct ElementLights {
    pub elements: Vec<ElementLight>,
    pub incident: Vec<IncidentLight>,
    /// Intensity that wide elements send, cd.
    pub intensity: Vec<Harmonics>,
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
    /// Sum of the squared estimated errors of the links of an element, by element, lx2.
    pub link_errors: Vec<f32>,
    /// Estimated root mean square error of the irradiance from elements, by element, lx by luminance. 0 for elements that are not leaves
    /// of surfaces.
    pub errors: Vec<f32>,
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
        size_of::<ElementLight>() + 2 * (size_of::<[f32; 4]>() + size_of::<[Rgb; 4]>()) + size_of::<[f32; 6]>();
    /// Number of bytes of an element's light by direction.
    pub const DIRECTIONAL_BYTES: usize = size_of::<IncidentLight>() + size_of::<Harmonics>();

    pub fn new(arena: &Arena) -> Self {
        let count = arena.elements.len();
        Self {
            elements: vec![ElementLight::ZERO; count],
            incident: vec![IncidentLight::ZERO; arena.directional_count],
            intensity: vec![Harmonics::ZERO; arena.directional_count],
            cluster_weights: ClusterWeights::default(),
            row_scale: vec![[1.0; 4]; count],
            lamp_scale: vec![[1.0; 4]; count],
            lamp_correction: vec![[Rgb::ZERO; 4]; count],
            ray_correction: vec![[Rgb::ZERO; 4]; count],
            arriving_share: vec![[1.0; 4]; count],
            caustics: Vec::new(),
            link_errors: vec![0.0; count],
            errors: vec![0.0; count],
            share_variance: 0.0,
            has_measured_shares: false,
            balance: Rgb::ONE,
        }
    }

    /// Allocates new elements, which begin with their parents' light. Parts of wide elements send what they reflect of it.
    pub fn grow(&mut self, scene: &Scene<'_>, arena: &Arena) {
        let first = self.elements.len();
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
        self.intensity.resize(arena.directional_count, Harmonics::ZERO);
        self.ray_correction.resize(arena.elements.len(), [Rgb::ZERO; 4]);
        self.lamp_correction.resize(arena.elements.len(), [Rgb::ZERO; 4]);
        self.link_errors.resize(arena.elements.len(), 0.0);
        self.errors.resize(arena.elements.len(), 0.0);
        for (index, element) in arena.elements.iter().enumerate().skip(first) {
            [FROM_LAMPS, FROM_ELEMENTS].into_iter().for_each(|kind| self.push_to(arena, index, kind));
            if arena.elements[element.parent as usize].is_directional() {
                self.reflect(scene, arena, index);
            }
        }
    }

    /// Returns the irradiance by the links if each surface has a radiosity of 1 lx and each point of fog receives as much as a
    /// surface, as `total` of [`FROM_ELEMENTS`]: the row sums of the links. With exact links, it is the share of the elements'
    /// light among all directions, which is at most 1.
    fn unit_irradiance(&self, arena: &Arena, links: &[Link]) -> Self {
        let mut unit = Self { cluster_weights: self.cluster_weights.clone(), ..Self::new(arena) };
        for index in (0..arena.elements.len()).rev() {
            let element = &arena.elements[index];
            if !element.is_leaf() {
                unit.pull(arena, index);
                continue;
            }
            let light = &mut unit.elements[index];
            light.radiosity = if let Shape::Volume(fog) = &element.shape { fog.sigma_s } else { Rgb::ONE };
            match &element.shape {
                Shape::Curved(curved) => {
                    unit.intensity[curved.directional as usize] = curved_intensity(arena, curved, |_| Rgb::ONE);
                }
                Shape::Cluster(cluster) => {
                    let mut sent = Harmonics::ZERO;
                    arena.for_each_normal(element, |_, normal, area| {
                        sent += Harmonics::from_direction(normal, Rgb::splat(area / PI));
                    });
                    unit.intensity[cluster.directional as usize] = sent;
                }
                Shape::Patch(_) | Shape::Volume(_) => {}
            }
        }
        unit.gather(arena, links);
        unit
    }

    /// Scales the links' light where the row sums exceed [`MAX_ROW_SUM`]. Returns the greatest row sum before that.
    pub fn bound_rows(&mut self, arena: &Arena, links: &[Link]) -> f32 {
        let unit = self.unit_irradiance(arena, links);
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

    /// Returns the light that an element sends toward a point, as the factors of links have it: the intensity, cd, of a wide element,
    /// else the radiosity, lx.
    pub fn sent_toward(&self, index: usize, element: &Element, point: Vec3A) -> Rgb {
        match element.directional() {
            Some(directional) => {
                let dir = (point - element.center).normalize_or(-Vec3A::Z);
                self.intensity[directional].cosine_integral(dir)
            }
            None => self.elements[index].radiosity,
        }
    }

    /// Gathers irradiance through all links, which are sorted by receiver, and transports it down the tree. The light of each receiver
    /// is added in the links' order.
    pub fn gather(&mut self, arena: &Arena, links: &[Link]) {
        let rows: Vec<&[Link]> = links.chunk_by(|a, b| a.receiver == b.receiver).collect();
        let lights = &*self;
        let gathered: Vec<([Rgb; 4], Harmonics)> =
            rows.par_iter().with_min_len(64).map(|row| gather_row(arena, lights, row)).collect();
        self.clear(FROM_ELEMENTS);
        for (row, (nodes, arriving)) in rows.iter().zip(gathered) {
            let receiver = row[0].receiver as usize;
            match arena.elements[receiver].directional() {
                Some(directional) => self.incident[directional].total[FROM_ELEMENTS] = arriving,
                None => self.elements[receiver].total[FROM_ELEMENTS] = nodes,
            }
        }
        self.push(arena, FROM_ELEMENTS);
    }

    /// Clears the light that all elements receive.
    /// - `kind`: [`FROM_LAMPS`] or [`FROM_ELEMENTS`].
    pub fn clear(&mut self, kind: usize) {
        self.elements.iter_mut().for_each(|light| light.total[kind] = [Rgb::ZERO; 4]);
        self.incident.iter_mut().for_each(|arriving| arriving.total[kind] = Harmonics::ZERO);
    }

    /// Computes the light that all elements send from the light that they receive.
    pub fn reflect_all(&mut self, scene: &Scene<'_>, arena: &Arena) -> IterationFlux {
        self.balance_flux(arena);
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
    fn balance_flux(&mut self, arena: &Arena) {
        self.balance = Rgb::ONE;
        let (mut all, mut sent, mut received) = ([0.0f64; 3], [0.0f64; 3], [0.0f64; 3]);
        for (index, element) in arena.elements.iter().enumerate().filter(|(_, element)| element.is_leaf()) {
            // Light that a mirror passes on may arrive several times.
            let shares = &self.arriving_share[index][..element.node_count()];
            let most = shares.iter().copied().fold(1.0, f32::max);
            let whole = self.elements[index].radiosity * (most * element.sending_size());
            let leaving = self.arriving_radiosity(element, index) * element.sending_size();
            let arriving =
                self.mean_irradiance_from_elements(arena, index) * (element.received_share() * element.size());
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
    pub fn mean_irradiance_from_elements(&self, arena: &Arena, index: usize) -> Rgb {
        let element = &arena.elements[index];
        if let Some(directional) = element.directional() {
            let arriving = self.directional_irradiance_from_elements(directional, index);
            let at = |normal: Vec3A| arriving.cosine_integral(normal);
            if let Shape::Curved(curved) = &element.shape {
                return arena.curved_normals(curved).map(at).sum::<Rgb>() / CURVED_NORMALS as f32;
            }
            let mut flux = Rgb::ZERO;
            arena.for_each_normal(element, |_, normal, area| flux += at(normal) * area);
            return flux / element.size();
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
                let light = self.directional_irradiance(curved.directional as usize, index, FROM_LAMPS);
                curved.part.reflectance * (light.total() * 0.25 + self.caustic_irradiance(index)[0])
            }
            Shape::Cluster(cluster) => {
                let light = self.directional_irradiance(cluster.directional as usize, index, FROM_LAMPS);
                cluster.reflectance * (light.total() * 0.25 + self.caustic_irradiance(index)[0])
            }
        }
    }

    /// Returns the numbers that determine the light of the next iteration: the radiosity of leaves by channel, lx, and then the
    /// intensity of curved leaves, cd.
    pub fn sent_light(&self, arena: &Arena) -> Vec<f32> {
        let mut numbers = Vec::with_capacity(3 * self.elements.len());
        for (_, light) in arena.elements.iter().zip(&self.elements).filter(|(element, _)| element.is_leaf()) {
            numbers.extend(light.radiosity.to_array());
        }
        for directional in directional_leaves(arena) {
            self.intensity[directional].0.iter().for_each(|part| numbers.extend(part.to_array()));
        }
        numbers
    }

    /// Returns the weights of the numbers of [`ElementLights::sent_light`] in a sum of flux: m2, for fog m3. The intensity of a curved
    /// leaf belongs to its radiosity and has no weight.
    pub fn sent_light_weights(arena: &Arena) -> Vec<f32> {
        let leaves = || arena.elements.iter().filter(|element| element.is_leaf());
        let curved = directional_leaves(arena).count();
        leaves().flat_map(|element| [element.sending_size(); 3]).chain(std::iter::repeat_n(0.0, 27 * curved)).collect()
    }

    /// Sets the output of [`ElementLights::sent_light`].
    pub fn set_sent_light(&mut self, arena: &Arena, numbers: &[f32]) {
        let mut numbers = numbers.iter().copied();
        let mut color = || Rgb::from_array(std::array::from_fn(|_| numbers.next().unwrap_or(0.0)));
        for (_, light) in arena.elements.iter().zip(&mut self.elements).filter(|(element, _)| element.is_leaf()) {
            light.radiosity = color().max(Rgb::ZERO);
        }
        for directional in directional_leaves(arena) {
            self.intensity[directional].0.iter_mut().for_each(|part| *part = color());
        }
        for index in (0..arena.elements.len()).rev().filter(|&index| !arena.elements[index].is_leaf()) {
            self.pull(arena, index);
        }
    }

    /// Transports arriving light down the tree: adds the light of the elements above to that of the elements' own links.
    /// - `kind`: [`FROM_LAMPS`] or [`FROM_ELEMENTS`].
    pub fn push(&mut self, arena: &Arena, kind: usize) {
        (0..arena.elements.len()).for_each(|index| self.push_to(arena, index, kind));
    }

    /// Adds the light of the elements above to that of an element.
    fn push_to(&mut self, arena: &Arena, index: usize, kind: usize) {
        let element = &arena.elements[index];
        let Some(parent) = arena.elements.get(element.parent as usize) else { return };
        // Shadow rays measure the light of lamps better than weights.
        let weighted = (kind == FROM_ELEMENTS).then(|| self.light_from_clusters(arena, index)).flatten();
        let above = parent.directional().map(|above| weighted.unwrap_or(self.incident[above].total[kind]));
        if let Some(directional) = element.directional() {
            if let Some(above) = above {
                self.incident[directional].total[kind] += above;
            }
            return;
        }
        let mut whole = self.elements[index].total[kind];
        let nodes = whole.iter_mut().enumerate().take(element.node_count());
        match (&above, &element.shape) {
            (Some(above), Shape::Volume(_)) => {
                // A point of fog receives a quarter of the light from all directions.
                let light = (above.total() * 0.25).max(Rgb::ZERO);
                nodes.for_each(|(_, value)| *value += light);
            }
            (Some(above), _) => {
                let mut irradiance = ByNormal(None);
                nodes.for_each(|(node, value)| {
                    *value += irradiance.get(element.node(node).normal, |normal| above.cosine_integral(normal));
                });
            }
            (None, _) => {
                let above = self.elements[element.parent as usize].total[kind];
                nodes.for_each(|(node, value)| {
                    *value += parent.interpolate(&above, parent.node_in_parent(element, node));
                });
            }
        }
        self.elements[index].total[kind] = whole;
    }

    /// Returns the light by direction that a whole surface receives from elements through the links of the clusters around it, each with
    /// the surface's weight. `None` if no weights are known.
    fn light_from_clusters(&self, arena: &Arena, index: usize) -> Option<Harmonics> {
        let total = |cluster: u32| {
            let directional = arena.elements.get(cluster as usize)?.directional()?;
            Some(self.incident[directional].total[FROM_ELEMENTS])
        };
        let mut light = None;
        for (cluster, weight) in self.cluster_weights.clusters_of(arena, index) {
            let above = total(arena.elements[cluster as usize].parent).unwrap_or(Harmonics::ZERO);
            let own = total(cluster)? + above * Rgb::splat(-1.0);
            *light.get_or_insert(Harmonics::ZERO) += own * Rgb::splat(weight);
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

    /// Returns the light by direction that a leaf receives from sources, or from elements and as caustics.
    /// - `directional`: index of the leaf's light by direction.
    pub fn directional_irradiance(&self, directional: usize, index: usize, from: usize) -> Harmonics {
        if from == FROM_LAMPS {
            return self.incident[directional].total[from] * Rgb::splat(self.lamp_scale[index][0])
                + Harmonics::from_irradiance(self.lamp_correction[index][0]);
        }
        self.directional_irradiance_from_elements(directional, index)
            + Harmonics::from_irradiance(self.caustic_irradiance(index)[0])
    }

    fn directional_irradiance_from_elements(&self, directional: usize, index: usize) -> Harmonics {
        let IncidentLight { total: whole, ray_correction: more } = self.incident[directional];
        (whole[FROM_ELEMENTS] * Rgb::splat(self.row_scale[index][0]) + more) * self.balance
    }

    /// Computes the light that a leaf sends from the light that it receives.
    pub fn reflect(&mut self, scene: &Scene<'_>, arena: &Arena, index: usize) {
        let element = &arena.elements[index];
        let behind = element.surface_part().map_or(Rgb::ZERO, |part| self.back_irradiance(scene, arena, element, part));
        let [of_lamps, of_elements] = [FROM_LAMPS, FROM_ELEMENTS].map(|from| self.node_irradiance(index, from));
        let (reflectance, transmittance) = match &element.shape {
            Shape::Curved(curved) => return self.reflect_curved(arena, curved, behind, index),
            Shape::Patch(Patch { part, .. }) => (part.reflectance, part.transmittance),
            Shape::Volume(fog) => (fog.sigma_s, Rgb::ZERO),
            Shape::Cluster(cluster) => return self.reflect_cluster(scene, arena, cluster, index),
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

    fn reflect_curved(&mut self, arena: &Arena, curved: &Curved, behind: Rgb, index: usize) {
        let directional = curved.directional as usize;
        let arriving = self.directional_irradiance(directional, index, FROM_LAMPS)
            + self.directional_irradiance(directional, index, FROM_ELEMENTS);
        let (mut sum, mut mean) = (Rgb::ZERO, 0.0);
        let sent = curved_intensity(arena, curved, |normal| {
            let irradiance = arriving.cosine_integral(normal);
            let radiosity = curved.part.reflectance * irradiance + curved.part.transmittance * behind;
            (sum, mean) = (sum + radiosity, mean + luminance(irradiance));
            radiosity
        });
        self.intensity[directional] = sent;
        let light = &mut self.elements[index];
        light.radiosity = sum / CURVED_NORMALS as f32;
        light.mean = mean / CURVED_NORMALS as f32;
        light.min_mean = light.mean;
        (light.darkest, light.brightest) = (0.0, 2.0 * luminance(light.radiosity));
    }

    /// Computes the light that the surfaces of a cluster send. The other side of a sheet receives the same light by direction.
    fn reflect_cluster(&mut self, scene: &Scene<'_>, arena: &Arena, cluster: &Cluster, index: usize) {
        let directional = cluster.directional as usize;
        let arriving = self.directional_irradiance(directional, index, FROM_LAMPS)
            + self.directional_irradiance(directional, index, FROM_ELEMENTS);
        let (mut sent, mut flux, mut irradiance) = (Harmonics::ZERO, Rgb::ZERO, 0.0);
        let (mut darkest, mut brightest) = (f32::INFINITY, 0.0f32);
        arena.for_each_normal(&arena.elements[index], |surface, normal, area| {
            let (reflectance, transmittance) = scene.surface_albedos(surface);
            let light = arriving.cosine_integral(normal);
            let mut radiosity = reflectance * light;
            if transmittance != Rgb::ZERO {
                radiosity += transmittance * arriving.cosine_integral(-normal);
            }
            sent += Harmonics::from_direction(normal, radiosity * (area / PI));
            (flux, irradiance) = (flux + radiosity * area, irradiance + luminance(light) * area);
            let value = luminance(radiosity);
            (darkest, brightest) = (darkest.min(value), brightest.max(value));
        });
        self.intensity[directional] = sent;
        let light = &mut self.elements[index];
        (light.radiosity, light.mean) = (flux / cluster.area, irradiance / cluster.area);
        light.min_mean = light.mean;
        (light.darkest, light.brightest) = (darkest, brightest);
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
        if let Some(directional) = other.directional() {
            let of = |from: usize| self.directional_irradiance(directional, index as usize, from);
            let light = of(FROM_LAMPS) + of(FROM_ELEMENTS);
            let is_cluster_of_sheet = other.is_cluster() && element.normal() != Vec3A::ZERO;
            return if is_cluster_of_sheet { light.cosine_integral(-element.normal()) } else { light.total() * 0.25 };
        }
        let [sources, elements] = [FROM_LAMPS, FROM_ELEMENTS].map(|from| self.node_irradiance(index as usize, from));
        let sum: Rgb = (0..other.node_count()).map(|node| sources[node] + elements[node]).sum();
        (sum / other.node_count() as f32).max(Rgb::ZERO)
    }

    fn pull(&mut self, arena: &Arena, index: usize) {
        let element = &arena.elements[index];
        let parts = element.children.map(|child| &arena.elements[child as usize]);
        if let Some(directional) = element.directional() {
            let mut intensity = Harmonics::ZERO;
            for (part, child) in parts.into_iter().zip(element.children) {
                match &part.shape {
                    Shape::Cluster(Cluster { directional, .. }) | Shape::Curved(Curved { directional, .. }) => {
                        intensity += self.intensity[*directional as usize];
                    }
                    Shape::Patch(patch) => {
                        let nodes = patch.nodes();
                        let radiosity = self.elements[child as usize].radiosity;
                        let amount = radiosity * (patch.part.area / (PI * nodes.len() as f32));
                        let mut sent = ByNormal(None);
                        for node in nodes {
                            intensity += sent.get(node.normal, |normal| Harmonics::from_direction(normal, amount));
                        }
                    }
                    Shape::Volume(_) => {}
                }
            }
            self.intensity[directional] = intensity;
        }
        let size = parts[0].size() + parts[1].size();
        let [wa, wb] = parts.map(|part| if size > 0.0 { part.size() / size } else { 0.5 });
        let [a, b] = element.children.map(|child| &self.elements[child as usize]);
        let (radiosity, mean) = (a.radiosity * wa + b.radiosity * wb, a.mean * wa + b.mean * wb);
        let min_mean = a.min_mean.min(b.min_mean);
        let (darkest, brightest) = (a.darkest.min(b.darkest), a.brightest.max(b.brightest));
        let ElementLight { total, .. } = self.elements[index];
        self.elements[index] = ElementLight { total, radiosity, darkest, brightest, mean, min_mean };
    }
}

/// Value of a function of the normal. The nodes of a flat patch have one normal, so it is computed once.
struct ByNormal<T>(Option<(Vec3A, T)>);

impl<T: Copy> ByNormal<T> {
    fn get(&mut self, normal: Vec3A, compute: impl FnOnce(Vec3A) -> T) -> T {
        match self.0 {
            Some((known, value)) if known == normal => value,
            _ => {
                let value = compute(normal);
                self.0 = Some((normal, value));
                value
            }
        }
    }
}

/// Returns the indices of the light by direction of leaves.
fn directional_leaves(arena: &Arena) -> impl Iterator<Item = usize> {
    arena.elements.iter().filter(|element| element.is_leaf()).filter_map(Element::directional)
}

/// Returns the intensity of a curved element by direction, cd, from the radiosity at points around it.
fn curved_intensity(arena: &Arena, curved: &Curved, mut radiosity: impl FnMut(Vec3A) -> Rgb) -> Harmonics {
    let mut sent = Harmonics::ZERO;
    for normal in arena.curved_normals(curved) {
        sent +=
            Harmonics::from_direction(normal, radiosity(normal) * (curved.part.area / (PI * CURVED_NORMALS as f32)));
    }
    sent
}

fn gather_row(arena: &Arena, lights: &ElementLights, row: &[Link]) -> ([Rgb; 4], Harmonics) {
    let p = &arena.elements[row[0].receiver as usize];
    let (mut nodes, mut arriving) = ([Rgb::ZERO; 4], Harmonics::ZERO);
    for link in row {
        let q = &arena.elements[link.source as usize];
        let sent = lights.sent_toward(link.source as usize, q, p.center);
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
