//! Sums over pilot paths by the place that they reached: integers, so that blocks of paths add up to the same bits in any order.

use femc_field::Ball;
use femc_geometry::Aabb;
use femc_math::glam::Vec3A;
use std::collections::BTreeMap;

/// Largest value of a direction, relative to the light that the field expects.
pub const MAX_VALUE: f32 = 1024.0;
/// Steps of a value in sums.
const STEPS: f32 = (1u32 << 20) as f32;

/// Sums over the directions that reached a place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlaceSums {
    /// Number of directions.
    pub count: u64,
    /// Light that comes from there to the picture, relative to the light expected of each path: the estimate, and what the paths
    /// found. Steps of 2^-20.
    light: [i64; 2],
    /// Sum of the squares of the light that the paths found. Steps of 2^-20.
    squares: i64,
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
        self.squares = self.squares.saturating_add((steps(light[1]) >> 10).pow(2));
        self.chance = self.chance.saturating_add(steps(chance));
    }

    /// Returns the sum of both.
    pub fn with(&self, other: &Self) -> Self {
        Self {
            count: self.count + other.count,
            light: [0, 1].map(|k| self.light[k].saturating_add(other.light[k])),
            squares: self.squares.saturating_add(other.squares),
            chance: self.chance.saturating_add(other.chance),
        }
    }

    /// Returns the sums without a part of them.
    pub fn without(&self, part: &Self) -> Self {
        Self {
            count: self.count - part.count,
            light: [0, 1].map(|k| self.light[k] - part.light[k]),
            squares: self.squares - part.squares,
            chance: self.chance - part.chance,
        }
    }

    /// Returns the light, relative: the lesser sum. Where the field is wrong, the estimate is too large; a rare path can find too
    /// much.
    pub fn light(&self) -> f64 {
        self.light[0].min(self.light[1]) as f64 / f64::from(STEPS)
    }

    /// Returns the number of directions of equal light that would have this much variance. Few bright ones count little.
    pub fn effective_count(&self) -> f64 {
        let light = self.light[1] as f64 / f64::from(STEPS);
        if self.squares > 0 { light * light / (self.squares as f64 / f64::from(STEPS)) } else { 0.0 }
    }

    /// Returns the light by chance, relative.
    pub fn chance(&self) -> f64 {
        self.chance as f64 / f64::from(STEPS)
    }
}

/// Sums by leaf, and bin in it, that directions reached.
pub type SumsByBin = BTreeMap<(u32, u32), PlaceSums>;

/// Number of steps of a position along each axis of a scene.
const GRID_STEPS: f32 = (1u32 << 16) as f32;
/// Number of halvings from the scene to a voxel.
pub const VOXEL_LEVELS: u32 = 8;

/// Integer positions in a scene, in steps of 2^-16 of its largest extent.
#[derive(Clone, Copy, Debug)]
pub struct PositionGrid {
    origin: Vec3A,
    /// Length of a step, m.
    step: f32,
}

impl PositionGrid {
    /// - `bounds`: bounds of the scene, m.
    pub fn new(bounds: Aabb) -> Self {
        Self { origin: bounds.min, step: bounds.size().max_element().max(f32::MIN_POSITIVE) / GRID_STEPS }
    }

    /// Returns the largest extent of the scene, m.
    pub fn extent(&self) -> f32 {
        self.step * GRID_STEPS
    }

    fn steps(&self, position: Vec3A) -> [i64; 3] {
        let steps = (position - self.origin) / self.step;
        // A conversion of NaN gives 0.
        [0, 1, 2].map(|axis| (steps[axis].clamp(0.0, GRID_STEPS - 1.0)) as i64)
    }

    /// Returns the number of the voxel at a position, with three bits for each halving, the first one highest.
    pub fn voxel(&self, position: Vec3A) -> u32 {
        let steps = self.steps(position);
        (0..VOXEL_LEVELS).fold(0, |voxel, level| {
            let bits = (0..3).map(|axis| ((steps[axis] >> (15 - level) & 1) as u32) << axis).sum::<u32>();
            voxel << 3 | bits
        })
    }

