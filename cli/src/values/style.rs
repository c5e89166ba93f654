//! Painted styles: those that come with the program, and the user's own.

use crate::exit::{Failure, failed, usage};
use femc_film::{FilmError, Picture};
use femc_reports::human;
use femc_stylize::{ChannelImage, GuideFrame, frames, styles};
use std::path::{Path, PathBuf};

/// A painting, and the render under it.
#[derive(Debug)]
pub struct PaintingStyle {
    /// The painting in red, green and blue, 0..1.
    pub painting: ChannelImage,
    /// The render, of the painting's size.
    pub source: GuideFrame,
    /// Name of the source in error messages.
    pub source_path: PathBuf,
    /// Share of the painting's pixels that are transparent, fully or in part.
    pub transparent: f64,
}

impl PaintingStyle {
    /// Reads a style that comes with the program, by its name, or the painting at `style`. The painting lies over the render at
    /// `source`, or over that of the styles that come with the program.
    pub fn read(style: &Path, source: Option<&Path>) -> Result<Self, Failure> {
        let bytes = match style.to_str().and_then(styles::png) {
            Some(painting) => painting.to_vec(),
            None => std::fs::read(style).map_err(|error| match error.kind() {
                std::io::ErrorKind::NotFound => usage(format!(
                    "--style {}: no such file; give a PNG, or one of the styles {}",
                    style.display(),
                    styles::names().collect::<Vec<_>>().join(", ")
                )),
                _ => failed(format!("--style {}: {error}", style.display())),
            })?,
        };
        match source {
            Some(path) => Self::from_png(style, &bytes, guide_frame("--source", path)?, path),
            None => {
                let ball = styles::source().map_err(failed)?;
                Self::from_png(style, &bytes, ball, Path::new("scenes/styles/ball.layers.exr"))
            }
        }
    }

    /// Returns a warning about the painting's transparency; `None`: it is opaque.
    pub fn transparency_warning(&self) -> Option<String> {
        (self.transparent > 0.0).then(|| {
            format!(
                "the painting is transparent in {} of its pixels, which count as white paint: the pictures become white there; paint \
                 a background instead",
                human::percent(self.transparent)
            )
        })
    }

    fn from_png(path: &Path, png: &[u8], source: GuideFrame, source_path: &Path) -> Result<Self, Failure> {
        let fault = |error: &dyn std::fmt::Display| failed(format!("--style {}: {error}; give a PNG", path.display()));
        let (picture, clear) = Picture::from_any_png_counting_transparent(png).map_err(|error| fault(&error))?;
        let [width, height] = source.size();
        if [picture.width, picture.height] != [width, height] {
            return Err(failed(format!(
                "--style {} has {}x{} pixels, the source {} {width}x{height}; paint over the source, pixel by pixel",
                path.display(),
                picture.width,
                picture.height,
                source_path.display(),
            )));
        }
        let painting = frames::image_from_picture(&picture).map_err(|error| fault(&error))?;
        let transparent = clear as f64 / picture.pixels.len().max(1) as f64;
        Ok(Self { painting, source, source_path: source_path.to_owned(), transparent })
    }
}

/// Reads a frame whose layers are guides.
pub fn guide_frame(flag: &str, path: &Path) -> Result<GuideFrame, Failure> {
    GuideFrame::read(path).map_err(|error| match error {
        FilmError::File { path, cause } if cause.kind() == std::io::ErrorKind::NotFound => {
            usage(format!("{flag} {}: no such file; give an EXR image", path.display()))
        }
        error => failed(format!("{flag}: {error}; give an EXR image with channels R, G and B, or with layers")),
    })
}
