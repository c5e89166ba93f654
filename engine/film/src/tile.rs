//! Exact sums of the samples of a rectangle of pixels.
//!
//! Per pixel: the sums of color in 128-bit fixed point, of albedo in 64-bit and of depth in 128-bit fixed point, and counts; and
//! of what further samples are decided by, the luminances ([`PixelSums`], 236 bytes). A term is rounded once and added as an
//! integer, so a tile is a function of the set of its samples; threads, order, tile cut and restarts leave no trace. Against floats
//! this costs 236 instead of some 60 bytes a pixel and a few nanoseconds a sample.
//!
//! The samples belong to independent **replicates** ([`femc_math::sampler`]), two for each **half**: the halves' means tell the
//! variance of the image, and the replicates of a half that of the half. Whether a half has samples enough is decided by the other
//! one alone, so that what is decided says nothing about the samples that it is decided for: the mean of each half is unbiased, and
//! so is the image, in which both have the weight 1/2. A half that has enough is **held**: more of its samples are drawn, because the
//! other half is decided by them, but they do not count in the image.
//!
//! A sample with a NaN, infinite, negative or absurd component is counted and left out: the pixel's mean is over the others.

use crate::{BadKind, BadSample, BadSamples, FilmError, Rect, Sample};
use femc_math::color::luminance;
use femc_math::sampler::{REPLICATES, replicate_of};
use femc_stats::ExactSum;
use femc_stats::exact::RadianceSum;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Largest number of pixels of a tile.
pub const MAX_TILE_PIXELS: u64 = 1 << 22;

/// Fixed-point fraction bits of an albedo sum; a term is at most 255, so 2^32 of them fit.
pub(crate) const ALBEDO_FRACTION: u32 = 24;

/// Halves of a pixel's samples.
pub const HALVES: usize = 2;

/// The half of a replicate: replicates take turns, so that the halves do, too.
pub const fn half_of(replicate: usize) -> usize {
    replicate % HALVES
}

/// The replicates of a half.
pub(crate) fn replicates_of(half: usize) -> [usize; REPLICATES / HALVES] {
    std::array::from_fn(|i| half + i * HALVES)
}

/// For each half the sample from which on its samples are held.
pub type Ends = [u32; HALVES];

/// No half is held.
pub const OPEN: Ends = [u32::MAX; HALVES];

/// Samples `start .. end` of every pixel of a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct SampleRange {
    /// First sample.
    pub start: u32,
    /// One past the last sample.
    pub end: u32,
}

impl SampleRange {
    /// Number of samples a pixel.
    pub const fn len(self) -> u32 {
        self.end.saturating_sub(self.start)
    }

    /// Whether there is none.
    pub const fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// Ranges that ascend without a gap, as one; `None` for others, and for no range.
    pub fn joined(ranges: &[Self]) -> Option<Self> {
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
    /// Color of each half, cd/m2, without samples that are held.
    pub color: [[RadianceSum; 3]; HALVES],
    /// Luminance of each replicate, cd/m2, of all samples.
    pub luminance: [RadianceSum; REPLICATES],
    /// Depth of the samples that met a surface, metres.
    pub depth: ExactSum<40>,
    /// Albedo in units of 2^-24.
    pub albedo: [u64; 3],
    /// Samples that met a surface.
    pub hits: u32,
    /// Good samples of each half that are not held.
    pub count: [u32; HALVES],
    /// Good samples of each replicate.
    pub drawn: [u32; REPLICATES],
    /// Largest luminance of a sample of each half, cd/m2.
    pub peak: [f32; HALVES],
}

impl PixelSums {
    /// Adds a sample without fault: finite, non-negative, at most [`MAX_RADIANCE`](crate::sample::MAX_RADIANCE).
    #[inline]
    fn add(&mut self, index: u32, sample: &Sample) {
        let replicate = replicate_of(index);
        let half = half_of(replicate);
        let add = |sum: &mut RadianceSum, value: f32| {
            let (mantissa, exponent) = parts(value);
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
            let (mantissa, exponent) = parts(sample.depth);
            self.depth.add_parts(mantissa, exponent);
            self.hits = self.hits.saturating_add(1);
        }
        self.count[half] = self.count[half].saturating_add(1);
        self.drawn[replicate] = self.drawn[replicate].saturating_add(1);
    }

    /// Good samples, whether held or not.
    pub fn samples(&self) -> u32 {
        self.drawn.iter().fold(0, |sum, count| sum.saturating_add(*count))
    }

    /// Good samples that count in the image.
    pub fn counted(&self) -> u32 {
        self.count.iter().fold(0, |sum, count| sum.saturating_add(*count))
    }

