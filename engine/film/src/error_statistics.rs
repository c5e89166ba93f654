//! Error statistics of tiles, from which further samples are decided without the pixels.
//!
//! [`ErrorStatistics`] hold for each tile its samples, its bad samples and the ends of its halves. For each block of 16 x 16 pixels
//! they hold the statistics of its error ([`Block`]) and, for each half of the samples, a bound on the variance of the block
//! ([`HalfBlock`]).
//!
//! The bound adds caution where an estimate is not enough. A variance estimated from few pixels, or from many of which a few have
//! most of it, is itself uncertain, so a multiple of its own standard error is added. Rare light may not have been sampled yet, so
//! the bound is at least the effect of three events as bright as the brightest sample. If no such event was seen, their mean number
//! is at most three, at 95 % confidence.
//!
//! Blocks begin at each tile's corner. If the tile edge is a multiple of 16, they are those of [`FrameImage::error`]
//! (`the_error_of_the_tiles_is_the_error_of_the_image`). The binary format:
//!
//! | bytes | content |
//! | --- | --- |
//! | 8 | `FEMCERRS` |
//! | 4 | format version, 3 |
//! | 16 | BLAKE3 of everything after this field, first half |
//! | 5 x 4 | film width, film height, tile edge; first tile, one past the last |
//! | 32 each | for each tile: samples (the first, one past the last), number of bad samples, rays traced, the ends of its halves |
//! | rest | zstd frame of the blocks in the order of the tiles, 7 doubles each, in byte planes |
//!
//! [`FrameImage::error`]: crate::FrameImage::error

use crate::codec::{compress_and_seal, read_header, start_header, to_planes, to_words};
use crate::convergence::{Z_95, blocks};
use crate::piece::complete_tile;
use crate::tile::{HALVES, HalfEnds, MAX_TILE_PIXELS};
use crate::{Block, FilmError, Frame, Rect, SampleRange, Tile, Tiling};
use std::ops::Range;

const MAGIC: &[u8; 8] = b"FEMCERRS";
const VERSION: u32 = 3;
const BLOCK_NUMBERS: usize = 3 + 2 * HALVES;
const BLOCK_BYTES: usize = 8 * BLOCK_NUMBERS;
/// Number of standard errors that a bound adds to the variance: 95 %, one side.
const Z_95_ONE_SIDED: f64 = 1.645;
/// Mean number of events of which none may be seen, at 95 % confidence.
const RULE_OF_THREE: f64 = 3.0;

/// Convergence of a tile.
#[derive(Clone, Debug, PartialEq)]
pub struct TileErrors {
    /// Samples of the tile.
    pub samples: SampleRange,
    /// Number of samples that were left out, over all pixels.
    pub bad: u64,
    /// Cost of the samples, in traced rays.
    pub rays: u64,
    /// First held sample of each half.
    pub ends: HalfEnds,
    /// Blocks, row by row.
    pub blocks: Vec<TileBlock>,
}

/// A block of a tile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TileBlock {
    /// Statistics of its error.
    pub block: Block,
    /// Statistics of each half of its samples, including held samples.
    pub halves: [HalfBlock; HALVES],
}

/// Statistics of a block from one half of its samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfBlock {
    /// Sum of the pixels' luminances, cd/m2 times pixels.
    pub sum: f64,
    /// Bound on the variance of that sum; infinite if a pixel has too few samples.
    pub bound: f64,
}

impl HalfBlock {
    fn from_tile(tile: &Tile, rect: Rect, half: usize) -> Self {
        let (mut sum, mut variance, mut squares, mut unseen) = (0.0, 0.0, 0.0, 0.0);
        let is_early = tile.spp() < 2 * femc_math::sampler::REPLICATES as u64;
        for sums in rect.pixels().map(|pixel| tile.pixel(pixel)) {
            // A pixel without good samples has only bad ones. They are reported, and more samples would not help.
            let Some([a, b]) = sums.luminances(half) else {
                variance += if is_early { f64::INFINITY } else { 0.0 };
                continue;
            };
            let one = 0.25 * (a - b).powi(2);
            let sample_count: u32 =
                crate::tile::replicates_of(half).iter().map(|&replicate| sums.replicate_counts[replicate]).sum();
            sum += 0.5 * (a + b);
            variance += one;
            squares += one * one;
            unseen = f64::max(unseen, f64::from(sums.peak[half]) / f64::from(sample_count));
        }
        // The square of the difference of two normal numbers has variance 2 V^2, and the mean of its square is 3 V^2.
        let bound = variance + Z_95_ONE_SIDED * (2.0 / 3.0 * squares).sqrt();
        Self { sum, bound: bound.max(RULE_OF_THREE * unseen * unseen) }
    }

    /// Returns the error of this block in an image of two such halves: half width of a 95 % interval of the mean luminance,
    /// relative to that mean or to `floor`, cd/m2, whichever is larger. `None`: no sample received light.
    /// - `area`: pixels of the block.
    pub fn relative_error(&self, area: u64, floor: f64) -> Option<f64> {
        let n = area as f64;
        let half_width = Z_95 * (0.5 * self.bound).sqrt() / n;
        (self.sum > 0.0 || self.bound > 0.0).then(|| half_width / (self.sum / n).max(floor))
    }
}

impl TileBlock {
    fn from_tile(tile: &Tile, rect: Rect) -> Self {
        let pixels = rect.pixels().map(|pixel| tile.pixel(pixel).resolve(tile.is_held()));
        Self {
            block: Block::from_pixels(rect, pixels),
            halves: std::array::from_fn(|half| HalfBlock::from_tile(tile, rect, half)),
        }
    }

