//! Number of rays from each leaf, and blocks of leaves whose rays are cast together.

use super::trace::{direct_irradiance, generate_ray, pack_normal, trace_ray};
use super::{MAX_PARTS, RayHit, RayHits, Rays, part_count};
use crate::arena::Arena;
use crate::gather::ElementLights;
use crate::scene::Scene;
use crate::tuning::{
    EXTRA_RAYS_RATIO, MAX_EXTRA_RAYS, MIN_FOG_RAYS, MIN_SMALL_RAYS, RAYS_PER_PART, SMALL_AREA_SHARE, TOTAL_RAYS,
};
use crate::visibility::VisibilityTester;
use femc_field::NONE;
use femc_math::color::luminance;
use rayon::prelude::*;
use std::ops::Range;

/// Plan for casting rays: the number of rays from each leaf.
#[derive(Clone, Debug)]
pub struct RayPlan {
    /// Leaves by index.
    leaves: Vec<u32>,
    /// First ray by leaf, and the end.
    first: Vec<u32>,
    /// Rays per area by element, 1/m2.
    density: Vec<f32>,
    /// Round, an argument of [`generate_ray`].
    round: u32,
}

impl RayPlan {
    /// Creates a plan without rays.
    pub fn empty() -> Self {
        Self { leaves: Vec::new(), first: vec![0], density: Vec::new(), round: 0 }
    }

    /// Plans the rays from all leaves.
    /// - `max_bytes`: maximum number of bytes of the rays. If it is too small, there are fewer rays, at least one from each part.
    /// - `round`: number of the round; each has different rays.
    pub fn new(arena: &Arena, lights: &ElementLights, round: u32, max_bytes: usize) -> Self {
        let leaves = ray_leaves(arena);
        let is_fog = |leaf: u32| arena.elements[leaf as usize].is_volume();
        let of_fog = MAX_PARTS * leaves.iter().filter(|&&leaf| is_fog(leaf)).count();
        let of_surfaces = MAX_PARTS * leaves.len() - of_fog;
        let fit = (max_bytes / ((size_of::<RayHit>() + size_of::<[u32; 2]>()) * (of_surfaces + of_fog).max(1))).max(1);
        // The many boxes of fog leave the surfaces their rays.
        let rays_per_part =
            |all: usize, parts: usize, least: usize| (all / parts.max(1)).clamp(least, RAYS_PER_PART[1]).min(fit);
        let [of_surface, of_small] =
            [RAYS_PER_PART[0], MIN_SMALL_RAYS].map(|least| rays_per_part(TOTAL_RAYS, of_surfaces, least));
        let of_box = rays_per_part(TOTAL_RAYS, of_fog, MIN_FOG_RAYS);
        let small = arena.elements.get(arena.surfaces as usize).map_or(0.0, |all| SMALL_AREA_SHARE * all.size());
        let each = |leaf: u32| match &arena.elements[leaf as usize] {
            element if element.is_volume() => of_box,
            element if element.surface_part().is_some_and(|part| part.area < small) => of_small,
            _ => of_surface,
        };
        let base = MAX_PARTS * leaves.iter().map(|&leaf| each(leaf)).sum::<usize>();
        // Clusters count as their surfaces: they do not lower the number of rays from bright leaves.
        let merged: usize =
            leaves.iter().map(|&leaf| arena.members(&arena.elements[leaf as usize]).len().saturating_sub(1)).sum();
        let regular = ((of_surfaces + MAX_PARTS * merged) * of_surface + of_fog * of_box) as f32;
        let more = (EXTRA_RAYS_RATIO * regular)
            .min(MAX_EXTRA_RAYS.max(base as f32))
            .min((fit * (of_surfaces + of_fog) - base) as f32);
        let power = |&leaf: &u32| {
            let element = &arena.elements[leaf as usize];
            element.sending_size() * luminance(lights.elements[leaf as usize].radiosity).max(0.0)
        };
        let whole: f32 = leaves.iter().map(power).sum();
        let by_power = |leaf: &u32| if whole > 0.0 { (more * (power(leaf) / whole)) as usize / MAX_PARTS } else { 0 };
        let mut first = vec![0u32];
        let mut density = vec![0.0f32; arena.elements.len()];
        for leaf in &leaves {
            let element = &arena.elements[*leaf as usize];
            let number = (part_count(element) * (each(*leaf) + by_power(leaf))) as u32;
            first.push(first[first.len() - 1] + number);
            density[*leaf as usize] = number as f32 / element.size();
        }
        Self { leaves, first, density, round }
    }

    /// Returns the range of the leaves of a block. The blocks have about equal numbers of rays.
    pub fn block_range(&self, block: u32, blocks: u32) -> Range<usize> {
        block_range(&self.first, block, blocks)
    }

