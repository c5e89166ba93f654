//! Exact sums of the layers of a tile, and what is resolved of them.
//!
//! A layer has, for each pixel, the sums of its color by half in 128-bit fixed point and the counts of samples: 104 bytes. They are
//! those of the tile in all that matters: a sample counts in the layers when it counts in the picture, halves are held from the same
//! sample on and have the same weights. So layers that part the light of each sample sum up to the picture, within the rounding of floats.
//!
//! As bytes:
//!
//! | bytes | what |
//! | --- | --- |
//! | 8 | `FEMCLAYR`: sums of samples of a tile; `FEMCLPIX`: resolved pixels of several tiles |
//! | 4 | format version, 1 |
//! | 16 | BLAKE3 of everything after this field, first half |
//! | 4 | number of layers, 1 to 64 |
//! | 6 x 4 | of sums: x, y, width, height; first sample, one past the last |
//! | 5 x 4 | of pixels: film width, film height, tile edge; first tile, one past the last |
//! | 8 each | of pixels: of each tile its samples, the first, one past the last |
//! | rest | zstd frame of the layers one after the other, row by row (of pixels tile by tile), in byte planes |

use crate::codec::{begin, finish, open, to_planes};
use crate::piece::{variance_factor, weights};
use crate::tile::{Ends, HALVES, MAX_TILE_PIXELS, OPEN, half_of};
use crate::{FilmError, Rect, SampleRange, Tiling};
use femc_math::Rgb;
use femc_math::sampler::replicate_of;
use femc_stats::ExactSum;
use femc_stats::exact::{BufferedSums, RadianceSum};
use std::ops::Range;

const SUMS: &[u8; 8] = b"FEMCLAYR";
const PIXELS: &[u8; 8] = b"FEMCLPIX";
const VERSION: u32 = 1;
const SUM_BYTES: usize = 16 * 3 * HALVES + 4 * HALVES;
const PIXEL_BYTES: usize = 4 * 6;
/// Most layers.
const MOST: u32 = 64;

/// Sums of a layer over the good samples of one pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LayerSums {
    /// Color of each half, cd/m2, without samples that are held.
    pub color: [[RadianceSum; 3]; HALVES],
    /// Good samples of each half that are not held.
    pub count: [u32; HALVES],
}

impl LayerSums {
    /// Counts sample number `index`, which is the same in all layers of a pixel.
    #[inline]
    pub fn count(&mut self, index: u32) {
        let count = &mut self.count[half_of(replicate_of(index))];
        *count = count.saturating_add(1);
    }

    /// Adds the samples of `other`, which are others.
    #[inline]
    pub fn merge(&mut self, other: &Self) {
        self.color.as_flattened_mut().iter_mut().zip(other.color.as_flattened()).for_each(|(a, b)| a.merge(*b));
        self.count.iter_mut().zip(other.count).for_each(|(a, b)| *a = a.saturating_add(b));
    }

    /// As [`Tile`](crate::Tile) resolves its color.
    fn resolve(&self, is_held: bool) -> LayerPixel {
        let mean = |half: usize, channel: usize| match self.count[half] {
            0 => 0.0,
            count => self.color[half][channel].value() / f64::from(count),
        };
        let (weights, factor) = (weights(self.count, is_held), variance_factor(self.count, is_held));
        let (mut color, mut variance) = ([0.0; 3], [0.0; 3]);
        for channel in 0..3 {
            let [a, b] = [mean(0, channel), mean(1, channel)];
            color[channel] = (weights[0] * a + weights[1] * b) as f32;
            variance[channel] = (factor * (a - b) * (a - b)) as f32;
        }
        LayerPixel { color, variance }
    }

