//! Exact sums of the samples of a rectangle of pixels.
//!
//! Each pixel stores the sums of color in 128-bit fixed point, of albedo in 64-bit and of depth in 128-bit fixed point, and counts.
//! It also stores the luminances that decide on further samples ([`PixelSums`], 236 bytes). A term is rounded once and added as an
//! integer, so a tile is a function of the set of its samples; it does not depend on threads, order, tile division or restarts.
//! Compared to floats, this costs 236 instead of some 60 bytes per pixel, and a few nanoseconds per sample.
//!
//! The samples belong to independent **replicates** ([`femc_math::sampler`]), two for each **half**. The halves' means give the
//! variance of the image, and the replicates of a half give the variance of the half. Only the other half decides whether a half
//! has enough samples. The decision is therefore independent of the samples that it concerns: the mean of each half is unbiased,
//! and so is the image, in which both have the weight 1/2. A half that has enough samples is **held**. More of its samples are
//! drawn, because they decide on the other half, but they do not count in the image.
//!
//! A sample with a NaN, infinite, negative or absurdly large component is counted and left out: the pixel's mean is over the
//! others.

use crate::{BadKind, BadSample, BadSamples, FilmError, Rect, Sample};
use femc_math::color::luminance;
use femc_math::sampler::{REPLICATES, replicate_of};
use femc_stats::ExactSum;
use femc_stats::exact::RadianceSum;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Maximum number of pixels of a tile.
pub const MAX_TILE_PIXELS: u64 = 1 << 22;

/// Number of fixed-point fraction bits of an albedo sum; a term is at most 255, so 2^32 of them fit.
pub(crate) const ALBEDO_FRACTION: u32 = 24;

/// Number of halves of a pixel's samples.
pub const HALVES: usize = 2;

/// Returns the half of a replicate: replicates alternate, and therefore the halves do, too.
pub const fn half_of(replicate: usize) -> usize {
    replicate % HALVES
}

/// Returns the replicates of a half.
pub(crate) fn replicates_of(half: usize) -> [usize; REPLICATES / HALVES] {
    std::array::from_fn(|i| half + i * HALVES)
}

/// First held sample of each half.
pub type HalfEnds = [u32; HALVES];

/// No half is held.
pub const NONE_HELD: HalfEnds = [u32::MAX; HALVES];

/// Samples `start .. end` of every pixel of a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct SampleRange {
    /// First sample.
    pub start: u32,
    /// One past the last sample.
    pub end: u32,
}

impl SampleRange {
    /// Returns the number of samples per pixel.
    pub const fn len(self) -> u32 {
        self.end.saturating_sub(self.start)
    }

    /// Checks whether the range is empty.
    pub const fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// Joins ranges that ascend without a gap; `None` for any other ranges, and for no range.
    pub fn join(ranges: &[Self]) -> Option<Self> {
        let (first, rest) = ranges.split_first()?;
        let join = |one: Self, next: &Self| (one.end == next.start).then_some(Self { end: next.end, ..one });
        rest.iter().try_fold(*first, join)
    }

    const fn overlaps(self, other: Self) -> bool {
        self.start < other.end && other.start < self.end
    }
}

impl From<Range<u32>> for SampleRange {
    fn from(range: Range<u32>) -> Self {
        Self { start: range.start, end: range.end }
    }
}

/// Sums over the good samples of one pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PixelSums {
    /// Color of each half, cd/m2, without held samples.
    pub color: [[RadianceSum; 3]; HALVES],
    /// Luminance of each replicate, cd/m2, of all samples.
    pub luminance: [RadianceSum; REPLICATES],
    /// Depth of the samples that hit a surface, meters.
    pub depth: ExactSum<40>,
    /// Albedo in units of 2^-24.
    pub albedo: [u64; 3],
    /// Number of samples that hit a surface.
    pub hits: u32,
    /// Number of good samples of each half that are not held.
    pub half_counts: [u32; HALVES],
    /// Number of good samples of each replicate.
    pub replicate_counts: [u32; REPLICATES],
    /// Largest luminance of a sample of each half, cd/m2.
    pub peak: [f32; HALVES],
}