    /// Creates the rays from the hits of all leaves in order.
    pub fn into_rays(self, parts: Vec<RayHits>) -> Rays {
        Rays::new(self.leaves, parts)
    }

    /// Checks that these are the hits of all leaves, in order.
    pub fn matches_hits(&self, arena: &Arena, parts: &[RayHits]) -> bool {
        let counts = parts.iter().flat_map(|part| &part.counts).copied();
        are_complete(arena, parts, self.leaves.len()) && counts.eq(self.first.windows(2).map(|ends| ends[1] - ends[0]))
    }

    /// Casts the rays of these leaves.
    pub fn cast(&self, scene: &Scene<'_>, arena: &Arena, part: Range<usize>) -> RayHits {
        let density = &self.density;
        let counts: Vec<u32> = self.first[part.start..=part.end].windows(2).map(|ends| ends[1] - ends[0]).collect();
        let chunks: Vec<(Vec<RayHit>, u64)> = self.leaves[part.clone()]
            .par_chunks(64)
            .zip(counts.par_chunks(64))
            .map(|(leaves, counts)| {
                let mut tester = VisibilityTester::default();
                let mut hits = Vec::with_capacity(counts.iter().sum::<u32>() as usize);
                for (&leaf, &count) in leaves.iter().zip(counts) {
                    let element = &arena.elements[leaf as usize];
                    let each = count as usize / part_count(element);
                    let sight = |ray: usize| {
                        let (spot, dir, u) = generate_ray(scene, arena, element, ray, each, self.round);
                        let direct = direct_irradiance(
                            scene,
                            &spot,
                            [element.key, u64::from(self.round), ray as u64],
                            &mut tester,
                        );
                        let (direct, origin_normal) = (direct.to_array(), pack_normal(spot.normal));
                        if !element.is_volume() && dir.dot(spot.normal) <= 0.0 {
                            return RayHit { direct, origin_normal, ..RayHit::MISS };
                        }
                        let mut hit = trace_ray(scene, arena, &spot, dir, u, &mut tester);
                        (hit.direct, hit.origin_normal) = (direct, origin_normal);
                        hit.density[0] = density[leaf as usize];
                        // A ray may hit fog in a box that has none at its nodes, and so none in the mean.
                        hit.is_two_way &= arena.elements.get(hit.leaf as usize).is_some_and(|other| {
                            other.stopped_share() > 0.0 && luminance(other.received_share()) > 0.0
                        });
                        if hit.is_two_way {
                            let number = density[hit.leaf as usize];
                            let other = &arena.elements[hit.leaf as usize];
                            let stopped = element.stopped_share() / other.stopped_share();
                            hit.density[1] = number * stopped;
                        }
                        hit
                    };
                    hits.extend((0..count as usize).map(sight));
                }
                (hits, tester.rays)
            })
            .collect();
        let traced = chunks.iter().map(|(_, rays)| rays).sum();
        let hits = chunks.into_iter().flat_map(|(sights, _)| sights).collect();
        RayHits { first_leaf: part.start as u32, counts, hits, traced }
    }
}

/// Returns the leaves from which rays begin, by index: parts of surfaces, clusters without parts, and boxes of fog.
pub fn ray_leaves(arena: &Arena) -> Vec<u32> {
    let is_leaf = |index: &u32| arena.elements[*index as usize].is_leaf();
    (0..arena.elements.len() as u32).filter(is_leaf).collect()
}

/// Checks that the hits belong to leaves 0 to `leaves` (exclusive), in order, and that each leaf that was hit exists.
pub fn are_complete(arena: &Arena, parts: &[RayHits], leaves: usize) -> bool {
    let mut next = 0;
    let follow = parts.iter().all(|part| {
        let is_next = part.first_leaf as usize == next;
        next += part.counts.len();
        is_next
    });
    let sights = || parts.par_iter().flat_map(|part| &part.hits);
    follow && next == leaves && sights().all(|sight| sight.leaf == NONE || (sight.leaf as usize) < arena.elements.len())
}

/// Returns the range of items of a block, if all blocks have about equal amounts.
/// - `first`: for each item the total of those before it, and at the end the total of all.
pub fn block_range(first: &[u32], block: u32, blocks: u32) -> Range<usize> {
    let (items, whole) = (first.len() - 1, u64::from(first[first.len() - 1]));
    let at = |block: u32| match block {
        0 => 0,
        _ if block >= blocks => items,
        _ => first.partition_point(|&first| u64::from(first) < whole * u64::from(block) / u64::from(blocks)).min(items),
    };
    at(block)..at(block + 1)
}
