//! Finds the block with the largest error.

use femc_film::convergence::{BLOCK_EDGE, FLOOR};
use femc_film::{Image, Rect};

/// Returns the largest relative error of the mean luminance of a block of 16x16 pixels, the blocks of `--error`. It is relative to
/// the reference's mean in the block, or to a fraction of the whole image's mean where the block is darker. The reference's noise
/// is included. 0: nothing is lit.
/// - `image`, `reference`: of one size.
pub fn worst_block(image: &Image, reference: &Image) -> f64 {
    let (width, height) = (reference.width, reference.height);
    let mean = |of: &Image, rect: Rect| {
        let values = rect.pixels().map(|(x, y)| f64::from(of.luminance(y as usize * width as usize + x as usize)));
        values.sum::<f64>() / rect.area() as f64
    };
    let floor = FLOOR * mean(reference, Rect { x: 0, y: 0, width, height });
    let corners = (0..height).step_by(BLOCK_EDGE as usize);
    let corners = corners.flat_map(|y| (0..width).step_by(BLOCK_EDGE as usize).map(move |x| (x, y)));
    let error = |(x, y): (u32, u32)| {
        let rect = Rect { x, y, width: BLOCK_EDGE.min(width - x), height: BLOCK_EDGE.min(height - y) };
        let there = mean(reference, rect);
        (mean(image, rect) - there).abs() / there.max(floor)
    };
    corners.map(error).filter(|error| error.is_finite()).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn block_error_uses_its_mean_and_dark_block_uses_floor() {
        let reference = Image::filled(40, 16, [1.0; 3]);
        let mut image = reference.clone();
        // One pixel of a block of 256, and one of the last block, which has 128.
        image.pixels[3] = [1.0 + 25.6; 3];
        assert!((worst_block(&image, &reference) - 0.1).abs() < 1e-6);
        image.pixels[39] = [1.0 + 25.6; 3];
        assert!((worst_block(&image, &reference) - 0.2).abs() < 1e-6);
        let mut dark = reference.clone();
        (0..640).filter(|at| at % 40 >= 32).for_each(|at| dark.pixels[at] = [0.0; 3]);
        // The scale of the dark block is 1 % of the frame's mean of 0.8.
        let off = worst_block(&reference, &dark);
        assert!((off - 1.0 / 0.008).abs() < 1e-3, "{off}");
        let black = Image::filled(16, 16, [0.0; 3]);
        assert_eq!(worst_block(&black, &black), 0.0);
    }
}