impl PixelSums {
    /// Adds a good sample: finite, non-negative, at most [`MAX_RADIANCE`](crate::sample::MAX_RADIANCE).
    #[inline]
    fn add(&mut self, index: u32, sample: &Sample) {
        let replicate = replicate_of(index);
        let half = half_of(replicate);
        let add = |sum: &mut RadianceSum, value: f32| {
            let (mantissa, exponent) = float_parts(value);
            sum.add_parts(mantissa, exponent);
        };
        let light = luminance(sample.color);
        self.color[half].iter_mut().zip(sample.color.to_array()).for_each(|(sum, value)| add(sum, value));
        add(&mut self.luminance[replicate], light);
        self.peak[half] = self.peak[half].max(light);
        for (sum, a) in self.albedo.iter_mut().zip(sample.albedo.to_array()) {
            *sum = sum.saturating_add(albedo_units(a));
        }
        if sample.depth.is_finite() {
            let (mantissa, exponent) = float_parts(sample.depth);
            self.depth.add_parts(mantissa, exponent);
            self.hits = self.hits.saturating_add(1);
        }
        self.half_counts[half] = self.half_counts[half].saturating_add(1);
        self.replicate_counts[replicate] = self.replicate_counts[replicate].saturating_add(1);
    }

    /// Returns the number of good samples, whether held or not.
    pub fn samples(&self) -> u32 {
        self.replicate_counts.iter().fold(0, |sum, count| sum.saturating_add(*count))
    }

    /// Returns the number of good samples that count in the image.
    pub fn counted_samples(&self) -> u32 {
        self.half_counts.iter().fold(0, |sum, count| sum.saturating_add(*count))
    }

    /// Returns the mean luminance of each replicate of a half, cd/m2; `None` if one has no good sample.
    pub(crate) fn luminances(&self, half: usize) -> Option<[f64; REPLICATES / HALVES]> {
        let replicates = replicates_of(half);
        let mean = |replicate: usize| self.luminance[replicate].value() / f64::from(self.replicate_counts[replicate]);
        replicates.iter().all(|&replicate| self.replicate_counts[replicate] > 0).then(|| replicates.map(mean))
    }

    /// Removes the samples of a half from the image.
    fn hold(&mut self, half: usize) {
        (self.color[half], self.half_counts[half]) = Default::default();
    }

    pub(crate) fn merge(&mut self, other: &Self) {
        self.color.as_flattened_mut().iter_mut().zip(other.color.as_flattened()).for_each(|(a, b)| a.merge(*b));
        self.luminance.iter_mut().zip(other.luminance).for_each(|(a, b)| a.merge(b));
        self.depth.merge(other.depth);
        self.albedo.iter_mut().zip(other.albedo).for_each(|(a, b)| *a = a.saturating_add(b));
        self.hits = self.hits.saturating_add(other.hits);
        self.half_counts.iter_mut().zip(other.half_counts).for_each(|(a, b)| *a = a.saturating_add(b));
        self.replicate_counts.iter_mut().zip(other.replicate_counts).for_each(|(a, b)| *a = a.saturating_add(b));
        self.peak.iter_mut().zip(other.peak).for_each(|(a, b)| *a = a.max(b));
    }
}

/// Returns mantissa and exponent of a finite float: `v = mantissa * 2^exponent`; subnormals, which no sum can hold, give 0.
#[inline]
pub(crate) fn float_parts(v: f32) -> (u64, i32) {
    let bits = v.to_bits();
    let exponent = (bits >> 23) & 0xff;
    let mantissa = if exponent == 0 { 0 } else { (bits & 0x007f_ffff) | 0x0080_0000 };
    (u64::from(mantissa), exponent as i32 - 150)
}

/// Computes `round(2^24 min(a, 255))`. In a double of the size of this bias, the lowest bit of the mantissa is 2^-24.
#[inline]
fn albedo_units(a: f32) -> u64 {
    const BIAS: f64 = (1u64 << (52 - ALBEDO_FRACTION)) as f64;
    (f64::from(a.min(255.0)) + BIAS).to_bits() - BIAS.to_bits()
}

/// The sums of some sample ranges of a rectangle of pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    pub(crate) rect: Rect,
    /// Sorted, disjoint, and not joined, because they are the keys under which samples were counted.
    pub(crate) ranges: Vec<SampleRange>,
    pub(crate) ends: HalfEnds,
    pub(crate) pixels: Vec<PixelSums>,
    pub(crate) bad: BadSamples,
    pub(crate) rays: u64,
}

