//! Scales of attributes, and the bins that count them. All edges are fixed and independent of the samples, so counts of
//! different workers, jobs and variants add up. A change of this file requires a new [`VERSION`].
//!
//! | scale | of 64 fine bins | of 10 coarse bins |
//! | --- | --- | --- |
//! | [`Scale::Film`] | 64 equal parts of the film's width or height | 10 runs of fine bins: `10 f / 64` |
//! | [`Scale::World`] | 0: no position; 63 equal parts of the scene's box, points outside in the nearest | the same |
//! | [`Scale::Radiance`] | 0: zero; two an octave: 1 has all below 2^-10 cd/m2, 2 from there to 2^-9.5, 63 all from 2^20.5 on | the same |
//! | [`Scale::Throughput`] | 0: zero; four an octave: 1 has all below 2^-11.75, 2 from there to 2^-11.5, 63 all from 2^3.5 on | the same |
//! | [`Scale::Count`] | the number; 63 has all from 63 on | the number, 9 has all from 9 on |
//! | [`Scale::Class`] | the number of the word, 0: none | the same |
//! | [`Scale::Name`] | 0: none, else 1 + key mod 63: names may share a bin | `10 f / 64` |

use crate::record::{InteractionKind, LightTechnique, Name, PathEnd};
use crate::statistics::Scope;

/// Version of the attributes and their bins.
pub const VERSION: u32 = 1;
/// Number of fine bins of an attribute.
pub const FINE_BINS: usize = 64;
/// Number of coarse bins of an attribute, as in the founding documents.
pub const COARSE_BINS: usize = 10;

/// Mapping from numbers to bins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Position of a pixel on the film along an axis.
    Film(usize),
    /// A coordinate along an axis, world, m.
    World(usize),
    /// Radiance, cd/m2.
    Radiance,
    /// Throughput factor.
    Throughput,
    /// Number of items.
    Count,
    /// Word of a small set.
    Class(Words),
    /// A name.
    Name,
}

/// Value of an attribute.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// A number in the unit of the scale.
    Number(f64),
    /// Index of a word among the [words](Words) of the scale.
    Word(u8),
    /// A name; [`Name::NONE`] counts as missing in bins.
    Name(Name),
}

/// A small set of words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Words {
    /// [`PathEnd`]
    End,
    /// [`InteractionKind`]
    Interaction,
    /// [`LightTechnique`]
    Technique,
}

impl Words {
    /// Returns the words in the order of their numbers.
    pub fn list(self) -> Vec<&'static str> {
        match self {
            Self::End => PathEnd::ALL.iter().map(|it| it.word()).collect(),
            Self::Interaction => InteractionKind::ALL.iter().map(|it| it.word()).collect(),
            Self::Technique => LightTechnique::ALL.iter().map(|it| it.word()).collect(),
        }
    }
}

impl Scale {
    /// Returns the name of the scale.
    pub fn word(self) -> &'static str {
        match self {
            Self::Film(_) => "film",
            Self::World(_) => "world",
            Self::Radiance => "radiance",
            Self::Throughput => "throughput",
            Self::Count => "count",
            Self::Class(_) => "class",
            Self::Name => "name",
        }
    }

    /// Returns the fine bin of a value; `None`: there is no value.
    #[inline]
    pub fn bin(self, scope: &Scope, value: Option<Value>) -> u8 {
        match (self, value) {
            (_, None) => 0,
            (_, Some(Value::Word(index))) => index + 1,
            (_, Some(Value::Name(name))) => name_bin(name),
            (Self::Film(axis), Some(Value::Number(place))) => film_bin(place as u32, scope.film[axis]),
            (Self::World(axis), Some(Value::Number(place))) => world_bin(place, scope.lower[axis], scope.upper[axis]),
            (Self::Radiance, Some(Value::Number(value))) => radiance_bin(value as f32),
            (Self::Throughput, Some(Value::Number(value))) => throughput_bin(value as f32),
            (Self::Count | Self::Class(_) | Self::Name, Some(Value::Number(value))) => count_bin(value as u32),
        }
    }

    /// Returns the lower edge of a fine bin; `None`: the bin stands for a word, a name or a missing value.
    pub fn lower_edge(self, scope: &Scope, bin: u8) -> Option<f64> {
        match self {
            Self::Radiance => Some(radiance_edge(bin)),
            Self::Throughput => Some(throughput_edge(bin)),
            Self::Count => Some(f64::from(bin)),
            Self::Film(axis) => Some(f64::from(scope.film[axis]) * f64::from(bin) / 64.0),
            Self::World(axis) => {
                let bin = f64::from(bin.checked_sub(1)?);
                Some(scope.lower[axis] + (scope.upper[axis] - scope.lower[axis]) * bin / 63.0)
            }
            Self::Class(_) | Self::Name => None,
        }
    }

    /// Returns the coarse bin of a fine bin.
    #[inline]
    pub fn coarse(self, fine: u8) -> u8 {
        match self {
            Self::Count | Self::Class(_) => fine.min(COARSE_BINS as u8 - 1),
            Self::Film(_) | Self::World(_) | Self::Radiance | Self::Throughput | Self::Name => {
                (u32::from(fine) * COARSE_BINS as u32 / FINE_BINS as u32) as u8
            }
        }
    }
}

