//! Scaling of the links' light to that of the rays.

use super::trace::unpack_normal;
use super::{MAX_PARTS, RaySample, Rays, SentLight, part_count};
use crate::arena::Arena;
use crate::element::Element;
use crate::exits::is_root;
use crate::gather::{ElementLights, FROM_ELEMENTS, FROM_LAMPS};
use crate::tuning::{
    CHANCE_VARIANCES, CHANCE_VARIANCES_OF_RARE_HITS, ERROR_PARTS, IRRADIANCE_FLOOR, LINK_ERROR_WEIGHT, MAX_RAY_SCALE,
    MIN_ERROR_RATIO, MIN_RELATIVE_ERROR, MIN_RELATIVE_VARIANCE, RAYS_OF_WHOLE, ROUGH_ERROR,
};
use femc_field::{Harmonics, NONE};
use femc_math::Rgb;
use femc_math::color::luminance;
use rayon::prelude::*;

/// Result of the comparison with rays.
pub struct RayCorrection {
    /// Light of the rays relative to that of the links; 1 if the links have none.
    pub ratio: f32,
    /// Root mean square of the changes, relative to the mean of the links' light.
    pub changed: f32,
    /// Leaves, and the difference between the irradiances of their parts, lx.
    pub contrast: Vec<(u32, f32)>,
    comparison: Comparison,
}

/// Noise of the light that rays find.
#[derive(Clone, Copy, Debug)]
struct Noise {
    /// Squared difference, in units of its variance, that counts as chance.
    chance: f32,
    estimator: VarianceEstimator,
}

/// Estimator of the variance of the light of a part's rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum VarianceEstimator {
    /// Few rays hit something bright: the variance follows from the estimate of the part above and the light of such rays.
    RareHits,
    /// As `RareHits`, for scenes with fog, where very few rays hit the bright fog around a lamp.
    RareHitsInFog,
    /// All rays find similar light: the variance of the rays themselves, and a minimum, since few rays may be alike by chance.
    Measured,
}

/// Sums over a part of a surface, for the comparison of rays and links.
#[derive(Clone, Copy, Debug, Default)]
struct PartSums {
    area: f32,
    /// Light of the rays and of the links, lm, and the rays' light by color.
    rays: f32,
    links: f32,
    color: Rgb,
    /// Light of the leaves' own rays, which are stratified, lm.
    own_rays: f32,
    /// Sums over the ways of their light times the light if all rays of the leaf found as much, lm lx: of the leaves' own rays, and of
    /// others' rays.
    squares: [f32; 2],
    /// Light of the brightest way, lm.
    max_sample: f32,
    /// Measured variance of the rays' light, lm2.
    measured_variance: f32,
    /// Sums over the leaves of the squared area over the number of rays; of that times the links' irradiance; and of that times its
    /// square.
    variances: [f32; 3],
}

impl PartSums {
    /// Creates the sums without ways.
    /// - `number`: number of rays of the part.
    fn new(area: f32, number: f32, links: f32) -> Self {
        let weight = area * area / number;
        Self {
            area,
            links: area * links,
            variances: [weight, weight * links, weight * links * links],
            ..Self::default()
        }
    }

    /// Adds the light along a way, lm, and the light if all rays of the leaf found as much, lx.
    fn add_sample(&mut self, color: Rgb, bright: f32, is_own: bool) {
        let light = luminance(color);
        self.rays += light;
        self.own_rays += if is_own { light } else { 0.0 };
        self.color += color;
        self.squares[usize::from(!is_own)] += light * bright;
        self.max_sample = self.max_sample.max(light);
    }

    /// Measures the variance of the rays' light, after the light of all rays of a part was added, one sample for each ray.
    /// - `number`: number of rays of the part.
    fn measure_variance(&mut self, number: f32) {
        let variance = self.area * self.squares[0] - self.rays * self.rays;
        self.measured_variance = variance.max(0.0) / (number - 1.0).max(1.0);
    }

