//! Painted versions of frames, beside them: `FRAME.painted.png`.

use super::layers_path;
use crate::args::SettingsArgs;
use crate::command::stylize::{PaintRequest, PaintResult, common_curve};
use crate::exit::{Failure, usage};
use crate::output::Printer;
use crate::values::{Exposure, PaintingStyle};
use clap::Args;
use femc_stylize::{Settings, styles};
use femc_worker::Painting;
use std::path::{Path, PathBuf};

/// Style in which frames are painted. `femc stylize` has more options, and paints existing frames.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Painting")]
pub struct PaintingArgs {
    /// Also paint each frame as FRAME.painted.png: hatching, watercolor, oil, cel, or a painting of --style-source (`femc stylize`)
    #[arg(long, value_name = "STYLE")]
    pub style: Option<PathBuf>,
    /// Render under the painting [default: that of the styles that come with femc]
    #[arg(long, value_name = "A.exr", requires = "style")]
    pub style_source: Option<PathBuf>,
    /// Amount by which the painting of a clip may change where the frames do not, from 0 (none) to 1 (each frame is painted
    /// independently) [default: 0.2]
    #[arg(long, value_name = "PART", requires = "style")]
    pub boil: Option<f32>,
}

/// Layers that painting reads: the guides, and the motion and depth that connect a frame to the next.
const PAINTING_LAYERS: [&str; 3] = ["guides", "motion", "depth"];

/// Adds the layers that painting reads, if they are not requested yet.
pub fn request_painting_layers(settings: &mut SettingsArgs) {
    let missing = PAINTING_LAYERS.into_iter().filter(|name| !settings.layers.iter().any(|asked| asked.trim() == *name));
    let missing: Vec<String> = missing.map(str::to_owned).collect();
    settings.layers.extend(missing);
}

impl PaintingArgs {
    /// Reads the style, before anything is rendered.
    pub fn style(&self) -> Result<Option<PaintingStyle>, Failure> {
        if let Some(boil) = self.boil.filter(|boil| !(0.0..=1.0).contains(boil)) {
            return Err(usage(format!("--boil {boil}: give a number from 0 to 1")));
        }
        self.style.as_deref().map(|style| PaintingStyle::read(style, self.style_source.as_deref())).transpose()
    }

    /// Returns the painting for a farm. Its style must be one that comes with femc, because workers have no others.
    pub fn requested_painting(&self) -> Result<Option<Painting>, Failure> {
        let Some(style) = &self.style else { return Ok(None) };
        let boil = self.boil.unwrap_or(Settings::default().boil);
        let painting = Painting { style: style.display().to_string(), boil };
        if self.style_source.is_none() && painting.is_valid() {
            return Ok(Some(painting));
        }
        self.style()?;
        let names = styles::names().collect::<Vec<_>>().join(", ");
        Err(usage(format!(
            "--style {}: a farm only has the styles {names}; paint fetched frames in other styles with `femc stylize`",
            style.display()
        )))
    }

    /// Paints the frames in order.
    /// - `threads`: number of threads, 0: one per processor;
    /// - `checkpoint`: checkpoint file, which exists while painting runs.
    pub fn paint(
        &self,
        style: &PaintingStyle,
        files: &[String],
        exposure: Exposure,
        threads: u32,
        checkpoint: &Path,
        printer: Printer,
    ) -> Result<Vec<String>, Failure> {
        if files.is_empty() {
            return Ok(Vec::new());
        }
        let targets: Vec<PathBuf> = files.iter().map(|file| layers_path(file.as_ref())).collect();
        let outputs: Vec<PathBuf> = files.iter().map(|file| Path::new(file).with_extension("painted.png")).collect();
        let settings = Settings { boil: self.boil.unwrap_or(Settings::default().boil), ..Settings::default() };
        let curve = common_curve(exposure, &targets)?;
        let PaintResult { frames, .. } = PaintRequest { style, guides: &[], curve, settings, threads }
            .paint(&targets, &outputs, checkpoint, printer)?;
        Ok(frames.into_iter().map(|row| row.image).collect())
    }
}
