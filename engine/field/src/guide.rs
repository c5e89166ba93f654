//! Guides: the directions from which a leaf's light comes, as a mixture of lobes for sampling.

use crate::regions::RegionGrids;
use crate::{Cell, Leaf};
use femc_math::elementary::sin_cos;
use femc_math::glam::{Vec2, Vec3A};
use femc_math::{Frame, Rgb, cross};
use std::collections::HashMap;
use std::f32::consts::PI;

/// Maximum number of lobes of a leaf.
pub const LOBES: usize = 8;
/// Number of lobes up to which evaluation takes half the time.
pub const HALF: usize = LOBES / 2;

/// Light through a place in space: through a gap, or from a source. It is a density over the plane through the place across the
/// view, which falls as `(1 + q)^-3`, with q = 1 on an ellipse. This is a Student distribution, whose long tails also cover light
/// slightly beside the place. From each point of the leaf the place lies in another direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lobe {
    /// Center of the lobe, prepared frame, m.
    pub target: Vec3A,
    /// Half axes of the ellipse, perpendicular to each other, m. Their lengths are root two times the standard deviations.
    pub axes: [Vec3A; 2],
    /// Share of the leaf's irradiance that the lobe contains.
    pub share: f32,
}

impl Lobe {
    /// Creates a circular lobe.
    /// - `along`: the view, unit;
    /// - `spread`: mean squared distance from the place, m2.
    pub fn round(target: Vec3A, along: Vec3A, spread: f32, share: f32) -> Self {
        let frame = Frame::from_normal(along);
        let radius = spread.max(f32::MIN_POSITIVE).sqrt();
        Self { target, axes: [Vec3A::X, Vec3A::Y].map(|axis| frame.to_world(axis) * radius), share }
    }
}

/// Guide of a leaf: the directions from which its light comes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Guide {
    /// Index of its first lobe.
    pub first: u32,
    /// Number of its lobes, at most [`LOBES`].
    pub count: u32,
    /// Share of directions to sample from the lobes, in [0, 1); 0: no guide.
    pub share: f32,
}

/// Guides of all leaves.
#[derive(Clone, Debug, Default)]
pub struct Guides {
    by_leaf: Vec<Guide>,
    lobes: Vec<Lobe>,
    /// Regions of surfaces, each with the index of its block, or [`UNGUIDED`].
    regions: RegionGrids,
    /// Lobes, and the share of directions to sample from them.
    blocks: Vec<(Block, f32)>,
}

/// Guide for paths at a point.
#[derive(Clone, Copy, Debug)]
pub struct Guided<'a> {
    /// Lobes from which light comes, if sampling them is worthwhile, and the share of directions to sample from them.
    pub lobes: Option<&'a (Block, f32)>,
    /// Irradiance near the point, lx by channel, without direct light from light sources.
    pub light: Rgb,
}

const UNGUIDED: u32 = u32::MAX;

impl Guides {
    /// Creates the guides.
    /// - `by_leaf`: guides by leaf, or empty; ranges are within `lobes`;
    /// - `roots`, `cells`: first cell by surface, and parts of surfaces down to these `leaves`.
    pub fn new(by_leaf: Vec<Guide>, lobes: Vec<Lobe>, roots: &[u32], cells: &[Cell], leaves: &[Leaf]) -> Self {
        let (mut blocks, mut known) = (Vec::new(), HashMap::new());
        let block = |&Guide { first, count, share }: &Guide| {
            if count == 0 || share <= 0.0 {
                return UNGUIDED;
            }
            *known.entry((first, count, share.to_bits())).or_insert_with(|| {
                blocks.push((Block::new(&lobes[first as usize..(first + count) as usize]), share));
                blocks.len() as u32 - 1
            })
        };
        let regions = if by_leaf.is_empty() {
            RegionGrids::default()
        } else {
            let data: Vec<u32> = by_leaf.iter().map(block).collect();
            RegionGrids::new(roots, cells, leaves, &data)
        };
        Self { by_leaf, lobes, regions, blocks }
    }

    /// Creates guides with possibly invalid ranges, only to encode them.
    #[cfg(test)]
    pub(crate) fn unchecked(by_leaf: Vec<Guide>, lobes: Vec<Lobe>) -> Self {
        Self { by_leaf, lobes, ..Self::default() }
    }

    /// Multiplies the light by a factor. The directions do not change.
    pub(crate) fn scale(&mut self, factor: f32) {
        self.regions.scale(factor);
    }

    /// Returns the guides by leaf.
    pub fn by_leaf(&self) -> &[Guide] {
        &self.by_leaf
    }