    fn add(&mut self, other: &Self) {
        self.measured_variance += other.measured_variance;
        self.area += other.area;
        self.rays += other.rays;
        self.own_rays += other.own_rays;
        self.links += other.links;
        self.color += other.color;
        self.squares.iter_mut().zip(other.squares).for_each(|(sum, part)| *sum += part);
        self.max_sample = self.max_sample.max(other.max_sample);
        self.variances.iter_mut().zip(other.variances).for_each(|(sum, part)| *sum += part);
    }

    /// Returns the irradiance of a ray that hits something bright, lx, of the leaves' own rays and of others' rays. Few of the own rays
    /// may have missed what is bright, so the part above counts like [`RAYS_OF_WHOLE`] further rays; in fog, there is no less than above. Nothing is known about the number
    /// of others' rays, so that irradiance is no less than in the part above.
    fn bright(&self, above: [f32; 2], estimator: VarianceEstimator) -> [f32; 2] {
        let others_rays = self.rays - self.own_rays;
        let mut bright = above;
        if self.own_rays > 0.0 {
            let number = self.area * self.area / self.variances[0].max(f32::MIN_POSITIVE);
            let own = self.squares[0] / self.own_rays;
            bright[0] = match estimator {
                VarianceEstimator::RareHitsInFog => own.max(above[0]),
                _ => (number * own + RAYS_OF_WHOLE * above[0]) / (number + RAYS_OF_WHOLE),
            };
        }
        if others_rays > 0.0 {
            bright[1] = bright[1].max(self.squares[1] / others_rays);
        }
        bright
    }

    /// Returns the share of the leaves' own rays in the light. It is no more than in the part above, since the others' rays may
    /// have missed this part.
    fn own_share(&self, above: f32) -> f32 {
        if self.rays > 0.0 { above.min(self.own_rays / self.rays) } else { above }
    }

    /// Returns the light of the part by an estimate, lm.
    fn light(&self, estimate: &LightEstimate) -> f32 {
        estimate.scale * self.links + luminance(estimate.extra) * self.area
    }

    /// Returns the variance of the rays' light, lm2. It assumes that the estimate above is right: few rays may have missed all of a part's
    /// light.
    fn variance(&self, above: &LightEstimate, noise: Noise) -> f32 {
        let (scale, extra, own) = (above.scale, luminance(above.extra), above.own_share);
        let [area, links, squares] = self.variances;
        let once = scale * links + extra * area;
        let twice = scale * scale * squares + 2.0 * scale * extra * links + extra * extra * area;
        match noise.estimator {
            VarianceEstimator::RareHits | VarianceEstimator::RareHitsInFog => {
                let bright = self.bright(above.bright, noise.estimator);
                let bright = own * bright[0] + (1.0 - own) * bright[1];
                (bright * once - own * own * twice).max(0.0)
            }
            VarianceEstimator::Measured => self.measured_variance + MIN_RELATIVE_VARIANCE * twice,
        }
    }

    /// Returns an unbiased estimate of the squared error of the light of a part, lm2, which may be negative: Stein's estimate for a
    /// function of a normal number (\[stein1981\]).
    /// - `above`: estimate of the part above;
    /// - `found`: estimate of this part.
    fn squared_error(&self, above: &LightEstimate, found: &LightEstimate, noise: Noise) -> f32 {
        let variance = self.variance(above, noise);
        let difference = self.rays - self.light(above);
        let chance = noise.chance * variance / (difference * difference).max(f32::MIN_POSITIVE);
        // Change of the found light with the rays' light.
        let slope = if chance < 1.0 { 1.0 + chance } else { 0.0 };
        let rest = self.rays - self.light(found);
        rest * rest + (2.0 * slope - 1.0) * variance
    }

