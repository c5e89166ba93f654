//! Shares of the targets by region.
//!
//! The samplers of directions, which are the targets and the BSDF, form a mixture. Expectation maximization (\[dempster1977\]) finds
//! its shares: the light that each direction found is divided among the samplers, and a sampler's new share is its part of the light.
//! The shares of a region also depend on those of the larger part of the surface that contains the region, and the shares of a surface
//! depend on those of the whole scene. The fewer directions a region has, the more they depend.

use crate::sums::{RegionSums, SumsByRegion};
use femc_field::{Cell, Field, NONE, PACK_TARGETS, RegionTargets, Split};
use std::collections::BTreeMap;
use std::ops::Range;

/// Number of directions whose weight the surroundings of a region have in its shares.
const PRIOR: f64 = 64.0;
/// Minimum number of directions of each half of a divided region, on average.
const MIN_DIRECTIONS: f64 = 128.0;
/// Maximum share of the directions toward targets, and toward patches. What a patch brings is known less well than what a gap brings:
/// pilot paths may have missed rare light from elsewhere, as of a caustic.
const MAX_SHARE: f64 = 0.9;
const MAX_PATCH_SHARE: f64 = 0.5;
/// Share of the directions for each new target, and for all.
const NEW_SHARES: [f64; 2] = [0.25, 0.5];
/// Share of a target below which it is not sampled.
const MIN_SHARE: f64 = 0.01;
/// Bounds of the ratio of the light of a region to that of the field.
const LIGHT_SCALES: [f64; 2] = [1.0 / 64.0, 64.0];

/// Shares of a region, and the ratio of its light to that of the field.
#[derive(Clone, Copy)]
struct Region {
    shares: [f64; PACK_TARGETS],
    light_scale: f64,
}

impl Default for Region {
    fn default() -> Self {
        Self { shares: [0.0; PACK_TARGETS], light_scale: 1.0 }
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

/// Sums of a part of the scene.
#[derive(Clone, Copy, Default)]
struct Part {
    count: f64,
    values: [f64; PACK_TARGETS + 1],
    /// Light that paths found, and the light of the field, both relative to the light expected.
    found: f64,
    field: f64,
}

impl Part {
    /// - `scale`: ratio of the light expected to that of the field.
    fn new(sums: &RegionSums, scale: f64) -> Self {
        let count = sums.count as f64;
        Self { count, values: sums.values(), found: sums.found(), field: count / scale }
    }

    fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.found += other.found;
        self.field += other.field;
        self.values.iter_mut().zip(other.values).for_each(|(sum, value)| *sum += value);
    }

    fn value(&self) -> f64 {
        self.values.iter().sum()
    }

    fn mean(&self) -> f64 {
        if self.count > 0.0 { self.value() / self.count } else { 0.0 }
    }

    /// Returns the shares of this part.
    /// - `around`: shares of the part around it;
    /// - `mean`: mean value of a direction there.
    fn region(&self, around: &Region, mean: f64) -> Region {
        let whole = PRIOR * mean + self.value();
        let share = |k: usize| (PRIOR * mean * around.shares[k] + self.values[k]) / whole;
        let shares = if whole > 0.0 { std::array::from_fn(share) } else { around.shares };
        let field = self.field / self.count.max(1.0);
        let light_scale = (PRIOR * field * around.light_scale + self.found) / ((PRIOR + self.count) * field);
        let light_scale = if self.count > 0.0 && light_scale.is_finite() { light_scale } else { around.light_scale };
        Region { shares, light_scale: light_scale.clamp(LIGHT_SCALES[0], LIGHT_SCALES[1]) }
    }
}

impl Shares {
    /// Computes the shares from the sums of a round.
    /// - `before`: shares of the round.
    pub fn new(field: &Field, sums: &SumsByRegion, before: &Self) -> Self {
        let part = |(leaf, sums): (&u32, &RegionSums)| Part::new(sums, before.light_scale(*leaf));
        // Halves come after the cell that contains them.
        let mut cells = vec![Part::default(); field.cells.len()];
        for (at, cell) in field.cells.iter().enumerate().rev() {
            let next = cell.next as usize;
            cells[at] = if cell.split == Split::None {
                sums.get_key_value(&cell.next).map_or(Part::default(), part)
            } else {
                let mut both = cells[next];
                both.add(&cells[next + 1]);
                both
            };
        }
        let mut whole = Part::default();
        sums.iter().for_each(|it| whole.add(&part(it)));
        let around = before.regions.first().copied().unwrap_or_default();
        let scene = whole.region(&around, whole.mean());
        let mut out = Self { regions: vec![scene], ..Self::default() };
        for &root in field.roots.iter().filter(|root| **root != NONE) {
            out.descend(field, &cells, root, &scene, whole.mean());
        }
        out
    }