    /// Mean luminance by each replicate of a half, cd/m2; `None` where one has no good sample.
    pub(crate) fn luminances(&self, half: usize) -> Option<[f64; REPLICATES / HALVES]> {
        let replicates = replicates_of(half);
        let mean = |replicate: usize| self.luminance[replicate].value() / f64::from(self.drawn[replicate]);
        replicates.iter().all(|&replicate| self.drawn[replicate] > 0).then(|| replicates.map(mean))
    }

    /// Takes the samples of a half out of the image.
    fn hold(&mut self, half: usize) {
        (self.color[half], self.count[half]) = Default::default();
    }

    pub(crate) fn merge(&mut self, other: &Self) {
        self.color.as_flattened_mut().iter_mut().zip(other.color.as_flattened()).for_each(|(a, b)| a.merge(*b));
        self.luminance.iter_mut().zip(other.luminance).for_each(|(a, b)| a.merge(b));
        self.depth.merge(other.depth);
        self.albedo.iter_mut().zip(other.albedo).for_each(|(a, b)| *a = a.saturating_add(b));
        self.hits = self.hits.saturating_add(other.hits);
        self.count.iter_mut().zip(other.count).for_each(|(a, b)| *a = a.saturating_add(b));
        self.drawn.iter_mut().zip(other.drawn).for_each(|(a, b)| *a = a.saturating_add(b));
        self.peak.iter_mut().zip(other.peak).for_each(|(a, b)| *a = a.max(b));
    }
}

/// Mantissa and exponent of a finite float: `v = mantissa * 2^exponent`; subnormals, which no sum can hold, are 0.
#[inline]
pub(crate) fn parts(v: f32) -> (u64, i32) {
    let bits = v.to_bits();
    let exponent = (bits >> 23) & 0xff;
    let mantissa = if exponent == 0 { 0 } else { (bits & 0x007f_ffff) | 0x0080_0000 };
    (u64::from(mantissa), exponent as i32 - 150)
}

/// `round(2^24 min(a, 255))`: in a double of the size of this bias the lowest bit of the mantissa is 2^-24.
#[inline]
fn albedo_units(a: f32) -> u64 {
    const BIAS: f64 = (1u64 << (52 - ALBEDO_FRACTION)) as f64;
    (f64::from(a.min(255.0)) + BIAS).to_bits() - BIAS.to_bits()
}

/// The sums of some sample ranges of a rectangle of pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    pub(crate) rect: Rect,
    /// Sorted, disjoint, not joined: they are the keys under which samples were counted.
    pub(crate) ranges: Vec<SampleRange>,
    pub(crate) ends: Ends,
    pub(crate) pixels: Vec<PixelSums>,
    pub(crate) bad: BadSamples,
    pub(crate) work: u64,
}

impl Tile {
    /// A tile that will get the samples `samples` of each pixel of `rect`.
    pub fn new(rect: Rect, samples: Range<u32>) -> Result<Self, FilmError> {
        rect.check(MAX_TILE_PIXELS)?;
        let range = SampleRange::from(samples);
        if range.is_empty() {
            return Err(FilmError::EmptyRange(range));
        }
        let pixels = vec![PixelSums::default(); rect.area() as usize];
        Ok(Self { rect, ranges: vec![range], ends: OPEN, pixels, bad: BadSamples::default(), work: 0 })
    }