    /// Returns the estimate of the light here.
    /// - `above`: estimate of the part above;
    fn estimate(&self, above: &LightEstimate, noise: Noise) -> LightEstimate {
        let (scale, own) = (above.scale, above.own_share);
        let bright = self.bright(above.bright, noise.estimator);
        let before = self.light(above);
        // A single ray that hit the fog at a lamp does not prove more light.
        let rays = if self.rays > before { (self.rays - self.max_sample).max(before) } else { self.rays };
        let variance = self.variance(above, noise);
        let difference = rays - before;
        let sure = 1.0 - noise.chance * variance / (difference * difference).max(f32::MIN_POSITIVE);
        let change = sure.max(0.0) * difference;
        if change <= 0.0 {
            let less = if before > 0.0 { (1.0 + change / before).max(0.0) } else { 1.0 };
            return LightEstimate { scale: scale * less, extra: above.extra * less, bright, own_share: own };
        }
        let room = (MAX_RAY_SCALE - scale).max(0.0) * self.links;
        let scaled = if self.links > 0.0 { scale + change.min(room) / self.links } else { scale };
        let more = (change - room).max(0.0) / (self.area * luminance(self.color)).max(f32::MIN_POSITIVE);
        LightEstimate { scale: scaled, extra: above.extra + self.color * more, bright, own_share: own }
    }
}

/// Comparison of the light of rays with that of links.
struct Comparison {
    /// Sums over all surfaces, by element, and by part of each leaf.
    all: PartSums,
    by_element: Vec<PartSums>,
    by_leaf: Vec<[PartSums; MAX_PARTS]>,
    /// Estimate by element.
    known: Vec<LightEstimate>,
    noise: Noise,
}

impl Comparison {
    /// Returns the estimates of the parts of a leaf.
    /// - `place`: index of the leaf among the leaves.
    fn part_estimates(&self, element: &Element, place: usize, leaf: u32) -> Vec<LightEstimate> {
        let (leaf, parts) = (leaf as usize, part_count(element));
        if element.is_directional() {
            return vec![self.known[leaf]; parts];
        }
        self.known[leaf].part_estimates(&self.by_element[leaf], self.noise, &self.by_leaf[place][..parts])
    }
}

/// Sums over the parts of an element, for the estimate of its error.
#[derive(Clone, Copy, Debug, Default)]
struct ErrorSums {
    /// Number of parts.
    parts: f32,
    /// Estimated squared errors of the irradiance of the parts, and squared irradiances, lx2.
    errors: f32,
    light: f32,
}

impl Comparison {
    /// Returns the estimated root mean square error of the light of leaves of surfaces, by element, lx. It has two parts: errors of
    /// the means of parts of leaves, which follow from the comparison with the rays, and errors within these parts, which the oracle of
    /// the links has estimated.
    /// - `leaves`: leaves in the order of the comparison;
    /// - `link_errors`: [`ElementLights::link_errors`].
    fn errors(&self, arena: &Arena, leaves: &[u32], link_errors: &[f32]) -> Vec<f32> {
        let floor = IRRADIANCE_FLOOR * self.all.links / self.all.area.max(f32::MIN_POSITIVE);
        let mut sums = vec![ErrorSums::default(); arena.elements.len()];
        for (place, &leaf) in leaves.iter().enumerate() {
            let element = &arena.elements[leaf as usize];
            if element.is_volume() {
                continue;
            }
            let sum = &mut sums[leaf as usize];
            let known = &self.known[leaf as usize];
            let mut add = |part: &PartSums, above: &LightEstimate, found: &LightEstimate| {
                let (area, light) = (part.area, part.light(found) / part.area + floor);
                let error = part.squared_error(above, found, self.noise) / (area * area);
                if error.is_finite() && light.is_finite() {
                    *sum = ErrorSums {
                        parts: sum.parts + 1.0,
                        errors: sum.errors + error,
                        light: sum.light + light * light,
                    };
                }
            };
            if element.is_directional() {
                let above = self.known.get(element.parent as usize).unwrap_or(known);
                add(&self.by_element[leaf as usize], above, known);
            } else {
                let parts = &self.by_leaf[place][..part_count(element)];
                let found = known.part_estimates(&self.by_element[leaf as usize], self.noise, parts);
                parts.iter().zip(&found).for_each(|(part, found)| add(part, known, found));
            }
        }
        for index in (0..arena.elements.len()).rev() {
            let ErrorSums { parts, errors, light } = sums[index];
            if let Some(above) = sums.get_mut(arena.elements[index].parent as usize) {
                (above.parts, above.errors, above.light) =
                    (above.parts + parts, above.errors + errors, above.light + light);
            }
        }
        // Squared relative error. The estimates of few parts are noisy, so the whole above counts as some parts.
        let mut ratios = vec![0.0f32; sums.len()];
        let mut found = vec![0.0; sums.len()];
        // A parent comes before its children.
        let mut of_links = link_errors.to_vec();
        for (index, element) in arena.elements.iter().enumerate() {
            let ErrorSums { parts, errors, light } = sums[index];
            if let Some(&above) = of_links.get(element.parent as usize) {
                of_links[index] += above;
            }
            if parts == 0.0 {
                continue;
            }
            let own = errors / light;
            let ratio = match ratios.get(element.parent as usize) {
                Some(&above) => {
                    ((parts * own + ERROR_PARTS * above) / (parts + ERROR_PARTS)).max(MIN_ERROR_RATIO * above)
                }
                None => own,
            };
            ratios[index] = ratio.max(MIN_RELATIVE_ERROR * MIN_RELATIVE_ERROR);
            if element.is_leaf() {
                found[index] =
                    (ratios[index] * light / parts + LINK_ERROR_WEIGHT * LINK_ERROR_WEIGHT * of_links[index]).sqrt();
            }
        }
        found
    }
}

