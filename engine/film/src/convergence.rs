//! How far an image is from converged, by its own account.
//!
//! The measure is taken over blocks of 16 x 16 pixels, because the variance of a single pixel is too noisy to stop by. The
//! account is from the same samples as the image: where a rare bright path has not been met yet, neither knows of it, and
//! stopping by it favors images that are too dark there.

use crate::piece::Pixel;
use crate::{FrameImage, Rect};
use femc_math::color::LUMINANCE_WEIGHTS;

/// Edge of a block, pixels.
pub const BLOCK: u32 = 16;
/// Half width of a 95 % interval in standard errors.
const Z_95: f64 = 1.959_963_984_540_054;
/// Blocks darker than this share of the image's mean luminance are measured against it.
const FLOOR: f64 = 0.01;

/// What the error of a block of pixels is made of, cd/m2 times pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// The pixels.
    pub rect: Rect,
    /// Sum of their luminances.
    pub sum: f64,
    /// Standard error of that sum; infinite when a pixel has fewer than two samples.
    pub deviation: f64,
}

impl Block {
    /// Of the pixels of `rect`.
    pub(crate) fn of(rect: Rect, pixels: impl Iterator<Item = Pixel>) -> Self {
        let (mut sum, mut variance) = (0.0, 0.0);
        for Pixel { color, variance: of_color, samples, .. } in pixels {
            sum += luminance(color.map(f64::from));
            variance += if samples < 2 { f64::INFINITY } else { luminance_variance(of_color) };
        }
        Self { rect, sum, deviation: f64::sqrt(variance) }
    }

    /// Half width of the 95 % confidence interval of the mean luminance, relative to that mean, or to `floor` where that is
    /// larger.
    pub fn relative(&self, floor: f64) -> f64 {
        let n = self.rect.area() as f64;
        if self.deviation == 0.0 { 0.0 } else { Z_95 * self.deviation / n / (self.sum / n).max(floor) }
    }
}

/// The blocks of a rectangle, row by row from its corner; those at its right and lower border may be cut.
pub(crate) fn blocks(area: Rect) -> impl Iterator<Item = Rect> {
    let Rect { x, y, width, height } = area;
    let across = move |down: u32| {
        (0..width).step_by(BLOCK as usize).map(move |right| Rect {
            x: x + right,
            y: y + down,
            width: BLOCK.min(width - right),
            height: BLOCK.min(height - down),
        })
    };
    (0..height).step_by(BLOCK as usize).flat_map(across)
}

/// Rec.709 luminance, cd/m2.
pub(crate) fn luminance(color: [f64; 3]) -> f64 {
    color.iter().zip(LUMINANCE_WEIGHTS.to_array()).map(|(value, weight)| f64::from(weight) * value).sum()
}

/// Upper bound, met where the channels vary together: the standard deviation of a sum is at most the sum of them.
fn luminance_variance(variance: [f32; 3]) -> f64 {
    luminance(variance.map(|value| f64::from(value).sqrt())).powi(2)
}

/// Error of one block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockError {
    /// The pixels.
    pub rect: Rect,
    /// Half width of the 95 % confidence interval of the block's mean luminance, relative to that mean (or to 1 % of the
    /// image's mean where that is larger). Infinite when a pixel of the block has fewer than two samples.
    pub relative: f64,
}

/// Error of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameError {
    /// Largest relative error of a block: the frame has converged to it at 95 % confidence, each block.
    pub worst: f64,
    /// Mean relative error of the blocks.
    pub mean: f64,
    /// Luminance that darker blocks are measured against: 1 % of the frame's mean, cd/m2.
    pub floor: f64,
    /// The blocks, row by row.
    pub blocks: Vec<BlockError>,
}

impl FrameError {
    /// Of all blocks of a frame, in any order. A black frame has error 0.
    pub fn of(mut blocks: Vec<Block>) -> Self {
        blocks.sort_unstable_by_key(|block| (block.rect.y, block.rect.x));
        let pixels: u64 = blocks.iter().map(|block| block.rect.area()).sum();
        let floor = FLOOR * blocks.iter().map(|block| block.sum).sum::<f64>() / pixels.max(1) as f64;
        let error = |block: &Block| BlockError { rect: block.rect, relative: block.relative(floor) };
        let blocks: Vec<BlockError> = blocks.iter().map(error).collect();
        let worst = blocks.iter().map(|b| b.relative).fold(0.0, f64::max);
        let mean = blocks.iter().map(|b| b.relative).sum::<f64>() / blocks.len().max(1) as f64;
        Self { worst, mean, floor, blocks }
    }
}

impl FrameImage {
    /// The error of the frame, in blocks from its upper left corner.
    pub fn error(&self) -> FrameError {
        let (width, height) = (self.color.width, self.color.height);
        let pixels = |rect: Rect| rect.pixels().map(|(x, y)| self.pixel(y as usize * width as usize + x as usize));
        let block = |rect: Rect| Block::of(rect, pixels(rect));
        FrameError::of(blocks(Rect { x: 0, y: 0, width, height }).map(block).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Image;

    fn gray(width: u32, height: u32, value: f32, variance: f32) -> FrameImage {
        let count = (width * height) as usize;
        FrameImage {
            color: Image::filled(width, height, [value; 3]),
            variance: vec![[variance; 3]; count],
            albedo: vec![[0.0; 3]; count],
            depth: vec![0.0; count],
            samples: vec![4; count],
        }
    }

    #[test]
    fn the_error_of_a_gray_block_is_its_standard_error_by_hand() {
        // 256 pixels of variance 0.01: the block's mean has the standard error 0.1 / 16.
        let error = gray(16, 16, 2.0, 0.01).error();
        assert!((error.worst - 1.959_964 * 0.00625 / 2.0).abs() < 1e-7, "{error:?}");
        assert_eq!((error.blocks.len(), error.worst), (1, error.mean));
    }

    #[test]
    fn blocks_at_the_border_are_smaller_and_the_worst_one_decides() {
        let mut image = gray(40, 20, 1.0, 1e-4);
        image.variance[20 * 40 - 1] = [1.0; 3];
        let error = image.error();
        assert_eq!(error.blocks.len(), 6);
        assert_eq!(error.blocks[5].rect, Rect { x: 32, y: 16, width: 8, height: 4 });
        assert_eq!(error.worst, error.blocks[5].relative);
        assert!(error.mean < error.worst);
    }

    #[test]
    fn dark_blocks_are_measured_against_a_hundredth_of_the_mean() {
        let mut image = gray(32, 16, 1.0, 0.0);
        for (x, y) in (Rect { x: 16, y: 0, width: 16, height: 16 }).pixels() {
            image.color.pixels[(y * 32 + x) as usize] = [0.0; 3];
            image.variance[(y * 32 + x) as usize] = [0.01; 3];
        }
        assert!((image.error().worst - 1.959_964 * 0.00625 / 0.005).abs() < 1e-4);
    }

    #[test]
    fn a_single_sample_is_not_convergence_and_black_without_variance_is() {
        let mut image = gray(16, 16, 0.0, 0.0);
        assert_eq!(image.error().worst, 0.0);
        image.samples[77] = 1;
        assert_eq!(image.error().worst, f64::INFINITY);
    }
}