fn film_bin(place: u32, size: u32) -> u8 {
    (u64::from(place) * FINE_BINS as u64 / u64::from(size.max(1))).min(FINE_BINS as u64 - 1) as u8
}

/// Returns the fine bin of a coordinate in a box.
#[inline]
fn world_bin(position: f64, low: f64, high: f64) -> u8 {
    let part = (position - low) / (high - low);
    // If the box has no extent, all points are in its first part: NaN becomes 0.
    1 + (part * (FINE_BINS - 1) as f64).clamp(0.0, (FINE_BINS - 2) as f64) as u8
}

/// Powers 2^0, 2^(1/4), 2^(1/2) and 2^(3/4), rounded to nearest.
const FOURTHS: [f32; 4] = [1.0, 1.189_207_115_002_721, std::f32::consts::SQRT_2, 1.681_792_830_507_429];

/// Returns the number of fourths of an octave that `value` lies above 2^0, rounded down; -504 to -501 for subnormal numbers.
#[inline]
fn quarter_octaves(value: f32) -> i32 {
    let bits = value.to_bits();
    let exponent = (bits >> 23 & 0xff) as i32 - 127;
    let mantissa = f32::from_bits(bits & 0x007f_ffff | 0x3f80_0000);
    let [_, first, second, third] = FOURTHS;
    let part = i32::from(mantissa >= first) + i32::from(mantissa >= second) + i32::from(mantissa >= third);
    4 * exponent.max(-126) + part
}

/// Returns the fine bin of a radiance, cd/m2; finite, not negative.
#[inline]
pub fn radiance_bin(value: f32) -> u8 {
    if value > 0.0 {
        (quarter_octaves(value).div_euclid(2) + RADIANCE_BASE).clamp(1, FINE_BINS as i32 - 1) as u8
    } else {
        0
    }
}

/// Returns the fine bin of a factor; finite, not negative.
#[inline]
pub fn throughput_bin(value: f32) -> u8 {
    if value > 0.0 { (quarter_octaves(value) + THROUGHPUT_BASE).clamp(1, FINE_BINS as i32 - 1) as u8 } else { 0 }
}

/// Bin of a radiance of 1 cd/m2.
const RADIANCE_BASE: i32 = 22;
/// Bin of a factor of 1.
const THROUGHPUT_BASE: i32 = 49;

/// Returns the lower edge of a fine bin of radiances; 0 for bins 0 and 1.
pub fn radiance_edge(bin: u8) -> f64 {
    lower_edge(bin, 2 * (i32::from(bin) - RADIANCE_BASE))
}

/// Returns the lower edge of a fine bin of factors; 0 for bins 0 and 1.
pub fn throughput_edge(bin: u8) -> f64 {
    lower_edge(bin, i32::from(bin) - THROUGHPUT_BASE)
}

fn lower_edge(bin: u8, fourths: i32) -> f64 {
    let octave = f32::from_bits(((fourths.div_euclid(4) + 127) as u32) << 23);
    if bin < 2 { 0.0 } else { f64::from(octave * FOURTHS[fourths.rem_euclid(4) as usize]) }
}

/// Returns the fine bin of a number of items.
#[inline]
pub fn count_bin(number: u32) -> u8 {
    number.min(FINE_BINS as u32 - 1) as u8
}

/// Returns the fine bin of a name.
#[inline]
pub fn name_bin(name: Name) -> u8 {
    if name == Name::NONE { 0 } else { 1 + (name.0 % (FINE_BINS as u64 - 1)) as u8 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_begin_at_their_edges() {
        type Bin = fn(f32) -> u8;
        type Edge = fn(u8) -> f64;
        for (bin, lower) in [(radiance_bin as Bin, radiance_edge as Edge), (throughput_bin, throughput_edge)] {
            assert_eq!((bin(0.0), bin(f32::MIN_POSITIVE), bin(f32::from_bits(1)), bin(f32::MAX)), (0, 1, 1, 63));
            for number in 2..64 {
                let edge = lower(number) as f32;
                assert_eq!(bin(edge), number, "{edge}");
                assert_eq!(bin(edge.next_down()), number - 1, "below {edge}");
            }
        }
        assert_eq!((radiance_bin(1.0), throughput_bin(1.0)), (22, 49));
        assert_eq!((radiance_edge(2), throughput_edge(2)), (1.0 / 1024.0, f64::from(FOURTHS[1]) / 4096.0));
        assert_eq!(radiance_edge(63), f64::from(std::f32::consts::SQRT_2 * 1048576.0));
    }

    #[test]
    fn places_on_the_film_and_in_the_world_are_cut_into_equal_parts() {
        assert_eq!((film_bin(0, 512), film_bin(7, 512), film_bin(8, 512), film_bin(511, 512)), (0, 0, 1, 63));
        let scope = Scope { lower: [0.0; 3], upper: [63.0, 126.0, 0.0], ..Scope::default() };
        let bins = |position: [f64; 3]| {
            [0, 1, 2].map(|axis| Scale::World(axis).bin(&scope, Some(Value::Number(position[axis]))))
        };
        assert_eq!(bins([0.0, 0.0, 0.0]), [1, 1, 1], "a box without extent has one part");
        assert_eq!(bins([62.5, 125.9, 9.0]), [63, 63, 63]);
        assert_eq!(bins([-1.0, 2.0, 0.0]), [1, 2, 1]);
        assert_eq!(bins([1e9, 1.99, 0.0])[..2], [63, 1]);
    }
}
