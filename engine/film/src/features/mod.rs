//! Features of a tile: exact means of numbers about what each pixel's samples have met first, and shares of what they belong to.
//!
//! A pixel has the number of its samples and of those that met something, of these the sums of some numbers, and how many of them
//! belong to which ids. What the numbers and ids mean the film does not know. All good samples count, as in the picture's albedo and
//! depth, whether the picture holds them or not: nothing was decided by them.
//!
//! A number is rounded once to a multiple of 2^-40 and kept within 2^40; a sum of 2^32 of these fits 128 bits, so that addition is exact in
//! any order. That costs 16 bytes a number and pixel before compression.
//!
//! As bytes, a header and a zstd frame of byte planes; what a tile has beside its picture is put together in one more header:
//!
//! | bytes | what |
//! | --- | --- |
//! | 8 | `FEMCFEAT`: sums of a tile; `FEMCFPIX`: resolved pixels of several tiles; `FEMCBESD`: the light layers and the features of either |
//! | 4 | format version, 1 |
//! | 16 | BLAKE3 of everything after this field, first half |
//! | 2 x 4 | of `FEMCBESD`: bytes of light layers, of features; 0: none. Both follow, and are all |
//! | 2 x 4 | of others: number of numbers, 0 to 64, and of kinds of ids, 0 to 8 |
//! | 6 x 4 | of sums: x, y, width, height; first sample, one past the last |
//! | 4 each | of sums: of each kind of ids the number of entries in all pixels |
//! | 5 x 4 | of pixels: film width, film height, tile edge; first tile, one past the last |
//! | 8 each | of pixels: of each tile its samples, the first, one past the last |
//! | rest | zstd frame: of sums samples and hits of each pixel, numbers pixel by pixel, and for each kind the pixels' numbers of entries and the entries, ids ascending, with their samples; of pixels tile by tile the words of the pixel, one after the other |

mod beside;
mod piece;
mod sums;
mod tile;

pub use beside::{BesidePiece, BesideTile};
pub use piece::{FeatureImage, FeaturePiece};
pub use sums::FeatureSums;
pub use tile::FeatureTile;

use crate::FilmError;

/// Ids of a pixel that an image tells, those that most samples belong to.
pub const RANKS: usize = 6;

/// Most numbers, and most kinds of ids.
const MOST: [u32; 2] = [64, 8];

/// How many numbers and kinds of ids a pixel has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FeatureLayout {
    /// Numbers that are averaged, at most 64.
    pub values: u32,
    /// Kinds of ids, at most 8.
    pub ids: u32,
}

impl FeatureLayout {
    /// Channels of a resolved pixel: the numbers, the coverage, and of each kind [`RANKS`] times an id and its share.
    pub fn channels(self) -> usize {
        self.values as usize + 1 + 2 * RANKS * self.ids as usize
    }

    fn check(self) -> Result<Self, FilmError> {
        let fits = self.values <= MOST[0] && self.ids <= MOST[1];
        fits.then_some(self).ok_or(FilmError::Corrupt("impossible number of features"))
    }
}