    fn to_bytes(self) -> [u8; SUM_BYTES] {
        let mut bytes = [0; SUM_BYTES];
        let (wide, narrow) = bytes.split_at_mut(16 * 3 * HALVES);
        let sums = wide.chunks_exact_mut(16).zip(self.color.as_flattened());
        sums.for_each(|(field, sum)| field.copy_from_slice(&sum.units().to_le_bytes()));
        let counts = narrow.chunks_exact_mut(4).zip(self.count);
        counts.for_each(|(field, count)| field.copy_from_slice(&count.to_le_bytes()));
        bytes
    }

    fn from_bytes(bytes: &[u8; SUM_BYTES]) -> Self {
        let sum = |at: usize| ExactSum::from_units(u128::from_le_bytes(std::array::from_fn(|i| bytes[16 * at + i])));
        let count = |half: usize| u32::from_le_bytes(std::array::from_fn(|i| bytes[96 + 4 * half + i]));
        Self {
            color: std::array::from_fn(|half| std::array::from_fn(|channel| sum(3 * half + channel))),
            count: std::array::from_fn(count),
        }
    }
}

/// Light of samples of one pixel that layers take together, on its way into their sums.
#[derive(Clone, Debug, Default)]
pub struct LayerLight([BufferedSums<60, 3>; HALVES]);

impl LayerLight {
    /// Adds sample number `index`, of which the layers take `color`, cd/m2: finite and not negative. It is to be counted apart.
    #[inline]
    pub fn add(&mut self, index: u32, color: Rgb) {
        self.0[half_of(replicate_of(index))].add(color.to_array());
    }

    /// The light of all samples that were added since the last time; `None`: there is none.
    pub fn take(&mut self) -> Option<LayerSums> {
        let color = self.0.each_mut().map(|half| std::mem::take(half).finish());
        let sums = LayerSums { color, count: [0; HALVES] };
        (sums != LayerSums::default()).then_some(sums)
    }
}

/// The layers of samples of a rectangle of pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LayerTile {
    rect: Rect,
    samples: SampleRange,
    layers: u32,
    /// Layer by layer, row by row.
    sums: Vec<LayerSums>,
}

impl LayerTile {
    /// Of sums by pixel, row by row, and in each pixel by layer.
    /// - errors: they are not so many.
    pub fn of_pixels(rect: Rect, samples: Range<u32>, layers: u32, sums: &[LayerSums]) -> Result<Self, FilmError> {
        let area = rect.check(MAX_TILE_PIXELS)?.area() as usize;
        let samples = SampleRange::from(samples);
        if samples.is_empty() {
            return Err(FilmError::EmptyRange(samples));
        }
        if !(1..=MOST).contains(&layers) || sums.len() != area * layers as usize {
            return Err(FilmError::Corrupt("layers of another number of pixels"));
        }
        let layer = |layer: usize| sums[layer..].iter().step_by(layers as usize);
        Ok(Self { rect, samples, layers, sums: (0..layers as usize).flat_map(layer).copied().collect() })
    }

    /// The pixels.
    pub fn rect(&self) -> Rect {
        self.rect
    }

    /// The samples.
    pub fn samples(&self) -> SampleRange {
        self.samples
    }

    /// Number of layers.
    pub fn layers(&self) -> u32 {
        self.layers
    }

    /// The samples of one tile from `begin` on that were rendered in these parts, in any order; a part that is there twice counts once. What is
    /// before `begin` is left out, the halves are held from `ends` on.
    /// - errors: parts of different pixels or layers, with a gap, that overlap, or on both sides of an end; none.
    pub fn united(mut parts: Vec<Self>, begin: u32, ends: Ends) -> Result<Self, FilmError> {
        parts.retain(|part| part.samples.end > begin);
        parts.sort_by_key(|part| part.samples);
        parts.dedup_by_key(|part| part.samples);
        let mut parts = parts.into_iter();
        let mut all = parts.next().ok_or(FilmError::Corrupt("a tile without layers"))?;
        all.hold(ends)?;
        for mut part in parts {
            if part.rect != all.rect {
                return Err(FilmError::OtherPixels { expected: all.rect, found: part.rect });
            }
            if part.layers != all.layers {
                return Err(FilmError::Corrupt("another number of layers"));
            }
            if part.samples.start != all.samples.end {
                return Err(FilmError::Gap(all.rect));
            }
            part.hold(ends)?;
            all.samples.end = part.samples.end;
            all.sums.iter_mut().zip(&part.sums).for_each(|(mine, theirs)| mine.merge(theirs));
        }
        Ok(all)
    }

