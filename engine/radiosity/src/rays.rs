//! Correction of the links' light with rays from the leaves.
//!
//! Links are kept if each alone matters little, but many links that are wrong in the same way matter together: a leaf beneath a
//! table is in the shadow of all of them. So rays from each leaf estimate the arriving light. They are few and noisy, but unbiased.
//! The links' light is scaled to that of the rays, over parts of surfaces as small as the rays can distinguish. The correction goes
//! from each surface down its tree, as far as the rays of a part differ from the estimate of the part above by more than chance
//! (James and Stein's estimator, \[efron1973\]). The boxes of fog are a tree of their own.

mod bytes;
mod correct;
mod exits;
mod plan;
mod trace;

pub use plan::RayPlan;
#[cfg(test)]
pub use plan::ray_leaves;
pub use trace::{Landing, PathKind, fog_part, follow_path, leaf_part};

use crate::arena::Arena;
use crate::element::{Element, Shape};
use crate::gather::{ElementLights, FROM_ELEMENTS, FROM_LAMPS};
use crate::tuning::DENSITY_RATIOS;
use femc_field::NONE;
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use rayon::prelude::*;
use trace::unpack_normal;

/// Maximum number of parts of a leaf, which its nodes represent.
const MAX_PARTS: usize = 4;

/// Hit of a ray.
#[derive(Clone, Copy, Debug)]
struct RayHit {
    /// Leaf that was hit, or [`NONE`].
    leaf: u32,
    /// Irradiance of the ray's origin, if all rays had this hit, relative to the leaf's radiosity; for fog, relative to its
    /// irradiance.
    share: f32,
    /// Normal at the hit, in 127ths.
    normal: [i8; 3],
    /// Normal at the ray's origin, in 127ths.
    origin_normal: [i8; 3],
    /// Part of the leaf.
    part: u8,
    /// Whether the leaf receives light through this ray: no mirror is between.
    is_two_way: bool,
    /// Expected number of rays along such ways, from the ray's own leaf and from the leaf that was hit, over the density of ways
    /// from the ray's own leaf: the cosine distribution of directions from evenly distributed points. 1/m2, for fog 1/m3.
    density: [f32; 2],
    /// Estimate of the irradiance of the ray's origin directly from lamps, by one shadow ray, lx.
    direct: [f32; 3],
}

/// Returns the rays per area by which a way's light is divided; 0: the way does not count. Only the leaf's own rays count, unless
/// the other leaf's rays are denser by [`min_density_ratio`] (maximum heuristic). Rays of the other leaf are not stratified here and
/// add noise.
/// - `own`, `other`: densities from the leaf itself, and from the other end;
/// - `is_own`: whether the leaf's own ray found the way;
/// - `contrast`: light of the other leaf relative to the mean of what the leaf receives.
fn counted_density([own, other]: [f32; 2], is_own: bool, contrast: f32) -> f32 {
    if is_own != (other <= min_density_ratio(contrast) * own) {
        0.0
    } else if is_own {
        own
    } else {
        other
    }
}

/// Returns the minimum ratio of the density of rays from the other end to that of a leaf's own rays, for the former to be preferred.
/// - `contrast`: light of the other leaf relative to the mean of what the leaf receives. Few of the own rays hit what is much brighter
///   than the rest.
fn min_density_ratio(contrast: f32) -> f32 {
    let [least, most] = DENSITY_RATIOS;
    (most / contrast).clamp(least, most)
}

/// Rays from all leaves of surfaces and of fog. Each ray measures the light that its origin receives from its end, and, if its end is a leaf,
/// the light that this leaf receives from the origin: light travels both ways. So the rays of either leaf may find a way between
/// them. Its light is divided by the expected number of rays along it from both leaves, or from those that count (multiple
/// importance sampling with the maximum heuristic, \[pharr2023\]). Leaves that send much light have more rays, which find the
/// surfaces that they light through a small gap.
#[derive(Debug)]
pub struct Rays {
    /// Leaves by index.
    leaves: Vec<u32>,
    /// First ray by leaf, and the end.
    first: Vec<u32>,
    /// Hits by leaf and part.
    hits: Vec<RayHit>,
    /// First incoming ray of each leaf, from other leaves, and the end; and for each such ray, the index of its leaf among the
    /// leaves, and the ray.
    incoming_start: Vec<u32>,
    incoming: Vec<[u32; 2]>,
    /// Number of traced rays.
    pub traced: u64,
}

