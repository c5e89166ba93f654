//! Thumbnails, which are exact sums in blocks of 8 x 8 pixels, and levels, which are luminance histograms of blocks.
//!
//! Both are integers, so the levels of a clip do not depend on the parts of its tiles or on the order in which frames were counted.
//! They give one exposure for a clip ([`crate::ToneCurve::from_levels`]) without reading an image. The binary format of a thumbnail
//! is like that of a tile ([`crate::codec`]). The format of levels is
//!
//! | bytes | content |
//! | --- | --- |
//! | 8 | `FEMCLEVL` |
//! | 4 | format version, 1 |
//! | 16 | BLAKE3 of everything after this field, first half |
//! | rest | zstd frame of the counts, 8 bytes each, in byte planes |

use crate::codec::{compress_and_seal, read_header, start_header, to_planes};
use crate::tile::PixelSums;
use crate::{FilmError, Frame, Image, Rect, Tile, Tiling};
use femc_math::elementary::double;

/// Edge of a thumbnail's block, pixels.
pub const THUMBNAIL_BLOCK_EDGE: u32 = 8;

impl Tile {
    /// Returns the tile's sums in blocks of [`THUMBNAIL_BLOCK_EDGE`] x [`THUMBNAIL_BLOCK_EDGE`] pixels of the film: a tile of a
    /// smaller film. Bad samples are in the sums of neither tile. The thumbnail of a merge is the merge of the thumbnails (test
    /// `part_thumbnails_of_a_tile_sum_to_its_own_for_any_cut`).
    /// - domain: tiles whose corner is a multiple of the block size; a tiling with [`Tiling::thumbnail_tiling`] has only such tiles.
    pub fn thumbnail(&self) -> Self {
        let Rect { x, y, width, height } = self.rect;
        let (left, top) = (x / THUMBNAIL_BLOCK_EDGE, y / THUMBNAIL_BLOCK_EDGE);
        let rect = Rect {
            x: left,
            y: top,
            width: (x + width).div_ceil(THUMBNAIL_BLOCK_EDGE) - left,
            height: (y + height).div_ceil(THUMBNAIL_BLOCK_EDGE) - top,
        };
        let mut pixels = vec![PixelSums::default(); rect.area() as usize];
        for ((x, y), sums) in self.rect.pixels().zip(&self.pixels) {
            pixels[((y / THUMBNAIL_BLOCK_EDGE - top) * rect.width + (x / THUMBNAIL_BLOCK_EDGE - left)) as usize]
                .merge(sums);
        }
        Self { rect, ranges: self.ranges.clone(), ends: self.ends, pixels, bad: crate::BadSamples::default(), rays: 0 }
    }
}

impl Tiling {
    /// Returns the tiling of the small film by the thumbnails of the tiles; `None`: the tile width is not a whole number of blocks.
    pub fn thumbnail_tiling(self) -> Option<Self> {
        let Self { width, height, edge } = self;
        let small = Self {
            width: width.div_ceil(THUMBNAIL_BLOCK_EDGE),
            height: height.div_ceil(THUMBNAIL_BLOCK_EDGE),
            edge: edge / THUMBNAIL_BLOCK_EDGE,
        };
        edge.is_multiple_of(THUMBNAIL_BLOCK_EDGE).then_some(small)
    }
}

/// Luminance histogram of blocks of pixels: black blocks, and bins of a 16th of an octave from 2^-40 to 2^40 cd/m2. Luminances
/// beyond the bins count in the first or the last.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LuminanceLevels {
    /// Number of black blocks, then a count for each bin.
    counts: Vec<u64>,
}

impl LuminanceLevels {
    const MAGIC: &'static [u8; 8] = b"FEMCLEVL";
    const VERSION: u32 = 1;
    /// Number of bins in an octave.
    const OCTAVE: f64 = 16.0;
    /// Start of the first bin, octaves above 1 cd/m2.
    const LOWEST: f64 = -40.0;
    const BINS: usize = 80 * 16;

    /// Counts the blocks of thumbnails; a block without a good sample is not counted.
    pub fn from_thumbnails(thumbnails: &Frame) -> Self {
        let mut levels = Self::default();
        let tiles = (0..thumbnails.tiling().count()).filter_map(|index| thumbnails.tile(index));
        for sums in tiles.flat_map(Tile::pixels).filter(|sums| sums.samples() > 0) {
            let sum: f64 = sums.luminance.iter().map(|luminance| luminance.value()).sum();
            levels.counts[Self::bin(sum / f64::from(sums.samples()))] += 1;
        }
        levels
    }

    /// Counts the blocks of a finished image, for callers without thumbnails. The image's pixels are rounded, so a block may count
    /// in a bin next to that of its thumbnail.
    pub fn from_image(image: &Image) -> Self {
        let (small, mut levels) = (image.shrunk_by(THUMBNAIL_BLOCK_EDGE), Self::default());
        (0..small.pixels.len()).for_each(|at| levels.counts[Self::bin(small.luminance(at).into())] += 1);
        levels
    }

    /// Returns the index of a luminance in the counts.
    fn bin(luminance: f64) -> usize {
        if luminance > 0.0 {
            let bin = ((double::log2(luminance) - Self::LOWEST) * Self::OCTAVE).floor();
            return 1 + bin.clamp(0.0, (Self::BINS - 1) as f64) as usize;
        }
        0
    }

    /// Adds the counts of `other`. Associative and commutative.
    pub fn merge(&mut self, other: &Self) {
        self.counts.iter_mut().zip(&other.counts).for_each(|(mine, theirs)| *mine = mine.saturating_add(*theirs));
    }

    /// Returns the luminance in the middle of each bin that has blocks, cd/m2, and the number of its blocks; without black blocks.
    pub fn lit_bins(&self) -> impl Iterator<Item = (f64, u64)> + Clone + '_ {
        let middle = |bin: usize| double::pow(2.0, (bin as f64 + 0.5) / Self::OCTAVE + Self::LOWEST);
        let bins = self.counts[1..].iter().enumerate().filter(|(_, count)| **count > 0);
        bins.map(move |(bin, &count)| (middle(bin), count))
    }

    /// Returns the number of counted blocks.
    pub fn blocks(&self) -> u64 {
        self.counts.iter().fold(0, |sum, count| sum.saturating_add(*count))
    }

    /// Encodes the levels. Equal counts give equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        compress_and_seal(
            start_header(Self::MAGIC, Self::VERSION),
            &to_planes(&self.counts, |count| count.to_le_bytes()),
        )
    }

    /// Decodes levels; damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, FilmError> {
        let reader = read_header(Self::MAGIC, Self::VERSION, bytes)?;
        Ok(Self { counts: reader.planes(1 + Self::BINS, |bytes| u64::from_le_bytes(*bytes))? })
    }
}

impl Default for LuminanceLevels {
    fn default() -> Self {
        Self { counts: vec![0; 1 + Self::BINS] }
    }
}