    fn hold(&mut self, ends: Ends) -> Result<(), FilmError> {
        for (half, end) in ends.into_iter().enumerate() {
            if self.samples.start >= end {
                self.sums.iter_mut().for_each(|sums| (sums.color[half], sums.count[half]) = Default::default());
            } else if self.samples.end > end {
                return Err(FilmError::Corrupt("samples on both sides of the end of a half"));
            }
        }
        Ok(())
    }

    /// The layers as bytes: the same bytes for the same sums.
    pub fn encode(&self) -> Vec<u8> {
        let Rect { x, y, width, height } = self.rect;
        let head = [self.layers, x, y, width, height, self.samples.start, self.samples.end];
        finish(with_words(SUMS, head), &to_planes(&self.sums, |sums| sums.to_bytes()))
    }

    /// The layers from their bytes; damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, FilmError> {
        let mut reader = open(SUMS, VERSION, bytes)?;
        let [layers] = reader.words()?;
        let [x, y, width, height] = reader.words()?;
        let rect = Rect { x, y, width, height }.check(MAX_TILE_PIXELS)?;
        let samples = reader.range()?;
        let sums: Vec<LayerSums> = reader.planes(check(layers)? * rect.area() as usize, LayerSums::from_bytes)?;
        if sums.iter().any(|sums| sums.count.iter().fold(0u64, |n, &it| n + u64::from(it)) > u64::from(samples.len())) {
            return Err(FilmError::Corrupt("more samples than its ranges hold"));
        }
        Ok(Self { rect, samples, layers, sums })
    }
}

fn with_words<const N: usize>(magic: &[u8; 8], words: [u32; N]) -> Vec<u8> {
    let mut out = begin(magic, VERSION);
    words.into_iter().for_each(|word| out.extend_from_slice(&word.to_le_bytes()));
    out
}

fn check(layers: u32) -> Result<usize, FilmError> {
    (1..=MOST).contains(&layers).then_some(layers as usize).ok_or(FilmError::Corrupt("impossible number of layers"))
}

/// What a layer's channels say of a pixel: mean and estimated variance of the mean.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct LayerPixel {
    color: [f32; 3],
    variance: [f32; 3],
}

impl LayerPixel {
    fn to_bytes(self) -> [u8; PIXEL_BYTES] {
        let mut bytes = [0; PIXEL_BYTES];
        let values = bytes.chunks_exact_mut(4).zip(self.color.into_iter().chain(self.variance));
        values.for_each(|(field, value)| field.copy_from_slice(&value.to_le_bytes()));
        bytes
    }

    fn from_bytes(bytes: &[u8; PIXEL_BYTES]) -> Self {
        let value = |at: usize| f32::from_le_bytes(std::array::from_fn(|i| bytes[4 * at + i]));
        Self { color: std::array::from_fn(value), variance: std::array::from_fn(|i| value(3 + i)) }
    }
}

/// The layers of some tiles of a frame, resolved.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerPiece {
    tiling: Tiling,
    tiles: Range<usize>,
    layers: u32,
    /// Of each tile.
    samples: Vec<SampleRange>,
    /// Tile by tile, layer by layer, row by row.
    pixels: Vec<LayerPixel>,
}

impl LayerPiece {
    /// No tiles of a film yet; the first that is put is number `first`.
    pub fn new(tiling: Tiling, first: usize) -> Self {
        Self { tiling, tiles: first..first, layers: 0, samples: Vec::new(), pixels: Vec::new() }
    }