impl Tile {
    /// Creates an empty tile for the samples `samples` of each pixel of `rect`.
    pub fn new(rect: Rect, samples: Range<u32>) -> Result<Self, FilmError> {
        rect.check(MAX_TILE_PIXELS)?;
        let range = SampleRange::from(samples);
        if range.is_empty() {
            return Err(FilmError::EmptyRange(range));
        }
        let pixels = vec![PixelSums::default(); rect.area() as usize];
        Ok(Self { rect, ranges: vec![range], ends: NONE_HELD, pixels, bad: BadSamples::default(), rays: 0 })
    }

    /// Joins full-width strips, which cover `rect` from top to bottom and have the samples `samples`, to a tile. Several threads
    /// can fill strips at the same time.
    /// - errors: the strips do not match.
    pub fn from_strips(rect: Rect, samples: Range<u32>, strips: Vec<Self>) -> Result<Self, FilmError> {
        let mut whole = Self::new(rect, samples)?;
        whole.pixels.clear();
        let mut y = rect.y;
        for strip in strips {
            let expected = Rect { y, height: strip.rect.height, ..rect };
            if strip.rect != expected || strip.ranges != whole.ranges {
                return Err(FilmError::OtherPixels { expected, found: strip.rect });
            }
            y = y.saturating_add(strip.rect.height);
            whole.pixels.extend_from_slice(&strip.pixels);
            whole.bad.merge(&strip.bad);
            whole.add_rays(strip.rays);
        }
        if whole.pixels.len() as u64 != rect.area() {
            return Err(FilmError::OtherPixels { expected: rect, found: Rect { height: y - rect.y, ..rect } });
        }
        Ok(whole)
    }

    /// Returns the pixels.
    pub fn rect(&self) -> Rect {
        self.rect
    }

    /// Returns the sample ranges whose samples are in the sums, ascending.
    pub fn ranges(&self) -> &[SampleRange] {
        &self.ranges
    }

    /// Returns the first held sample of each half: from there on, its samples do not count in the image.
    pub fn ends(&self) -> HalfEnds {
        self.ends
    }

    /// Checks whether a half is held.
    pub(crate) fn is_held(&self) -> bool {
        self.ends != NONE_HELD
    }

    /// Holds the samples of each half from `ends` on. A half that is already held from an earlier sample on does not change.
    /// - errors: a sum has samples before and after an end. The tile does not change.
    pub fn hold(&mut self, ends: HalfEnds) -> Result<(), FilmError> {
        let ends = earlier_ends(self.ends, ends);
        let is_new = |half: usize| ends[half] < self.ends[half];
        let mut held = [false; HALVES];
        for half in (0..HALVES).filter(|&half| is_new(half)) {
            held[half] = self.ranges.iter().all(|range| range.start >= ends[half]);
            if !held[half] && self.ranges.iter().any(|range| range.end > ends[half]) {
                return Err(FilmError::Corrupt("a sample range crosses the boundary between the halves"));
            }
        }
        for half in (0..HALVES).filter(|&half| held[half]) {
            self.pixels.iter_mut().for_each(|pixel| pixel.hold(half));
        }
        self.ends = ends;
        Ok(())
    }

    /// Returns the number of samples per pixel in all ranges.
    pub fn spp(&self) -> u64 {
        self.ranges.iter().map(|r| u64::from(r.len())).sum()
    }

    /// Returns the account of the samples that were left out.
    pub fn bad_samples(&self) -> &BadSamples {
        &self.bad
    }

    /// Returns the cost of the samples: the number of rays traced for them, which is the same on every machine.
    pub fn rays(&self) -> u64 {
        self.rays
    }

    /// Adds to the cost of the samples.
    pub fn add_rays(&mut self, rays: u64) {
        self.rays = self.rays.saturating_add(rays);
    }

    /// Returns the sums of the pixels, row by row.
    pub fn pixels(&self) -> &[PixelSums] {
        &self.pixels
    }

