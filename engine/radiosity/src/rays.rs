//! Correction of the links' light with rays from the leaves.
//!
//! Links are kept if each alone matters little, but many links that are wrong in the same way matter together: a leaf beneath a
//! table is in the shadow of all of them. So rays from each leaf estimate the arriving light. They are few and noisy, but unbiased.
//! The links' light is scaled to that of the rays, over parts of surfaces as small as the rays can distinguish. The correction goes
//! from each surface down its tree, as far as the rays of a part differ from the estimate of the part above by more than chance
//! (James and Stein's estimator, \[efron1973\]).

mod aims;
mod bytes;
mod correct;

pub use aims::Aims;

use crate::arena::Arena;
use crate::element::{Element, ElementKind};
use crate::gather::{ElementLights, FROM_ELEMENTS, FROM_LAMPS};
use crate::scene::{MEAN_DIRECTION, SHUTTER_TIME, Scene};
use crate::visibility::{RandomNumbers, VisibilityTester};
use aims::Aim;
use femc_field::{NONE, SurfaceSpot};
use femc_geometry::{Ray, offset_origin};
use femc_math::color::luminance;
use femc_math::glam::{Vec2, Vec3A};
use femc_math::{Frame, Rgb, warp};
use femc_prepared::media::{DistanceSample, MediumStack};
use femc_prepared::{Crossing, Orientation};
use femc_scattering::{LobeKind, Transmitted};
use rayon::prelude::*;
use std::f32::consts::PI;
use std::ops::Range;

/// Minimum and maximum number of rays from each part of a leaf, and the total number of rays if the number per part is between
/// these.
const RAYS_PER_PART: [usize; 2] = [8, 1024];
const TOTAL_RAYS: usize = 1 << 16;
/// Total number of rays if few rays have found portals, so that each leaf measures their light with its own rays.
const TOTAL_RAYS_FOR_PORTALS: usize = 4 * TOTAL_RAYS;
/// Number of additional rays, distributed among the leaves by the light that they send, relative to the other rays.
const EXTRA_RAYS_RATIO: f32 = 1.0;
/// Maximum number of parts of a leaf, which its nodes represent.
const MAX_PARTS: usize = 4;
/// Minimum ratio of the density of rays from the other end to that of a leaf's own rays, for the former to be preferred.
const MIN_DENSITY_RATIO: f32 = 32.0;
/// Number of bytes of the minimum number of rays of a surface.
pub const MIN_BYTES: usize = MAX_PARTS * (size_of::<RayHit>() + size_of::<[u32; 2]>());
/// Hit of a ray.
#[derive(Clone, Copy, Debug)]
struct RayHit {
    /// Leaf that was hit; [`NONE`] for a lamp, or for no hit.
    leaf: u32,
    /// Irradiance of the ray's origin, if all rays had this hit, relative to the leaf's radiosity; for fog, relative to its
    /// irradiance; for a lamp, in lx.
    share: f32,
    /// Normal at the hit, in 127ths.
    normal: [i8; 3],
    /// Normal at the ray's origin, in 127ths.
    origin_normal: [i8; 3],
    /// Part of the leaf. [`NO_PART`] for hits through a mirror, for fog and for lamps, which receive nothing through this ray.
    part: u8,
    /// Hit point, m; through a mirror, the mirrored point.
    target: [f32; 3],
    /// Expected number of rays along such ways, over the density of the cosine distribution and the area, 1/m2: from the ray's own
    /// leaf, and from the leaf that was hit.
    density: [f32; 2],
}

/// Weights of samples of a pair of leaves, which rays from either leaf can find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum MisHeuristic {
    /// Balance heuristic over the rays of both leaves.
    Balance,
    /// Only the leaf's own rays count, unless the other leaf's rays are denser by [`MIN_DENSITY_RATIO`]. Rays of the other leaf are
    /// not stratified here and add noise.
    Maximum,
}

impl MisHeuristic {
    /// Returns the rays per area by which a way's light is divided; 0: the way does not count.
    /// - `own`, `other`: densities from the leaf itself, and from the other end;
    /// - `is_own`: whether the leaf's own ray found the way.
    fn density(self, own: f32, other: f32, is_own: bool) -> f32 {
        match self {
            Self::Balance => own + other,
            Self::Maximum if is_own == (other <= MIN_DENSITY_RATIO * own) => {
                if is_own {
                    own
                } else {
                    other
                }
            }
            Self::Maximum => 0.0,
        }
    }
}

