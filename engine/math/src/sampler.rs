//! Owen-scrambled Sobol points, keyed by (seed, frame, pixel, sample, dimension).
//!
//! The samples of a pixel go in turn to [`REPLICATES`] **replicates**, which are independent of each other. The differences of the
//! replicates' means give an unbiased estimate of the variance of the pixel's mean. A single stratified set does not allow this,
//! because its halves depend on each other. Within a replicate, each pair of dimensions is a (0,2)-sequence. Hashes of (seed,
//! frame, pixel, replicate, dimension) shuffle its index order and scramble its digits (\[burley2020\]). Pairs are therefore
//! independent of each other (padding), and each is stratified over every power-of-two run of a replicate's samples. A stream holds
//! no state but its dimension counter, so any sample of any pixel can be redrawn anywhere.

use crate::hash::{mix32, mix64, unit_f32};
use femc_simd::{Integers, Simd, WIDTH};

/// Number of independent parts of a pixel's samples.
pub const REPLICATES: usize = 4;

/// Returns the replicate of sample number `sample` of a pixel.
#[inline]
pub const fn replicate_of(sample: u32) -> usize {
    sample as usize % REPLICATES
}

/// The random numbers of one sample of one pixel.
#[derive(Clone, Copy, Debug)]
pub struct SampleStream {
    key: u64,
    /// Index in the replicate, with its digits reversed.
    reversed_index: u32,
    dimension: u32,
}

/// Scrambles each binary digit of a fraction by the digits above it. The fraction has its digits reversed, before and after
/// (\[laine2011\], constants of \[vegdahl2021\]).
#[inline(always)]
fn scramble_reversed<I: Integers>(x: I, seed: I) -> I {
    let x = x.xor(x.times(x.constant(0x3d20_adea)));
    let x = x.plus(seed).times(seed.shifted_down::<16>().or(x.constant(1)));
    let x = x.xor(x.times(x.constant(0x0552_6c56)));
    x.xor(x.times(x.constant(0x53a2_2864)))
}

/// Computes the second Sobol dimension (Pascal's triangle modulo 2) of `index`, as the digit-reversed 32-bit fraction.
#[inline(always)]
fn pascal_reversed<I: Integers>(x: I) -> I {
    // Five shift-and-xor steps apply the generator matrix C[i][j] = binomial(j, i) mod 2, least significant digit first.
    let x = x.xor(x.and(x.constant(0xaaaa_aaaa)).shifted_down::<1>());
    let x = x.xor(x.and(x.constant(0xcccc_cccc)).shifted_down::<2>());
    let x = x.xor(x.and(x.constant(0xf0f0_f0f0)).shifted_down::<4>());
    let x = x.xor(x.and(x.constant(0xff00_ff00)).shifted_down::<8>());
    x.xor(x.and(x.constant(0xffff_0000)).shifted_down::<16>())
}

/// Returns the digit-reversed 32-bit fraction of a number.
/// - `reversed_index`: index in the replicate with its digits reversed;
/// - `shuffle`, `seed`: the halves of the dimension's hash.
#[inline(always)]
fn scrambled_1d<I: Integers>(reversed_index: I, shuffle: I, seed: I) -> I {
    // The shuffled index is the digit-reversed form of its radical inverse.
    scramble_reversed(scramble_reversed(reversed_index, shuffle).reversed(), seed)
}

/// Returns the digit-reversed 32-bit fractions of a point, as [`scrambled_1d`] does.
#[inline(always)]
fn scrambled_2d<I: Integers>(reversed_index: I, shuffle: I, seed: I) -> [I; 2] {
    let shuffled = scramble_reversed(reversed_index, shuffle).reversed();
    let other = mix32(seed.xor(seed.constant(0x5bd1_e995)));
    [scramble_reversed(shuffled, seed), scramble_reversed(pascal_reversed(shuffled), other)]
}

/// The next number of several streams.
#[derive(Clone, Debug, Default)]
pub struct StreamLanes {
    reversed_index: [u32; WIDTH],
    shuffle: [u32; WIDTH],
    seed: [u32; WIDTH],
}