    /// Returns the sums of the film's pixel (`x`, `y`), which lies in the tile.
    pub(crate) fn pixel(&self, (x, y): (u32, u32)) -> &PixelSums {
        &self.pixels[((y - self.rect.y) * self.rect.width + (x - self.rect.x)) as usize]
    }

    /// Returns the number of pixels with a sum that has left its range and is only a lower bound.
    pub fn saturated_pixels(&self) -> usize {
        let full = |p: &PixelSums| {
            let mut sums = p.color.as_flattened().iter().chain(&p.luminance);
            sums.any(|sum| sum.is_saturated()) || p.depth.is_saturated()
        };
        self.pixels.iter().filter(|p| full(p)).count()
    }

    /// Adds sample number `index` of the film's pixel (`x`, `y`), which must lie in the tile.
    ///
    /// A bad sample is counted with its position and changes no sum. Returns the reason why it is unusable.
    #[inline]
    pub fn add(&mut self, x: u32, y: u32, index: u32, sample: &Sample) -> Option<BadKind> {
        debug_assert!(self.rect.contains(x, y), "pixel {x},{y} outside of tile {}", self.rect);
        debug_assert!(self.ranges.iter().any(|r| (r.start..r.end).contains(&index)), "sample {index} not announced");
        let fault = sample.fault();
        match fault {
            None => self.pixels[((y - self.rect.y) * self.rect.width + (x - self.rect.x)) as usize].add(index, sample),
            Some(kind) => self.bad.add(BadSample { y, x, sample: index, kind }),
        }
        fault
    }

    /// Adds the samples of `other`, a tile of the same pixels.
    ///
    /// The union is keyed by sample range. Ranges that are already present are the same samples, so merging them again changes
    /// nothing. Associative, commutative, idempotent (test `any_order_and_partition_gives_the_same_bytes`). A half that is held in
    /// either tile is held in the union.
    /// - errors: other pixels; ranges that partly overlap; some ranges known and others new; samples before and after an end in one
    ///   sum. The tile does not change.
    pub fn merge(&mut self, other: &Self) -> Result<MergeOutcome, FilmError> {
        if self.rect != other.rect {
            return Err(FilmError::OtherPixels { expected: self.rect, found: other.rect });
        }
        if other.ranges.iter().all(|r| self.ranges.binary_search(r).is_ok()) {
            return Ok(MergeOutcome::Known);
        }
        for &new in &other.ranges {
            if let Some(&old) = self.ranges.iter().find(|old| old.overlaps(new)) {
                return Err(FilmError::Overlap { rect: self.rect, old, new });
            }
        }
        let ends = earlier_ends(self.ends, other.ends);
        let mut other = std::borrow::Cow::Borrowed(other);
        if other.ends != ends {
            other.to_mut().hold(ends)?;
        }
        self.hold(ends)?;
        self.ranges.extend_from_slice(&other.ranges);
        self.ranges.sort_unstable();
        self.pixels.iter_mut().zip(&other.pixels).for_each(|(mine, theirs)| mine.merge(theirs));
        self.bad.merge(&other.bad);
        self.add_rays(other.rays);
        Ok(MergeOutcome::New)
    }
}

/// Returns the earlier end of each half.
fn earlier_ends(a: HalfEnds, b: HalfEnds) -> HalfEnds {
    std::array::from_fn(|half| a[half].min(b[half]))
}

/// Result of a merge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MergeOutcome {
    /// The samples were new and are now counted.
    New,
    /// The samples had been counted before; nothing changed.
    Known,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_that_ascend_without_a_gap_are_one_and_others_are_none() {
        let joined = |bounds: &[(u32, u32)]| {
            let ranges: Vec<SampleRange> = bounds.iter().map(|&(start, end)| SampleRange { start, end }).collect();
            SampleRange::join(&ranges).map(|one| (one.start, one.end))
        };
        assert_eq!(joined(&[(0, 12)]), Some((0, 12)));
        assert_eq!(joined(&[(0, 1), (1, 7), (7, 12)]), Some((0, 12)));
        assert_eq!(joined(&[(3, 5), (5, 6)]), Some((3, 6)));
        for other in [&[][..], &[(0, 5), (6, 12)], &[(5, 6), (3, 5)], &[(0, 5), (4, 6)]] {
            assert_eq!(joined(other), None, "{other:?}");
        }
    }
}