/// See [`RayHit::part`].
const NO_PART: u8 = u8::MAX;

/// A way along which light reaches a leaf.
#[derive(Clone, Copy, Debug)]
pub struct IncidentSegment {
    /// Point of the leaf, m.
    pub origin: Vec3A,
    /// Origin of the light, m; through a mirror, the mirrored point.
    pub target: Vec3A,
    /// Contribution to the leaf's mean irradiance, lx. The sum over all ways is an estimate of that.
    pub irradiance: f32,
    /// Number of ways in all directions, by the cosine distribution, if they were everywhere as dense as here.
    pub ray_count: f32,
}

/// Rays from all leaves of surfaces. Each ray measures the light that its origin receives from its end, and, if its end is a leaf,
/// the light that this leaf receives from the origin: light travels both ways. So the rays of either leaf may find a way between
/// them. Its light is divided by the expected number of rays along it from both leaves, or from those that count (multiple
/// importance sampling with the balance or the maximum heuristic, \[pharr2023\]). Leaves that send much light have more rays, which
/// find the surfaces that they light through a small gap. A share of the later rays goes in the directions from which earlier rays
/// have found light.
#[derive(Debug)]
pub struct Rays {
    /// Leaves by index.
    leaves: Vec<u32>,
    /// First ray by leaf, and the end.
    first: Vec<u32>,
    /// Round, an argument of [`generate_ray`].
    round: u32,
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
    /// Index of the ray, and of its leaf among the leaves. `None`: the leaf itself.
    ray: usize,
    origin: Option<usize>,
    part: usize,
    /// Contribution to the leaf's mean irradiance, lx.
    irradiance: Rgb,
    /// Number of ways if they were everywhere as dense as here; see [`IncidentSegment::ray_count`].
    ray_count: f32,
}

impl RayHit {
    const MISS: Self = Self {
        leaf: NONE,
        share: 0.0,
        normal: [0; 3],
        origin_normal: [0; 3],
        part: NO_PART,
        target: [0.0; 3],
        density: [0.0; 2],
    };
}

/// Returns the number of parts of a leaf from which rays begin.
fn part_count(element: &Element) -> usize {
    if element.node_count == 3 { 3 } else { MAX_PARTS }
}

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

impl RayPlan {
    /// Creates a plan without rays.
    pub fn empty() -> Self {
        Self { leaves: Vec::new(), first: vec![0], density: Vec::new(), round: 0 }
    }

    /// Plans the rays from all leaves.
    /// - `max_bytes`: maximum number of bytes of the rays. If it is too small, there are fewer rays, at least one from each part.
    /// - `round`: number of the round; each has different rays.
    /// - `needs_more_rays`: whether more rays are worth casting, because some must measure the light through portals.
    pub fn new(arena: &Arena, lights: &ElementLights, round: u32, max_bytes: usize, needs_more_rays: bool) -> Self {
        let leaves = ray_leaves(arena);
        let parts = MAX_PARTS * leaves.len().max(1);
        let fit = (max_bytes / ((size_of::<RayHit>() + size_of::<[u32; 2]>()) * parts)).max(1);
        let all = if needs_more_rays { TOTAL_RAYS_FOR_PORTALS } else { TOTAL_RAYS };
        let each = (all / parts).clamp(RAYS_PER_PART[0], RAYS_PER_PART[1]).min(fit);
        let more = (EXTRA_RAYS_RATIO * (parts * each) as f32).min(((fit - each) * parts) as f32);
        let power = |&leaf: &u32| {
            let element = &arena.elements[leaf as usize];
            element.size * luminance(lights.elements[leaf as usize].radiosity).max(0.0)
        };
        let whole: f32 = leaves.iter().map(power).sum();
        let by_power = |leaf: &u32| if whole > 0.0 { (more * (power(leaf) / whole)) as usize / MAX_PARTS } else { 0 };
        let mut first = vec![0u32];
        let mut density = vec![0.0f32; arena.elements.len()];
        for leaf in &leaves {
            let element = &arena.elements[*leaf as usize];
            let number = (part_count(element) * (each + by_power(leaf))) as u32;
            first.push(first[first.len() - 1] + number);
            density[*leaf as usize] = number as f32 / element.size;
        }
        Self { leaves, first, density, round }
    }

