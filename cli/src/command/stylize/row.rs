//! Report row of a painted target in `femc stylize`: its file, size, time and quality figures.

use femc_stylize::{QualityMetrics, StylizedImage};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A painted target.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// Picture file.
    pub image: String,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Number of pyramid levels.
    pub levels: usize,
    /// Time in seconds.
    pub seconds: f64,
    /// Number of target patches; each has a source patch.
    pub target_patches: usize,
    /// Quality figures.
    #[serde(flatten)]
    pub figures: QualityMetrics,
    /// Mean difference from the previous frame along the motion, levels of 255.
    pub flicker: Option<f64>,
}

impl Row {
    /// Creates the row of a picture that was written to `out`.
    pub fn new(out: &Path, painted: &StylizedImage, flicker: Option<f64>, seconds: f64) -> Self {
        Self {
            image: out.display().to_string(),
            width: painted.image.width(),
            height: painted.image.height(),
            levels: painted.levels,
            seconds,
            target_patches: painted.field.patches.len(),
            figures: painted.quality,
            flicker,
        }
    }
}
