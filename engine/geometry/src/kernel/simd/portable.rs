//! The portable twin: plain arrays, of which the compiler makes what vectors it can (SSE2, NEON).

use super::{
    Simd, Vector,
    stack::{Entry, Stack},
};
use crate::tree::{Child, Lanes, WIDTH};
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Sub};

/// Plain arrays: the compiler makes what vectors it can of them.
#[derive(Clone, Copy, Debug)]
pub struct Token;

#[derive(Clone, Copy)]
pub struct Floats([f32; WIDTH]);

#[inline(always)]
fn zip(a: Floats, b: Floats, f: impl Fn(f32, f32) -> f32) -> Floats {
    Floats(std::array::from_fn(|i| f(a.0[i], b.0[i])))
}

#[inline(always)]
fn truth(b: bool) -> f32 {
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
        zip(self, other, |a, b| truth(a <= b))
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Self {
        zip(self, other, |a, b| truth(a < b))
    }
    #[inline(always)]
    fn equal(self, other: Self) -> Self {
        zip(self, other, |a, b| truth(a == b))
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

impl Simd for Token {
    type V = Floats;
    #[inline(always)]
    fn splat(self, x: f32) -> Floats {
        Floats([x; WIDTH])
    }
    #[inline(always)]
    fn load(self, lanes: &Lanes) -> Floats {
        Floats(lanes.0)
    }
    #[inline(always)]
    fn push(self, mut mask: u32, distances: Floats, children: &[Child; WIDTH], stack: &mut Stack) -> usize {
        let count = mask.count_ones() as usize;
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize % WIDTH;
            stack.push(Entry::new(distances.0[lane], children[lane]));
            mask &= mask - 1;
        }
        count
    }
}