impl Rays {
    /// Measures the share of the light of each leaf that arrives at other elements. By reciprocity, this is the share of the leaf's
    /// rays that hit something.
    pub fn measure_arriving_shares(&self, arena: &Arena, lights: &mut ElementLights) {
        let (mut arriving, mut variance) = (0.0f64, 0.0f64);
        for (place, &leaf) in self.leaves.iter().enumerate() {
            let element = &arena.elements[leaf as usize];
            let parts = part_count(element);
            let (shares, variances) = self.arriving_share(place, parts);
            let flux =
                f64::from(luminance(lights.elements[leaf as usize].radiosity) * element.sending_size()) / parts as f64;
            for part in 0..parts {
                arriving += flux * f64::from(shares[part]);
                variance += flux * flux * f64::from(variances[part]);
            }
            lights.arriving_share[leaf as usize] = shares;
        }
        lights.share_variance = if arriving > 0.0 { (variance / (arriving * arriving)) as f32 } else { 0.0 };
        // Rays through mirrors are too noisy for the balance of all light: a room of mirrors was 4.5 % too dark instead of 3.5 %.
        let is_surface = |leaf: u32| leaf != NONE && !arena.elements[leaf as usize].is_volume();
        let has_mirrors = self.hits.iter().any(|hit| !hit.is_two_way && is_surface(hit.leaf));
        lights.has_measured_shares = !has_mirrors;
    }

    /// Returns the share of the rays of each part of a leaf that hit something, and its variance.
    fn arriving_share(&self, place: usize, parts: usize) -> ([f32; MAX_PARTS], [f32; MAX_PARTS]) {
        let range = self.first[place] as usize..self.first[place + 1] as usize;
        let (mut hits, mut all) = ([[0.0f32; 2]; MAX_PARTS], [[0.0f32; 2]; MAX_PARTS]);
        for (ray, hit) in self.hits[range].iter().enumerate().filter(|(_, hit)| hit.density[0] > 0.0) {
            let (weight, share) = (1.0 / hit.density[0], if hit.leaf == NONE { 0.0 } else { hit.share });
            let (hits, all) = (&mut hits[ray % parts], &mut all[ray % parts]);
            *hits = [hits[0] + weight * share, hits[1] + weight * share * share];
            *all = [all[0] + weight, all[1] + 1.0];
        }
        let (mut shares, mut variances) = ([1.0; MAX_PARTS], [0.0; MAX_PARTS]);
        for part in (0..parts).filter(|&part| all[part][0] > 0.0) {
            let [mean, square] = hits[part].map(|sum| sum / all[part][0]);
            (shares[part], variances[part]) = (mean, (square - mean * mean).max(0.0) / all[part][1]);
        }
        (shares, variances)
    }