    /// Takes the next tile in.
    /// - errors: it is another one, or has another number of layers.
    pub fn put(&mut self, tile: &LayerTile, ends: Ends) -> Result<(), FilmError> {
        if self.tiling.rect(self.tiles.end) != Some(tile.rect) {
            return Err(FilmError::NotInFrame(tile.rect));
        }
        if self.layers != 0 && self.layers != tile.layers {
            return Err(FilmError::Corrupt("another number of layers"));
        }
        self.layers = tile.layers;
        self.tiles.end += 1;
        self.samples.push(tile.samples);
        self.pixels.extend(tile.sums.iter().map(|sums| sums.resolve(ends != OPEN)));
        Ok(())
    }

    /// How the film is cut.
    pub fn tiling(&self) -> Tiling {
        self.tiling
    }

    /// The tiles.
    pub fn tiles(&self) -> Range<usize> {
        self.tiles.clone()
    }

    /// The samples of each tile.
    pub fn samples(&self) -> &[SampleRange] {
        &self.samples
    }

    /// The tiles as bytes: the same bytes for the same pixels.
    pub fn encode(&self) -> Vec<u8> {
        let Tiling { width, height, edge } = self.tiling;
        let [start, end] = [self.tiles.start, self.tiles.end].map(|tile| tile as u32);
        let mut out = with_words(PIXELS, [self.layers, width, height, edge, start, end]);
        let bounds = self.samples.iter().flat_map(|range| [range.start, range.end]);
        bounds.for_each(|word| out.extend_from_slice(&word.to_le_bytes()));
        finish(out, &to_planes(&self.pixels, |pixel| pixel.to_bytes()))
    }

    /// The tiles from their bytes; damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, FilmError> {
        let mut reader = open(PIXELS, VERSION, bytes)?;
        let [layers] = reader.words()?;
        let count = check(layers)?;
        let (tiling, tiles) = reader.tiles()?;
        let samples = tiles.clone().map(|_| reader.range()).collect::<Result<Vec<_>, _>>()?;
        let area: u64 = tiles.clone().filter_map(|tile| tiling.rect(tile)).map(|rect| rect.area()).sum();
        let pixels = reader.planes(count * area as usize, LayerPixel::from_bytes)?;
        Ok(Self { tiling, tiles, layers, samples, pixels })
    }
}

/// One layer of a frame, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerImage {
    /// What its channels are called.
    pub name: String,
    /// Mean, cd/m2.
    pub color: Vec<[f32; 3]>,
    /// Estimated variance of that, by channel; see [`FrameImage`](crate::FrameImage).
    pub variance: Vec<[f32; 3]>,
}

impl LayerImage {
    /// Black layers of a film.
    pub fn black(names: impl IntoIterator<Item = String>, width: u32, height: u32) -> Vec<Self> {
        let black = vec![[0.0; 3]; width as usize * height as usize];
        names.into_iter().map(|name| Self { name, color: black.clone(), variance: black.clone() }).collect()
    }

    /// Takes the pixels of a piece in.
    /// - errors: it is of another film or of other layers.
    pub fn put(all: &mut [Self], piece: &LayerPiece) -> Result<(), FilmError> {
        let film = piece.tiling.width as usize * piece.tiling.height as usize;
        if all.len() != piece.layers as usize || all.iter().any(|layer| layer.color.len() != film) {
            return Err(FilmError::Corrupt("layers of another frame"));
        }
        let mut pixels = piece.pixels.iter();
        for rect in piece.tiles().filter_map(|tile| piece.tiling.rect(tile)) {
            for layer in all.iter_mut() {
                for ((x, y), pixel) in rect.pixels().zip(&mut pixels) {
                    let at = y as usize * piece.tiling.width as usize + x as usize;
                    (layer.color[at], layer.variance[at]) = (pixel.color, pixel.variance);
                }
            }
        }
        Ok(())
    }
}