    /// A tile of `rect` from full-width strips that cover it from top to bottom, each with the samples `samples`: what
    /// several threads filled at the same time.
    /// - errors: strips that are not just these.
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
            whole.charge(strip.work);
        }
        if whole.pixels.len() as u64 != rect.area() {
            return Err(FilmError::OtherPixels { expected: rect, found: Rect { height: y - rect.y, ..rect } });
        }
        Ok(whole)
    }

    /// The pixels.
    pub fn rect(&self) -> Rect {
        self.rect
    }

    /// The sample ranges whose samples are in the sums, ascending.
    pub fn ranges(&self) -> &[SampleRange] {
        &self.ranges
    }

    /// For each half the sample from which on its samples do not count in the image.
    pub fn ends(&self) -> Ends {
        self.ends
    }

    /// Whether a half is held.
    pub(crate) fn is_held(&self) -> bool {
        self.ends != OPEN
    }

    /// Holds the samples of each half from `ends` on. A half that is held from an earlier sample on stays so.
    /// - errors: there are samples before and behind an end in one sum. The tile stays as it was.
    pub fn hold(&mut self, ends: Ends) -> Result<(), FilmError> {
        let ends = earlier(self.ends, ends);
        let is_new = |half: usize| ends[half] < self.ends[half];
        let mut held = [false; HALVES];
        for half in (0..HALVES).filter(|&half| is_new(half)) {
            held[half] = self.ranges.iter().all(|range| range.start >= ends[half]);
            if !held[half] && self.ranges.iter().any(|range| range.end > ends[half]) {
                return Err(FilmError::Corrupt("samples on both sides of the end of a half"));
            }
        }
        for half in (0..HALVES).filter(|&half| held[half]) {
            self.pixels.iter_mut().for_each(|pixel| pixel.hold(half));
        }
        self.ends = ends;
        Ok(())
    }

    /// Samples a pixel in all ranges.
    pub fn spp(&self) -> u64 {
        self.ranges.iter().map(|r| u64::from(r.len())).sum()
    }

    /// Account of the samples that were left out.
    pub fn bad(&self) -> &BadSamples {
        &self.bad
    }

    /// What the samples cost: rays traced for them, a count that is the same on every machine.
    pub fn work(&self) -> u64 {
        self.work
    }

    /// Adds to what the samples cost.
    pub fn charge(&mut self, rays: u64) {
        self.work = self.work.saturating_add(rays);
    }

    /// Sums of the pixels, row by row.
    pub fn pixels(&self) -> &[PixelSums] {
        &self.pixels
    }

    /// Sums of the film's pixel (`x`, `y`), which lies in the tile.
    pub(crate) fn pixel(&self, (x, y): (u32, u32)) -> &PixelSums {
        &self.pixels[((y - self.rect.y) * self.rect.width + (x - self.rect.x)) as usize]
    }

    /// Pixels one of whose sums has left its range and is a lower bound.
    pub fn saturated(&self) -> usize {
        let full = |p: &PixelSums| {
            let mut sums = p.color.as_flattened().iter().chain(&p.luminance);
            sums.any(|sum| sum.is_saturated()) || p.depth.is_saturated()
        };
        self.pixels.iter().filter(|p| full(p)).count()
    }

    /// Adds sample number `index` of the film's pixel (`x`, `y`), which must lie in the tile.
    ///
    /// A bad sample is counted, with its place, and changes no sum; returned is what makes it unusable.
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
    /// The union is keyed by sample range: ranges that are there already are the same samples, so merging them again changes
    /// nothing. Associative, commutative, idempotent (test `any_order_and_partition_gives_the_same_bytes`).
    /// What is held in one of them is held in both.
    /// - errors: other pixels; ranges that partly overlap; some ranges known and others new; samples before and behind an end in one
    ///   sum. The tile stays as it was.
    pub fn merge(&mut self, other: &Self) -> Result<Merged, FilmError> {
        if self.rect != other.rect {
            return Err(FilmError::OtherPixels { expected: self.rect, found: other.rect });
        }
        if other.ranges.iter().all(|r| self.ranges.binary_search(r).is_ok()) {
            return Ok(Merged::Known);
        }
        for &new in &other.ranges {
            if let Some(&old) = self.ranges.iter().find(|old| old.overlaps(new)) {
                return Err(FilmError::Overlap { rect: self.rect, old, new });
            }
        }
        let ends = earlier(self.ends, other.ends);
        let mut other = std::borrow::Cow::Borrowed(other);
        if other.ends != ends {
            other.to_mut().hold(ends)?;
        }
        self.hold(ends)?;
        self.ranges.extend_from_slice(&other.ranges);
        self.ranges.sort_unstable();
        self.pixels.iter_mut().zip(&other.pixels).for_each(|(mine, theirs)| mine.merge(theirs));
        self.bad.merge(&other.bad);
        self.charge(other.work);
        Ok(Merged::New)
    }
}

/// The earlier end of each half.
fn earlier(a: Ends, b: Ends) -> Ends {
    std::array::from_fn(|half| a[half].min(b[half]))
}

/// What a merge did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Merged {
    /// The samples were new and are counted now.
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
            SampleRange::joined(&ranges).map(|one| (one.start, one.end))
        };
        assert_eq!(joined(&[(0, 12)]), Some((0, 12)));
        assert_eq!(joined(&[(0, 1), (1, 7), (7, 12)]), Some((0, 12)));
        assert_eq!(joined(&[(3, 5), (5, 6)]), Some((3, 6)));
        for other in [&[][..], &[(0, 5), (6, 12)], &[(5, 6), (3, 5)], &[(0, 5), (4, 6)]] {
            assert_eq!(joined(other), None, "{other:?}");
        }
    }
}
