//! What is told of a painted target.

use femc_stylize::{Figures, Stylized};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A painted target.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// The picture's file.
    pub image: String,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Levels of the pyramids.
    pub levels: usize,
    /// Time that it took.
    pub seconds: f64,
    /// Target patches; each has a source patch.
    pub target_patches: usize,
    /// As [`Figures`] has it; so are those below.
    pub guide_error: f64,
    /// Bits.
    pub usage_entropy: f64,
    /// Bits.
    pub usage_entropy_most: f64,
    /// Part of the source patches.
    pub unused: f64,
    /// Part of the style's pixels.
    pub unused_pixels: f64,
    /// Part of the style's.
    pub sharpness: Option<f64>,
    /// Mean difference from the frame before along the motion, levels of 255.
    pub flicker: Option<f64>,
}

impl Row {
    /// Of a picture that was written to `out`.
    pub fn of(out: &Path, painted: &Stylized, flicker: Option<f64>, seconds: f64) -> Self {
        let Figures { guide_error, usage_entropy, usage_entropy_most, unused, unused_pixels, sharpness } =
            painted.figures;
        Self {
            image: out.display().to_string(),
            width: painted.image.width(),
            height: painted.image.height(),
            levels: painted.levels,
            seconds,
            target_patches: painted.field.patches.len(),
            guide_error,
            usage_entropy,
            usage_entropy_most,
            unused,
            unused_pixels,
            sharpness,
            flicker,
        }
    }
}
