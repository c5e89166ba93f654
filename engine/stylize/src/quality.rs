//! Quality figures of a result.

use crate::{ChannelImage, PatchField};
use femc_math::elementary::double;
use serde::{Deserialize, Serialize};

/// Figures of a stylized picture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct QualityMetrics {
    /// Mean over target patches of the squared difference between their guides and those of their source patches, summed over
    /// pixels and channels; guides in 0..255, not weighted by mu.
    pub guide_error: f64,
    /// Entropy of the use of source patches, bits.
    pub usage_entropy: f64,
    /// Upper bound of the entropy: all source patches are used equally or, if the target has fewer patches, each is used at most
    /// once.
    pub usage_entropy_most: f64,
    /// Fraction of the source patches that are unused.
    pub unused: f64,
    /// Fraction of the style's pixels that lie in no used patch.
    pub unused_pixels: f64,
    /// Mean gradient of the result's luma over that of the style's; `None`: the style has no gradient.
    pub sharpness: Option<f64>,
}

impl QualityMetrics {
    /// Computes the figures of a field and of the image that it paints.
    pub(crate) fn new(
        field: &PatchField,
        guides: [&ChannelImage; 2],
        style: &ChannelImage,
        result: &ChannelImage,
    ) -> Self {
        let mut uses = vec![0u32; field.source.count()];
        field.patches.iter().for_each(|&p| uses[p as usize] += 1);
        let total = field.patches.len() as f64;
        let entropy = |uses: u32| double::log2(total / f64::from(uses)) * f64::from(uses) / total;
        let mut seen = vec![false; style.width() * style.height()];
        for p in (0..uses.len()).filter(|&p| uses[p] > 0) {
            let (x, y) = field.source.corner(p as u32);
            let rows = (y..y + field.source.patch()).map(|row| row * style.width() + x);
            rows.for_each(|at| seen[at..at + field.source.patch()].fill(true));
        }
        let part = |count: usize, all: usize| count as f64 / all as f64;
        let (painted, sharp) = (gradient(result), gradient(style));
        Self {
            guide_error: guide_error(field, guides),
            usage_entropy: uses.iter().filter(|&&uses| uses > 0).map(|&uses| entropy(uses)).sum(),
            usage_entropy_most: double::log2(uses.len().min(field.patches.len()) as f64),
            unused: part(uses.iter().filter(|&&uses| uses == 0).count(), uses.len()),
            unused_pixels: part(seen.iter().filter(|&&seen| !seen).count(), seen.len()),
            sharpness: (sharp > 0.0).then(|| painted / sharp),
        }
    }
}

fn guide_error(field: &PatchField, [source, target]: [&ChannelImage; 2]) -> f64 {
    let patch = field.target.patch();
    let error = |(q, &p): (usize, &u32)| {
        let ((x, y), (u, v)) = (field.source.corner(p), field.target.corner(q as u32));
        let row = |row: usize| {
            let pairs = source.run(x, y + row, patch).iter().zip(target.run(u, v + row, patch));
            pairs.map(|(a, b)| f64::from(a - b) * f64::from(a - b)).sum::<f64>()
        };
        (0..patch).map(row).sum::<f64>()
    };
    255.0 * 255.0 * field.patches.iter().enumerate().map(error).sum::<f64>() / field.patches.len() as f64
}

/// Computes the mean length of the gradient of Rec.709 luma, by differences of neighbors.
fn gradient(image: &ChannelImage) -> f64 {
    let luma = |x: usize, y: usize| {
        let pixel = image.pixel(x, y);
        0.2126 * f64::from(pixel[0]) + 0.7152 * f64::from(pixel[1]) + 0.0722 * f64::from(pixel[2])
    };
    let (width, height) = (image.width() - 1, image.height() - 1);
    let mut sum = 0.0;
    for y in 0..height {
        for x in 0..width {
            let (dx, dy) = (luma(x + 1, y) - luma(x, y), luma(x, y + 1) - luma(x, y));
            sum += (dx * dx + dy * dy).sqrt();
        }
    }
    sum / (width * height) as f64
}
