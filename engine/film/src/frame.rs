//! A frame: the union of its tiles.

use crate::tile::{HalfEnds, MergeOutcome};
use crate::{BadSamples, FilmError, FrameImage, SampleRange, Tile, Tiling};

/// Result of an insertion.
pub type InsertOutcome = MergeOutcome;

/// The tiles of a frame that have arrived so far: a set keyed by (tile, sample range), stored as one sum per tile.
///
/// The result depends only on the set of inserted keys, not on order or repetitions.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    tiling: Tiling,
    tiles: Vec<Option<Tile>>,
}

impl Frame {
    /// Creates a frame without samples.
    pub fn new(tiling: Tiling) -> Self {
        Self { tiling, tiles: vec![None; tiling.count()] }
    }

    /// Returns the tiling of the film.
    pub fn tiling(&self) -> Tiling {
        self.tiling
    }

    /// Adds the samples of `tile`; samples that are already in the frame change nothing.
    /// - errors: the tile's pixels match no tile of the frame, or its sample ranges overlap others (see [`Tile::merge`]).
    pub fn insert(&mut self, tile: Tile) -> Result<InsertOutcome, FilmError> {
        let index = self.tiling.index_of(tile.rect).ok_or(FilmError::NotInFrame(tile.rect))?;
        match &mut self.tiles[index] {
            Some(old) => old.merge(&tile),
            empty => {
                *empty = Some(tile);
                Ok(MergeOutcome::New)
            }
        }
    }

    /// Returns the sums of tile `index`; `None` if nothing has arrived or there is no such tile.
    pub fn tile(&self, index: usize) -> Option<&Tile> {
        self.tiles.get(index)?.as_ref()
    }

    /// Holds the samples of each half of tile `index` from `ends` on ([`Tile::hold`]); does nothing if there is no such tile.
    pub fn hold(&mut self, index: usize, ends: HalfEnds) -> Result<(), FilmError> {
        self.tiles.get_mut(index).and_then(Option::as_mut).map_or(Ok(()), |tile| tile.hold(ends))
    }

    /// Returns the sample ranges of tile `index` that have arrived, ascending.
    pub fn ranges(&self, index: usize) -> &[SampleRange] {
        self.tile(index).map_or(&[], Tile::ranges)
    }

    /// Returns the account of all samples that were left out.
    pub fn bad_samples(&self) -> BadSamples {
        let mut all = BadSamples::default();
        self.tiles.iter().flatten().for_each(|tile| all.merge(tile.bad_samples()));
        all
    }

    /// Resolves the image: means, variances of the means, counts. Pixels without samples are zero.
    pub fn resolve(&self) -> FrameImage {
        let Tiling { width, height, .. } = self.tiling;
        let mut image = FrameImage::black(width, height);
        for tile in self.tiles.iter().flatten() {
            for ((x, y), sums) in tile.rect.pixels().zip(&tile.pixels) {
                image.set(y as usize * width as usize + x as usize, &sums.resolve(tile.is_held()));
            }
        }
        image
    }
}
