//! Unfinished frames. The available outputs are combined as the farm will combine all of them.

use crate::shows_pixels;
use femc_film::{BadSamples, FilmError, Frame, FrameImage, ImagePiece, Tile, Tiling, sums};
use femc_model::{FrameParts, Role};

/// An unfinished frame, to which outputs are added.
pub struct PartialFrame {
    frame: Frame,
    /// Resolved groups of tiles. They replace the tiles in `frame`.
    pieces: Vec<ImagePiece>,
}

impl PartialFrame {
    /// Makes a frame without outputs.
    pub fn new(parts: &FrameParts) -> Result<Self, FilmError> {
        let ([width, height], edge) = (parts.grid.film, parts.grid.tile);
        Ok(Self { frame: Frame::new(Tiling::new(width, height, edge)?), pieces: Vec::new() })
    }

    /// Adds an output. Outputs that show no pixels are ignored.
    pub fn insert(&mut self, role: Role, bytes: &[u8]) -> Result<(), FilmError> {
        debug_assert!(shows_pixels(role));
        match role {
            Role::Tile => self.insert_tiles(vec![Tile::decode(bytes)?]),
            Role::Sums => self.insert_tiles(sums::decode(bytes)?),
            Role::Pixels => {
                self.pieces.push(ImagePiece::decode(bytes)?);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn insert_tiles(&mut self, tiles: Vec<Tile>) -> Result<(), FilmError> {
        tiles.into_iter().try_for_each(|tile| self.frame.insert(tile).map(drop))
    }

    /// Returns the image. It is black where nothing is rendered yet.
    pub fn image(&self) -> Result<FrameImage, FilmError> {
        let mut image = self.frame.resolve();
        self.pieces.iter().try_for_each(|piece| image.put(piece))?;
        Ok(image)
    }

    /// Returns the counts of samples that were left out.
    pub fn bad_samples(&self) -> BadSamples {
        let mut bad = BadSamples::default();
        let is_loose = |index: &usize| !self.pieces.iter().any(|piece| piece.tiles().contains(index));
        let loose = (0..self.frame.tiling().count()).filter(is_loose).filter_map(|index| self.frame.tile(index));
        loose
            .map(Tile::bad_samples)
            .chain(self.pieces.iter().map(ImagePiece::bad_samples))
            .for_each(|part| bad.merge(part));
        bad
    }
}