impl StreamLanes {
    /// Replaces a stream.
    /// - `dimension`: dimension of the number.
    #[inline(always)]
    pub fn set(&mut self, lane: usize, stream: &SampleStream, dimension: u32) {
        let hash = stream.hash(dimension);
        self.reversed_index[lane] = stream.reversed_index;
        self.shuffle[lane] = hash as u32;
        self.seed[lane] = (hash >> 32) as u32;
    }

    #[inline(always)]
    fn load<S: Simd>(&self, simd: S) -> [S::I; 3] {
        [simd.integers(&self.reversed_index), simd.integers(&self.shuffle), simd.integers(&self.seed)]
    }

    /// Draws a number for each stream: [`SampleStream::next_1d`].
    #[inline(always)]
    pub fn next_1d<S: Simd>(&self, simd: S) -> S::V {
        let [reversed_index, shuffle, seed] = self.load(simd);
        unit_floats(simd, scrambled_1d(reversed_index, shuffle, seed))
    }

    /// Draws a point for each stream: [`SampleStream::next_2d`].
    #[inline(always)]
    pub fn next_2d<S: Simd>(&self, simd: S) -> [S::V; 2] {
        let [reversed_index, shuffle, seed] = self.load(simd);
        let [x, y] = scrambled_2d(reversed_index, shuffle, seed);
        [unit_floats(simd, x), unit_floats(simd, y)]
    }
}

#[inline(always)]
fn unit_floats<S: Simd>(simd: S, reversed: S::I) -> S::V {
    simd.to_floats(reversed.reversed().shifted_down::<8>()) * simd.splat(1.0 / 16_777_216.0)
}

impl SampleStream {
    /// Creates the stream of `sample` in `pixel` (row-major index in the whole film) of `frame`.
    #[inline]
    pub fn new(seed: u64, frame: u32, pixel: u32, sample: u32) -> Self {
        let pixel_key = mix64(mix64(seed ^ 0x6a09_e667_f3bc_c908) ^ ((u64::from(frame) << 32) | u64::from(pixel)));
        let key = mix64(pixel_key.wrapping_add(1 + replicate_of(sample) as u64));
        Self { key, reversed_index: (sample / REPLICATES as u32).reverse_bits(), dimension: 0 }
    }

    /// Returns a stream that is independent of this one and of the streams of other branches.
    #[inline]
    pub fn branch(self, number: u64) -> Self {
        Self { key: mix64(self.key ^ mix64(number.wrapping_add(0xbb67_ae85_84ca_a73b))), ..self }
    }

    /// Continues at `dimension`. Decisions of a path start at fixed dimensions, so one branch does not shift another.
    #[inline]
    pub fn seek(&mut self, dimension: u32) {
        self.dimension = dimension;
    }

    /// Returns the dimension that the next draw uses.
    #[inline]
    pub fn dimension(&self) -> u32 {
        self.dimension
    }

    /// Draws the next number in [0, 1). Takes one dimension.
    #[inline]
    pub fn next_1d(&mut self) -> f32 {
        let h = self.hash(self.dimension);
        self.dimension += 1;
        unit_f32(scrambled_1d(self.reversed_index, h as u32, (h >> 32) as u32).reverse_bits())
    }

    /// Draws the next point in [0, 1)^2. Takes two dimensions.
    #[inline]
    pub fn next_2d(&mut self) -> [f32; 2] {
        let h = self.hash(self.dimension);
        self.dimension += 2;
        let [x, y] = scrambled_2d(self.reversed_index, h as u32, (h >> 32) as u32);
        // One reversal of 64 digits costs as much as one of 32.
        let both = (u64::from(x) << 32 | u64::from(y)).reverse_bits();
        [unit_f32(both as u32), unit_f32((both >> 32) as u32)]
    }

