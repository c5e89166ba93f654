//! Unfinished frames. The available outputs are combined as the farm will combine all of them.

use crate::shows_pixels;
use femc_film::{BadSamples, FilmError, Frame, FrameImage, Piece, Tile, Tiling};
use femc_model::{FrameParts, Role};

/// An unfinished frame, to which outputs are added.
pub struct Partial {
    union: Frame,
    /// Resolved groups of tiles. They replace the tiles in `union`.
    pieces: Vec<Piece>,
}

impl Partial {
    /// Makes a frame without outputs.
    pub fn new(parts: &FrameParts) -> Result<Self, FilmError> {
        let ([width, height], edge) = (parts.grid.film, parts.grid.tile);
        Ok(Self { union: Frame::new(Tiling::new(width, height, edge)?), pieces: Vec::new() })
    }

    /// Adds an output. Outputs that show no pixels are ignored.
    pub fn insert(&mut self, role: Role, bytes: &[u8]) -> Result<(), FilmError> {
        debug_assert!(shows_pixels(role));
        match role {
            Role::Tile => self.put(vec![Tile::decode(bytes)?]),
            Role::Sums => self.put(femc_worker::decode_sums(bytes)?),
            Role::Pixels => {
                self.pieces.push(Piece::decode(bytes)?);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn put(&mut self, tiles: Vec<Tile>) -> Result<(), FilmError> {
        tiles.into_iter().try_for_each(|tile| self.union.insert(tile).map(drop))
    }

    /// Returns the image. It is black where nothing is rendered yet.
    pub fn image(&self) -> Result<FrameImage, FilmError> {
        let mut image = self.union.resolve();
        self.pieces.iter().try_for_each(|piece| image.put(piece))?;
        Ok(image)
    }

    /// Returns the counts of samples that were left out.
    pub fn bad(&self) -> BadSamples {
        let mut bad = BadSamples::default();
        let is_loose = |index: &usize| !self.pieces.iter().any(|piece| piece.tiles().contains(index));
        let loose = (0..self.union.tiling().count()).filter(is_loose).filter_map(|index| self.union.tile(index));
        loose.map(Tile::bad).chain(self.pieces.iter().map(Piece::bad)).for_each(|part| bad.merge(part));
        bad
    }
}