    /// Returns all lobes.
    pub fn lobes(&self) -> &[Lobe] {
        &self.lobes
    }

    /// Returns the number of bytes of the guides.
    pub fn memory(&self) -> usize {
        size_of_val(&*self.by_leaf) + size_of_val(&*self.lobes) + self.regions.memory() + size_of_val(&*self.blocks)
    }

    /// Returns the guide at a point of a surface. `None` if there are no guides.
    /// - `place`: the point's parameters on the surface.
    #[inline]
    pub fn at(&self, surface: u32, place: impl FnOnce() -> Vec2) -> Option<Guided<'_>> {
        let region = self.regions.at(surface, place)?;
        Some(Guided { lobes: self.blocks.get(region.data as usize), light: Rgb::from(region.light) })
    }
}

/// Lobes in a structure of arrays.
#[derive(Clone, Copy, Debug)]
pub struct Block {
    /// Values by axis and lobe: the center; the plane's unit normal; the ellipse's axes over their squared lengths.
    targets: [[f32; LOBES]; 3],
    normals: [[f32; LOBES]; 3],
    across: [[[f32; LOBES]; 3]; 2],
    /// Squared lengths of the half axes, m2.
    squares: [[f32; LOBES]; 2],
    /// Density at the center of the plane, 1/m2, times the lobe's share.
    peaks: [f32; LOBES],
    shares: [f32; LOBES],
    /// Whether there are at most [`HALF`] lobes.
    is_half: bool,
}

impl Block {
    /// Creates a block of at most [`LOBES`] lobes.
    pub fn new(lobes: &[Lobe]) -> Self {
        const NONE: [f32; LOBES] = [0.0; LOBES];
        let mut out = Self {
            targets: [NONE; 3],
            normals: [NONE; 3],
            across: [[NONE; 3]; 2],
            squares: [NONE; 2],
            peaks: NONE,
            shares: NONE,
            is_half: lobes.len() <= HALF,
        };
        for (k, lobe) in lobes.iter().enumerate().take(LOBES) {
            let [a, b] = lobe.axes.map(|axis| axis.length_squared());
            let normal = cross(lobe.axes[0], lobe.axes[1]).normalize_or_zero();
            let density = 2.0 / (PI * (a * b).sqrt());
            let is_sound = [a, b].iter().all(|square| square.is_finite() && *square > 0.0)
                && normal != Vec3A::ZERO
                && lobe.target.is_finite()
                && (lobe.share * density).is_finite()
                && lobe.share > 0.0;
            if !is_sound {
                continue;
            }
            for axis in 0..3 {
                (out.targets[axis][k], out.normals[axis][k]) = (lobe.target[axis], normal[axis]);
                (out.across[0][axis][k], out.across[1][axis][k]) = (lobe.axes[0][axis] / a, lobe.axes[1][axis] / b);
            }
            (out.squares[0][k], out.squares[1][k]) = (a, b);
            (out.peaks[k], out.shares[k]) = (lobe.share * density, lobe.share);
        }
        out
    }
}

/// Lobes of a leaf as seen from one of its points.
#[derive(Clone, Copy, Debug)]
pub struct Directions<'a> {
    block: &'a Block,
    /// Distance to the plane along its normal, m; and the point's coordinates in it, in half axes.
    heights: [f32; LOBES],
    places: [[f32; LOBES]; 2],
    /// 1 over the sum of the shares of the visible lobes, for these; 0 for the others.
    weights: [f32; LOBES],
    is_empty: bool,
}

/// Minimum distance of a point from a lobe's plane, as a share of its distance from the lobe's center, for the lobe to be visible.
const FLAT: f32 = 1e-3;

impl<'a> Directions<'a> {
    /// Creates the directions of lobes at a point. If no lobe is visible, they are empty ([`Self::is_empty`]).
    #[inline]
    pub fn new(block: &'a Block, point: Vec3A) -> Self {
        if block.is_half { Self::with_lobes::<HALF>(block, point) } else { Self::with_lobes::<LOBES>(block, point) }
    }

