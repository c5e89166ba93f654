//! Integer hashes: the source of all randomness except for Sobol points.

use femc_simd::Integers;

/// Mixes 32 bits bijectively (\[wellons2018\], `lowbias32`).
#[inline(always)]
pub fn mix32<I: Integers>(x: I) -> I {
    let x = x.xor(x.shifted_down::<16>());
    let x = x.times(x.constant(0x7feb_352d));
    let x = x.xor(x.shifted_down::<15>());
    let x = x.times(x.constant(0x846c_a68b));
    x.xor(x.shifted_down::<16>())
}

/// Mixes 64 bits bijectively (the finalizer of SplitMix64, \[steele2014\]).
#[inline]
pub fn mix64(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Hashes a sequence of words; the order matters.
#[inline]
pub fn combine(words: &[u64]) -> u64 {
    hash_prefix(words).finish(&[])
}

/// Hashes the first words of a sequence. Sequences with a common prefix share this work.
#[inline]
pub fn hash_prefix(words: &[u64]) -> HashPrefix {
    HashPrefix(0x9e37_79b9_7f4a_7c15).with_words(words)
}

/// Hash of the first words of a sequence, see [`hash_prefix`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HashPrefix(u64);

impl HashPrefix {
    #[inline]
    fn with_words(self, words: &[u64]) -> Self {
        Self(words.iter().fold(self.0, |h, w| mix64(h ^ w).wrapping_add(0x9e37_79b9_7f4a_7c15)))
    }

    /// Returns the [`combine`] hash of the first words followed by `words`.
    #[inline]
    pub fn finish(self, words: &[u64]) -> u64 {
        mix64(self.with_words(words).0)
    }
}

/// Converts the 24 high bits of `x` to a float in [0, 1).
#[inline]
pub fn unit_f32(x: u32) -> f32 {
    (x >> 8) as f32 * (1.0 / 16_777_216.0)
}
