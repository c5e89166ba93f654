//! A frame in work as a picture: the same union that the farm will make, of what is there.

use super::client::Farm;
use crate::exit::{Failure, failed};
use femc_film::{BadSamples, Frame, FrameImage, Piece, Provenance, Tile, Tiling, exr};
use femc_model::{Digest, FrameParts, Output, Role};
use std::collections::BTreeSet;
use std::path::Path;

/// A frame as far as it is done; it grows.
pub struct Partial {
    frame: u32,
    union: Frame,
    /// Of groups of tiles, which take the place of what is in `union`.
    pieces: Vec<Piece>,
    /// What is taken in.
    seen: BTreeSet<Digest>,
}

impl Partial {
    /// Nothing of a frame yet.
    pub fn new(parts: &FrameParts) -> Result<Self, Failure> {
        let ([width, height], edge) = (parts.grid.film, parts.grid.tile);
        let union = Frame::new(Tiling::new(width, height, edge).map_err(failed)?);
        Ok(Self { frame: parts.frame, union, pieces: Vec::new(), seen: BTreeSet::new() })
    }

    /// Whether these parts are of the same frame and add to what is here: another round begins with other sums.
    pub fn may_take(&self, parts: &FrameParts) -> bool {
        let mut sums = parts.outputs.iter().filter(|output| output.role == Role::Sums);
        self.frame == parts.frame && sums.all(|sums| self.seen.contains(&sums.artifact.digest))
    }

    /// Take in what is new; false if the frame went on meanwhile, and its parts are gone.
    pub async fn take(&mut self, farm: &Farm, parts: &FrameParts) -> Result<bool, Failure> {
        for Output { role, artifact } in &parts.outputs {
            let shows_pixels = matches!(role, Role::Tile | Role::Sums | Role::Pixels);
            if !shows_pixels || self.seen.contains(&artifact.digest) {
                continue;
            }
            let Some(bytes) = farm.get_if_there(artifact).await? else { return Ok(false) };
            match role {
                Role::Tile => self.insert(vec![Tile::decode(&bytes).map_err(failed)?])?,
                Role::Sums => self.insert(femc_worker::decode_sums(&bytes).map_err(failed)?)?,
                Role::Pixels => self.pieces.push(Piece::decode(&bytes).map_err(failed)?),
                _ => {}
            }
            self.seen.insert(artifact.digest);
        }
        Ok(true)
    }

    fn insert(&mut self, tiles: Vec<Tile>) -> Result<(), Failure> {
        tiles.into_iter().try_for_each(|tile| self.union.insert(tile).map(drop)).map_err(failed)
    }

    /// Black where nothing is rendered yet.
    pub fn image(&self) -> Result<FrameImage, Failure> {
        let mut image = self.union.resolve();
        self.pieces.iter().try_for_each(|piece| image.put(piece)).map_err(failed)?;
        Ok(image)
    }

    fn bad(&self) -> BadSamples {
        let mut bad = BadSamples::default();
        let is_loose = |index: &usize| !self.pieces.iter().any(|piece| piece.tiles().contains(index));
        let loose = (0..self.union.tiling().count()).filter(is_loose).filter_map(|index| self.union.tile(index));
        loose.map(Tile::bad).chain(self.pieces.iter().map(Piece::bad)).for_each(|part| bad.merge(part));
        bad
    }

    /// Write it as EXR.
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
            bad: self.bad(),
        };
        femc_film::file::write_atomic(path, &exr::encode(&image, &provenance).map_err(failed)?).map_err(failed)
    }
}
