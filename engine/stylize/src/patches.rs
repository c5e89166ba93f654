//! Style and guides of a picture in one image of whole numbers, weighted so that the energy of two patches is a squared distance.
//!
//! Sums of whole numbers are the same in any order, so wider instructions change no bit.

use crate::{ChannelImage, PatchGrid, Settings};
use rayon::prelude::*;

/// Number of channels of the style: red, green and blue.
pub(crate) const STYLE_CHANNELS: usize = 3;
/// Integer that stands for a value of 1 in a channel of weight 1. With weights that sum to 1, patches of 15 x 15 pixels have
/// energies below 2^31.
const SCALE: f32 = 3000.0;

/// Weights of the energy. They sum to 1 over all channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// Weight of each channel of the style.
    pub style: f32,
    /// Weight of each channel of the guides.
    pub guide: f32,
}

impl Weights {
    /// Computes the weights from the settings: all guides together have `mu` times the weight of the style.
    /// - `channels`: number of channels of the guides.
    pub fn new(settings: &Settings, channels: usize) -> Self {
        let style = 1.0 / (1.0 + settings.mu);
        Self { style: style / STYLE_CHANNELS as f32, guide: style * settings.mu / channels as f32 }
    }
}

/// The patches of a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Patches {
    grid: PatchGrid,
    width: usize,
    channels: usize,
    values: Vec<i16>,
    weights: Weights,
}

impl Patches {
    /// Creates patches of three channels of `style` and all channels of `guides`.
    /// - `style`: of the size of the guides; `None`: black, for guides alone.
    pub fn new(style: Option<&ChannelImage>, guides: &ChannelImage, weights: Weights, patch: usize) -> Self {
        let (width, channels) = (guides.width(), STYLE_CHANNELS + guides.channels());
        let mut values = vec![0i16; width * guides.height() * channels];
        let gain = SCALE * weights.guide.sqrt();
        values.par_chunks_mut(width * channels).enumerate().for_each(|(y, row)| {
            for (out, guides) in row.chunks_mut(channels).zip(guides.run(0, y, width).chunks(channels - STYLE_CHANNELS))
            {
                out[STYLE_CHANNELS..].iter_mut().zip(guides).for_each(|(out, value)| *out = quantize(*value, gain));
            }
        });
        let grid = PatchGrid::new(width, guides.height(), patch);
        let mut patches = Self { grid, width, channels, values, weights };
        if let Some(style) = style {
            patches.set_style(style);
        }
        patches
    }

    /// Replaces the style.
    pub(crate) fn set_style(&mut self, style: &ChannelImage) {
        let (gain, width, channels) = (SCALE * self.weights.style.sqrt(), self.width, self.channels);
        self.values.par_chunks_mut(width * channels).enumerate().for_each(|(y, row)| {
            for (out, color) in row.chunks_mut(channels).zip(style.run(0, y, width).chunks(STYLE_CHANNELS)) {
                out[..STYLE_CHANNELS].iter_mut().zip(color).for_each(|(out, value)| *out = quantize(*value, gain));
            }
        });
    }

    /// Returns the grid that numbers the patches.
    pub fn grid(&self) -> PatchGrid {
        self.grid
    }

    /// Returns the number of values of a patch.
    pub(crate) fn patch_values(&self) -> usize {
        self.grid.patch() * self.grid.patch() * self.channels
    }

    /// Returns the energy of a difference of `levels` of 255 in all channels of the style, over a whole patch.
    pub(crate) fn style_energy(&self, levels: f32) -> f64 {
        let difference = f64::from(SCALE) * f64::from(levels) / 255.0;
        difference
            * difference
            * f64::from(self.weights.style)
            * (STYLE_CHANNELS * self.grid.patch() * self.grid.patch()) as f64
    }

    #[inline]
    fn run(&self, x: usize, y: usize) -> &[i16] {
        let at = (y * self.width + x) * self.channels;
        &self.values[at..at + self.grid.patch() * self.channels]
    }

    /// Writes the values of patch `at`, row by row, into `values`, which has the length of a patch.
    pub(crate) fn gather(&self, at: u32, values: &mut [f32]) {
        let ((x, y), patch) = (self.grid.corner(at), self.grid.patch());
        for (row, room) in values.chunks_mut(patch * self.channels).enumerate() {
            room.iter_mut().zip(self.run(x, y + row)).for_each(|(out, value)| *out = f32::from(*value));
        }
    }

    /// Returns the energy of patch `mine` of `self` and patch `theirs` of `other`, or a partial sum that exceeds `limit`.
    #[inline]
    pub fn energy(&self, mine: u32, other: &Self, theirs: u32, limit: u32) -> u32 {
        let ((x, y), (u, v)) = (self.grid.corner(mine), other.grid.corner(theirs));
        let mut sum = 0;
        for row in 0..self.grid.patch() {
            sum += squared_distance(self.run(x, y + row), other.run(u, v + row));
            if sum > limit {
                break;
            }
        }
        sum
    }
}

#[inline]
fn quantize(value: f32, gain: f32) -> i16 {
    (gain * value.clamp(0.0, 1.0) + 0.5) as i16
}

/// Computes the sum of the squared differences of values in 0..=[`SCALE`].
#[inline]
fn squared_distance(a: &[i16], b: &[i16]) -> u32 {
    let difference = |(a, b): (&i16, &i16)| i32::from(a.wrapping_sub(*b));
    a.iter().zip(b).map(difference).map(|d| d * d).sum::<i32>() as u32
}
