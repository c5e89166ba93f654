//! Shares of the targets by region.
//!
//! The samplers of directions, which are the targets and the BSDF, form a mixture. Expectation maximization (\[dempster1977\]) finds
//! its shares: the light of each direction is divided among the samplers by their densities, and a sampler's new share is its part of
//! the light. The shares of the whole scene are computed first, then those of surfaces, then those of their parts. The result for a
//! part is averaged with the shares of the part that contains it. The latter count as much as 64 directions.

use femc_field::{Cell, Field, NONE, PACK_TARGETS, RegionTargets, Split};
use femc_math::elementary::ln;
use std::collections::BTreeMap;
use std::ops::Range;

/// Number of steps of the expectation maximization.
const STEPS: u32 = 3;
/// Number of directions whose weight the surroundings of a region have in its shares.
const PRIOR: f64 = 64.0;
/// Minimum number of directions of each half of a divided region, on average.
const MIN_DIRECTIONS: f64 = 128.0;
/// Maximum share of the directions toward targets, and toward patches. What a patch brings is known less well than what a gap brings:
/// pilot paths may have missed rare light from elsewhere, as of a caustic.
const MAX_SHARE: f64 = 0.9;
const MAX_PATCH_SHARE: f64 = 0.8;
/// Share of the directions for each new target, and for all.
const NEW_SHARES: [f64; 2] = [0.25, 0.5];
/// Share of a target below which it is not sampled.
const MIN_SHARE: f64 = 0.01;
/// Gain of a region below which its directions are not guided, nats. Guiding costs about as much as a ray.
const MIN_REGION_GAIN: f64 = 0.05;
/// Gain of new targets. They must be tried.
const NEW_GAIN: f64 = 1.0;
/// Bounds of the ratio of the light of a region to that of the field.
const LIGHT_SCALES: [f64; 2] = [1.0 / 64.0, 64.0];

/// Shares of a region, and the ratio of its light to that of the field.
#[derive(Clone, Copy)]
struct Region {
    shares: [f64; PACK_TARGETS],
    /// Mean logarithm of the ratio of the density of directions with these shares to that of the BSDF, by light.
    gain: f64,
    light_scale: f64,
}

impl Default for Region {
    fn default() -> Self {
        Self { shares: [0.0; PACK_TARGETS], gain: 0.0, light_scale: 1.0 }
    }
}

/// Shares of the targets by region.
#[derive(Default)]
pub struct Shares {
    /// Shares of the whole scene, then of regions.
    regions: Vec<Region>,
    /// Regions by leaf, for leaves of surfaces that paths reached.
    by_leaf: BTreeMap<u32, u32>,
}

/// A direction that a path took from a region.
#[derive(Clone, Copy, Debug)]
pub struct DirectionRecord {
    /// Index of the region.
    pub region: u32,
    /// Estimate of the light along it, relative to the light expected along all directions.
    pub value: f32,
    /// Light that the path found along it, relative to the same.
    pub found: f32,
    /// Densities by sampler, targets, then the BSDF, relative to the density of all together.
    pub ratios: [f32; PACK_TARGETS + 1],
    /// Share of the region's directions toward targets that the surface takes: gloss is not guided.
    pub guided: f32,
}

impl DirectionRecord {
    /// Returns the density with other shares of targets, relative to the density of all together.
    fn density(&self, shares: &[f64; PACK_TARGETS]) -> f64 {
        let ratios = self.ratios.map(f64::from);
        let guided = f64::from(self.guided);
        let targets = shares.iter().zip(ratios).map(|(share, ratio)| share * ratio).sum::<f64>();
        (1.0 - guided * shares.iter().sum::<f64>()) * ratios[PACK_TARGETS] + guided * targets
    }
}

/// Directions of a part of the scene: neighbors among all directions in the order of leaves ([`leaf_ranks`]).
#[derive(Clone, Default)]
struct Part {
    range: Range<usize>,
    /// Light that paths found, and the light of the field, both relative to the light expected.
    found: f64,
    field: f64,
}

