//! The portable instruction set: plain arrays, which the compiler vectorizes where it can (SSE2, NEON).

use super::{Integers, Lanes, Simd, Vector, WIDTH, sealed::Sealed};
use std::mem::MaybeUninit;
use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Sub};

/// Plain arrays, which the compiler vectorizes where it can.
#[derive(Clone, Copy, Debug)]
pub struct Token;

#[derive(Clone, Copy)]
pub struct Floats([f32; WIDTH]);

#[derive(Clone, Copy)]
pub struct Whole([u32; WIDTH]);

impl Integers for Whole {
    #[inline(always)]
    fn constant(self, value: u32) -> Self {
        Self([value; WIDTH])
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i].plus(other.0[i])))
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i].times(other.0[i])))
    }
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i].and(other.0[i])))
    }
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i].or(other.0[i])))
    }
    #[inline(always)]
    fn xor(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i].xor(other.0[i])))
    }
    #[inline(always)]
    fn shifted_up<const BITS: i32>(self) -> Self {
        Self(self.0.map(|x| x << BITS))
    }
    #[inline(always)]
    fn shifted_down<const BITS: i32>(self) -> Self {
        Self(self.0.map(|x| x >> BITS))
    }
    #[inline(always)]
    fn reversed(self) -> Self {
        Self(self.0.map(u32::reverse_bits))
    }
}

#[inline(always)]
fn zip(a: Floats, b: Floats, f: impl Fn(f32, f32) -> f32) -> Floats {
    Floats(std::array::from_fn(|i| f(a.0[i], b.0[i])))
}

#[inline(always)]
fn lane_mask(b: bool) -> f32 {
    f32::from_bits(if b { u32::MAX } else { 0 })
}

macro_rules! operators {
    ($($trait:ident $method:ident $f:expr;)*) => {$(
        impl $trait for Floats {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                zip(self, other, $f)
            }
        }
    )*};
}

operators! {
    Add add |a, b| a + b;
    Sub sub |a, b| a - b;
    Mul mul |a, b| a * b;
    Div div |a, b| a / b;
    BitAnd bitand |a, b| f32::from_bits(a.to_bits() & b.to_bits());
    BitOr bitor |a, b| f32::from_bits(a.to_bits() | b.to_bits());
    BitXor bitxor |a, b| f32::from_bits(a.to_bits() ^ b.to_bits());
}

impl Vector for Floats {
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        zip(self, other, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        zip(self, other, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn le(self, other: Self) -> Self {
        zip(self, other, |a, b| lane_mask(a <= b))
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Self {
        zip(self, other, |a, b| lane_mask(a < b))
    }
    #[inline(always)]
    fn equal(self, other: Self) -> Self {
        zip(self, other, |a, b| lane_mask(a == b))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.map(f32::sqrt))
    }
    #[inline(always)]
    fn select(self, yes: Self, no: Self) -> Self {
        Self(std::array::from_fn(|i| if self.0[i].to_bits() >> 31 == 1 { yes.0[i] } else { no.0[i] }))
    }
    #[inline(always)]
    fn signs(self) -> u32 {
        self.0.iter().enumerate().fold(0, |m, (i, x)| m | (x.to_bits() >> 31) << i)
    }
    #[inline(always)]
    fn lanes(self) -> Lanes {
        Lanes(self.0)
    }
}

impl Sealed for Token {}

impl Simd for Token {
    type V = Floats;
    type I = Whole;
    #[inline(always)]
    fn integers(self, lanes: &[u32; WIDTH]) -> Whole {
        Whole(*lanes)
    }
    #[inline(always)]
    fn to_floats(self, integers: Whole) -> Floats {
        Floats(integers.0.map(|x| x as f32))
    }
    #[inline(always)]
    fn bits(self, floats: Floats) -> Whole {
        Whole(floats.0.map(f32::to_bits))
    }
    #[inline(always)]
    fn with_bits(self, bits: Whole) -> Floats {
        Floats(bits.0.map(f32::from_bits))
    }
    #[inline(always)]
    fn splat(self, x: f32) -> Floats {
        Floats([x; WIDTH])
    }
    #[inline(always)]
    fn mask(self, bits: u32) -> Floats {
        Floats(std::array::from_fn(|i| lane_mask(bits >> i & 1 == 1)))
    }
    #[inline(always)]
    fn load(self, lanes: &Lanes) -> Floats {
        Floats(lanes.0)
    }
    #[inline(always)]
    fn compress(self, mask: u32, high: Floats, low: &[u32; WIDTH], room: &mut [MaybeUninit<u64>; WIDTH]) -> usize {
        let mut mask = mask & 255;
        let mut count = 0;
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize % WIDTH;
            room[count % WIDTH].write(u64::from(high.0[lane].to_bits()) << 32 | u64::from(low[lane]));
            count += 1;
            mask &= mask - 1;
        }
        count
    }
}
