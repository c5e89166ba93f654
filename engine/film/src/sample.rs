//! One sample of one pixel, and the account of unusable samples.

use femc_math::Rgb;
use serde::{Deserialize, Serialize};

/// Largest usable radiance of a sample, cd/m2: 2^40; the sun's disc has 1.6e9.
pub const MAX_RADIANCE: f32 = 1_099_511_627_776.0;

/// The result of one camera path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Radiance toward the camera, linear Rec.709, luminance in cd/m2. Includes the path's weight.
    pub color: Rgb,
    /// Albedo of the first surface, 0..1; zero if there is none.
    pub albedo: Rgb,
    /// Distance of the first surface from the camera, meters; infinite if there is none.
    pub depth: f32,
}

impl Sample {
    /// Sample of a path without a hit.
    pub const MISS: Self = Self { color: Rgb::ZERO, albedo: Rgb::ZERO, depth: f32::INFINITY };

    /// Returns the reason why the sample is unusable, the worst one first.
    #[inline]
    pub fn fault(&self) -> Option<BadKind> {
        let smallest = self.color.min_element().min(self.albedo.min_element()).min(self.depth);
        let largest = self.color.max_element();
        // The comparisons are false for a NaN in color; `min` would hide one in albedo or depth.
        let usable = smallest >= 0.0
            && largest <= MAX_RADIANCE
            && self.albedo.is_finite()
            && !self.color.is_nan()
            && !self.depth.is_nan();
        if usable { None } else { Some(self.classify()) }
    }

    #[cold]
    fn classify(&self) -> BadKind {
        let values = || self.color.to_array().into_iter().chain(self.albedo.to_array());
        if values().any(f32::is_nan) || self.depth.is_nan() {
            BadKind::NotANumber
        } else if values().any(f32::is_infinite) {
            BadKind::Infinite
        } else if values().any(|v| v < 0.0) || self.depth < 0.0 {
            BadKind::Negative
        } else {
            BadKind::OutOfRange
        }
    }
}

/// Reason why a sample was left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BadKind {
    /// A component is NaN.
    NotANumber,
    /// A color or albedo is infinite.
    Infinite,
    /// A component is below zero.
    Negative,
    /// A radiance is finite but above [`MAX_RADIANCE`].
    OutOfRange,
}

impl BadKind {
    /// All kinds, in the order of [`BadSamples::counts`].
    pub const ALL: [Self; 4] = [Self::NotANumber, Self::Infinite, Self::Negative, Self::OutOfRange];
}

/// Position of a bad sample, sufficient to draw it again. Ordered by row, column and sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct BadSample {
    /// Row of the film.
    pub y: u32,
    /// Column of the film.
    pub x: u32,
    /// Sample index in the pixel.
    pub sample: u32,
    /// Reason why it was left out.
    pub kind: BadKind,
}

/// Account of the samples that were left out. Merging is associative and commutative.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct BadSamples {
    /// Number of samples of each kind, in the order of [`BadKind::ALL`].
    pub counts: [u64; 4],
    /// First bad sample by row, column and sample.
    pub first: Option<BadSample>,
}

impl BadSamples {
    /// Returns the number of all bad samples.
    pub fn total(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Returns the number of bad samples of one kind.
    pub fn count(&self, kind: BadKind) -> u64 {
        self.counts[kind as usize]
    }

    /// Adds a bad sample.
    pub fn add(&mut self, bad: BadSample) {
        self.counts[bad.kind as usize] += 1;
        self.first = Some(self.first.map_or(bad, |first| first.min(bad)));
    }

    /// Adds all bad samples of `other`.
    pub fn merge(&mut self, other: &Self) {
        for (mine, theirs) in self.counts.iter_mut().zip(other.counts) {
            *mine = mine.saturating_add(theirs);
        }
        self.first = match (self.first, other.first) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (a, b) => a.or(b),
        };
    }
}

impl std::fmt::Display for BadSamples {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [nan, infinite, negative, large] = self.counts;
        write!(
            f,
            "{} bad samples ({nan} NaN, {infinite} infinite, {negative} negative, {large} out of range)",
            self.total()
        )?;
        self.first.map_or(Ok(()), |b| write!(f, ", first: pixel {},{} sample {}", b.x, b.y, b.sample))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: Sample = Sample { color: Rgb::ONE, albedo: Rgb::splat(0.5), depth: 2.0 };

    #[test]
    fn a_fault_in_any_component_is_seen_with_its_kind() {
        assert_eq!(GOOD.fault(), None);
        assert_eq!(Sample::MISS.fault(), None);
        assert_eq!(Sample { color: -Rgb::ZERO, ..GOOD }.fault(), None);
        for axis in 0..3 {
            for (value, kind) in [
                (f32::NAN, BadKind::NotANumber),
                (f32::INFINITY, BadKind::Infinite),
                (f32::NEG_INFINITY, BadKind::Infinite),
                (-1e-20, BadKind::Negative),
            ] {
                let (mut color, mut albedo) = (GOOD.color, GOOD.albedo);
                color[axis] = value;
                albedo[axis] = value;
                assert_eq!(Sample { color, ..GOOD }.fault(), Some(kind), "color {axis} {value}");
                assert_eq!(Sample { albedo, ..GOOD }.fault(), Some(kind), "albedo {axis} {value}");
            }
        }
        assert_eq!(Sample { depth: f32::NAN, ..GOOD }.fault(), Some(BadKind::NotANumber));
        assert_eq!(Sample { depth: -1.0, ..GOOD }.fault(), Some(BadKind::Negative));
        assert_eq!(Sample { color: Rgb::new(0.0, f32::MAX, 0.0), ..GOOD }.fault(), Some(BadKind::OutOfRange));
    }
}