    /// Returns the ratio of the light of a leaf's region to that of the field.
    fn light_scale(&self, leaf: u32) -> f64 {
        let region = self.by_leaf.get(&leaf).copied().unwrap_or(0);
        self.regions.get(region as usize).map_or(1.0, |region| region.light_scale)
    }

    /// Computes the shares of a cell and of its parts.
    fn descend(&mut self, field: &Field, parts: &[Part], cell: u32, around: &Region, mean: f64) {
        let part = &parts[cell as usize];
        if part.count == 0.0 {
            return;
        }
        let Cell { split, next, .. } = field.cells[cell as usize];
        let own = part.region(around, mean);
        if split != Split::None && part.count >= 2.0 * MIN_DIRECTIONS {
            for half in [next, next + 1] {
                self.descend(field, parts, half, &own, part.mean());
            }
            return;
        }
        let region = self.regions.len() as u32;
        self.regions.push(own);
        let mut below = vec![cell];
        while let Some(cell) = below.pop() {
            let Cell { split, next, .. } = field.cells[cell as usize];
            match split {
                Split::None => _ = self.by_leaf.insert(next, region),
                _ => below.extend([next, next + 1]),
            }
        }
    }

    /// Replaces the targets by others.
    /// - `before`, `after`: opening of each target;
    /// - `new`: openings that had no targets before.
    pub fn replace(&mut self, before: &[usize], after: &[usize], new: Range<usize>) {
        let whole = NEW_SHARES[1].min(NEW_SHARES[0] * new.len() as f64);
        let count = |opening: usize| after.iter().filter(|it| **it == opening).count() as f64;
        for region in &mut self.regions {
            let old = region.shares;
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
        let by_region = self.regions.iter().map(|Region { shares, light_scale }| {
            let mut kept = shares.map(|share| if share < MIN_SHARE { 0.0 } else { share });
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
        let region = Region { shares: of_region, light_scale: 2.0 };
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
        let patches = targets(|k| k >= 2);
        assert!((patches.shares[2] - 0.5 / 3.0).abs() < 1e-6 && (patches.shares[0] - 0.2).abs() < 1e-6, "{patches:?}");
    }

    /// Half of the directions go to one target and find four times the light that the field expects. The other directions come from
    /// the BSDF and find no light.
    #[test]
    fn shares_and_light_follow_what_directions_found() {
        let mut sums = RegionSums::default();
        for k in 0..1000 {
            let mut parts = [0.0; PACK_TARGETS + 1];
            parts[if k % 2 == 0 { 1 } else { PACK_TARGETS }] = 1.0;
            let light = if k % 2 == 0 { 4.0 } else { 0.0 };
            sums.add_direction(light, light, parts);
        }
        let part = Part::new(&sums, 1.0);
        let around = Region { shares: [0.1, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], light_scale: 1.0 };
        let Region { shares, light_scale } = part.region(&around, part.mean());
        assert!((shares[1] - (64.0 * 0.1 + 1000.0) / 1064.0).abs() < 1e-6, "{shares:?}");
        assert!((light_scale - (64.0 + 2000.0) / 1064.0).abs() < 1e-6, "{light_scale}");
        // The light was expected with a factor of 4: the field has a quarter of the light expected.
        let corrected = Part::new(&sums, 4.0).region(&Region { light_scale: 4.0, ..around }, 1.0);
        assert!((corrected.light_scale - (64.0 * 0.25 * 4.0 + 2000.0) / (1064.0 * 0.25)).abs() < 1e-6);
        assert_eq!(Part::default().region(&around, 1.0).shares, around.shares);
    }
}
