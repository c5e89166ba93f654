//! How far the tiles of a frame are from converged: all that decides on their further samples, without their pixels.
//!
//! [`Errors`] hold of each tile its samples, its bad samples, and of each block of 16 x 16 pixels what its error is made of.
//! Blocks begin at each tile's corner: where a tile's edge is a multiple of 16, they are those of [`FrameImage::error`]
//! (`the_error_of_the_tiles_is_the_error_of_the_image`). As bytes:
//!
//! | bytes | what |
//! | --- | --- |
//! | 8 | `FEMCERRS` |
//! | 4 | format version, 1 |
//! | 16 | BLAKE3 of everything after this field, first half |
//! | 5 x 4 | film width, film height, tile edge; first tile, one past the last |
//! | 16 each | of each tile its samples (the first, one past the last), number of bad samples |
//! | rest | zstd frame of the blocks in the order of the tiles, 4 doubles each, in byte planes |
//!
//! [`FrameImage::error`]: crate::FrameImage::error

use crate::codec::{begin, finish, open, to_planes};
use crate::convergence::{blocks, luminance};
use crate::piece::whole;
use crate::tile::{MAX_TILE_PIXELS, PixelSums, REPLICATES};
use crate::{Block, FilmError, Frame, Rect, SampleRange, Tile, Tiling};
use std::ops::Range;

const MAGIC: &[u8; 8] = b"FEMCERRS";
const VERSION: u32 = 1;
const BLOCK_BYTES: usize = 8 * (2 + REPLICATES);

/// How far a tile is from converged.
#[derive(Clone, Debug, PartialEq)]
pub struct TileErrors {
    /// Its samples.
    pub samples: SampleRange,
    /// How many of them, of all pixels, were left out.
    pub bad: u64,
    /// Its blocks, row by row.
    pub blocks: Vec<TileBlock>,
}

/// A block of a tile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TileBlock {
    /// What its error is made of.
    pub block: Block,
    /// The sum of luminances by each replicate of the samples alone, cd/m2 times pixels; `None` where a pixel lacks one.
    pub replicates: Option<[f64; REPLICATES]>,
}

impl TileBlock {
    /// Error of the sum of luminances by its replicates: half their difference, cd/m2 times pixels. Each has the weight 1/2,
    /// however many samples it has, so that the weights do not depend on the samples.
    pub fn contrast(&self) -> Option<f64> {
        self.replicates.map(|[a, b]| 0.5 * (a - b).abs())
    }

    fn of(tile: &Tile, rect: Rect) -> Self {
        let Rect { x: left, y: top, width, .. } = tile.rect();
        let sums = |(x, y): (u32, u32)| &tile.pixels()[((y - top) * width + (x - left)) as usize];
        let mut replicates = Some([0.0; REPLICATES]);
        for sums in rect.pixels().map(sums) {
            replicates = replicates.zip(luminances(sums)).map(|(mut all, one)| {
                all.iter_mut().zip(one).for_each(|(sum, value)| *sum += value);
                all
            });
        }
        Self { block: Block::of(rect, rect.pixels().map(|pixel| sums(pixel).resolve())), replicates }
    }

    fn to_bytes(self) -> [u8; BLOCK_BYTES] {
        let [a, b] = self.replicates.unwrap_or([f64::NAN; REPLICATES]);
        let mut bytes = [0; BLOCK_BYTES];
        let numbers = [self.block.sum, self.block.deviation, a, b];
        bytes.chunks_exact_mut(8).zip(numbers).for_each(|(field, number)| field.copy_from_slice(&number.to_le_bytes()));
        bytes
    }
}

/// Mean luminance by each replicate, cd/m2; `None` where one has no samples.
fn luminances(sums: &PixelSums) -> Option<[f64; REPLICATES]> {
    let mean = |i: usize| luminance(sums.color[i].map(|sum| sum.value() / f64::from(sums.count[i])));
    sums.count.iter().all(|&count| count > 0).then(|| std::array::from_fn(mean))
}

impl TileErrors {
    /// Largest relative error of a block, 95 %.
    /// - `floor`: luminance that darker blocks are measured against, cd/m2; see [`FrameError`](crate::FrameError).
    pub fn worst(&self, floor: f64) -> f64 {
        self.blocks.iter().map(|it| it.block.relative(floor)).fold(0.0, f64::max)
    }
}

/// How far some tiles of a frame are from converged.
#[derive(Clone, Debug, PartialEq)]
pub struct Errors {
    tiling: Tiling,
    first: usize,
    tiles: Vec<TileErrors>,
}