/// Light along a way to a part of a leaf.
#[derive(Clone, Copy, Debug)]
struct RaySample {
    /// Whether it is a ray of the leaf itself.
    is_own: bool,
    part: usize,
    /// Contribution to the leaf's mean irradiance, lx.
    irradiance: Rgb,
}

impl RayHit {
    const MISS: Self = Self {
        leaf: NONE,
        share: 0.0,
        normal: [0; 3],
        origin_normal: [0; 3],
        part: 0,
        is_two_way: false,
        density: [0.0; 2],
        direct: [0.0; 3],
    };
}

/// Returns the number of parts of a leaf from which rays begin.
pub fn part_count(element: &Element) -> usize {
    if element.is_triangle() { 3 } else { MAX_PARTS }
}

/// Hits of rays from some leaves.
#[derive(Clone, Debug, Default)]
pub struct RayHits {
    /// Index of the first leaf among all.
    first_leaf: u32,
    /// Number of rays by leaf.
    counts: Vec<u32>,
    hits: Vec<RayHit>,
    /// Number of traced rays.
    traced: u64,
}

impl Rays {
    /// Creates the rays from the hits of all leaves, in order.
    pub fn new(leaves: Vec<u32>, parts: Vec<RayHits>) -> Self {
        let ends = parts.iter().flat_map(|part| &part.counts).scan(0, |end, count| {
            *end += count;
            Some(*end)
        });
        let first = [0].into_iter().chain(ends).collect();
        let traced = parts.iter().map(|part| part.traced).sum();
        let mut sights = Vec::new();
        for part in parts {
            if sights.is_empty() { sights = part.hits } else { sights.extend(part.hits) }
        }
        let mut out = Self { leaves, first, hits: sights, incoming_start: Vec::new(), incoming: Vec::new(), traced };
        out.build_reverse_index();
        out
    }

    /// Builds the reverse index: the incoming rays of each leaf.
    fn build_reverse_index(&mut self) {
        let place = |sight: &RayHit| {
            let both = sight.is_two_way && sight.share > 0.0;
            both.then(|| self.leaves.binary_search(&sight.leaf).ok()).flatten()
        };
        let places: Vec<u32> = self.hits.par_iter().map(|sight| place(sight).map_or(NONE, |at| at as u32)).collect();
        let mut first = vec![0u32; self.leaves.len() + 1];
        places.iter().filter(|&&at| at != NONE).for_each(|&at| first[at as usize + 1] += 1);
        (1..first.len()).for_each(|at| first[at] += first[at - 1]);
        let mut next = first.clone();
        let mut from = vec![[0u32; 2]; first[self.leaves.len()] as usize];
        let mut origin = 0u32;
        for (ray, &at) in places.iter().enumerate() {
            while self.first[origin as usize + 1] as usize <= ray {
                origin += 1;
            }
            if at != NONE {
                from[next[at as usize] as usize] = [origin, ray as u32];
                next[at as usize] += 1;
            }
        }
        (self.incoming_start, self.incoming) = (first, from);
    }

    /// Returns the number of bytes of the rays.
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.hits) + size_of_val(&*self.incoming) + 20 * self.leaves.len()
    }

    /// Visits the light of the shadow rays from the leaf at this index.
    fn visit_shadow_rays(&self, arena: &Arena, leaf_index: usize, mut each: impl FnMut(RaySample)) {
        let parts = part_count(&arena.elements[self.leaves[leaf_index] as usize]);
        let [first, end] = [self.first[leaf_index], self.first[leaf_index + 1]].map(|at| at as usize);
        let number = (end - first) as f32;
        for (ray, hit) in self.hits[first..end].iter().enumerate() {
            let irradiance = Rgb::from_array(hit.direct) * (1.0 / number);
            each(RaySample { is_own: true, part: ray % parts, irradiance });
        }
    }

    /// Visits the ways along which light reaches the leaf at this index: first the ways of its own rays, then the ways of rays that
    /// other leaves have cast and that hit this leaf.
    fn visit_samples(&self, arena: &Arena, light: &SentLight<'_>, leaf_index: usize, mut each: impl FnMut(RaySample)) {
        let element = &arena.elements[self.leaves[leaf_index] as usize];
        let [first, end] = [self.first[leaf_index], self.first[leaf_index + 1]].map(|at| at as usize);
        let parts = part_count(element);
        let mean = light.mean_irradiance(arena, self.leaves[leaf_index]);
        let contrast = |other: u32| light.means.get(other as usize).map_or(1.0, |radiosity| radiosity / mean);
        for (ray, sight) in self.hits[first..end].iter().enumerate() {
            let number = counted_density(sight.density, true, contrast(sight.leaf)) * element.size();
            if number > 0.0 {
                let irradiance = light.received_irradiance(arena, sight) * (1.0 / number);
                each(RaySample { is_own: true, part: ray % parts, irradiance });
            }
        }
        for &[origin, ray] in
            &self.incoming[self.incoming_start[leaf_index] as usize..self.incoming_start[leaf_index + 1] as usize]
        {
            let (ray, origin) = (ray as usize, origin as usize);
            let sight = &self.hits[ray];
            let (leaf, [other, own]) = (self.leaves[origin], sight.density);
            let number = counted_density([own, other], false, contrast(leaf)) * element.size();
            if number > 0.0 {
                let origin_part = (ray - self.first[origin] as usize) % part_count(&arena.elements[leaf as usize]);
                // Light in the other direction is scattered here instead of there.
                let [here, there] =
                    [element, &arena.elements[leaf as usize]].map(|end| luminance(end.received_share()));
                let irradiance = light.radiosity(arena, leaf, origin_part, unpack_normal(sight.origin_normal))
                    * (sight.share * there / (here * number));
                each(RaySample { is_own: false, part: usize::from(sight.part), irradiance });
            }
        }
    }
}

