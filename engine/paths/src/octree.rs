//! Distribution of the energy in a scene: a sparse octree over a box, after \[simons2016\].
//!
//! A voxel holds the number of its intersections and the sum of their energies by bounce. The energy of an intersection is the mean
//! of the three channels. Sums are integers, so adding trees of disjoint records gives the same result in any order. Only leaves
//! are stored. A voxel of a coarser level is the sum of its leaves.

use crate::record::{Intersection, LightPath};
use femc_stats::ExactSum;
use std::collections::BTreeMap;

/// Sum of energies, cd/m2: quantum 2^-40, range 2^88.
pub type EnergySum = ExactSum<40>;

/// Maximum number of levels below the root.
pub const MAX_LEVELS: u8 = 20;

/// The box and the finest voxels of a tree. Trees with equal roots can be added and compared, so the variants of a sweep share one
/// root.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Root {
    /// Lower corner, world, m.
    pub lower: [f64; 3],
    /// Width of the cube, m; above 0.
    pub width: f64,
    /// Number of halvings from the cube to a leaf, at most [`MAX_LEVELS`].
    pub levels: u8,
}

impl Root {
    /// Creates the cube around a box, with the same lower corner.
    pub fn around(lower: [f64; 3], upper: [f64; 3], levels: u8) -> Self {
        let width = (0..3).map(|axis| upper[axis] - lower[axis]).fold(0.0, f64::max);
        let width = if width.is_finite() && width > 0.0 { width } else { 1.0 };
        Self { lower, width, levels: levels.min(MAX_LEVELS) }
    }

    /// Returns the code of the leaf that contains a point: three bits a level, x the lowest, the coarsest level highest. `None`:
    /// the point is outside.
    pub fn morton_code(&self, position: [f64; 3]) -> Option<u64> {
        let leaves = (1u64 << self.levels) as f64;
        let mut code = 0;
        for (axis, (position, lower)) in position.into_iter().zip(self.lower).enumerate() {
            let place = ((position - lower) / self.width * leaves).floor();
            // The upper faces of the cube belong to the last leaves.
            let place = if position == lower + self.width { leaves - 1.0 } else { place };
            if !(0.0..leaves).contains(&place) {
                return None;
            }
            code |= spread_bits(place as u64) << axis;
        }
        Some(code)
    }

    /// Returns the leaf of an intersection, with the contents that the intersection adds. `None`: it is outside.
    pub(crate) fn voxel_of(&self, it: &Intersection) -> Option<(u64, Voxel)> {
        let energy = it.radiance.iter().map(|value| f64::from(*value)).sum::<f64>() / 3.0;
        let units = EnergySum::quantize(energy).ok()?;
        Some((self.morton_code(it.position)?, Voxel { count: 1, energy: EnergySum::from_units(units) }))
    }

    /// Returns the lower corner and the width of a voxel of a level, m.
    pub fn voxel(&self, level: u8, code: u64) -> ([f64; 3], f64) {
        let width = self.width / (1u64 << level.min(MAX_LEVELS)) as f64;
        (std::array::from_fn(|axis| self.lower[axis] + width * compact_bits(code >> axis) as f64), width)
    }
}

/// Returns the place of a voxel among the voxels of its level, by axis.
pub fn voxel_place(code: u64) -> [u64; 3] {
    std::array::from_fn(|axis| compact_bits(code >> axis))
}

/// Spreads the bits of a number of 20 bits to every third position.
fn spread_bits(x: u64) -> u64 {
    (0..u32::from(MAX_LEVELS)).fold(0, |code, bit| code | (x >> bit & 1) << (3 * bit))
}

fn compact_bits(code: u64) -> u64 {
    (0..u32::from(MAX_LEVELS)).fold(0, |x, bit| x | (code >> (3 * bit) & 1) << bit)
}

/// Contents of a voxel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Voxel {
    /// Number of intersections.
    pub count: u64,
    /// Sum of their energies.
    pub energy: EnergySum,
}

impl Voxel {
    /// Returns the mean energy of its intersections, cd/m2.
    pub fn mean(self) -> f64 {
        if self.count == 0 { 0.0 } else { self.energy.value() / self.count as f64 }
    }