    /// Sets the light that the leaves receive in addition to that of the links.
    /// - `error`: allowed error of a link.
    pub fn correct(&self, arena: &Arena, lights: &mut ElementLights, error: f32) -> RayCorrection {
        let comparison = self.compare(arena, lights, FROM_ELEMENTS, error);
        let mut contrast = Vec::with_capacity(self.leaves.len());
        let (mut changed, mut whole, mut area) = (0.0f64, 0.0f64, 0.0f64);
        for (place, (&leaf, sums_of)) in self.leaves.iter().zip(&comparison.by_leaf).enumerate() {
            let element = &arena.elements[leaf as usize];
            let parts = comparison.part_estimates(element, place, leaf);
            let row_scale = lights.row_scale[leaf as usize];
            if let Some(directional) = element.directional() {
                let arriving = &mut lights.incident[directional];
                arriving.ray_correction = arriving.total[FROM_ELEMENTS]
                    * Rgb::splat(row_scale[0] * (parts[0].scale - 1.0))
                    + Harmonics::from_irradiance(parts[0].extra);
            } else {
                let whole = lights.elements[leaf as usize].total[FROM_ELEMENTS];
                for (node, (more, part)) in lights.ray_correction[leaf as usize].iter_mut().zip(&parts).enumerate() {
                    *more = whole[node] * (row_scale[node] * (part.scale - 1.0)) + part.extra;
                }
            }
            let sums_of = &sums_of[..parts.len()];
            contrast.push((leaf, part_contrast(sums_of, &parts)));
            if element.is_volume() {
                continue;
            }
            for (sums, part) in sums_of.iter().zip(parts) {
                let size = f64::from(sums.area);
                changed += f64::from(sums.light(&part) - sums.links).powi(2) / size.max(f64::MIN_POSITIVE);
                (whole, area) = (whole + f64::from(sums.links), area + size);
            }
        }
        let area = area.max(f64::MIN_POSITIVE);
        let changed = (changed / area).sqrt() / (whole / area).max(f64::MIN_POSITIVE);
        let all = &comparison.all;
        let ratio = if all.links > 0.0 { all.rays / all.links } else { 1.0 };
        RayCorrection { ratio, changed: changed as f32, contrast, comparison }
    }

    /// Estimates the root mean square error of the light of all leaves of surfaces after a correction ([`ElementLights::errors`]).
    pub fn estimate_errors(&self, arena: &Arena, lights: &mut ElementLights, correction: &RayCorrection) {
        lights.errors = correction.comparison.errors(arena, &self.leaves, &lights.link_errors);
    }

    /// Corrects the light that the leaves receive directly from lamps. Returns the difference between the irradiances of the parts of
    /// each leaf, lx.
    /// - `error`: allowed error of a link.
    pub fn correct_lamps(&self, arena: &Arena, lights: &mut ElementLights, error: f32) -> Vec<f32> {
        let comparison = self.compare(arena, lights, FROM_LAMPS, error);
        let mut contrast = Vec::with_capacity(self.leaves.len());
        for (place, &leaf) in self.leaves.iter().enumerate() {
            let element = &arena.elements[leaf as usize];
            let parts = comparison.part_estimates(element, place, leaf);
            contrast.push(part_contrast(&comparison.by_leaf[place], &parts));
            let (scales, more) = (&mut lights.lamp_scale[leaf as usize], &mut lights.lamp_correction[leaf as usize]);
            for ((scale, more), part) in scales.iter_mut().zip(more).zip(parts) {
                (*scale, *more) = (part.scale, part.extra);
            }
        }
        contrast
    }

