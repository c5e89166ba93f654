//! A finished frame with the metadata of its file.

use crate::exit::{Failure, failed, usage};
use crate::request::FrameMetadata;
use femc_film::convergence::BLOCK_EDGE;
use femc_film::{FilmError, Image, Rect, exr};
use femc_pipeline::Settings;
use femc_pipeline::variance_attribution::ExpectedPixel;
use std::path::Path;

/// Contents of the file.
pub struct Frame {
    /// Settings that it was rendered with.
    pub settings: Settings,
    /// Digest of its scene.
    pub scene: String,
    /// Frame number in the clip, from 1.
    pub number: u32,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    image: Image,
    errors: Vec<f32>,
    samples: Vec<f32>,
}

/// A block of pixels with a large error.
#[derive(Clone, Copy, Debug)]
pub struct WorstBlock {
    /// Pixels of the block.
    pub rect: Rect,
    /// Relative error, as the file states it.
    pub error: f64,
    /// Mean luminance, cd/m2.
    pub mean: f64,
    /// Luminance that the error is relative to: the mean, or the frame's floor, cd/m2.
    pub scale: f64,
}

impl Frame {
    /// Reads a frame that this build of the engine has rendered.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let file = exr::read(path).map_err(|error| match error {
            FilmError::File { path, cause } if cause.kind() == std::io::ErrorKind::NotFound => {
                usage(format!("{}: no such file; give a frame that femc has rendered", path.display()))
            }
            other => failed(other),
        })?;
        let FrameMetadata { settings, frame: number, scene, engine } = FrameMetadata::parse(path, &file.attributes)?;
        if engine != femc_worker::engine() {
            return Err(failed(format!(
                "{} was rendered by build {engine} of the engine, but this femc has build {}: only the same build draws the same \
                 samples; render the frame again, or use the femc that rendered it",
                path.display(),
                femc_worker::engine()
            )));
        }
        let (width, height, [errors, samples]) =
            exr::read_channels(path, ["relative_error.Y", "samples.Y"]).map_err(failed)?;
        Ok(Self { settings, scene, number, width, height, image: file.image, errors, samples })
    }

    fn pixel_index(&self, (x, y): (u32, u32)) -> usize {
        y as usize * self.width as usize + x as usize
    }

    /// Returns the samples and the color of a pixel.
    pub fn pixel(&self, pixel: (u32, u32)) -> ExpectedPixel {
        let at = self.pixel_index(pixel);
        ExpectedPixel { samples: self.samples[at] as u32, color: self.image.pixels[at] }
    }

    /// Returns the blocks with the largest errors, the worst first. Of equal blocks, the upper left one comes first.
    pub fn worst_blocks(&self, most: usize) -> Vec<WorstBlock> {
        let luminance = |pixel| f64::from(self.image.luminance(self.pixel_index(pixel)));
        let frame = Rect { x: 0, y: 0, width: self.width, height: self.height };
        let floor = 0.01 * frame.pixels().map(luminance).sum::<f64>() / frame.area() as f64;
        let corners = (0..self.height).step_by(BLOCK_EDGE as usize);
        let corners = corners.flat_map(|y| (0..self.width).step_by(BLOCK_EDGE as usize).map(move |x| (x, y)));
        let block = |(x, y): (u32, u32)| {
            let rect = Rect { x, y, width: BLOCK_EDGE.min(self.width - x), height: BLOCK_EDGE.min(self.height - y) };
            let mean = rect.pixels().map(luminance).sum::<f64>() / rect.area() as f64;
            WorstBlock { rect, error: f64::from(self.errors[self.pixel_index((x, y))]), mean, scale: mean.max(floor) }
        };
        let mut blocks: Vec<WorstBlock> = corners.map(block).filter(|block| block.error > 0.0).collect();
        blocks.sort_by(|a, b| b.error.total_cmp(&a.error));
        blocks.truncate(most);
        blocks
    }
}
