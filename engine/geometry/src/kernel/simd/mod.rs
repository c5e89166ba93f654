//! Vectors of eight floats, and the choice of the instruction set at run time.
//!
//! A [`Level`] holds the token of the best instruction set that the processor has; tokens are what vectors are made from, so code for an
//! instruction set cannot be reached without it.

#![expect(
    unsafe_code,
    reason = "measured: intrinsics trace 1.6 times the rays of the portable twin, and clearing the stack would cost as much as a ray"
)]

#[cfg(target_arch = "x86_64")]
mod avx2;
mod portable;
pub(crate) mod stack;

use crate::tree::{Child, Lanes, WIDTH};
use stack::Stack;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Sub};

/// Eight floats or eight lane masks. `min` and `max` return their second operand when either is NaN.
pub(crate) trait Vector:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + BitAnd<Output = Self>
    + BitOr<Output = Self>
{
    fn min(self, other: Self) -> Self;
    fn max(self, other: Self) -> Self;
    /// Mask of `self <= other`; false for NaN, like the other comparisons.
    fn le(self, other: Self) -> Self;
    fn lt(self, other: Self) -> Self;
    fn equal(self, other: Self) -> Self;
    /// Sign bits, lane 0 lowest.
    fn signs(self) -> u32;
    fn lanes(self) -> Lanes;
}

/// An instruction set.
pub(crate) trait Simd: Copy {
    type V: Vector;
    fn splat(self, x: f32) -> Self::V;
    fn load(self, lanes: &Lanes) -> Self::V;
    /// Pushes the children whose bit in `mask` is set, with their distances; returns how many.
    fn push(self, mask: u32, distances: Self::V, children: &[Child; WIDTH], stack: &mut Stack) -> usize;
}

/// Work that is compiled for each instruction set.
pub(crate) trait Task {
    type Output;
    /// Does the work. Implementations must be `#[inline(always)]`, else they are compiled for the base instruction set.
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}

/// The instruction set to use.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Level {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2(avx2::Token),
}

impl Level {
    /// The best that this processor has.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if let Some(token) = avx2::Token::detect() {
            return Self::Avx2(token);
        }
        Self::Portable
    }

    #[inline(always)]
    pub fn run<T: Task>(self, task: T) -> T::Output {
        match self {
            Self::Portable => task.run(portable::Token),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2(token) => token.run(task),
        }
    }
}
