//! Vectors of eight floats or integers, and the choice of the instruction set at run time.
//!
//! A [`Level`] holds the token of the best instruction set that the processor has. Vectors can only be made from a token, so code
//! for an instruction set cannot be reached without it. All instruction sets do the same IEEE operations (no fused multiply-add),
//! so code that is written once over [`Simd`] gives the same bits on all of them.
#![deny(missing_docs)]
#![expect(unsafe_code, reason = "measured: intrinsics trace 1.6 times the rays of the portable twin")]

#[cfg(target_arch = "x86_64")]
mod avx2;
mod portable;

use std::mem::MaybeUninit;
use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Sub};

/// Number of lanes of a vector.
pub const WIDTH: usize = 8;

/// Eight floats, aligned for one vector load.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(32))]
pub struct Lanes(pub [f32; WIDTH]);

impl Lanes {
    /// All lanes 0.
    pub const ZERO: Self = Self([0.0; WIDTH]);
}

/// Eight floats or eight lane masks. `min` and `max` return their second operand when either is NaN.
pub trait Vector:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + BitAnd<Output = Self>
    + BitOr<Output = Self>
    + BitXor<Output = Self>
{
    /// Returns the lesser of each pair of lanes.
    fn min(self, other: Self) -> Self;
    /// Returns the greater of each pair of lanes.
    fn max(self, other: Self) -> Self;
    /// Returns the mask of `self <= other`; false for NaN, like the other comparisons.
    fn le(self, other: Self) -> Self;
    /// Returns the mask of `self < other`.
    fn lt(self, other: Self) -> Self;
    /// Returns the mask of `self == other`.
    fn equal(self, other: Self) -> Self;
    /// Returns the square root of each lane.
    fn sqrt(self) -> Self;
    /// Selects lanes: `yes` where the mask `self` is set, `no` elsewhere.
    fn select(self, yes: Self, no: Self) -> Self;
    /// Returns the sign bits, lane 0 lowest.
    fn signs(self) -> u32;
    /// Stores the lanes in memory.
    fn lanes(self) -> Lanes;
}

/// One integer of 32 bits, or eight. Arithmetic wraps.
pub trait Integers: Copy {
    /// Returns `value` in each lane.
    fn constant(self, value: u32) -> Self;
    /// Returns the sum.
    fn plus(self, other: Self) -> Self;
    /// Returns the lower half of the product.
    fn times(self, other: Self) -> Self;
    /// Returns the bits that are set in both.
    fn and(self, other: Self) -> Self;
    /// Returns the bits that are set in any of both.
    fn or(self, other: Self) -> Self;
    /// Returns the bits that are set in one of both.
    fn xor(self, other: Self) -> Self;
    /// Shifts toward higher bits.
    fn shifted_up<const BITS: i32>(self) -> Self;
    /// Shifts toward lower bits, and fills with 0.
    fn shifted_down<const BITS: i32>(self) -> Self;
    /// Returns the bits in reverse order.
    fn reversed(self) -> Self;
}

impl Integers for u32 {
    #[inline(always)]
    fn constant(self, value: u32) -> Self {
        value
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        self.wrapping_add(other)
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        self.wrapping_mul(other)
    }
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        self & other
    }
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        self | other
    }
    #[inline(always)]
    fn xor(self, other: Self) -> Self {
        self ^ other
    }
    #[inline(always)]
    fn shifted_up<const BITS: i32>(self) -> Self {
        self << BITS
    }
    #[inline(always)]
    fn shifted_down<const BITS: i32>(self) -> Self {
        self >> BITS
    }
    #[inline(always)]
    fn reversed(self) -> Self {
        self.reverse_bits()
    }
}

/// An instruction set. Only this crate can implement it: the caller's `unsafe` code trusts the number that [`Simd::compress`]
/// returns.
pub trait Simd: Copy + sealed::Sealed {
    /// Vector type of this instruction set.
    type V: Vector;
    /// Vector of integers.
    type I: Integers;
    /// Loads integers from memory.
    fn integers(self, lanes: &[u32; WIDTH]) -> Self::I;
    /// Converts integers below 2^31 to floats, with rounding.
    fn to_floats(self, integers: Self::I) -> Self::V;
    /// Returns the bits of floats.
    fn bits(self, floats: Self::V) -> Self::I;
    /// Returns the floats with these bits.
    fn with_bits(self, bits: Self::I) -> Self::V;
    /// Makes a vector with `x` in every lane.
    fn splat(self, x: f32) -> Self::V;
    /// Makes a mask from bits, lane 0 lowest.
    fn mask(self, bits: u32) -> Self::V;
    /// Loads lanes from memory.
    fn load(self, lanes: &Lanes) -> Self::V;
    /// Packs the lanes that `mask` selects. Each becomes one entry of `room`, with the lane of `high` in its upper 32 bits and the
    /// lane of `low` in its lower 32 bits. Entries are written from the first on. Returns the number of written entries.
    fn compress(self, mask: u32, high: Self::V, low: &[u32; WIDTH], room: &mut [MaybeUninit<u64>; WIDTH]) -> usize;
}

