//! Images of any number of channels, and their pyramids.

use crate::StylizeError;
use rayon::prelude::*;

/// An image of floats: row by row from the top left, the channels of a pixel one after another.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelImage {
    width: usize,
    height: usize,
    channels: usize,
    values: Vec<f32>,
}

impl ChannelImage {
    /// Creates an image.
    /// - `values`: `width * height * channels` of them, usually 0 to 1;
    /// - errors: the number of values is wrong, or a value is not finite.
    pub fn new(width: u32, height: u32, channels: usize, values: Vec<f32>) -> Result<Self, StylizeError> {
        let shape = StylizeError::Shape { width, height, channels, values: values.len() };
        let (wide, high) = (width as usize, height as usize);
        let expected = wide.checked_mul(high).and_then(|pixels| pixels.checked_mul(channels));
        // Patch numbers have 32 bits.
        if values.is_empty() || expected != Some(values.len()) || wide * high > u32::MAX as usize {
            return Err(shape);
        }
        if let Some(at) = values.iter().position(|value| !value.is_finite()) {
            let pixel = at / channels;
            return Err(StylizeError::NotFinite { x: (pixel % wide) as u32, y: (pixel / wide) as u32 });
        }
        Ok(Self { width: wide, height: high, channels, values })
    }

    /// Creates an image from a function that fills each row with valid values.
    pub(crate) fn from_rows(
        width: usize,
        height: usize,
        channels: usize,
        fill: impl Fn(usize, &mut [f32]) + Sync,
    ) -> Self {
        let mut values = vec![0.0; width * height * channels];
        values.par_chunks_mut(width * channels).enumerate().for_each(|(y, row)| fill(y, row));
        Self { width, height, channels, values }
    }

    /// Returns the number of columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns the number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Returns the number of values per pixel.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Returns all values.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Returns the values of a pixel.
    #[inline]
    pub fn pixel(&self, x: usize, y: usize) -> &[f32] {
        self.run(x, y, 1)
    }

    /// Returns the values of `count` pixels of a row, from column `x` on.
    #[inline]
    pub(crate) fn run(&self, x: usize, y: usize, count: usize) -> &[f32] {
        let at = (y * self.width + x) * self.channels;
        &self.values[at..at + count * self.channels]
    }

    /// Returns width and height in the type that errors use.
    pub(crate) fn size(&self) -> [u32; 2] {
        [self.width as u32, self.height as u32]
    }

    /// Returns the image at half the width and height, rounded up: filtered with (1 4 6 4 1) / 16 along both axes (pixels beyond
    /// the border are replaced by the nearest one), keeping every second pixel, starting with the first.
    pub fn halved(&self) -> Self {
        const KERNEL: [f32; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];
        let (width, height, channels) = (self.width.div_ceil(2), self.height.div_ceil(2), self.channels);
        let near = |at: usize, k: usize, end: usize| (2 * at + k).saturating_sub(2).min(end - 1);
        let narrow = Self::from_rows(width, self.height, channels, |y, row| {
            for (x, out) in row.chunks_mut(channels).enumerate() {
                for (k, weight) in KERNEL.iter().enumerate() {
                    let pixel = self.pixel(near(x, k, self.width), y);
                    out.iter_mut().zip(pixel).for_each(|(out, value)| *out += weight * value);
                }
            }
        });
        Self::from_rows(width, height, channels, |y, row| {
            for (k, weight) in KERNEL.iter().enumerate() {
                let from = narrow.run(0, near(y, k, self.height), width);
                row.iter_mut().zip(from).for_each(|(out, value)| *out += weight * value);
            }
        })
    }

    /// Returns the image at all levels, the finest first.
    pub(crate) fn pyramid(&self, levels: usize) -> Vec<Self> {
        let mut pyramid = vec![self.clone()];
        while pyramid.len() < levels {
            let next = pyramid[pyramid.len() - 1].halved();
            pyramid.push(next);
        }
        pyramid
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halved_image_keeps_its_mean_and_filters_every_second_pixel() {
        let flat = ChannelImage::new(7, 5, 2, [0.25, 0.75].repeat(35)).unwrap().halved();
        assert_eq!((flat.width(), flat.height()), (4, 3));
        assert!(flat.values().chunks(2).all(|pixel| pixel == [0.25, 0.75]));
        let mut values = vec![0.0; 81];
        values[4 * 9 + 4] = 256.0;
        let dot = ChannelImage::new(9, 9, 1, values).unwrap().halved();
        let found: Vec<f32> = (1..4).map(|x| dot.pixel(x, 2)[0]).collect();
        assert_eq!(found, [6.0, 36.0, 6.0], "weights of (1 4 6 4 1) (1 4 6 4 1)");
        assert_eq!(dot.pixel(1, 1), [1.0]);
    }

    #[test]
    fn values_that_are_no_image_are_refused_with_what_is_wrong() {
        assert!(matches!(ChannelImage::new(2, 2, 3, vec![0.0; 11]), Err(StylizeError::Shape { values: 11, .. })));
        assert!(matches!(ChannelImage::new(0, 2, 3, vec![]), Err(StylizeError::Shape { .. })));
        let mut values = vec![0.0; 12];
        values[10] = f32::NAN;
        assert_eq!(ChannelImage::new(2, 2, 3, values), Err(StylizeError::NotFinite { x: 1, y: 1 }));
    }
}
