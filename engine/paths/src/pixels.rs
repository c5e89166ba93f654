//! Sums by pixel: luminance and its variance, length of the paths, and throughput at their ends.
//!
//! The sums cover all samples of one half of a pixel. They are integers, so the result does not depend on the order. A term is
//! rounded once, to the nearest unit, ties to even:
//!
//! | sum | unit | largest term |
//! | --- | --- | --- |
//! | luminance | 2^-16 cd/m2 | 2^32 cd/m2 |
//! | squares of the rounded luminances | 2^-32 cd2/m4 | |
//! | throughput at the path's end, of its greatest channel | 2^-12 | 2^8 |
//! | depth | 1 | |
//!
//! Sums saturate at the largest value of their type.

use crate::statistics::{LightStatistics, PortionKey};

/// Fraction bits of a luminance.
const LUMINANCE_BITS: i32 = 16;
/// Fraction bits of a throughput.
const THROUGHPUT_BITS: i32 = 12;
/// Largest term of the luminance, cd/m2.
const MAX_LUMINANCE: f32 = (1u64 << 32) as f32;
/// Largest term of the throughput.
const MAX_THROUGHPUT: f32 = (1u64 << 8) as f32;

/// Sums of some samples of one pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelSums {
    /// Number of samples, without bad ones.
    pub samples: u32,
    /// Number of intersections of their paths.
    pub depth: u32,
    /// Sum of the throughputs at the paths' ends, 2^-12.
    pub throughput: u32,
    /// Sum of the luminances, 2^-16 cd/m2.
    pub luminance: u64,
    /// Sum of the squared luminances, 2^-32 cd2/m4, the lower half first. Two words instead of a `u128` avoid padding for
    /// alignment.
    squares: [u64; 2],
}

/// Number of 4-byte words of the sums.
pub(crate) const WORDS: usize = 9;

impl PixelSums {
    /// Counts a sample.
    /// - `luminance`: cd/m2, finite, not negative;
    /// - `throughput`: at the path's end, not negative.
    #[inline]
    pub fn count(&mut self, luminance: f32, throughput: f32, depth: u32) {
        // In a double near this bias, the lowest bit of the mantissa is worth 1.
        const BIAS: f64 = (1u64 << 52) as f64;
        let units = |value: f32, bits: i32, most: f32| {
            (f64::from(value.clamp(0.0, most)) * f64::from(1u32 << bits) + BIAS).to_bits() - BIAS.to_bits()
        };
        let light = units(luminance, LUMINANCE_BITS, MAX_LUMINANCE);
        self.samples = self.samples.saturating_add(1);
        self.depth = self.depth.saturating_add(depth);
        let throughput = units(throughput, THROUGHPUT_BITS, MAX_THROUGHPUT);
        self.throughput = self.throughput.saturating_add(throughput as u32);
        self.luminance = self.luminance.saturating_add(light);
        self.set_squares(self.squares().saturating_add(u128::from(light) * u128::from(light)));
    }

    /// Adds the sums of other samples.
    pub fn merge(&mut self, other: &Self) {
        self.samples = self.samples.saturating_add(other.samples);
        self.depth = self.depth.saturating_add(other.depth);
        self.throughput = self.throughput.saturating_add(other.throughput);
        self.luminance = self.luminance.saturating_add(other.luminance);
        self.set_squares(self.squares().saturating_add(other.squares()));
    }

    fn squares(&self) -> u128 {
        u128::from(self.squares[0]) | u128::from(self.squares[1]) << 64
    }

    fn set_squares(&mut self, squares: u128) {
        self.squares = [squares as u64, (squares >> 64) as u64];
    }

    /// Returns the mean over the samples.
    fn mean(&self, sum: f64) -> f64 {
        sum / f64::from(self.samples)
    }

    /// Returns the sum of the squared differences from the mean, (cd/m2)^2. It is exact except for the last division.
    fn deviation(&self) -> f64 {
        let (n, sum) = (u128::from(self.samples), u128::from(self.luminance));
        // (n Q - S^2) / n. A value that overflows saturates, and so does the difference.
        let spread = self.squares().saturating_mul(n).saturating_sub(sum.saturating_mul(sum));
        spread as f64 / n.max(1) as f64 / (1u64 << (2 * LUMINANCE_BITS)) as f64
    }

    pub(crate) fn words(&self) -> [u32; WORDS] {
        let [low, high] = self.squares;
        let long = |value: u64| [value as u32, (value >> 32) as u32];
        let ([a, b], [c, d], [e, f]) = (long(self.luminance), long(low), long(high));
        [self.samples, self.depth, self.throughput, a, b, c, d, e, f]
    }

    pub(crate) fn from_words([samples, depth, throughput, a, b, c, d, e, f]: [u32; WORDS]) -> Self {
        let long = |low: u32, high: u32| u64::from(low) | u64::from(high) << 32;
        Self { samples, depth, throughput, luminance: long(a, b), squares: [long(c, d), long(e, f)] }
    }
}

/// A pixel of the image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pixel {
    /// Number of samples that count, without bad ones.
    pub samples: u64,
    /// Mean luminance, cd/m2, as in the image: from the means of both halves.
    pub luminance: f64,
    /// Variance of the luminance of a sample, (cd/m2)^2, about the mean of its half. It is 0 if no half has two samples.
    pub variance: f64,
    /// Mean depth of the samples' paths.
    pub depth: f64,
    /// Mean throughput at the ends of the paths.
    pub throughput: f64,
}