impl Errors {
    /// Of these tiles of `frame`.
    /// - errors: there are none; the frame has fewer tiles; one has no samples, or a gap in them.
    pub fn of(frame: &Frame, tiles: Range<usize>) -> Result<Self, FilmError> {
        if tiles.is_empty() {
            return Err(FilmError::Corrupt("a group of no tiles"));
        }
        let measure = |index: usize| {
            let (tile, samples) = whole(frame, index)?;
            let blocks = blocks(tile.rect()).map(|rect| TileBlock::of(tile, rect)).collect();
            Ok(TileErrors { samples, bad: tile.bad().total(), blocks })
        };
        let (tiling, first) = (frame.tiling(), tiles.start);
        Ok(Self { tiling, first, tiles: tiles.map(measure).collect::<Result<_, FilmError>>()? })
    }

    /// How their film is cut.
    pub fn tiling(&self) -> Tiling {
        self.tiling
    }

    /// Numbers of the tiles.
    pub fn tiles(&self) -> Range<usize> {
        self.first..self.first + self.tiles.len()
    }

    /// The samples of each tile.
    pub fn samples(&self) -> impl Iterator<Item = SampleRange> + '_ {
        self.tiles.iter().map(|tile| tile.samples)
    }

    /// Of each tile, in order.
    pub fn into_tiles(self) -> Vec<TileErrors> {
        self.tiles
    }

    /// The errors as bytes: the same bytes for the same errors.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = begin(MAGIC, VERSION);
        let mut word = |w: u32| out.extend_from_slice(&w.to_le_bytes());
        let (Tiling { width, height, edge }, Range { start, end }) = (self.tiling, self.tiles());
        [width, height, edge, start as u32, end as u32].into_iter().for_each(&mut word);
        let accounts = self.tiles.iter().map(|tile| (tile.samples, tile.bad));
        let words = accounts.flat_map(|(it, bad)| [it.start, it.end, bad as u32, (bad >> 32) as u32]);
        words.for_each(word);
        let blocks: Vec<TileBlock> = self.tiles.iter().flat_map(|tile| &tile.blocks).copied().collect();
        finish(out, &to_planes(&blocks, |block| block.to_bytes()))
    }

    /// The errors from their bytes; damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, FilmError> {
        let mut reader = open(MAGIC, VERSION, bytes)?;
        let (tiling, tiles) = reader.tiles()?;
        let mut accounts = Vec::new();
        for _ in tiles.clone() {
            let (samples, [low, high]) = (reader.range()?, reader.words()?);
            accounts.push((samples, u64::from(low) | (u64::from(high) << 32)));
        }
        let rects = || tiles.clone().filter_map(|index| tiling.rect(index));
        if rects().map(|rect| rect.area()).sum::<u64>() > MAX_TILE_PIXELS {
            return Err(FilmError::Corrupt("more pixels than a group of tiles has"));
        }
        let count = rects().map(|rect| blocks(rect).count()).sum();
        let mut numbers = reader.planes(count, numbers)?.into_iter();
        let mut all = Vec::with_capacity(accounts.len());
        for (rect, (samples, bad)) in rects().zip(accounts) {
            let blocks = blocks(rect).zip(&mut numbers).map(|(rect, numbers)| sound(rect, numbers));
            all.push(TileErrors { samples, bad, blocks: blocks.collect::<Option<_>>().ok_or(IMPOSSIBLE)? });
        }
        Ok(Self { tiling, first: tiles.start, tiles: all })
    }
}

const IMPOSSIBLE: FilmError = FilmError::Corrupt("impossible errors");

fn numbers(bytes: &[u8; BLOCK_BYTES]) -> [f64; 2 + REPLICATES] {
    std::array::from_fn(|at| f64::from_le_bytes(std::array::from_fn(|i| bytes[8 * at + i])))
}

/// A block of these numbers, if they can be one's.
fn sound(rect: Rect, [sum, deviation, a, b]: [f64; 2 + REPLICATES]) -> Option<TileBlock> {
    let is_sum = |value: f64| value.is_finite() && value >= 0.0;
    let replicates = if a.is_nan() && b.is_nan() { None } else { Some([a, b]) };
    let is_sound = is_sum(sum) && deviation >= 0.0 && replicates.is_none_or(|pair| pair.into_iter().all(is_sum));
    is_sound.then_some(TileBlock { block: Block { rect, sum, deviation }, replicates })
}