    #[inline(always)]
    fn hash(&self, dimension: u32) -> u64 {
        mix64(self.key.wrapping_add(u64::from(dimension).wrapping_mul(0x9e37_79b9_7f4a_7c15)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn power_of_two_replicate_runs_stratify_elementary_intervals() {
        for pixel in 0..20 {
            for log in 0..=8u32 {
                let n = 1usize << log;
                let replicate = pixel % REPLICATES as u32;
                let sample = |at: usize| at as u32 * REPLICATES as u32 + replicate;
                assert!((0..n).all(|at| replicate_of(sample(at)) == replicate as usize));
                let points: Vec<[f32; 2]> =
                    (0..n).map(|at| SampleStream::new(7, 3, pixel, sample(at)).next_2d()).collect();
                for a in 0..=log {
                    let (nx, ny) = (1usize << a, 1usize << (log - a));
                    let mut seen = vec![false; n];
                    for p in &points {
                        let cell = (p[0] * nx as f32) as usize + nx * (p[1] * ny as f32) as usize;
                        assert!(!seen[cell], "two points share an elementary interval {nx}x{ny}, pixel {pixel}");
                        seen[cell] = true;
                    }
                }
            }
        }
    }

    #[test]
    fn pairs_of_dimensions_and_pixels_are_independent() {
        // Correlation between dimensions 0 and 2 over pixels, and between neighboring pixels, at the 4-sigma level.
        let n = 20_000;
        let (mut dims, mut pixels) = (0.0f64, 0.0f64);
        for pixel in 0..n {
            let mut s = SampleStream::new(1, 1, pixel, 5);
            let a = s.next_2d()[0];
            let b = s.next_2d()[0];
            let c = SampleStream::new(1, 1, pixel + 1, 5).next_2d()[0];
            dims += (f64::from(a) - 0.5) * (f64::from(b) - 0.5) * 12.0;
            pixels += (f64::from(a) - 0.5) * (f64::from(c) - 0.5) * 12.0;
        }
        let bound = 4.0 * f64::from(n).sqrt();
        assert!(dims.abs() < bound && pixels.abs() < bound, "{dims} {pixels} against {bound}");
    }

    /// Correlations of the first numbers, over pixels, at the 4-sigma level.
    #[test]
    fn branches_are_independent_of_their_stream_and_of_each_other() {
        let n = 20_000;
        let mut sums = [0.0f64; 3];
        for pixel in 0..n {
            let stream = SampleStream::new(1, 1, pixel, 5);
            let centered = |mut stream: SampleStream| f64::from(stream.next_1d()) - 0.5;
            let [own, one, two] = [stream, stream.branch(1), stream.branch(2)].map(centered);
            sums[0] += own * one * 12.0;
            sums[1] += one * two * 12.0;
            sums[2] += one * 12f64.sqrt();
        }
        assert!(sums.iter().all(|sum| sum.abs() < 4.0 * f64::from(n).sqrt()), "{sums:?}");
    }

    #[test]
    fn replicates_are_independent_though_each_is_stratified() {
        // Each replicate's mean of the first coordinate deviates from 1/2 by about (12 n^3)^-1/2. Over pixels, the product of two
        // such deviations has mean 0, and the square of one has the variance of stratified points, not of random ones.
        let (pixels, n) = (10_000, 8u32);
        let (mut product, mut squared, mut of_product) = (0.0f64, 0.0f64, 0.0f64);
        for pixel in 0..pixels {
            let mean = |replicate: u32| {
                let x = (0..n).map(|at| SampleStream::new(3, 1, pixel, at * REPLICATES as u32 + replicate).next_1d());
                x.map(f64::from).sum::<f64>() / f64::from(n) - 0.5
            };
            let (a, b) = (mean(pixel % 4), mean((pixel + 1 + pixel / 4 % 3) % 4));
            product += a * b;
            of_product += (a * b).powi(2);
            squared += a * a;
        }
        let variance = squared / f64::from(pixels);
        assert!((variance * 12.0 * f64::from(n).powi(3) - 1.0).abs() < 0.1, "{variance}");
        assert!(product.abs() < 4.0 * of_product.sqrt(), "{product}");
    }

    #[test]
    fn a_mean_over_scrambles_is_unbiased() {
        let mut sum = 0.0f64;
        let n = 40_000;
        for pixel in 0..n {
            let x = SampleStream::new(11, 0, pixel, 0).next_1d();
            assert!((0.0..1.0).contains(&x));
            sum += f64::from(x);
        }
        assert!((sum / f64::from(n) - 0.5).abs() < 4.0 / (12.0f64 * f64::from(n)).sqrt());
    }
}