    /// Compares the light of rays with that of links.
    /// - `kind`: [`FROM_LAMPS`] or [`FROM_ELEMENTS`].
    fn compare(&self, arena: &Arena, lights: &ElementLights, kind: usize, error: f32) -> Comparison {
        let (chance, estimator) = match kind {
            FROM_LAMPS => (CHANCE_VARIANCES_OF_RARE_HITS, VarianceEstimator::Measured),
            _ if arena.fog != NONE => (CHANCE_VARIANCES_OF_RARE_HITS, VarianceEstimator::RareHitsInFog),
            _ => (CHANCE_VARIANCES, VarianceEstimator::RareHits),
        };
        let chance = chance * (ROUGH_ERROR / error).max(1.0);
        let noise = Noise { chance, estimator };
        let sent = (kind == FROM_ELEMENTS).then(|| SentLight::new(arena, lights));
        let by_leaf: Vec<[PartSums; MAX_PARTS]> = (0..self.leaves.len())
            .into_par_iter()
            .map(|place| {
                let leaf = self.leaves[place];
                let element = &arena.elements[leaf as usize];
                let own = (self.first[place + 1] - self.first[place]) as usize;
                let parts = part_count(element);
                let links = self.link_irradiance(arena, place, (lights, kind));
                let (area, number) = (element.size() / parts as f32, (own / parts) as f32);
                let mut sums = [0, 1, 2, 3]
                    .map(|k| if k < parts { PartSums::new(area, number, links[k]) } else { PartSums::default() });
                let add = |RaySample { is_own, part, irradiance }: RaySample| {
                    let bright = luminance(irradiance) * own as f32;
                    sums[part.min(parts - 1)].add_sample(irradiance * element.size(), bright, is_own);
                };
                match &sent {
                    Some(light) => self.visit_samples(arena, light, place, add),
                    None => self.visit_shadow_rays(arena, place, add),
                }
                if estimator == VarianceEstimator::Measured {
                    sums[..parts].iter_mut().for_each(|part| part.measure_variance(number));
                }
                sums
            })
            .collect();
        let mut sums = vec![PartSums::default(); arena.elements.len()];
        for (&leaf, parts) in self.leaves.iter().zip(&by_leaf) {
            parts.iter().for_each(|part| sums[leaf as usize].add(part));
        }
        let mut all = PartSums::default();
        for index in (0..arena.elements.len()).rev() {
            let element = &arena.elements[index];
            let part = sums[index];
            if is_root(arena, index as u32) {
                all.add(&part);
            } else if element.surface_part().is_some() || (element.is_volume() && index != arena.fog as usize) {
                sums[element.parent as usize].add(&part);
            }
        }
        // A parent comes before its children. The total of its parts is known best.
        let whole = all.estimate(&LightEstimate::links(&all, noise.estimator), noise);
        let mut known = vec![whole; arena.elements.len()];
        let roots: Vec<u32> = (0..arena.elements.len() as u32).filter(|&index| is_root(arena, index)).collect();
        let parts: Vec<PartSums> = roots.iter().map(|&root| sums[root as usize]).collect();
        for (&root, part) in roots.iter().zip(whole.part_estimates(&all, noise, &parts)) {
            known[root as usize] = part;
        }
        if let Some(fog) = sums.get(arena.fog as usize) {
            // The fog is a tree of its own, whose parts have volumes.
            let nothing = LightEstimate::links(fog, noise.estimator);
            known[arena.fog as usize] = fog.estimate(&nothing, noise);
        }
        for (index, element) in arena.elements.iter().enumerate() {
            if element.is_cluster() || element.is_leaf() {
                continue;
            }
            let parts = element.children.map(|child| sums[child as usize]);
            let parts = known[index].part_estimates(&sums[index], noise, &parts);
            element.children.iter().zip(parts).for_each(|(&child, part)| known[child as usize] = part);
        }
        Comparison { all, by_element: sums, by_leaf, known, noise }
    }