    pub(crate) fn merge(&mut self, other: Self) {
        self.count = self.count.saturating_add(other.count);
        self.energy.merge(other.energy);
    }
}

/// Error: trees with different roots cannot be combined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the octrees have different roots")]
pub struct RootMismatch;

/// Energy of intersections by bounce and position.
#[derive(Clone, Debug, PartialEq)]
pub struct Octree {
    /// Box of the tree.
    pub root: Root,
    /// Leaves by bounce and code.
    pub leaves: BTreeMap<(u32, u64), Voxel>,
    /// Number of intersections outside the box.
    pub outside: u64,
}

impl Octree {
    /// Creates a tree without intersections.
    pub fn new(root: Root) -> Self {
        Self { root, leaves: BTreeMap::new(), outside: 0 }
    }

    /// Creates a tree of the intersections of paths.
    pub fn from_paths<'a>(root: Root, paths: impl IntoIterator<Item = &'a LightPath>) -> Self {
        let mut tree = Self::new(root);
        paths.into_iter().for_each(|path| tree.add(path));
        tree
    }

    /// Adds the intersections of a path.
    pub fn add(&mut self, path: &LightPath) {
        for it in &path.intersections {
            match self.root.voxel_of(it) {
                Some((code, voxel)) => self.leaves.entry((it.bounce, code)).or_default().merge(voxel),
                None => self.outside += 1,
            }
        }
    }

    /// Adds a tree of other intersections.
    pub fn merge(&mut self, other: &Self) -> Result<(), RootMismatch> {
        if self.root != other.root {
            return Err(RootMismatch);
        }
        other.leaves.iter().for_each(|(key, voxel)| self.leaves.entry(*key).or_default().merge(*voxel));
        self.outside = self.outside.saturating_add(other.outside);
        Ok(())
    }

    /// Returns the voxels of a level, for one bounce or for all bounces together. Level 0 is the root.
    pub fn level(&self, level: u8, bounce: Option<u32>) -> BTreeMap<u64, Voxel> {
        let shift = 3 * u32::from(self.root.levels.saturating_sub(level));
        let mut voxels = BTreeMap::<u64, Voxel>::new();
        for (&(own, code), voxel) in &self.leaves {
            if bounce.is_none_or(|bounce| bounce == own) {
                voxels.entry(code >> shift).or_default().merge(*voxel);
            }
        }
        voxels
    }

    /// Returns the mean energy of each voxel of a level in this tree minus the mean in another tree, cd/m2. If a tree lacks a
    /// voxel, its mean there is 0.
    pub fn difference(&self, other: &Self, level: u8, bounce: Option<u32>) -> Result<BTreeMap<u64, f64>, RootMismatch> {
        if self.root != other.root {
            return Err(RootMismatch);
        }
        let mut all: BTreeMap<u64, f64> =
            self.level(level, bounce).into_iter().map(|(code, voxel)| (code, voxel.mean())).collect();
        for (code, voxel) in other.level(level, bounce) {
            *all.entry(code).or_default() -= voxel.mean();
        }
        Ok(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_in_the_voxels_of_all_levels_that_its_leaf_is_in() {
        let root = Root::around([-1.0, 0.0, 2.0], [3.0, 1.0, 5.0], 6);
        assert_eq!(root.width, 4.0);
        for point in [[0.3, 0.9, 4.9], [-1.0, 0.0, 2.0], [2.99, 3.9, 2.01], [3.0, 4.0, 6.0]] {
            let code = root.morton_code(point).unwrap();
            for level in 0..=6 {
                let (lower, width) = root.voxel(level, code >> (3 * (6 - u32::from(level))));
                assert_eq!(width, 4.0 / f64::from(1 << level));
                assert!((0..3).all(|axis| (lower[axis]..=lower[axis] + width).contains(&point[axis])), "{point:?}");
            }
        }
        assert_eq!(root.morton_code([3.1, 0.0, 2.0]), None);
        assert_eq!(root.morton_code([f64::NAN, 0.0, 2.0]), None);
    }
}