    fn to_bytes(self) -> [u8; BLOCK_BYTES] {
        let Block { sum, variance, freedom, .. } = self.block;
        let halves = self.halves.into_iter().flat_map(|half| [half.sum, half.bound]);
        let numbers = [sum, variance, freedom].into_iter().chain(halves);
        let mut bytes = [0; BLOCK_BYTES];
        bytes.chunks_exact_mut(8).zip(numbers).for_each(|(field, number)| field.copy_from_slice(&number.to_le_bytes()));
        bytes
    }
}

impl TileErrors {
    /// Returns the largest error of a block in one half of the samples ([`HalfBlock::relative_error`]); a block without light has
    /// the error `unlit`.
    pub fn worst_error(&self, half: usize, floor: f64, unlit: f64) -> f64 {
        let error = |it: &TileBlock| it.halves[half].relative_error(it.block.rect.area(), floor).unwrap_or(unlit);
        self.blocks.iter().map(error).fold(0.0, f64::max)
    }
}

/// Convergence of some tiles of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorStatistics {
    tiling: Tiling,
    first: usize,
    tiles: Vec<TileErrors>,
}

impl ErrorStatistics {
    /// Computes the errors of these tiles of `frame`.
    /// - errors: the range is empty; the frame has fewer tiles; a tile has no samples, or a gap in them.
    pub fn from_frame(frame: &Frame, tiles: Range<usize>) -> Result<Self, FilmError> {
        if tiles.is_empty() {
            return Err(FilmError::Corrupt("the group has no tiles"));
        }
        let measure = |index: usize| {
            let (tile, samples) = complete_tile(frame, index)?;
            let blocks = blocks(tile.rect()).map(|rect| TileBlock::from_tile(tile, rect)).collect();
            Ok(TileErrors { samples, bad: tile.bad_samples().total(), rays: tile.rays(), ends: tile.ends(), blocks })
        };
        let (tiling, first) = (frame.tiling(), tiles.start);
        Ok(Self { tiling, first, tiles: tiles.map(measure).collect::<Result<_, FilmError>>()? })
    }

    /// Returns the tiling of the film.
    pub fn tiling(&self) -> Tiling {
        self.tiling
    }

    /// Returns the numbers of the tiles.
    pub fn tiles(&self) -> Range<usize> {
        self.first..self.first + self.tiles.len()
    }

    /// Returns the samples of each tile.
    pub fn samples(&self) -> impl Iterator<Item = SampleRange> + '_ {
        self.tiles.iter().map(|tile| tile.samples)
    }

    /// Returns the errors of each tile, in order.
    pub fn into_tiles(self) -> Vec<TileErrors> {
        self.tiles
    }

    /// Encodes the errors. Equal errors give equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = start_header(MAGIC, VERSION);
        let mut word = |w: u32| out.extend_from_slice(&w.to_le_bytes());
        let (Tiling { width, height, edge }, Range { start, end }) = (self.tiling, self.tiles());
        [width, height, edge, start as u32, end as u32].into_iter().for_each(&mut word);
        for tile in &self.tiles {
            let counts = [tile.bad, tile.rays].into_iter().flat_map(to_words);
            [tile.samples.start, tile.samples.end].into_iter().chain(counts).chain(tile.ends).for_each(&mut word);
        }
        let blocks: Vec<TileBlock> = self.tiles.iter().flat_map(|tile| &tile.blocks).copied().collect();
        compress_and_seal(out, &to_planes(&blocks, |block| block.to_bytes()))
    }

    /// Decodes errors; damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, FilmError> {
        let mut reader = read_header(MAGIC, VERSION, bytes)?;
        let (tiling, tiles) = reader.tiles()?;
        let mut accounts = Vec::new();
        for _ in tiles.clone() {
            accounts.push((reader.range()?, reader.long()?, reader.long()?, reader.words()?));
        }
        let rects = || tiles.clone().filter_map(|index| tiling.rect(index));
        if rects().map(|rect| rect.area()).sum::<u64>() > MAX_TILE_PIXELS {
            return Err(FilmError::Corrupt("more pixels than a group of tiles can have"));
        }
        let count = rects().map(|rect| blocks(rect).count()).sum();
        let mut numbers = reader.planes(count, read_numbers)?.into_iter();
        let mut all = Vec::with_capacity(accounts.len());
        for (rect, (samples, bad, work, ends)) in rects().zip(accounts) {
            let blocks = blocks(rect).zip(&mut numbers).map(|(rect, numbers)| valid_block(rect, numbers));
            all.push(TileErrors {
                samples,
                bad,
                rays: work,
                ends,
                blocks: blocks.collect::<Option<_>>().ok_or(INVALID)?,
            });
        }
        Ok(Self { tiling, first: tiles.start, tiles: all })
    }
}

const INVALID: FilmError = FilmError::Corrupt("invalid errors");

fn read_numbers(bytes: &[u8; BLOCK_BYTES]) -> [f64; BLOCK_NUMBERS] {
    std::array::from_fn(|at| f64::from_le_bytes(std::array::from_fn(|i| bytes[8 * at + i])))
}

/// Creates a block from these numbers if they are valid.
fn valid_block(rect: Rect, [sum, variance, freedom, numbers @ ..]: [f64; BLOCK_NUMBERS]) -> Option<TileBlock> {
    let is_sum = |value: f64| value.is_finite() && value >= 0.0;
    let halves = std::array::from_fn(|half| HalfBlock { sum: numbers[2 * half], bound: numbers[2 * half + 1] });
    let is_sound = is_sum(sum)
        && variance >= 0.0
        && freedom >= 0.0
        && halves.iter().all(|half: &HalfBlock| is_sum(half.sum) && half.bound >= 0.0);
    is_sound.then_some(TileBlock { block: Block { rect, sum, variance, freedom }, halves })
}