    /// Returns the irradiance of the links at the parts of a leaf, lx.
    fn link_irradiance(
        &self,
        arena: &Arena,
        leaf_index: usize,
        (lights, kind): (&ElementLights, usize),
    ) -> [f32; MAX_PARTS] {
        let leaf = self.leaves[leaf_index] as usize;
        let element = &arena.elements[leaf];
        let scale = if kind == FROM_LAMPS { [1.0; 4] } else { lights.row_scale[leaf] };
        if let Some(directional) = element.directional() {
            let light = lights.incident[directional].total[kind];
            let range = self.first[leaf_index] as usize..self.first[leaf_index + 1] as usize;
            let (sights, number) = (&self.hits[range.clone()], range.len() as f32);
            let sum: f32 = sights
                .iter()
                .map(|sight| luminance(light.cosine_integral(unpack_normal(sight.origin_normal))).max(0.0))
                .sum();
            return [scale[0] * sum / number; MAX_PARTS];
        }
        let total = &lights.elements[leaf].total[kind];
        [0, 1, 2, 3].map(|node| scale[node] * luminance(total[node].max(Rgb::ZERO)))
    }
}

/// Estimate of the light of a part of a surface.
#[derive(Clone, Copy, Debug)]
struct LightEstimate {
    /// Factor of the links' light.
    scale: f32,
    /// Additional irradiance, lx.
    extra: Rgb,
    /// Irradiance of a ray that hits something bright, lx: of the leaves' own rays, and of others' rays.
    bright: [f32; 2],
    /// Share of the leaves' own rays in the light.
    own_share: f32,
}

impl LightEstimate {
    /// Returns the estimate that the links have, for the whole of all parts.
    fn links(all: &PartSums, estimator: VarianceEstimator) -> Self {
        Self { scale: 1.0, extra: Rgb::ZERO, bright: all.bright([0.0; 2], estimator), own_share: all.own_share(1.0) }
    }

    /// Returns the estimates of the parts of a whole. Together they have the light of the whole.
    fn part_estimates(self, whole: &PartSums, noise: Noise, parts: &[PartSums]) -> Vec<Self> {
        let above = Self {
            bright: whole.bright(self.bright, noise.estimator),
            own_share: whole.own_share(self.own_share),
            ..self
        };
        let known: Vec<Self> = parts.iter().map(|part| part.estimate(&above, noise)).collect();
        let together: f32 = parts.iter().zip(&known).map(|(part, known)| part.light(known)).sum();
        let more = (whole.light(&self) / together.max(f32::MIN_POSITIVE)).min(MAX_RAY_SCALE);
        let of = |(part, known): (&PartSums, Self)| Self {
            scale: known.scale * more,
            extra: known.extra * more,
            bright: part.bright(above.bright, noise.estimator),
            own_share: part.own_share(above.own_share),
        };
        parts.iter().zip(known).map(of).collect()
    }
}

/// Returns the difference between the greatest and the least irradiance of the parts of a leaf, lx.
fn part_contrast(sums: &[PartSums], parts: &[LightEstimate]) -> f32 {
    let found = sums.iter().zip(parts).map(|(sums, part)| sums.light(part) / sums.area);
    let (low, high) = found.fold((f32::INFINITY, 0.0f32), |(low, high), light| (low.min(light), high.max(light)));
    high - low
}

#[cfg(test)]
mod tests {
    use super::*;

    const RARE: Noise = Noise { chance: CHANCE_VARIANCES, estimator: VarianceEstimator::RareHits };

    /// Rays of other leaves find a third of the light of all parts, but none reached one of them. That is chance, not a shadow: the
    /// difference is no more than two standard deviations.
    #[test]
    fn part_missed_by_rays_of_other_leaves_is_not_darkened() {
        let gray = |light: f32| Rgb::splat(light);
        let part = |by_others: usize| {
            let mut sums = PartSums::new(1.0, 32.0, 1.0);
            (0..32).for_each(|_| sums.add_sample(gray(0.67 / 32.0), 0.67, true));
            (0..by_others).for_each(|_| sums.add_sample(gray(0.11), 3.52, false));
            sums
        };
        let parts: Vec<PartSums> = [4, 3, 5, 0, 3, 3, 4, 2].map(part).to_vec();
        let mut all = PartSums::default();
        parts.iter().for_each(|part| all.add(part));
        let nothing = LightEstimate::links(&all, RARE.estimator);
        let known = nothing.part_estimates(&all, Noise { chance: 4.0, ..RARE }, &parts);
        let scales: Vec<f32> = known.iter().map(|known| known.scale).collect();
        assert!(scales.iter().all(|scale| (scale - 1.0).abs() < 0.01), "{scales:?}");
    }