mod sealed {
    /// Prevents other crates from implementing [`super::Simd`].
    pub trait Sealed {}
}

/// Iterates over the lanes whose bits are set in a mask. Kernels need a loop instead: closures are not compiled for their instruction
/// set.
#[inline(always)]
pub fn lanes_of(mut mask: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = (mask != 0).then(|| mask.trailing_zeros() as usize % WIDTH);
        mask &= mask.wrapping_sub(1);
        lane
    })
}

/// Work that is compiled for each instruction set.
pub trait Kernel {
    /// Result of the work.
    type Output;
    /// Does the work. Implementations must be `#[inline(always)]`, otherwise they are compiled for the base instruction set.
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}

/// The instruction set to use.
#[derive(Clone, Copy, Debug)]
pub struct Level(Kind);

#[derive(Clone, Copy, Debug)]
enum Kind {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2(avx2::Token),
}

impl Default for Level {
    fn default() -> Self {
        Self::detect()
    }
}

impl Level {
    /// Plain arrays, on every processor.
    pub const PORTABLE: Self = Self(Kind::Portable);

    /// Returns the best level that this processor has.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if let Some(token) = avx2::Token::detect() {
            return Self(Kind::Avx2(token));
        }
        Self::PORTABLE
    }

    /// Runs `kernel` with this instruction set.
    #[inline(always)]
    pub fn run<T: Kernel>(self, kernel: T) -> T::Output {
        match self.0 {
            Kind::Portable => kernel.run(portable::Token),
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2(token) => token.run(kernel),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Task that returns the bits of every vector operation on two numbers per lane.
    struct All<'a>(&'a Lanes, &'a Lanes);

    impl Kernel for All<'_> {
        type Output = Vec<u64>;

        #[inline(always)]
        fn run<S: Simd>(self, simd: S) -> Vec<u64> {
            let (a, b) = (simd.load(self.0), simd.load(self.1));
            let less = a.lt(b);
            let vectors = [
                a + b,
                a - b,
                a * b,
                a / b,
                a.min(b),
                a.max(b),
                a.le(b) & a,
                a.equal(b) | b,
                a.sqrt(),
                less.select(a, b),
                simd.splat(3.0) * a,
                a ^ simd.splat(-0.0),
                simd.mask(0xa6) & a,
            ];
            // The bits of a NaN may differ between instruction sets, but NaN must stay NaN.
            let bits = |x: f32| u64::from(if x.is_nan() { u32::MAX } else { x.to_bits() });
            let mut out: Vec<_> = vectors.iter().flat_map(|v| v.lanes().0.map(bits)).collect();
            out.push(u64::from(less.signs()));
            let (i, j) =
                (simd.bits(a), simd.integers(&[0, 1, u32::MAX, 0x8000_0001, 12_345, 0x00ff_00ff, 77, 1 << 24]));
            let integers = [
                i.constant(9),
                i.plus(j),
                i.times(j),
                i.and(j),
                i.or(j),
                i.xor(j),
                j.shifted_up::<5>(),
                j.shifted_down::<5>(),
                i.xor(j).reversed(),
                simd.bits(simd.to_floats(i.shifted_down::<1>())),
            ];
            for v in integers {
                // Halves of the bits are whole numbers that a float holds exactly.
                for half in [v.and(v.constant(0xffff)), v.shifted_down::<16>()] {
                    out.extend(simd.to_floats(half).lanes().0.map(|x| u64::from(x as u32)));
                }
                out.push(u64::from(simd.with_bits(v).signs()));
            }
            for mask in 0..256 {
                let mut room = [const { MaybeUninit::uninit() }; WIDTH];
                let count = simd.compress(mask, a, &[0, 1, 2, 3, 4, 5, 6, 7], &mut room);
                // SAFETY: the first `count` entries were written.
                out.extend(room[..count].iter().map(|entry| unsafe { entry.assume_init() }));
                out.push(count as u64);
            }
            out
        }
    }

    #[test]
    fn every_instruction_set_gives_the_same_bits() {
        let a = Lanes([0.0, -0.0, 1.5, -2.25, f32::NAN, f32::INFINITY, 1e-42, 3.0e38]);
        let b = Lanes([-0.0, 3.0, 1.5, f32::NAN, 1.0, f32::INFINITY, 7.0, -3.0e38]);
        for (a, b) in [(&a, &b), (&b, &a), (&a, &a)] {
            assert_eq!(Level::detect().run(All(a, b)), Level::PORTABLE.run(All(a, b)));
        }
    }

    #[test]
    fn compressed_lanes_are_those_of_the_mask_in_order() {
        let said = Level::detect().run(All(&Lanes([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]), &Lanes::ZERO));
        let entry = |x: f32, lane: u64| u64::from(x.to_bits()) << 32 | lane;
        let mut expected: Vec<_> = (0..8u8).map(|lane| entry(f32::from(lane) + 1.0, u64::from(lane))).collect();
        expected.push(8);
        assert_eq!(said[said.len() - 9..], expected);
    }
}
