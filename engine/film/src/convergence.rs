//! How far an image is from converged, by its own account.
//!
//! The measure is taken over blocks of 16 x 16 pixels, because the variance of a single pixel is too noisy to stop by. The
//! account is from the same samples as the image: where a rare bright path has not been met yet, neither knows of it, and
//! stopping by it favors images that are too dark there.

use crate::{FrameImage, Rect};
use femc_math::color::LUMINANCE_WEIGHTS;

/// Edge of a block, pixels.
pub const BLOCK: u32 = 16;
/// Half width of a 95 % interval in standard errors.
const Z_95: f64 = 1.959_963_984_540_054;
/// Blocks darker than this share of the image's mean luminance are measured against it.
const FLOOR: f64 = 0.01;

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
    /// The blocks, row by row.
    pub blocks: Vec<BlockError>,
}

impl FrameImage {
    /// The error of the frame. A black frame has error 0.
    pub fn error(&self) -> FrameError {
        let pixels = self.color.pixels.len() as f64;
        let floor = FLOOR * (0..self.color.pixels.len()).map(|i| self.luminance_of(i)).sum::<f64>() / pixels;
        let (width, height) = (self.color.width, self.color.height);
        let mut blocks = Vec::new();
        for y in (0..height).step_by(BLOCK as usize) {
            for x in (0..width).step_by(BLOCK as usize) {
                let rect = Rect { x, y, width: BLOCK.min(width - x), height: BLOCK.min(height - y) };
                blocks.push(BlockError { rect, relative: self.block_error(rect, floor) });
            }
        }
        let worst = blocks.iter().map(|b| b.relative).fold(0.0, f64::max);
        let mean = blocks.iter().map(|b| b.relative).sum::<f64>() / blocks.len().max(1) as f64;
        FrameError { worst, mean, blocks }
    }

    fn block_error(&self, rect: Rect, floor: f64) -> f64 {
        let (mut sum, mut variance) = (0.0, 0.0);
        for (x, y) in rect.pixels() {
            let at = y as usize * self.color.width as usize + x as usize;
            if self.samples[at] < 2 {
                return f64::INFINITY;
            }
            sum += self.luminance_of(at);
            variance += self.luminance_variance(at);
        }
        let n = rect.area() as f64;
        if variance == 0.0 { 0.0 } else { Z_95 * variance.sqrt() / n / (sum / n).max(floor) }
    }

    fn luminance_of(&self, at: usize) -> f64 {
        let weights = LUMINANCE_WEIGHTS.to_array();
        (0..3).map(|i| f64::from(weights[i]) * f64::from(self.color.pixels[at][i])).sum()
    }

    /// Upper bound, met where the channels vary together: the standard deviation of a sum is at most the sum of them.
    fn luminance_variance(&self, at: usize) -> f64 {
        let weights = LUMINANCE_WEIGHTS.to_array();
        let deviation: f64 = (0..3).map(|i| f64::from(weights[i]) * f64::from(self.variance[at][i]).sqrt()).sum();
        deviation * deviation
    }
}