    /// Returns the range of the leaves of a block. The blocks have about equal numbers of rays.
    pub fn block_range(&self, block: u32, blocks: u32) -> Range<usize> {
        block_range(&self.first, block, blocks)
    }

    /// Creates the rays from the hits of all leaves in order.
    pub fn into_rays(self, parts: Vec<RayHits>) -> Rays {
        Rays::new(self.leaves, self.round, parts)
    }

    /// Checks that these are the hits of all leaves, in order.
    pub fn matches_hits(&self, arena: &Arena, parts: &[RayHits]) -> bool {
        let counts = parts.iter().flat_map(|part| &part.counts).copied();
        are_complete(arena, parts, self.leaves.len()) && counts.eq(self.first.windows(2).map(|ends| ends[1] - ends[0]))
    }

    /// Casts the rays of these leaves.
    /// - `aims`: guides for a share of the rays.
    pub fn cast(&self, scene: &Scene<'_>, arena: &Arena, aims: &Aims, part: Range<usize>) -> RayHits {
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
                        let (spot, dir, u) = generate_ray(scene, element, aims.get(leaf), ray, each, self.round);
                        if dir.dot(spot.normal) <= 0.0 {
                            return RayHit { origin_normal: pack_normal(spot.normal), ..RayHit::MISS };
                        }
                        let mut hit = trace_ray(scene, arena, &spot, dir, u, &mut tester);
                        hit.origin_normal = pack_normal(spot.normal);
                        hit.density[0] = density[leaf as usize] * aims.get(leaf).ratio(&spot, dir, each);
                        if hit.part != NO_PART {
                            let number = density[hit.leaf as usize];
                            let other = &arena.elements[hit.leaf as usize];
                            let normal = unpack_normal(hit.normal);
                            let spot = SurfaceSpot { position: Vec3A::from_array(hit.target), normal, ..spot };
                            let each = (number * other.size / part_count(other) as f32).round() as usize;
                            hit.density[1] = number * aims.get(hit.leaf).ratio(&spot, -dir, each);
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

/// Returns the leaves of surfaces from which rays begin, by index.
pub fn ray_leaves(arena: &Arena) -> Vec<u32> {
    let is_leaf = |index: &u32| {
        let element = &arena.elements[*index as usize];
        element.is_leaf() && matches!(element.kind, ElementKind::Patch | ElementKind::Curved)
    };
    (0..arena.elements.len() as u32).filter(is_leaf).collect()
}

/// Checks that hits are, in order, those of `leaves` leaves, and that the leaves that were hit exist.
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

impl Rays {
    /// Creates the rays from the hits of all leaves, in order.
    pub fn new(leaves: Vec<u32>, round: u32, parts: Vec<RayHits>) -> Self {
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
        let mut out =
            Self { leaves, first, round, hits: sights, incoming_start: Vec::new(), incoming: Vec::new(), traced };
        out.build_reverse_index();
        out
    }

    /// Returns the number of rays of a group of leaves.
    pub fn ray_count(&self, leaves: &[u32]) -> u32 {
        let of = |leaf: &u32| self.leaves.binary_search(leaf).map_or(0, |at| self.first[at + 1] - self.first[at]);
        leaves.iter().map(of).sum()
    }

    /// Builds the reverse index: the incoming rays of each leaf.
    fn build_reverse_index(&mut self) {
        let place = |sight: &RayHit| {
            let both = sight.part != NO_PART && sight.share > 0.0;
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

    /// Visits the ways along which light reaches the leaf at this index, with the current light: those of its own rays, then those
    /// of other leaves' rays that hit it.
    fn visit_samples(
        &self,
        (arena, lights): (&Arena, &ElementLights),
        leaf_index: usize,
        weights: MisHeuristic,
        mut each: impl FnMut(RaySample),
    ) {
        let element = &arena.elements[self.leaves[leaf_index] as usize];
        let [first, end] = [self.first[leaf_index], self.first[leaf_index + 1]].map(|at| at as usize);
        let parts = part_count(element);
        for (ray, sight) in self.hits[first..end].iter().enumerate() {
            let number = weights.density(sight.density[0], sight.density[1], true) * element.size;
            if number > 0.0 {
                let irradiance = received_irradiance(arena, lights, sight) * (1.0 / number);
                each(RaySample { ray: first + ray, origin: None, part: ray % parts, irradiance, ray_count: number });
            }
        }
        for &[origin, ray] in
            &self.incoming[self.incoming_start[leaf_index] as usize..self.incoming_start[leaf_index + 1] as usize]
        {
            let (ray, origin) = (ray as usize, origin as usize);
            let sight = &self.hits[ray];
            let number = weights.density(sight.density[1], sight.density[0], false) * element.size;
            if number > 0.0 {
                let leaf = self.leaves[origin];
                let irradiance =
                    radiosity(arena, lights, leaf, unpack_normal(sight.origin_normal)) * (sight.share / number);
                each(RaySample {
                    ray,
                    origin: Some(origin),
                    part: usize::from(sight.part),
                    irradiance,
                    ray_count: number,
                });
            }
        }
    }

    /// Returns the origin of a ray.
    fn ray_origin(&self, scene: &Scene<'_>, arena: &Arena, leaf_index: usize, ray: usize) -> SurfaceSpot {
        let element = &arena.elements[self.leaves[leaf_index] as usize];
        let [first, end] = [self.first[leaf_index], self.first[leaf_index + 1]].map(|at| at as usize);
        generate_ray(scene, element, &Aim::NONE, ray - first, (end - first) / part_count(element), self.round).0
    }

    /// Returns by leaf, in the order of their indices, the light of its ways, lm, and the sum of its squares.
    pub fn leaf_light(&self, arena: &Arena, lights: &ElementLights) -> Vec<(u32, [f32; 2])> {
        let of = |place: usize| {
            let leaf = self.leaves[place];
            let size = arena.elements[leaf as usize].size;
            let mut sums = [0.0f32; 2];
            self.visit_samples((arena, lights), place, MisHeuristic::Balance, |RaySample { irradiance, .. }| {
                let light = luminance(irradiance) * size;
                if light.is_finite() {
                    sums = [sums[0] + light, sums[1] + light * light];
                }
            });
            (leaf, sums)
        };
        (0..self.leaves.len()).into_par_iter().map(of).collect()
    }

    /// Returns the ways along which light reaches a leaf, with the current light.
    /// - `is_wanted`: filter on [`IncidentSegment::irradiance`] and [`IncidentSegment::ray_count`], applied before the ends of a
    ///   way are computed.
    pub fn incident_segments(
        &self,
        (scene, arena): (&Scene<'_>, &Arena),
        lights: &ElementLights,
        leaf: u32,
        is_wanted: impl Fn(f32, f32) -> bool,
    ) -> Vec<IncidentSegment> {
        let Ok(place) = self.leaves.binary_search(&leaf) else { return Vec::new() };
        let mut segments = Vec::new();
        self.visit_samples(
            (arena, lights),
            place,
            MisHeuristic::Balance,
            |RaySample { ray, origin, irradiance, ray_count: number, .. }| {
                let irradiance = luminance(irradiance);
                if !is_wanted(irradiance, number) {
                    return;
                }
                let begin = self.ray_origin(scene, arena, origin.unwrap_or(place), ray).position;
                let end = Vec3A::from_array(self.hits[ray].target);
                let [origin, target] = if origin.is_none() { [begin, end] } else { [end, begin] };
                segments.push(IncidentSegment { origin, target, irradiance, ray_count: number });
            },
        );
        segments
    }
}

/// Packs a unit vector in 127ths.
fn pack_normal(normal: Vec3A) -> [i8; 3] {
    (normal * 127.0).round().to_array().map(|x| x as i8)
}

fn unpack_normal(normal: [i8; 3]) -> Vec3A {
    Vec3A::from_array(normal.map(f32::from)).normalize_or_zero()
}

/// Returns the part of a leaf at a position in it.
fn leaf_part(element: &Element, local: Vec2) -> usize {
    if element.node_count == 3 {
        let weights = [1.0 - local.x - local.y, local.x, local.y];
        (1..3).fold(0, |best, k| if weights[k] > weights[best] { k } else { best })
    } else {
        usize::from(local.x >= 0.5) + 2 * usize::from(local.y >= 0.5)
    }
}

/// Returns the origin of a ray of a leaf, its direction, by the cosine distribution, and two further numbers in [0, 1). Successive
/// rays begin on the parts of the leaf in turn.
/// - `rays_per_part`: number of rays of a part;
/// - `round`: number of the round; each has different rays.
fn generate_ray(
    scene: &Scene<'_>,
    element: &Element,
    aim: &Aim,
    ray: usize,
    rays_per_part: usize,
    round: u32,
) -> (SurfaceSpot, Vec3A, [f32; 2]) {
    let surface = &scene.surfaces[element.surface as usize];
    let parts = part_count(element);
    let (part, turn) = (ray % parts, ray / parts);
    let mut numbers = RandomNumbers::new(&[element.key, 11, u64::from(round), part as u64]);
    let shift = [numbers.next(), numbers.next()];
    let mut numbers = RandomNumbers::new(&[element.key, 12, u64::from(round), ray as u64]);
    let mut local = Vec2::new(numbers.next(), numbers.next());
    if parts == 3 {
        // Each of three parts has the points nearest to one corner.
        if local.x + local.y > 1.0 {
            local = Vec2::ONE - local;
        }
        let mut weights = [1.0 - local.x - local.y, local.x, local.y];
        let most = (1..3).fold(0, |best, k| if weights[k] > weights[best] { k } else { best });
        weights.swap(most, part);
        local = Vec2::new(weights[1], weights[2]);
    } else {
        local = 0.5 * (local + Vec2::new((part % 2) as f32, (part / 2) as f32));
    }
    let spot = surface.point_at(element.outline.point_at(local));
    // Shifted lattices.
    let aimed = aim.number(rays_per_part);
    let (turn, of) = if turn < aimed { (turn, aimed) } else { (turn - aimed, rays_per_part - aimed) };
    let u = [(turn as f32 + shift[0]) / of as f32, (turn as f32 * 0.618_034 + shift[1]).fract()];
    if ray / parts < aimed
        && let Some(dir) = aim.sample(spot.position, numbers.next(), u)
    {
        return (spot, dir, [numbers.next(), numbers.next()]);
    }
    let dir = (warp::direction(1.0 - 2.0 * u[0], u[1]) + spot.normal).normalize_or(spot.normal);
    (spot, dir, [numbers.next(), numbers.next()])
}

/// Traces a ray to its hit: a surface that scatters, the fog, or a lamp seen through a mirror or refracting glass. Mirrors and
/// clear surfaces pass it on.
/// - `u`: numbers in [0, 1).
fn trace_ray(
    scene: &Scene<'_>,
    arena: &Arena,
    from: &SurfaceSpot,
    dir: Vec3A,
    u: [f32; 2],
    tester: &mut VisibilityTester,
) -> RayHit {
    let nothing = RayHit::MISS;
    let mut way = 0.0;
    let target = |way: f32| (from.position + dir * way).to_array();
    let prepared = scene.prepared;
    let mut numbers = RandomNumbers::new(&[u64::from(u[0].to_bits()), u64::from(u[1].to_bits())]);
    let mut ray = Ray {
        origin: offset_origin(from.position, from.error, from.normal, dir),
        dir,
        t_max: f32::INFINITY,
        time: SHUTTER_TIME,
    };
    let (mut share, mut is_bent, mut is_turned, mut is_inside) = (1.0f32, false, false, false);
    for _ in 0..=crate::visibility::MAX_CLEAR_SURFACES {
        tester.rays += 1;
        let hit = prepared.world.intersect(&ray);
        let length = hit.as_ref().map_or(f32::INFINITY, |hit| hit.t);
        let media = &prepared.media;
        if !media.is_empty()
            && !is_inside
            && media.find_intervals(ray.origin, ray.dir, length, &MediumStack::default(), &mut tester.media)
        {
            match media.sample_distance(&tester.media, f64::from(numbers.next()), numbers.next()) {
                DistanceSample::Scatter(event) => {
                    let leaf = arena.fog_at(ray.origin + ray.dir * event.t);
                    let (share, target) = (share * luminance(event.weight), target(way + event.t));
                    return leaf.map_or(nothing, |leaf| RayHit { leaf, share, target, ..nothing });
                }
                DistanceSample::Through { weight } => share *= luminance(weight),
            }
        }
        let Some(hit) = hit else { return nothing };
        way += length;
        let point = prepared.shading_point(&ray, &hit);
        let is_back = point.normal.dot(ray.dir) > 0.0;
        if is_bent && point.light != NONE {
            // Light that arrives without a change of direction is covered by the links with lamps.
            let (lights, world) = (&prepared.lights, &prepared.world);
            let lamp = (point.light, SHUTTER_TIME, point.normal, -ray.dir, point.parametric);
            let radiance = lights.radiance(world, &prepared.textures, lamp.0, lamp.1, lamp.2, lamp.3, lamp.4);
            if radiance != Rgb::ZERO {
                return RayHit { share: share * PI * luminance(radiance), target: target(way), ..nothing };
            }
        }
        let material = &prepared.materials[point.material as usize];
        let crossing = material.crossing[usize::from(is_back)];
        let straight_through = luminance(crossing.straight_through());
        if matches!(crossing, Crossing::Null { .. }) {
            share *= straight_through;
            ray.origin = offset_origin(point.position, point.error, point.normal, ray.dir);
            continue;
        }
        let mut specular_probability = 0.0;
        if material.bsdf.has_delta() {
            let towards_viewer = material.orientation == Orientation::TowardViewer;
            let normal = if is_back && towards_viewer { -point.normal } else { point.normal };
            let (frame, delta) = (Frame::from_normal(normal), material.bsdf.without_lambertian());
            let wo = frame.to_local(-ray.dir);
            let (reflected, transmitted) = material.bsdf.diffuse_albedos(MEAN_DIRECTION);
            let [sent, passed] = [reflected + transmitted, delta.albedo(wo)].map(luminance);
            specular_probability = if passed > 0.0 { passed / (passed + sent) } else { 0.0 };
            if numbers.next() < specular_probability {
                let Some(sample) = delta.sample(wo, [numbers.next(), numbers.next()], numbers.next()) else {
                    return nothing;
                };
                share *= luminance(sample.weight) / specular_probability;
                let is_through = sample.transmitted == Transmitted::Yes;
                let is_straight = sample.lobe == LobeKind::Delta && is_through && straight_through > 0.0;
                is_bent |= !is_straight;
                is_turned = true;
                is_inside ^= is_through && sample.eta != 1.0;
                let dir = frame.to_world(sample.wi).normalize_or(normal);
                let origin = offset_origin(point.position, point.error, point.normal, dir);
                ray = Ray { origin, dir, ..ray };
                continue;
            }
        }
        let surface = scene.sides[hit.instance as usize][hit.primitive as usize][usize::from(is_back)];
        if surface == NONE || arena.roots[surface as usize] == NONE || share <= 0.0 {
            return nothing;
        }
        let place = scene.surfaces[surface as usize].parameters(point.position, [hit.u, hit.v]);
        let (leaf, local) = arena.element_at(arena.roots[surface as usize], place, 0.0);
        let part = if is_turned { NO_PART } else { leaf_part(&arena.elements[leaf as usize], local) as u8 };
        let normal = if is_back { -point.normal } else { point.normal };
        let (share, normal) = (share / (1.0 - specular_probability), pack_normal(normal));
        return RayHit { leaf, share, normal, part, target: target(way), ..nothing };
    }
    nothing
}

/// Returns the irradiance of a ray's origin, if all rays had this hit, lx.
fn received_irradiance(arena: &Arena, lights: &ElementLights, hit: &RayHit) -> Rgb {
    if hit.leaf == NONE {
        return Rgb::splat(hit.share);
    }
    let light = &lights.elements[hit.leaf as usize];
    if arena.elements[hit.leaf as usize].kind == ElementKind::Volume {
        return Rgb::splat(hit.share * light.mean);
    }
    radiosity(arena, lights, hit.leaf, unpack_normal(hit.normal)) * hit.share
}

/// Returns the radiosity of a leaf of a surface, lx.
/// - `normal`: normal at the point, for a curved leaf.
fn radiosity(arena: &Arena, lights: &ElementLights, leaf: u32, normal: Vec3A) -> Rgb {
    let element = &arena.elements[leaf as usize];
    let radiosity = if element.kind == ElementKind::Curved {
        let of = |from: usize| lights.directional_irradiance(element, leaf as usize, from).cosine_integral(normal);
        element.reflectance * (of(FROM_LAMPS) + of(FROM_ELEMENTS))
    } else {
        lights.elements[leaf as usize].radiosity
    };
    radiosity.max(Rgb::ZERO)
}