/// Light that elements send, as rays find it. Many rays hit the same leaf, so the light of the parts of leaves is computed once.
#[derive(Debug)]
pub struct SentLight<'a> {
    lights: &'a ElementLights,
    /// Output of [`ElementLights::part_radiosity`] by element; 0 for elements that are not leaves.
    parts: Vec<[Rgb; 4]>,
    /// Mean of these over the parts by luminance, by element, lx.
    means: Vec<f32>,
}

impl<'a> SentLight<'a> {
    pub fn new(arena: &Arena, lights: &'a ElementLights) -> Self {
        let of = |(index, element): (usize, &Element)| {
            if element.is_leaf() { lights.part_radiosity(element, index) } else { [Rgb::ZERO; 4] }
        };
        let parts: Vec<[Rgb; 4]> = arena.elements.par_iter().enumerate().map(of).collect();
        let mean = |(element, parts): (&Element, &[Rgb; 4])| {
            let count = element.node_count();
            parts[..count].iter().copied().map(luminance).sum::<f32>() / count as f32
        };
        let means = arena.elements.iter().zip(&parts).map(mean).collect();
        Self { lights, parts, means }
    }

    /// Returns the mean irradiance of a leaf from elements by luminance, lx; infinite for fog.
    fn mean_irradiance(&self, arena: &Arena, leaf: u32) -> f32 {
        if arena.elements[leaf as usize].is_volume() {
            return f32::INFINITY;
        }
        luminance(self.lights.mean_irradiance_from_elements(arena, leaf as usize)).max(f32::MIN_POSITIVE)
    }

    /// Returns the irradiance of a ray's origin, if all rays had this hit, lx.
    fn received_irradiance(&self, arena: &Arena, hit: &RayHit) -> Rgb {
        if hit.leaf == NONE {
            return Rgb::ZERO;
        }
        self.radiosity(arena, hit.leaf, usize::from(hit.part), unpack_normal(hit.normal)) * hit.share
    }

    /// Returns the radiosity of a part of a leaf, as [`ElementLights::part_radiosity`], lx. A leaf that is bright only in a place that few rays reach, such
    /// as a ceiling inside of a lamp's housing, is not as bright as its mean elsewhere.
    /// - `normal`: normal at the point, for a curved leaf.
    fn radiosity(&self, arena: &Arena, leaf: u32, part: usize, normal: Vec3A) -> Rgb {
        let (lights, index) = (self.lights, leaf as usize);
        let of = |directional: u32, from: usize| {
            lights.directional_irradiance(directional as usize, index, from).cosine_integral(normal)
        };
        let all = |directional: u32| of(directional, FROM_LAMPS) + of(directional, FROM_ELEMENTS);
        let radiosity = match &arena.elements[index].shape {
            Shape::Curved(curved) => curved.part.reflectance * all(curved.directional),
            Shape::Cluster(cluster) => cluster.reflectance * all(cluster.directional),
            Shape::Patch(_) | Shape::Volume(_) => self.parts[index][part],
        };
        radiosity.max(Rgb::ZERO)
    }
}