    /// The rays' light has normal noise around light that differs from that of the links by some standard deviations.
    #[test]
    #[expect(clippy::disallowed_methods, reason = "the last bits of the weights do not matter")]
    fn estimated_squared_errors_have_the_mean_of_the_true_ones() {
        let noise = Noise { estimator: VarianceEstimator::Measured, ..RARE };
        for true_light in [10.0, 10.5, 11.0, 12.0, 14.0] {
            let (mut estimated, mut truth, mut whole) = (0.0f64, 0.0f64, 0.0f64);
            for k in -6000..=6000 {
                let normal = f64::from(k) * 1e-3;
                let weight = (-0.5 * normal * normal).exp();
                let mut part = PartSums::new(1.0, 8.0, 10.0);
                part.variances = [0.0; 3];
                (part.rays, part.color, part.measured_variance) = (true_light + normal as f32, Rgb::ONE, 1.0);
                let above = LightEstimate { scale: 1.0, extra: Rgb::ZERO, bright: [0.0; 2], own_share: 1.0 };
                let found = part.estimate(&above, noise);
                estimated += weight * f64::from(part.squared_error(&above, &found, noise));
                truth += weight * f64::from(part.light(&found) - true_light).powi(2);
                whole += weight;
            }
            let [estimated, truth] = [estimated, truth].map(|sum| sum / whole);
            assert!((estimated - truth).abs() < 0.02, "{true_light}: estimated {estimated}, true {truth}");
        }
    }

    /// Light has leaked into a closed box in a room with places that are twice as bright as the mean. All rays in the box find
    /// the same light, 7 % less than the links. That is no chance.
    #[test]
    fn light_that_leaks_into_a_closed_box_is_removed() {
        let part = |number: u16, links: f32, light: f32, brightest: f32| {
            let mut sums = PartSums::new(1.0, f32::from(number), links);
            let hits = f32::from(number) * light / brightest;
            let each = |k: u16| if f32::from(k) < hits { brightest } else { 0.0 };
            (0..number).for_each(|k| sums.add_sample(Rgb::splat(each(k) / f32::from(number)), each(k), true));
            sums
        };
        let parts = [part(1000, 1.0, 1.0, 2.0), part(300, 0.215, 0.2, 0.2)];
        let mut all = PartSums::default();
        parts.iter().for_each(|part| all.add(part));
        let known = LightEstimate::links(&all, RARE.estimator).part_estimates(&all, RARE, &parts);
        assert!((known[1].scale * 0.215 / 0.2 - 1.0).abs() < 0.03, "{known:?}");
    }

    /// If links have no light, that of the rays is added, in the parts as in the whole.
    #[test]
    fn light_that_no_link_brings_is_added() {
        let part = |light: f32| {
            let mut sums = PartSums::new(2.0, 400.0, 0.0);
            (0..400).for_each(|_| sums.add_sample(Rgb::splat(light * 2.0 / 400.0), light, true));
            sums
        };
        let parts = [part(3.0), part(5.0)];
        let mut all = PartSums::default();
        parts.iter().for_each(|part| all.add(part));
        let nothing = LightEstimate::links(&all, RARE.estimator);
        let known = all.estimate(&nothing, RARE).part_estimates(&all, RARE, &parts);
        for (known, want) in known.iter().zip([3.0, 5.0]) {
            assert!((luminance(known.extra) / want - 1.0).abs() < 0.1, "{known:?} {want}");
        }
    }
}
