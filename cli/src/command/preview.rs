//! Preview of a frame in progress. It combines the existing parts in the same way as the farm will combine all parts.

use super::client::FarmClient;
use crate::exit::{Failure, failed};
use femc_film::{FrameImage, Provenance, exr};
use femc_model::{Digest, FrameParts, Output, Role};
use femc_pictures::shows_pixels;
use std::collections::BTreeSet;
use std::path::Path;

/// A partly rendered frame, which grows.
pub struct PreviewFrame {
    frame: u32,
    assembly: femc_pictures::PartialFrame,
    /// Digests of the parts that have been added.
    added: BTreeSet<Digest>,
}

impl PreviewFrame {
    /// Creates an empty frame.
    pub fn new(parts: &FrameParts) -> Result<Self, Failure> {
        let assembly = femc_pictures::PartialFrame::new(parts).map_err(failed)?;
        Ok(Self { frame: parts.frame, assembly, added: BTreeSet::new() })
    }

    /// Returns whether these parts belong to the same frame and extend this one. After the start of another round the sums differ,
    /// and they do not.
    pub fn can_extend(&self, parts: &FrameParts) -> bool {
        let mut sums = parts.outputs.iter().filter(|output| output.role == Role::Sums);
        self.frame == parts.frame && sums.all(|sums| self.added.contains(&sums.artifact.digest))
    }

    /// Adds the new parts. Returns false if the frame has progressed meanwhile and its parts are gone.
    pub async fn add_parts(&mut self, farm: &FarmClient, parts: &FrameParts) -> Result<bool, Failure> {
        for Output { role, artifact } in &parts.outputs {
            if !shows_pixels(*role) || self.added.contains(&artifact.digest) {
                continue;
            }
            let Some(bytes) = farm.get_if_present(artifact).await? else { return Ok(false) };
            self.assembly.insert(*role, &bytes).map_err(failed)?;
            self.added.insert(artifact.digest);
        }
        Ok(true)
    }

    /// Returns the image, black where nothing is rendered yet.
    pub fn image(&self) -> Result<FrameImage, Failure> {
        self.assembly.image().map_err(failed)
    }

    /// Writes the image as EXR.
    pub fn write(&self, path: &Path) -> Result<(), Failure> {
        let image = self.image()?;
        let provenance = Provenance {
            version: env!("CARGO_PKG_VERSION").into(),
            engine: String::new(),
            settings: String::new(),
            bias: None,
            allocation: None,
            scene: String::new(),
            frame: self.frame,
            seconds: 0.0,
            spp: image.mean_spp(),
            error: image.error(),
            bad: self.assembly.bad_samples(),
        };
        femc_film::file::write_atomic(path, &exr::encode(&image, &provenance).map_err(failed)?).map_err(failed)
    }
}