impl Part {
    /// Returns the part that consists of this part and the next one.
    fn with_next(&self, next: &Self) -> Self {
        let range = match (self.range.is_empty(), next.range.is_empty()) {
            (true, _) => next.range.clone(),
            (false, true) => self.range.clone(),
            (false, false) => self.range.start..next.range.end,
        };
        Self { range, found: self.found + next.found, field: self.field + next.field }
    }

    fn count(&self) -> f64 {
        self.range.len() as f64
    }

    /// Returns the shares of this part.
    /// - `around`: shares of the part around it.
    fn region(&self, all: &[DirectionRecord], around: &Region) -> Region {
        let count = self.count();
        if count == 0.0 {
            return *around;
        }
        let own_records = &all[self.range.clone()];
        let fitted = fit_shares(own_records, &around.shares);
        let own = count / (count + PRIOR);
        let shares = std::array::from_fn(|k| around.shares[k] + own * (fitted[k] - around.shares[k]));
        let field = self.field / count;
        let light_scale = (PRIOR * field * around.light_scale + self.found) / ((PRIOR + count) * field);
        let light_scale = if light_scale.is_finite() { light_scale } else { around.light_scale };
        let gain = gain(own_records, &shares).map_or(around.gain, |gain| around.gain + own * (gain - around.gain));
        Region { shares, gain, light_scale: light_scale.clamp(LIGHT_SCALES[0], LIGHT_SCALES[1]) }
    }
}

/// Returns the gain of shares for directions. `None`: no direction found light.
fn gain(records: &[DirectionRecord], shares: &[f64; PACK_TARGETS]) -> Option<f64> {
    let [mut light, mut sum] = [0.0; 2];
    for record in records {
        let ratio = record.density(shares) / f64::from(record.ratios[PACK_TARGETS]);
        if ratio > 0.0 && ratio.is_finite() {
            light += f64::from(record.value);
            sum += f64::from(record.value) * f64::from(ln(ratio as f32));
        }
    }
    (light > 0.0).then(|| sum / light)
}

/// Returns the shares of targets whose density follows the light of directions best.
/// - `start`: shares from which the search begins.
fn fit_shares(records: &[DirectionRecord], start: &[f64; PACK_TARGETS]) -> [f64; PACK_TARGETS] {
    let mut shares = *start;
    for _ in 0..STEPS {
        let mut sums = [0.0; PACK_TARGETS + 1];
        for record in records {
            let weight = f64::from(record.value) / record.density(&shares) * f64::from(record.guided);
            if weight > 0.0 && weight.is_finite() {
                sums.iter_mut().zip(record.ratios).for_each(|(sum, ratio)| *sum += weight * f64::from(ratio));
            }
        }
        sums[PACK_TARGETS] *= 1.0 - shares.iter().sum::<f64>();
        sums.iter_mut().zip(shares).for_each(|(sum, share)| *sum *= share);
        let whole = sums.iter().sum::<f64>();
        if !(whole > 0.0 && whole.is_finite()) {
            break;
        }
        shares = std::array::from_fn(|k| sums[k] / whole);
    }
    shares
}

/// Visits the leaves of a cell in order.
fn visit_leaves(field: &Field, cell: u32, visit: &mut impl FnMut(u32)) {
    let mut below = vec![cell];
    while let Some(cell) = below.pop() {
        let Cell { split, next, .. } = field.cells[cell as usize];
        match split {
            Split::None => visit(next),
            _ => below.extend([next + 1, next]),
        }
    }
}

/// Returns the rank of each leaf. The leaves of a cell have successive ranks.
fn leaf_ranks(field: &Field) -> Vec<u32> {
    let mut ranks = vec![u32::MAX; field.leaves.len()];
    let mut rank = 0;
    for &root in field.roots.iter().filter(|root| **root != NONE) {
        visit_leaves(field, root, &mut |leaf| {
            ranks[leaf as usize] = rank;
            rank += 1;
        });
    }
    ranks
}

