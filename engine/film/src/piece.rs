//! Resolved pixels, and pieces of a frame that is resolved in several places.
//!
//! A [`ImagePiece`] is the part of an image that some tiles cover: 48 bytes per pixel instead of the 236 of exact sums. No samples
//! can be added to it. The binary format:
//!
//! | bytes | content |
//! | --- | --- |
//! | 8 | `FEMCPIEC` |
//! | 4 | format version, 3 |
//! | 16 | BLAKE3 of everything after this field, first half |
//! | 5 x 4 | film width, film height, tile edge; first tile, one past the last |
//! | 8 each | for each tile, its first sample and one past the last |
//! | | bad samples, as in a tile ([`crate::codec`]) |
//! | rest | zstd frame of the pixels in the order of the tiles, in byte planes |

use crate::codec::{compress_and_seal, put_bad_samples, read_header, start_header, to_planes};
use crate::convergence::luminance;
use crate::tile::{ALBEDO_FRACTION, HALVES, MAX_TILE_PIXELS, PixelSums};
use crate::{BadSamples, FilmError, Frame, FrameImage, Image, Rect, SampleRange, Tile, Tiling};
use std::ops::Range;

const MAGIC: &[u8; 8] = b"FEMCPIEC";
const VERSION: u32 = 3;
const WORDS: usize = 12;
const PIXEL_BYTES: usize = 4 * WORDS;

/// A resolved pixel of an image; see [`FrameImage`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Pixel {
    pub(crate) color: [f32; 3],
    pub(crate) variance: [f32; 3],
    pub(crate) luminance_variance: f32,
    albedo: [f32; 3],
    depth: f32,
    pub(crate) samples: u32,
}

impl PixelSums {
    /// Computes means and the variance of the mean; zero without samples.
    /// - `is_held`: whether a half of the tile is held. If so, each half has the weight 1/2, because the counts depend on the
    ///   sample values; otherwise every good sample has the same weight.
    pub(crate) fn resolve(&self, is_held: bool) -> Pixel {
        let samples = self.samples();
        let mut pixel = Pixel { samples: self.counted_samples(), ..Pixel::default() };
        if samples == 0 {
            return pixel;
        }
        let (unit, n) = (f64::from(1u32 << ALBEDO_FRACTION), f64::from(samples));
        pixel.albedo = self.albedo.map(|sum| (sum as f64 / unit / n) as f32);
        if self.hits > 0 {
            pixel.depth = (self.depth.value() / f64::from(self.hits)) as f32;
        }
        let (weights, factor) = (half_weights(self.half_counts, is_held), variance_factor(self.half_counts, is_held));
        let mean = |half: usize, channel: usize| match self.half_counts[half] {
            0 => 0.0,
            count => self.color[half][channel].value() / f64::from(count),
        };
        let [a, b] = [0, 1].map(|half| [0, 1, 2].map(|channel| mean(half, channel)));
        let color: [f64; 3] = std::array::from_fn(|i| weights[0] * a[i] + weights[1] * b[i]);
        let difference: [f64; 3] = std::array::from_fn(|i| a[i] - b[i]);
        pixel.color = color.map(|value| value as f32);
        pixel.variance = difference.map(|value| (factor * value * value) as f32);
        pixel.luminance_variance = (factor * luminance(difference).powi(2)) as f32;
        pixel
    }
}

/// Returns the weights of the halves in the image, by their counts of samples. If only one half has samples, its weight is 1.
pub(crate) fn half_weights(count: [u32; HALVES], is_held: bool) -> [f64; HALVES] {
    let [a, b] = count.map(f64::from);
    match (a > 0.0, b > 0.0) {
        (true, true) if is_held => [0.5; 2],
        (true, true) => [a / (a + b), b / (a + b)],
        _ => [f64::from(a > 0.0), f64::from(b > 0.0)],
    }
}