    /// Returns the ball around the light: with its mean position and, as radius, the root mean square distance from it. `None`: there
    /// is no light.
    pub fn ball(&self, sums: &VoxelSums) -> Option<Ball> {
        let weight = sums.weight as f64;
        let middle = sums.offsets.map(|sum| sum as f64 / weight);
        let square = sums.squares as f64 / weight - middle.iter().map(|at| at * at).sum::<f64>();
        let center = Vec3A::from(middle.map(|at| at as f32)) * self.step + self.origin;
        let radius = (square.max(1.0).sqrt() as f32) * self.step;
        (sums.weight > 0).then_some(Ball { center, radius })
    }
}

/// Sums over the directions that reached a voxel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct VoxelSums {
    /// Sums as for any place.
    pub place: PlaceSums,
    /// Light that the paths found; its sums times positions by axis, and times squared positions. Steps of 2^-10 and of the grid.
    weight: i64,
    offsets: [i64; 3],
    squares: i128,
}

impl VoxelSums {
    /// Adds a direction to a position, as [`PlaceSums::add_direction`].
    pub fn add_direction(&mut self, grid: &PositionGrid, end: Vec3A, light: [f32; 2], chance: f32) {
        self.place.add_direction(light, chance);
        let weight = (light[1].clamp(0.0, MAX_VALUE) * 1024.0) as i64;
        let steps = grid.steps(end);
        self.weight += weight;
        (0..3).for_each(|axis| self.offsets[axis] += weight * steps[axis]);
        self.squares += i128::from(weight) * i128::from(steps.iter().map(|at| at * at).sum::<i64>());
    }

    /// Returns the sum of both.
    pub fn with(&self, other: &Self) -> Self {
        Self {
            place: self.place.with(&other.place),
            weight: self.weight + other.weight,
            offsets: [0, 1, 2].map(|axis| self.offsets[axis] + other.offsets[axis]),
            squares: self.squares + other.squares,
        }
    }
}

/// Sums by voxel that directions reached.
pub type SumsByVoxel = BTreeMap<u32, VoxelSums>;

#[cfg(test)]
mod tests {
    use super::*;
    use femc_math::hash::{mix64, unit_f32};

    #[test]
    fn sums_of_blocks_are_those_of_all_directions_in_any_order() {
        let number = |k: u64| 3.0 * unit_f32((mix64(k) >> 32) as u32);
        let grid = PositionGrid::new(Aabb { min: Vec3A::ZERO, max: Vec3A::splat(3.0) });
        let sums = |directions: &mut dyn Iterator<Item = u64>| {
            let mut sums = VoxelSums::default();
            for k in directions {
                let [a, b, c, x, y, z] = [0, 1, 2, 3, 4, 5].map(|at| number(6 * k + at));
                sums.add_direction(&grid, Vec3A::new(x, y, z), [a, b], c);
            }
            sums
        };
        let whole = sums(&mut (0..1000));
        let [most, others] = [sums(&mut (300..1000).rev()), sums(&mut (0..300))];
        assert_eq!(most.with(&others), whole);
        assert_eq!(whole.place.without(&others.place), most.place);
        assert!((whole.place.light() / 1000.0 - 1.5).abs() < 0.1, "{whole:?}");
        // Values that are evenly spread over 0..3 have a mean square of 3 and a square mean of 2.25.
        assert!((whole.place.effective_count() / 750.0 - 1.0).abs() < 0.05, "{whole:?}");
    }

    #[test]
    fn values_that_are_not_numbers_or_endless_do_not_spoil_sums() {
        let mut place = PlaceSums::default();
        place.add_direction([f32::NAN, 1.0], f32::NAN);
        place.add_direction([f32::INFINITY, 1.0], f32::INFINITY);
        assert_eq!((place.count, place.light(), place.chance()), (2, 2.0, 1024.0));
    }
}