impl Shares {
    /// Computes the shares from the directions of a round.
    /// - `records`: the directions; each region is a leaf of the field;
    /// - `before`: shares with which the round sampled.
    pub fn new(field: &Field, mut records: Vec<DirectionRecord>, before: &Self) -> Self {
        let ranks = leaf_ranks(field);
        records.sort_by_key(|record| ranks[record.region as usize]);
        let mut leaves: BTreeMap<u32, Part> = BTreeMap::new();
        let mut whole = Part::default();
        for own in records.chunk_by(|a, b| a.region == b.region) {
            let region = own[0].region;
            let range = whole.range.end..whole.range.end + own.len();
            let found = own.iter().map(|record| f64::from(record.found)).sum();
            let part = Part { range, found, field: own.len() as f64 / before.light_scale(region) };
            whole = whole.with_next(&part);
            leaves.insert(region, part);
        }
        // Halves come after the cell that contains them.
        let mut cells = vec![Part::default(); field.cells.len()];
        for (at, cell) in field.cells.iter().enumerate().rev() {
            let next = cell.next as usize;
            cells[at] = if cell.split == Split::None {
                leaves.remove(&cell.next).unwrap_or_default()
            } else {
                cells[next].with_next(&cells[next + 1])
            };
        }
        let around = before.regions.first().copied().unwrap_or_default();
        let scene = whole.region(&records, &around);
        let mut out = Self { regions: vec![scene], ..Self::default() };
        for &root in field.roots.iter().filter(|root| **root != NONE) {
            out.descend(field, &records, &cells, root, &scene);
        }
        out
    }

    /// Returns the ratio of the light of a leaf's region to that of the field.
    fn light_scale(&self, leaf: u32) -> f64 {
        let region = self.by_leaf.get(&leaf).copied().unwrap_or(0);
        self.regions.get(region as usize).map_or(1.0, |region| region.light_scale)
    }

    /// Computes the shares of a cell and of its parts.
    fn descend(&mut self, field: &Field, records: &[DirectionRecord], parts: &[Part], cell: u32, around: &Region) {
        let part = &parts[cell as usize];
        if part.range.is_empty() {
            return;
        }
        let Cell { split, next, .. } = field.cells[cell as usize];
        let own = part.region(records, around);
        if split != Split::None && part.count() >= 2.0 * MIN_DIRECTIONS {
            for half in [next, next + 1] {
                self.descend(field, records, parts, half, &own);
            }
            return;
        }
        let region = self.regions.len() as u32;
        self.regions.push(own);
        visit_leaves(field, cell, &mut |leaf| _ = self.by_leaf.insert(leaf, region));
    }

    /// Replaces the targets by others.
    /// - `before`, `after`: opening of each target;
    /// - `new`: openings that had no targets before.
    pub fn replace(&mut self, before: &[usize], after: &[usize], new: Range<usize>) {
        let whole = NEW_SHARES[1].min(NEW_SHARES[0] * new.len() as f64);
        let count = |opening: usize| after.iter().filter(|it| **it == opening).count() as f64;
        for region in &mut self.regions {
            let old = region.shares;
            region.gain = NEW_GAIN;
            let scale = ((MAX_SHARE - whole) / old.iter().sum::<f64>().max(f64::MIN_POSITIVE)).min(1.0);
            let of_opening =
                |opening: usize| before.iter().zip(old).filter(|it| *it.0 == opening).map(|it| it.1).sum::<f64>();
            region.shares = [0.0; PACK_TARGETS];
            for (share, &opening) in region.shares.iter_mut().zip(after) {
                let all = if new.contains(&opening) { whole / new.len() as f64 } else { scale * of_opening(opening) };
                *share = all / count(opening);
            }
        }
    }