/// Returns the factor that turns the squared difference of the halves into an unbiased estimate of the variance of the mean with
/// these weights. A single half has no such estimate: its squared mean stands in for the variance (a relative error of 1).
pub(crate) fn variance_factor(count: [u32; HALVES], is_held: bool) -> f64 {
    let [a, b] = count.map(f64::from);
    match (a > 0.0, b > 0.0) {
        (true, true) if is_held => 0.25,
        (true, true) => a * b / (a + b).powi(2),
        _ => 1.0,
    }
}

impl Pixel {
    fn to_bytes(self) -> [u8; PIXEL_BYTES] {
        let mut bytes = [0; PIXEL_BYTES];
        let floats =
            [self.color, self.variance, self.albedo].concat().into_iter().chain([self.luminance_variance, self.depth]);
        let words = floats.map(f32::to_bits).chain([self.samples]);
        bytes.chunks_exact_mut(4).zip(words).for_each(|(field, word)| field.copy_from_slice(&word.to_le_bytes()));
        bytes
    }

    fn from_bytes(bytes: &[u8; PIXEL_BYTES]) -> Self {
        let word = |at: usize| u32::from_le_bytes(std::array::from_fn(|i| bytes[4 * at + i]));
        let three = |at: usize| [at, at + 1, at + 2].map(|at| f32::from_bits(word(at)));
        Self {
            color: three(0),
            variance: three(3),
            albedo: three(6),
            luminance_variance: f32::from_bits(word(9)),
            depth: f32::from_bits(word(10)),
            samples: word(11),
        }
    }
}

/// Some resolved tiles of a frame; each has its own number of samples.
#[derive(Clone, Debug, PartialEq)]
pub struct ImagePiece {
    tiling: Tiling,
    tiles: Range<usize>,
    /// Samples of each tile.
    samples: Vec<SampleRange>,
    bad: BadSamples,
    /// Pixels, tile by tile, row by row.
    pixels: Vec<Pixel>,
}

impl ImagePiece {
    /// Resolves these tiles of `frame`.
    /// - errors: the range is empty; the frame has fewer tiles; a tile has no samples, or a gap in them.
    pub fn from_frame(frame: &Frame, tiles: Range<usize>) -> Result<Self, FilmError> {
        if tiles.is_empty() {
            return Err(FilmError::Corrupt("the group has no tiles"));
        }
        let mut piece = Self {
            tiling: frame.tiling(),
            samples: Vec::new(),
            tiles: tiles.clone(),
            bad: BadSamples::default(),
            pixels: Vec::new(),
        };
        for index in tiles {
            let (tile, samples) = complete_tile(frame, index)?;
            piece.samples.push(samples);
            piece.bad.merge(tile.bad_samples());
            piece.pixels.extend(tile.pixels().iter().map(|sums| sums.resolve(tile.is_held())));
        }
        Ok(piece)
    }

    /// Returns the numbers of its tiles.
    pub fn tiles(&self) -> Range<usize> {
        self.tiles.clone()
    }

    /// Returns the tiling of its film.
    pub fn tiling(&self) -> Tiling {
        self.tiling
    }

    /// Returns the samples of each of its tiles.
    pub fn samples(&self) -> &[SampleRange] {
        &self.samples
    }

    /// Returns the account of the samples that were left out.
    pub fn bad_samples(&self) -> &BadSamples {
        &self.bad
    }