    /// Checks whether no lobe is visible. Then there is nothing to sample.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.is_empty
    }

    #[inline(always)]
    fn with_lobes<const N: usize>(block: &'a Block, point: Vec3A) -> Self {
        const NONE: [f32; LOBES] = [0.0; LOBES];
        let mut out = Self { block, heights: NONE, places: [NONE; 2], weights: NONE, is_empty: false };
        let mut seen = NONE;
        for (k, seen) in seen.iter_mut().enumerate().take(N) {
            let x = block.targets[0][k] - point.x;
            let y = block.targets[1][k] - point.y;
            let z = block.targets[2][k] - point.z;
            let dot = |of: &[[f32; LOBES]; 3]| of[0][k] * x + of[1][k] * y + of[2][k] * z;
            let height = dot(&block.normals);
            out.heights[k] = height;
            (out.places[0][k], out.places[1][k]) = (-dot(&block.across[0]), -dot(&block.across[1]));
            let is_seen = height * height > FLAT * FLAT * (x * x + y * y + z * z);
            *seen = if is_seen { block.shares[k] } else { 0.0 };
        }
        let sum: f32 = seen.iter().sum();
        out.is_empty = !(sum > 0.0 && sum.is_finite());
        let scale = 1.0 / sum;
        out.weights = seen.map(|share| if share > 0.0 { scale } else { 0.0 });
        out
    }

    /// Returns the directions unless they are empty.
    #[inline]
    pub fn non_empty(self) -> Option<Self> {
        (!self.is_empty).then_some(self)
    }

    /// Returns the density of [`Self::sample`] in a unit direction, 1/sr.
    #[inline]
    pub fn pdf(&self, dir: Vec3A) -> f32 {
        let [a, b, c, d, e, f, g, h] = self.each(dir);
        ((a + e) + (b + f)) + ((c + g) + (d + h))
    }

    /// Returns the density by lobe.
    #[inline]
    pub fn each(&self, dir: Vec3A) -> [f32; LOBES] {
        if self.block.is_half { self.first::<HALF>(dir) } else { self.first::<LOBES>(dir) }
    }

    /// Returns the densities of the first `N` lobes.
    #[inline(always)]
    fn first<const N: usize>(&self, dir: Vec3A) -> [f32; LOBES] {
        let mut each = [0.0f32; LOBES];
        for (k, pdf) in each.iter_mut().enumerate().take(N) {
            let dot = |of: &[[f32; LOBES]; 3]| of[0][k] * dir.x + of[1][k] * dir.y + of[2][k] * dir.z;
            let ahead = dot(&self.block.normals);
            // Relative to the direction of the plane. A direction parallel to the plane has no density.
            let steep = if ahead.abs() > 1e-6 { ahead } else { f32::INFINITY };
            let distance = self.heights[k] / steep;
            let a = self.places[0][k] + distance * dot(&self.block.across[0]);
            let b = self.places[1][k] + distance * dot(&self.block.across[1]);
            let x = 1.0 / (1.0 + a * a + b * b);
            let value = self.block.peaks[k] * self.weights[k] * (x * x * x) * (distance * distance / steep.abs());
            *pdf = if distance > 0.0 { value } else { 0.0 };
        }
        each
    }

    /// Samples a direction.
    /// - `choice`, `u`: numbers in [0, 1).
    #[inline]
    pub fn sample(&self, choice: f32, u: [f32; 2]) -> Vec3A {
        self.of_lobe(self.pick(choice).0, u)
    }

    /// Samples a direction from only two numbers. The first one also chooses the lobe, so points that are evenly spread over the
    /// square give each lobe evenly spread directions.
    /// - `u`: in [0, 1)^2.
    #[inline]
    pub fn sample_evenly(&self, u: [f32; 2]) -> Vec3A {
        let (at, rest) = self.pick(u[0]);
        self.of_lobe(at, [rest, u[1]])
    }

    /// Returns the lobe that a number in [0, 1) chooses, and the position of the number in that lobe's part, in [0, 1).
    #[inline]
    fn pick(&self, choice: f32) -> (usize, f32) {
        let share = |k: usize| self.block.shares[k] * self.weights[k];
        let (mut at, mut left) = (0, choice);
        while at + 1 < LOBES && left >= share(at) {
            left -= share(at);
            at += 1;
        }
        // By rounding, nothing may be left for the last lobes.
        while at > 0 && share(at) <= 0.0 {
            at -= 1;
        }
        (at, (left / share(at)).clamp(0.0, 1.0 - f32::EPSILON / 2.0))
    }

    #[inline]
    fn of_lobe(&self, at: usize, u: [f32; 2]) -> Vec3A {
        let radius = (1.0 / (1.0 - u[0]).sqrt() - 1.0).max(0.0).sqrt();
        let (sin, cos) = sin_cos(2.0 * PI * u[1]);
        let axis = |of: &[[f32; LOBES]; 3]| Vec3A::new(of[0][at], of[1][at], of[2][at]);
        let places = [radius * cos - self.places[0][at], radius * sin - self.places[1][at]];
        let mut way = axis(&self.block.normals) * self.heights[at];
        for (k, place) in places.into_iter().enumerate() {
            way += axis(&self.block.across[k]) * (place * self.block.squares[k][at]);
        }
        way.normalize_or(Vec3A::Z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_math::warp;

    fn lattice(n: u32) -> impl Iterator<Item = [f32; 2]> {
        (0..n).map(move |k| [(k as f32 + 0.5) / n as f32, (k as f32 * 0.618_034).fract()])
    }

    fn some() -> Block {
        let lobe = |target: Vec3A, spread, share| Lobe::round(target, target.normalize(), spread, share);
        let tall = [Vec3A::new(-0.1, 0.3, 0.0), Vec3A::new(0.0, 0.0, 2.0)];
        let lobes = [
            lobe(Vec3A::new(3.0, 1.0, 0.5), 0.05, 0.4),
            lobe(Vec3A::new(-1.0, 2.0, 2.0), 1.0, 0.2),
            lobe(Vec3A::new(0.0, 0.0, -5.0), 9.0, 0.1),
            Lobe { target: Vec3A::new(-3.0, -1.0, 0.5), axes: tall, share: 0.1 },
        ];
        Block::new(&lobes)
    }

    /// The shares of samples in boxes of directions match the density (chi-square with 95 degrees of freedom: 161 at a level of
    /// 3e-5).
    #[test]
    fn samples_have_the_density() {
        let block = some();
        let directions = Directions::new(&block, Vec3A::new(0.1, 0.2, 0.3));
        const N: usize = 200_000;
        let bin = |dir: Vec3A| {
            let turn = femc_math::elementary::atan2(dir.y, dir.x) / (2.0 * PI) + 0.5;
            let [row, column] = [(dir.z + 1.0) * 4.0, turn * 12.0].map(|at| at as usize);
            row.min(7) * 12 + column.min(11)
        };
        let [mut wanted, mut got, mut evenly] = [(); 3].map(|()| vec![0.0f64; 96]);
        for z in 0..4000 {
            for turn in 0..960 {
                let dir = warp::direction((z as f32 + 0.5) / 2000.0 - 1.0, (turn as f32 + 0.5) / 960.0);
                wanted[bin(dir)] += f64::from(directions.pdf(dir)) * 4.0 * std::f64::consts::PI / (4000.0 * 960.0);
            }
        }
        // Independent numbers, since a lattice would be more even than chance.
        let mut state = 1u64;
        let mut number = || {
            state = femc_math::hash::mix64(state.wrapping_add(0x9e37_79b9_7f4a_7c15));
            femc_math::hash::unit_f32((state >> 32) as u32)
        };
        for _ in 0..N {
            let choice = number();
            got[bin(directions.sample(choice, [number(), number()]))] += 1.0;
            evenly[bin(directions.sample_evenly([number(), number()]))] += 1.0;
        }
        let total: f64 = wanted.iter().sum();
        assert!((total - 1.0).abs() < 1e-2, "{total}");
        for got in [got, evenly] {
            let square = |(want, got): (&f64, &f64)| {
                let want = want / total * N as f64;
                (got - want).powi(2) / want.max(1.0)
            };
            let chi: f64 = wanted.iter().zip(&got).map(square).sum();
            assert!(chi < 161.0, "{chi}");
        }
    }

    #[test]
    fn a_lobe_points_from_each_point_to_the_same_place() {
        let lobes = [Lobe::round(Vec3A::new(1.0, 2.0, 3.0), Vec3A::X, 1e-4, 1.0)];
        for point in [Vec3A::ZERO, Vec3A::new(5.0, 0.0, 0.0), Vec3A::new(0.5, 2.0, 2.9)] {
            let block = Block::new(&lobes);
            let directions = Directions::new(&block, point);
            let mean: Vec3A = lattice(256).map(|u| directions.sample(0.3, u)).sum();
            assert!(mean.normalize().dot((lobes[0].target - point).normalize()) > 0.999);
        }
        assert!(Directions::new(&Block::new(&[]), Vec3A::ZERO).is_empty(), "no lobes");
        let dark = [Lobe { share: 0.0, ..lobes[0] }];
        assert!(Directions::new(&Block::new(&dark), Vec3A::ZERO).is_empty(), "lobes of nothing");
        assert!(Directions::new(&Block::new(&lobes), Vec3A::new(1.0, 0.0, 0.0)).is_empty(), "a plane from the side");
    }
}
