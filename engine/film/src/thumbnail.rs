//! Thumbnails, exact sums in blocks of 8 x 8 pixels, and levels, the luminances of blocks counted in bins.
//!
//! Both are integers, so the levels of a clip are the same whatever parts its tiles came in and in whatever order frames were
//! counted. One exposure for a clip ([`crate::ToneCurve::of_levels`]) follows from them without a look at an image. As bytes a
//! thumbnail is like a tile ([`crate::codec`]), and levels are
//!
//! | bytes | what |
//! | --- | --- |
//! | 8 | `FEMCLEVL` |
//! | 4 | format version, 1 |
//! | 16 | BLAKE3 of everything after this field, first half |
//! | rest | zstd frame of the counts, 8 bytes each, in byte planes |

use crate::codec::{begin, finish, open, to_planes};
use crate::tile::PixelSums;
use crate::{FilmError, Frame, Image, Rect, Tile, Tiling};
use femc_math::elementary::double;

/// Edge of a thumbnail's block, pixels.
pub const BLOCK: u32 = 8;

impl Tile {
    /// The tile's sums in blocks of [`BLOCK`] x [`BLOCK`] pixels of the film: a tile of the film that is so many times smaller.
    /// Bad samples are in the sums of neither. The thumbnail of a merge is the merge of the thumbnails (test
    /// `the_thumbnails_of_a_tile_s_parts_add_up_to_its_own_in_any_cut`).
    /// - the tile begins at whole blocks, as those of a tiling do that has [`Tiling::of_thumbnails`].
    pub fn thumbnail(&self) -> Self {
        let Rect { x, y, width, height } = self.rect;
        let (left, top) = (x / BLOCK, y / BLOCK);
        let rect = Rect {
            x: left,
            y: top,
            width: (x + width).div_ceil(BLOCK) - left,
            height: (y + height).div_ceil(BLOCK) - top,
        };
        let mut pixels = vec![PixelSums::default(); rect.area() as usize];
        for ((x, y), sums) in self.rect.pixels().zip(&self.pixels) {
            pixels[((y / BLOCK - top) * rect.width + (x / BLOCK - left)) as usize].merge(sums);
        }
        Self { rect, ranges: self.ranges.clone(), ends: self.ends, pixels, bad: crate::BadSamples::default(), work: 0 }
    }
}

impl Tiling {
    /// How the thumbnails of its tiles cut the small film; `None`: a tile is no whole number of blocks wide.
    pub fn of_thumbnails(self) -> Option<Self> {
        let Self { width, height, edge } = self;
        let small = Self { width: width.div_ceil(BLOCK), height: height.div_ceil(BLOCK), edge: edge / BLOCK };
        edge.is_multiple_of(BLOCK).then_some(small)
    }
}

/// Blocks of pixels, counted by their luminance: black ones, and the others in bins of a 16th of an octave from 2^-40 to 2^40
/// cd/m2. What is beyond the bins counts in the first or the last.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Levels {
    /// Black blocks, then a count for each bin.
    counts: Vec<u64>,
}

impl Levels {
    const MAGIC: &'static [u8; 8] = b"FEMCLEVL";
    const VERSION: u32 = 1;
    /// Bins of an octave.
    const OCTAVE: f64 = 16.0;
    /// The first bin begins here, octaves above 1 cd/m2.
    const LOWEST: f64 = -40.0;
    const BINS: usize = 80 * 16;

    /// The levels of the blocks that thumbnails hold; a block without a good sample is not counted.
    pub fn of(thumbnails: &Frame) -> Self {
        let mut levels = Self::default();
        let tiles = (0..thumbnails.tiling().count()).filter_map(|index| thumbnails.tile(index));
        for sums in tiles.flat_map(Tile::pixels).filter(|sums| sums.samples() > 0) {
            let sum: f64 = sums.luminance.iter().map(|luminance| luminance.value()).sum();
            levels.counts[Self::bin(sum / f64::from(sums.samples()))] += 1;
        }
        levels
    }

    /// The levels of a finished image, for those who have nothing else: its pixels are rounded, so a block may count in a bin next
    /// to that of its thumbnail.
    pub fn of_image(image: &Image) -> Self {
        let (small, mut levels) = (image.shrunk_by(BLOCK), Self::default());
        (0..small.pixels.len()).for_each(|at| levels.counts[Self::bin(small.luminance(at).into())] += 1);
        levels
    }

    /// The place of a luminance in the counts.
    fn bin(luminance: f64) -> usize {
        if luminance > 0.0 {
            let bin = ((double::log2(luminance) - Self::LOWEST) * Self::OCTAVE).floor();
            return 1 + bin.clamp(0.0, (Self::BINS - 1) as f64) as usize;
        }
        0
    }

    /// Counts those of `other`, too. Associative and commutative.
    pub fn merge(&mut self, other: &Self) {
        self.counts.iter_mut().zip(&other.counts).for_each(|(mine, theirs)| *mine = mine.saturating_add(*theirs));
    }

    /// The luminance in the middle of each bin that has blocks, cd/m2, and how many it has; without the black ones.
    pub fn lit(&self) -> impl Iterator<Item = (f64, u64)> + Clone + '_ {
        let middle = |bin: usize| double::pow(2.0, (bin as f64 + 0.5) / Self::OCTAVE + Self::LOWEST);
        let bins = self.counts[1..].iter().enumerate().filter(|(_, count)| **count > 0);
        bins.map(move |(bin, &count)| (middle(bin), count))
    }

    /// How many blocks are counted.
    pub fn blocks(&self) -> u64 {
        self.counts.iter().fold(0, |sum, count| sum.saturating_add(*count))
    }

    /// The levels as bytes: the same bytes for the same counts.
    pub fn encode(&self) -> Vec<u8> {
        finish(begin(Self::MAGIC, Self::VERSION), &to_planes(&self.counts, |count| count.to_le_bytes()))
    }

    /// The levels from their bytes; damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, FilmError> {
        let reader = open(Self::MAGIC, Self::VERSION, bytes)?;
        Ok(Self { counts: reader.planes(1 + Self::BINS, |bytes| u64::from_le_bytes(*bytes))? })
    }
}

impl Default for Levels {
    fn default() -> Self {
        Self { counts: vec![0; 1 + Self::BINS] }
    }
}
