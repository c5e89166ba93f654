//! One frame: the union of tiles.

use crate::tile::{Ends, Merged};
use crate::{BadSamples, FilmError, FrameImage, SampleRange, Tile, Tiling};

/// What an insertion did.
pub type Inserted = Merged;

/// The tiles of a frame as far as they have arrived: a set keyed by (tile, sample range), kept as one sum a tile.
///
/// The result depends on the set of inserted keys alone, not on the order or on repetitions.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    tiling: Tiling,
    tiles: Vec<Option<Tile>>,
}

impl Frame {
    /// A frame without samples.
    pub fn new(tiling: Tiling) -> Self {
        Self { tiling, tiles: vec![None; tiling.count()] }
    }

    /// How the film is cut.
    pub fn tiling(&self) -> Tiling {
        self.tiling
    }

    /// Takes the samples of `tile` in; samples that are here already change nothing.
    /// - errors: the tile's pixels are none of the frame's tiles, or its sample ranges overlap others (see [`Tile::merge`]).
    pub fn insert(&mut self, tile: Tile) -> Result<Inserted, FilmError> {
        let index = self.tiling.index_of(tile.rect).ok_or(FilmError::NotInFrame(tile.rect))?;
        match &mut self.tiles[index] {
            Some(old) => old.merge(&tile),
            empty => {
                *empty = Some(tile);
                Ok(Merged::New)
            }
        }
    }

    /// The sums of tile `index`, `None` when nothing has arrived or there is no such tile.
    pub fn tile(&self, index: usize) -> Option<&Tile> {
        self.tiles.get(index)?.as_ref()
    }

    /// Holds the samples of each half of tile `index` from `ends` on ([`Tile::hold`]); nothing where there is no such tile.
    pub fn hold(&mut self, index: usize, ends: Ends) -> Result<(), FilmError> {
        self.tiles.get_mut(index).and_then(Option::as_mut).map_or(Ok(()), |tile| tile.hold(ends))
    }

    /// The sample ranges of tile `index` that have arrived, ascending.
    pub fn ranges(&self, index: usize) -> &[SampleRange] {
        self.tile(index).map_or(&[], Tile::ranges)
    }

    /// Account of all samples that were left out.
    pub fn bad(&self) -> BadSamples {
        let mut all = BadSamples::default();
        self.tiles.iter().flatten().for_each(|tile| all.merge(tile.bad()));
        all
    }

    /// The image: means, variances of the means, counts. Pixels without samples are zero.
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
