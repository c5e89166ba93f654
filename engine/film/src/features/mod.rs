//! Features of a tile: exact means of first-hit numbers of each pixel's samples, and the shares of ids.
//!
//! A pixel stores the number of its samples and the number of hits. For the hits, it stores the sums of some numbers, and how many
//! belong to which ids. The film does not know the meaning of the numbers and ids. All good samples count, as in the picture's
//! albedo and depth, whether the picture holds them or not, because no decision was based on them.
//!
//! A number is rounded once to a multiple of 2^-40 and clamped to 2^40. A sum of 2^32 such numbers fits into 128 bits, so addition
//! is exact in any order. This costs 16 bytes per number and pixel before compression.
//!
//! The binary format is a header and a zstd frame of byte planes. Another header joins the data of a tile besides its picture:
//!
//! | bytes | content |
//! | --- | --- |
//! | 8 | `FEMCFEAT`: sums of a tile; `FEMCFPIX`: resolved pixels of several tiles; `FEMCBESD`: the light layers and the features of either |
//! | 4 | format version, 1 |
//! | 16 | BLAKE3 of everything after this field, first half |
//! | 2 x 4 | `FEMCBESD`: bytes of light layers, of features; 0: none. Both follow, and nothing else |
//! | 2 x 4 | others: number of numbers, 0 to 64, and of kinds of ids, 0 to 8 |
//! | 6 x 4 | sums: x, y, width, height; first sample, one past the last |
//! | 4 each | sums: for each kind of ids, the number of entries in all pixels |
//! | 5 x 4 | pixels: film width, film height, tile edge; first tile, one past the last |
//! | 8 each | pixels: for each tile, its first sample and one past the last |
//! | rest | zstd frame. Sums: samples and hits of each pixel, numbers pixel by pixel, and for each kind the pixels' numbers of entries and the entries, ids ascending, with their samples. Pixels: tile by tile, the words of the pixel, one after the other |

mod aovs;
mod piece;
mod sums;
mod tile;

pub use aovs::{AovPiece, AovTile};
pub use piece::{FeatureImage, FeaturePiece};
pub use sums::FeatureSums;
pub use tile::FeatureTile;

use crate::FilmError;

/// Number of ids that an image stores per pixel: those with the most samples.
pub const RANKS: usize = 6;

/// Maximum number of numbers, and of kinds of ids.
const MAX_FEATURES: [u32; 2] = [64, 8];

/// Number of values and of kinds of ids of a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FeatureLayout {
    /// Number of averaged values, at most 64.
    pub values: u32,
    /// Number of kinds of ids, at most 8.
    pub ids: u32,
}

impl FeatureLayout {
    /// Returns the number of channels of a resolved pixel: the values, the coverage, and for each kind [`RANKS`] times an id and
    /// its share.
    pub fn channels(self) -> usize {
        self.values as usize + 1 + 2 * RANKS * self.ids as usize
    }

    fn check(self) -> Result<Self, FilmError> {
        let fits = self.values <= MAX_FEATURES[0] && self.ids <= MAX_FEATURES[1];
        fits.then_some(self).ok_or(FilmError::Corrupt("invalid number of features"))
    }
}
