//! Sums over pilot paths by region: integers, so that blocks of paths add up to the same bits in any order.

use femc_field::PACK_TARGETS;
use std::collections::BTreeMap;

/// Largest value of a direction, relative to the light that the field expects.
pub const MAX_VALUE: f32 = 1024.0;
/// Steps of a value in sums.
const STEPS: f32 = (1u32 << 20) as f32;

/// Sums over the directions that paths took from a region.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RegionSums {
    /// Number of directions.
    pub count: u64,
    /// Values by sampler: of each target, and of the BSDF. Each direction is divided among the samplers by the probabilities that
    /// they sampled it. Steps of 2^-20.
    values: [i64; PACK_TARGETS + 1],
    /// Light that the paths found, relative to the light expected. Steps of 2^-20.
    found: i64,
}

impl RegionSums {
    /// Adds a direction.
    /// - `value`: estimate of the light along it, relative to the light expected;
    /// - `found`: light that the path found, relative to the light expected;
    /// - `parts`: probability by sampler that it sampled the direction; targets, then the BSDF. They sum to 1.
    pub fn add_direction(&mut self, value: f32, found: f32, parts: [f32; PACK_TARGETS + 1]) {
        self.count += 1;
        let [value, found] = [value, found].map(|value| value.clamp(0.0, MAX_VALUE));
        self.found = self.found.saturating_add((found * STEPS) as i64);
        for (sum, part) in self.values.iter_mut().zip(parts) {
            // A conversion of NaN gives 0.
            *sum = sum.saturating_add((value * part * STEPS) as i64);
        }
    }

    /// Adds other sums.
    pub fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.found = self.found.saturating_add(other.found);
        self.values.iter_mut().zip(other.values).for_each(|(sum, value)| *sum = sum.saturating_add(value));
    }

    /// Returns the sum of the light that the paths found, relative to the light expected.
    pub fn found(&self) -> f64 {
        self.found as f64 / f64::from(STEPS)
    }

    /// Returns the values by sampler: targets, then the BSDF.
    pub fn values(&self) -> [f64; PACK_TARGETS + 1] {
        self.values.map(|value| value as f64 / f64::from(STEPS))
    }
}

/// Sums by region, for regions with directions.
pub type SumsByRegion = BTreeMap<u32, RegionSums>;

/// Sums over the directions that reached a place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlaceSums {
    /// Number of directions.
    pub count: u64,
    /// Light that comes from there to the picture, relative to the light expected of each path: the estimate, and what the paths
    /// found. Steps of 2^-20.
    light: [i64; 2],
    /// Light that would come from there if light were even: that of the vertices where directions of the BSDF began. Steps of 2^-20.
    chance: i64,
}

impl PlaceSums {
    /// Adds a direction.
    /// - `light`: estimate of the light along it and light that the path found, relative to the light expected of the path;
    /// - `chance`: light of all directions of its vertex, relative to the same, if the BSDF sampled it; else a part.
    pub fn add_direction(&mut self, light: [f32; 2], chance: f32) {
        self.count += 1;
        let steps = |value: f32| (value.clamp(0.0, MAX_VALUE) * STEPS) as i64;
        self.light = [0, 1].map(|k| self.light[k].saturating_add(steps(light[k])));
        self.chance = self.chance.saturating_add(steps(chance));
    }

    /// Returns the sum of both.
    pub fn with(&self, other: &Self) -> Self {
        Self {
            count: self.count + other.count,
            light: [0, 1].map(|k| self.light[k].saturating_add(other.light[k])),
            chance: self.chance.saturating_add(other.chance),
        }
    }

    /// Returns the sums without a part of them.
    pub fn without(&self, part: &Self) -> Self {
        Self {
            count: self.count - part.count,
            light: [0, 1].map(|k| self.light[k] - part.light[k]),
            chance: self.chance - part.chance,
        }
    }

    /// Returns the light, relative: the lesser sum. Where the field is wrong, the estimate is too large; a rare path can find too
    /// much.
    pub fn light(&self) -> f64 {
        self.light[0].min(self.light[1]) as f64 / f64::from(STEPS)
    }

    /// Returns the light by chance, relative.
    pub fn chance(&self) -> f64 {
        self.chance as f64 / f64::from(STEPS)
    }
}

/// Sums by region that directions reached.
pub type SumsByPlace = BTreeMap<u32, PlaceSums>;

#[cfg(test)]
mod tests {
    use super::*;
    use femc_math::hash::{mix64, unit_f32};

    #[test]
    fn sums_of_blocks_are_those_of_all_directions_in_any_order() {
        let number = |k: u64| 3.0 * unit_f32((mix64(k) >> 32) as u32);
        let sums = |directions: &mut dyn Iterator<Item = u64>| {
            let (mut region, mut place) = (RegionSums::default(), PlaceSums::default());
            for k in directions {
                let mut parts = [0.0; PACK_TARGETS + 1];
                (parts[k as usize % 8], parts[PACK_TARGETS]) = (0.25, 0.75);
                region.add_direction(number(4 * k), number(4 * k + 1), parts);
                place.add_direction([number(4 * k), number(4 * k + 1)], number(4 * k + 2));
            }
            (region, place)
        };
        let whole = sums(&mut (0..1000));
        let [(mut region, place), (more, others)] = [sums(&mut (300..1000).rev()), sums(&mut (0..300))];
        region.add(&more);
        assert_eq!((region, place.with(&others)), whole);
        assert_eq!(whole.1.without(&others), place);
        let mean = region.values().iter().sum::<f64>() / 1000.0;
        assert!((mean - 1.5).abs() < 0.1 && (region.found() / 1000.0 - 1.5).abs() < 0.1, "{mean}");
    }

    #[test]
    fn values_that_are_not_numbers_or_endless_do_not_spoil_sums() {
        let mut sums = RegionSums::default();
        let parts = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        sums.add_direction(f32::NAN, f32::INFINITY, parts);
        sums.add_direction(f32::INFINITY, f32::NAN, parts);
        assert_eq!((sums.count, sums.values().iter().sum::<f64>(), sums.found()), (2, 1024.0, 1024.0));
        let mut place = PlaceSums::default();
        place.add_direction([f32::NAN, 1.0], f32::NAN);
        assert_eq!((place.count, place.light(), place.chance()), (1, 0.0, 0.0));
    }
}