impl Pixel {
    fn from_halves([a, b]: [PixelSums; 2]) -> Self {
        let halves: Vec<PixelSums> = [a, b].into_iter().filter(|half| half.samples > 0).collect();
        let mean = |sum: &dyn Fn(&PixelSums) -> f64| {
            halves.iter().map(|half| half.mean(sum(half))).sum::<f64>() / halves.len().max(1) as f64
        };
        let samples: u64 = halves.iter().map(|half| u64::from(half.samples)).sum();
        // Degrees of freedom.
        let free = samples - halves.len() as u64;
        let deviation: f64 = halves.iter().map(PixelSums::deviation).sum();
        Self {
            samples,
            luminance: mean(&|half| half.luminance as f64) / f64::from(1u32 << LUMINANCE_BITS),
            variance: if free == 0 { 0.0 } else { deviation / free as f64 },
            depth: mean(&|half| f64::from(half.depth)),
            throughput: mean(&|half| f64::from(half.throughput)) / f64::from(1u32 << THROUGHPUT_BITS),
        }
    }
}

/// All pixels of a film.
#[derive(Clone, Debug, PartialEq)]
pub struct PixelMaps {
    /// Width and height, pixels.
    pub film: [u32; 2],
    /// Sums of each half, row by row.
    sums: Vec<[PixelSums; 2]>,
}

impl PixelMaps {
    /// Computes the pixels of statistics, preferably of those that [count](LightStatistics::into_image_samples).
    pub fn from_statistics(statistics: &LightStatistics) -> Self {
        let scope = &statistics.scope;
        let mut sums = vec![[PixelSums::default(); 2]; scope.pixel_count() as usize];
        for (key, counters) in &statistics.portions {
            for (pixel, own) in scope.tile_pixels(key.tile).zip(&counters.pixels) {
                sums[pixel as usize][usize::from(key.half)].merge(own);
            }
        }
        Self { film: scope.film, sums }
    }

    /// Returns the pixels, row by row. Pixels without samples are 0.
    pub fn pixels(&self) -> impl ExactSizeIterator<Item = Pixel> + '_ {
        self.sums.iter().map(|sums| Pixel::from_halves(*sums))
    }

    /// Returns the mean luminance of all samples of a pixel except one, cd/m2. `None`: the pixel has no other sample.
    /// - `pixel`: row-major index of the pixel;
    /// - `luminance`: luminance of the excluded sample, cd/m2.
    pub fn mean_of_others(&self, pixel: u32, luminance: f32) -> Option<f64> {
        let [a, b] = self.sums.get(pixel as usize)?;
        let samples = u64::from(a.samples) + u64::from(b.samples);
        let sum = (a.luminance as f64 + b.luminance as f64) / f64::from(1u32 << LUMINANCE_BITS);
        let others = (sum - f64::from(luminance)).max(0.0);
        (samples > 1).then(|| others / (samples - 1) as f64)
    }
}

/// Checks that a portion has exactly the pixels of its tile, and no more samples of each than its key says.
pub(crate) fn are_valid(key: PortionKey, area: u64, good: u64, pixels: &[PixelSums]) -> bool {
    pixels.len() as u64 == area
        && pixels.iter().all(|pixel| pixel.samples <= key.samples())
        && pixels.iter().map(|pixel| u64::from(pixel.samples)).sum::<u64>() == good
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_is_of_the_halves_and_the_variance_about_each() {
        let sums_of = |values: &[f32]| {
            let mut sums = PixelSums::default();
            values.iter().for_each(|value| sums.count(*value, value / 4.0, 3));
            sums
        };
        let pixel = Pixel::from_halves([sums_of(&[1.0, 2.0, 6.0]), sums_of(&[4.0, 6.0])]);
        assert_eq!((pixel.samples, pixel.luminance, pixel.depth), (5, 4.0, 3.0));
        assert_eq!((pixel.variance, pixel.throughput), ((14.0 + 2.0) / 3.0, 1.0));
        let alone = Pixel::from_halves([sums_of(&[1.0, 3.0]), PixelSums::default()]);
        assert_eq!((alone.samples, alone.luminance, alone.variance), (2, 2.0, 2.0));
        assert_eq!(Pixel::from_halves([sums_of(&[3.0]), sums_of(&[5.0])]).variance, 0.0);
        assert_eq!(Pixel::from_halves(Default::default()), Pixel::default());
    }

    #[test]
    fn overflowing_pixel_sums_saturate_in_any_order() {
        let mut bright = PixelSums::default();
        bright.count(f32::MAX, f32::MAX, u32::MAX);
        assert_eq!((bright.luminance, bright.throughput, bright.depth), (1 << 48, 1 << 20, u32::MAX));
        let mut dim = PixelSums::default();
        dim.count(2.0, 0.5, 1);
        let mut parts = [(bright, dim), (dim, bright)].map(|(mut a, b)| {
            a.merge(&b);
            a
        });
        assert_eq!(parts[0], parts[1]);
        assert_eq!(parts[0].depth, u32::MAX);
        for _ in 0..80 {
            let own = parts[0];
            parts[0].merge(&own);
        }
        assert_eq!((parts[0].luminance, parts[0].squares(), parts[0].samples), (u64::MAX, u128::MAX, u32::MAX));
        assert_eq!(PixelSums::from_words(parts[0].words()), parts[0]);
        assert!(Pixel::from_halves(parts).variance.is_finite());
    }
}
