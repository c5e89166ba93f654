//! Error estimates of an image, from the image's own samples.
//!
//! Errors are measured over blocks of 16 x 16 pixels, because the variance of a single pixel is too noisy. The variance of a
//! block's mean is estimated from the differences of its pixels' halves, which are independent ([`crate::tile`]). The estimate is
//! unbiased, whatever the stratification. No safety margin is added here; the errors that decide on further samples are more
//! cautious ([`crate::error_statistics`]).
//!
//! A block whose samples have all been black is **unlit**. Its error is unknown: no sample received light.

use crate::piece::Pixel;
use crate::{FrameImage, Rect};
use femc_math::color::LUMINANCE_WEIGHTS;

/// Edge of a block, pixels.
pub const BLOCK_EDGE: u32 = 16;
/// Half width of a 95 % interval in standard errors, for a normal distribution with known variance.
pub(crate) const Z_95: f64 = 1.959_963_984_540_054;
/// Fraction of the image's mean luminance below which blocks are measured relative to this luminance instead of their own.
pub const FLOOR: f64 = 0.01;

/// Statistics of a block of pixels that determine its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// The pixels of the block.
    pub rect: Rect,
    /// Sum of their luminances, cd/m2 times pixels.
    pub sum: f64,
    /// Estimated variance of that sum; infinite if a pixel has fewer than two samples.
    pub variance: f64,
    /// Degrees of freedom of the estimate: about the number of pixels if they are alike, 3 if one of them has all the variance.
    pub freedom: f64,
}

impl Block {
    /// Computes the statistics from the pixels of `rect`.
    pub(crate) fn from_pixels(rect: Rect, pixels: impl Iterator<Item = Pixel>) -> Self {
        let (mut sum, mut variance, mut squares) = (0.0, 0.0, 0.0);
        for Pixel { color, luminance_variance, samples, .. } in pixels {
            let one = if samples < 2 { f64::INFINITY } else { f64::from(luminance_variance) };
            sum += luminance(color.map(f64::from));
            variance += one;
            squares += one * one;
        }
        Self { rect, sum, variance, freedom: degrees_of_freedom(variance, squares) }
    }

    /// Returns the half width of the 95 % confidence interval of the mean luminance, relative to that mean or to `floor`, whichever
    /// is larger; `None`: the block is unlit.
    pub fn relative_error(&self, floor: f64) -> Option<f64> {
        let n = self.rect.area() as f64;
        let half_width = || student_95(self.freedom) * self.variance.sqrt() / n;
        if self.variance.is_infinite() {
            Some(f64::INFINITY)
        } else {
            (self.sum > 0.0).then(|| half_width() / (self.sum / n).max(floor))
        }
    }
}

/// Estimates the degrees of freedom of a sum of squares of normal numbers (\[satterthwaite1946\]), each of one degree. The inputs
/// are the sum of the squares and the sum of their squares; a third of the latter estimates the sum of the squared variances. The
/// result is at least 3.
pub(crate) fn degrees_of_freedom(sum: f64, squares: f64) -> f64 {
    if squares > 0.0 && squares.is_finite() { 3.0 * sum * sum / squares } else { f64::INFINITY }
}

/// Returns the 97.5 % quantile of Student's distribution: half the width of a 95 % interval, in standard errors. For 1 and 2
/// degrees of freedom it has a closed form; from 3 on it is the expansion about the normal one (\[abramowitz1964\], 26.7.5), within
/// 1 %.
pub fn student_95(freedom: f64) -> f64 {
    if freedom < 2.5 {
        return if freedom < 1.5 { 12.706_205 } else { 4.302_653 };
    }
    let z = Z_95;
    let terms = [
        (z.powi(3) + z) / 4.0,
        (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0,
        (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0,
    ];
    terms.iter().rev().fold(0.0, |rest, term| (rest + term) / freedom) + z
}

/// Returns the blocks of a rectangle, row by row from its corner; those at its right and lower border may be smaller.
pub(crate) fn blocks(area: Rect) -> impl Iterator<Item = Rect> {
    let Rect { x, y, width, height } = area;
    let across = move |down: u32| {
        (0..width).step_by(BLOCK_EDGE as usize).map(move |right| Rect {
            x: x + right,
            y: y + down,
            width: BLOCK_EDGE.min(width - right),
            height: BLOCK_EDGE.min(height - down),
        })
    };
    (0..height).step_by(BLOCK_EDGE as usize).flat_map(across)
}

/// Computes the Rec.709 luminance, cd/m2.
pub(crate) fn luminance(color: [f64; 3]) -> f64 {
    color.iter().zip(LUMINANCE_WEIGHTS.to_array()).map(|(value, weight)| f64::from(weight) * value).sum()
}

/// Error of one block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockError {
    /// The pixels of the block.
    pub rect: Rect,
    /// Half width of the 95 % confidence interval of the block's mean luminance, relative to that mean or to 1 % of the image's
    /// mean, whichever is larger. Infinite if a pixel of the block has fewer than two samples; `None`: no sample received light.
    pub relative: Option<f64>,
}

/// Error of a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameError {
    /// Largest relative error of a block: every block has converged to it at 95 % confidence.
    pub worst: f64,
    /// Mean relative error of the lit blocks.
    pub mean: f64,
    /// Number of blocks without light in any sample; the other numbers exclude them.
    pub unlit: usize,
    /// Reference luminance for darker blocks: 1 % of the frame's mean, cd/m2.
    pub floor: f64,
    /// The blocks, row by row.
    pub blocks: Vec<BlockError>,
}