    /// Returns the targets by region, and the region by leaf.
    /// - `leaves`: number of leaves of the field;
    /// - `is_patch`: whether a target is part of a patch.
    pub fn regions(&self, leaves: usize, is_patch: impl Fn(usize) -> bool) -> (Vec<RegionTargets>, Vec<u32>) {
        let mut by_leaf = vec![0; leaves];
        self.by_leaf.iter().for_each(|(&leaf, &region)| by_leaf[leaf as usize] = region);
        let by_region = self.regions.iter().map(|Region { shares, gain, light_scale }| {
            let is_sampled = |share| share >= MIN_SHARE && *gain >= MIN_REGION_GAIN;
            let mut kept = shares.map(|share| if is_sampled(share) { share } else { 0.0 });
            let patches: f64 = (0..PACK_TARGETS).filter(|&k| is_patch(k)).map(|k| kept[k]).sum();
            let scale = (MAX_PATCH_SHARE / patches.max(f64::MIN_POSITIVE)).min(1.0);
            (0..PACK_TARGETS).filter(|&k| is_patch(k)).for_each(|k| kept[k] *= scale);
            let scale = (MAX_SHARE / kept.iter().sum::<f64>().max(f64::MIN_POSITIVE)).min(1.0);
            let shares = kept.map(|share| (share * scale) as f32);
            RegionTargets { pack: 0, shares, light_scale: *light_scale as f32 }
        });
        (by_region.collect(), by_leaf)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::array;

    /// Shares with one region besides that of the scene.
    fn shares(of_region: [f64; PACK_TARGETS]) -> Shares {
        let region = Region { shares: of_region, light_scale: 2.0, gain: 1.0 };
        Shares { regions: vec![Region::default(), region], by_leaf: BTreeMap::from([(3, 1)]) }
    }

    #[test]
    fn the_shares_of_an_opening_stay_when_others_are_found() {
        let mut shares = shares([0.2, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        // Two parts of one opening become one, and another opening gets three parts.
        shares.replace(&[0, 0], &[0, 1, 1, 1], 1..2);
        let [scene, region] = [0, 1].map(|k| shares.regions[k].shares);
        assert!((region[0] - 0.3).abs() < 1e-12 && (region[1..4].iter().sum::<f64>() - 0.25).abs() < 1e-12);
        assert!(scene[0] == 0.0 && (scene[1..4].iter().sum::<f64>() - 0.25).abs() < 1e-12, "{scene:?}");
    }

    #[test]
    fn shares_toward_targets_and_patches_are_limited() {
        let targets = |is_patch: fn(usize) -> bool| {
            let (regions, by_leaf) = shares(array::from_fn(|k| if k < 5 { 0.2 } else { 0.001 })).regions(5, is_patch);
            assert_eq!((by_leaf, regions[1].light_scale), (vec![0, 0, 0, 1, 0], 2.0));
            regions[1]
        };
        let all = shares([0.0; PACK_TARGETS]);
        assert_eq!(
            [3, 4].map(|leaf| all.light_scale(leaf)),
            [2.0, 1.0],
            "leaves without paths have the light of the scene"
        );
        assert_eq!(Shares::default().light_scale(3), 1.0);
        let openings = targets(|_| false);
        assert!((openings.share() - 0.9).abs() < 1e-6 && openings.shares[7] == 0.0, "{openings:?}");
        let patches = targets(|_| true);
        assert!(patches.shares[..5].iter().all(|share| (share - 0.16).abs() < 1e-6), "{patches:?}");
    }

    /// Half of the directions go to one target and find four times the light that the field expects. The other directions come from
    /// the BSDF and find no light.
    #[test]
    fn shares_and_light_follow_what_directions_found() {
        let record = |k: u32| {
            let mut ratios = [0.0; PACK_TARGETS + 1];
            ratios[if k.is_multiple_of(2) { 1 } else { PACK_TARGETS }] = 2.0;
            let light = if k.is_multiple_of(2) { 4.0 } else { 0.0 };
            DirectionRecord { region: 3, value: light, found: light, ratios, guided: 1.0 }
        };
        let records: Vec<DirectionRecord> = (0..1000).map(record).collect();
        let part = Part { range: 0..1000, found: 2000.0, field: 1000.0 };
        let around = Region { shares: [0.1, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], ..Region::default() };
        let Region { shares, light_scale, .. } = part.region(&records, &around);
        assert!((shares[1] - (64.0 * 0.1 + 1000.0) / 1064.0).abs() < 1e-6, "{shares:?}");
        assert!((light_scale - (64.0 + 2000.0) / 1064.0).abs() < 1e-6, "{light_scale}");
        // The light was expected with a factor of 4: the field has a quarter of the light expected.
        let part = Part { field: 250.0, ..part };
        let corrected = part.region(&records, &Region { light_scale: 4.0, ..around });
        assert!((corrected.light_scale - (64.0 * 0.25 * 4.0 + 2000.0) / (1064.0 * 0.25)).abs() < 1e-6);
        assert_eq!(Part::default().region(&records, &around).shares, around.shares);
    }
}