    /// Encodes the piece. Equal pixels give equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = start_header(MAGIC, VERSION);
        let mut word = |w: u32| out.extend_from_slice(&w.to_le_bytes());
        let Tiling { width, height, edge } = self.tiling;
        [width, height, edge, self.tiles.start as u32, self.tiles.end as u32].into_iter().for_each(&mut word);
        self.samples.iter().flat_map(|range| [range.start, range.end]).for_each(&mut word);
        put_bad_samples(&self.bad, word);
        compress_and_seal(out, &to_planes(&self.pixels, |pixel| pixel.to_bytes()))
    }

    /// Decodes a piece; damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, FilmError> {
        let mut reader = read_header(MAGIC, VERSION, bytes)?;
        let (tiling, tiles) = reader.tiles()?;
        let samples = tiles.clone().map(|_| reader.range()).collect::<Result<Vec<_>, _>>()?;
        let bad = reader.bad_samples(Rect { x: 0, y: 0, width: tiling.width, height: tiling.height })?;
        let count: u64 = tiles.clone().filter_map(|index| tiling.rect(index)).map(|rect| rect.area()).sum();
        if count > MAX_TILE_PIXELS {
            return Err(FilmError::Corrupt("more pixels than a group of tiles can have"));
        }
        let pixels = reader.planes(count as usize, Pixel::from_bytes)?;
        let areas = tiles.clone().filter_map(|index| tiling.rect(index)).map(|rect| rect.area() as usize);
        let most = samples.iter().zip(areas).flat_map(|(range, area)| std::iter::repeat_n(range.len(), area));
        if pixels.iter().zip(most).any(|(pixel, most)| pixel.samples > most) {
            return Err(FilmError::Corrupt("more samples than its range holds"));
        }
        Ok(Self { tiling, tiles, samples, bad, pixels })
    }
}

/// Returns tile `index` of a frame, and its samples as one range.
/// - errors: the frame has fewer tiles; this one has no samples, or a gap in them.
pub(crate) fn complete_tile(frame: &Frame, index: usize) -> Result<(&Tile, SampleRange), FilmError> {
    let rect = frame.tiling().rect(index).ok_or(FilmError::Corrupt("more tiles than the film has"))?;
    let whole = frame.tile(index).and_then(|tile| Some((tile, SampleRange::join(tile.ranges())?)));
    whole.ok_or(FilmError::Gap(rect))
}

impl FrameImage {
    /// Creates an image without samples.
    pub fn black(width: u32, height: u32) -> Self {
        let count = width as usize * height as usize;
        Self {
            color: Image { width, height, pixels: vec![[0.0; 3]; count] },
            variance: vec![[0.0; 3]; count],
            luminance_variance: vec![0.0; count],
            albedo: vec![[0.0; 3]; count],
            depth: vec![0.0; count],
            samples: vec![0; count],
        }
    }

    /// Copies the pixels of `piece` to their place, replacing earlier ones.
    /// - errors: the piece belongs to a film of another size.
    pub fn put(&mut self, piece: &ImagePiece) -> Result<(), FilmError> {
        let Tiling { width, height, .. } = piece.tiling;
        let own = Rect { x: 0, y: 0, width: self.color.width, height: self.color.height };
        if (own.width, own.height) != (width, height) {
            return Err(FilmError::OtherPixels { expected: own, found: Rect { width, height, ..own } });
        }
        let places = piece.tiles().filter_map(|index| piece.tiling.rect(index)).flat_map(Rect::pixels);
        for ((x, y), pixel) in places.zip(&piece.pixels) {
            self.set(y as usize * width as usize + x as usize, pixel);
        }
        Ok(())
    }

    /// Returns the mean number of samples per pixel over the film; left-out samples do not count.
    pub fn mean_spp(&self) -> f64 {
        let total: u64 = self.samples.iter().map(|&count| u64::from(count)).sum();
        total as f64 / (f64::from(self.color.width) * f64::from(self.color.height))
    }

    pub(crate) fn pixel(&self, at: usize) -> Pixel {
        let (color, variance, albedo) = (self.color.pixels[at], self.variance[at], self.albedo[at]);
        let luminance_variance = self.luminance_variance[at];
        Pixel { color, variance, luminance_variance, albedo, depth: self.depth[at], samples: self.samples[at] }
    }

    pub(crate) fn set(&mut self, at: usize, pixel: &Pixel) {
        self.color.pixels[at] = pixel.color;
        self.variance[at] = pixel.variance;
        self.luminance_variance[at] = pixel.luminance_variance;
        self.albedo[at] = pixel.albedo;
        self.depth[at] = pixel.depth;
        self.samples[at] = pixel.samples;
    }
}