impl FrameError {
    /// Computes the error from all blocks of a frame, in any order. A black frame has error 0 and only unlit blocks.
    pub fn from_blocks(mut blocks: Vec<Block>) -> Self {
        blocks.sort_unstable_by_key(|block| (block.rect.y, block.rect.x));
        let pixels: u64 = blocks.iter().map(|block| block.rect.area()).sum();
        let floor = FLOOR * blocks.iter().map(|block| block.sum).sum::<f64>() / pixels.max(1) as f64;
        let error = |block: &Block| BlockError { rect: block.rect, relative: block.relative_error(floor) };
        let blocks: Vec<BlockError> = blocks.iter().map(error).collect();
        let lit = || blocks.iter().filter_map(|block| block.relative);
        let worst = lit().fold(0.0, f64::max);
        let mean = lit().sum::<f64>() / lit().count().max(1) as f64;
        Self { worst, mean, unlit: blocks.len() - lit().count(), floor, blocks }
    }

    /// Returns the worst relative error; `None` if it is unknown: a pixel has fewer than two samples, or no sample received light.
    pub fn reached_error(&self) -> Option<f64> {
        (self.unlit < self.blocks.len() && self.worst.is_finite()).then_some(self.worst)
    }
}

impl FrameImage {
    /// Computes the error of the frame, in blocks from its upper left corner.
    pub fn error(&self) -> FrameError {
        let (width, height) = (self.color.width, self.color.height);
        let pixels = |rect: Rect| rect.pixels().map(|(x, y)| self.pixel(y as usize * width as usize + x as usize));
        let block = |rect: Rect| Block::from_pixels(rect, pixels(rect));
        FrameError::from_blocks(blocks(Rect { x: 0, y: 0, width, height }).map(block).collect())
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
            luminance_variance: vec![variance; count],
            samples: vec![4; count],
            ..FrameImage::black(width, height)
        }
    }

    #[test]
    fn students_quantiles_are_those_of_the_tables() {
        let table = [(1.0, 12.706), (2.0, 4.303), (3.0, 3.182), (4.0, 2.776)];
        for (freedom, quantile) in
            table.into_iter().chain([(5.0, 2.571), (10.0, 2.228), (30.0, 2.042), (1000.0, 1.962)])
        {
            assert!((student_95(freedom) / quantile - 1.0).abs() < 0.01, "{freedom}: {}", student_95(freedom));
        }
        assert_eq!(student_95(f64::INFINITY), Z_95);
    }

    #[test]
    fn the_error_of_a_gray_block_is_its_standard_error_by_hand() {
        // 256 pixels of variance 0.01: the block's mean has the standard error 0.1 / 16. Equal squares triple the degrees of
        // freedom.
        let error = gray(16, 16, 2.0, 0.01).error();
        assert!((error.worst - student_95(768.0) * 0.00625 / 2.0).abs() < 1e-7, "{error:?}");
        assert_eq!((error.blocks.len(), error.worst), (1, error.mean));
        let mut image = gray(16, 16, 2.0, 0.0);
        image.luminance_variance[9] = 2.56;
        assert!((image.error().worst - student_95(3.0) * 0.00625 / 2.0).abs() < 1e-7, "one pixel has all the variance");
    }

    #[test]
    fn blocks_at_the_border_are_smaller_and_the_worst_one_decides() {
        let mut image = gray(40, 20, 1.0, 1e-4);
        image.luminance_variance[20 * 40 - 1] = 1.0;
        let error = image.error();
        assert_eq!(error.blocks.len(), 6);
        assert_eq!(error.blocks[5].rect, Rect { x: 32, y: 16, width: 8, height: 4 });
        assert_eq!(Some(error.worst), error.blocks[5].relative);
        assert!(error.mean < error.worst);
    }

    #[test]
    fn dark_blocks_use_a_mean_based_floor_and_black_ones_are_unlit() {
        let mut image = gray(32, 16, 1.0, 0.0);
        for (x, y) in (Rect { x: 16, y: 0, width: 16, height: 16 }).pixels() {
            image.color.pixels[(y * 32 + x) as usize] = [0.0; 3];
            image.luminance_variance[(y * 32 + x) as usize] = 0.01;
        }
        let error = image.error();
        assert_eq!((error.unlit, error.worst, error.blocks[1].relative), (1, 0.0, None));
        image.color.pixels[16] = [1e-6; 3];
        assert!((image.error().worst - student_95(768.0) * 0.00625 / 0.005).abs() < 1e-4);
    }

    #[test]
    fn a_single_sample_is_not_convergence_and_black_is_unlit() {
        let mut image = gray(16, 16, 0.0, 0.0);
        assert_eq!((image.error().worst, image.error().unlit, image.error().reached_error()), (0.0, 1, None));
        image.samples[77] = 1;
        assert_eq!((image.error().worst, image.error().reached_error()), (f64::INFINITY, None));
        let lit = gray(16, 16, 2.0, 0.01).error();
        assert_eq!(lit.reached_error(), Some(lit.worst));
    }
}
