//! A painted target in the report of `femc stylize`: its file, size, time and figures.

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
    /// What it is judged by.
    #[serde(flatten)]
    pub figures: Figures,
    /// Mean difference from the frame before along the motion, levels of 255.
    pub flicker: Option<f64>,
}

impl Row {
    /// Of a picture that was written to `out`.
    pub fn of(out: &Path, painted: &Stylized, flicker: Option<f64>, seconds: f64) -> Self {
        Self {
            image: out.display().to_string(),
            width: painted.image.width(),
            height: painted.image.height(),
            levels: painted.levels,
            seconds,
            target_patches: painted.field.patches.len(),
            figures: painted.figures,
            flicker,
        }
    }
}
