//! Exact sums of the layers of a tile, and resolved layers.
//!
//! Light that several layers accept is summed up once, by color and half in 128-bit fixed point. This takes 96 bytes per pixel for
//! each set of layers, and 8 for the counts of samples. A layer is the sum of the sets that it belongs to. The sums follow the
//! tile's rules: a sample counts in the layers if it counts in the picture, halves are held from the same sample on and have the
//! same weights. Therefore layers that split the light of each sample sum up to the picture, within the rounding of floats.
//!
//! The binary format:
//!
//! | bytes | content |
//! | --- | --- |
//! | 8 | `FEMCLAYR`: sums of samples of a tile; `FEMCLPIX`: resolved pixels of several tiles |
//! | 4 | format version: 2 for sums, 1 for pixels |
//! | 16 | BLAKE3 of everything after this field, first half |
//! | 4 | number of layers, 1 to 64 |
//! | 7 x 4 | sums: x, y, width, height; first sample, one past the last; number of sets of layers |
//! | 8 each | sums: the sets, ascending, a bit for each layer |
//! | 5 x 4 | pixels: film width, film height, tile edge; first tile, one past the last |
//! | 8 each | pixels: for each tile, its first sample and one past the last |
//! | rest | zstd frame, in byte planes. Sums: the counts, then the sets, each row by row. Pixels: the layers, tile by tile |

use crate::codec::{compress_and_seal, from_planes, read_header, start_header, to_planes};
use crate::piece::{half_weights, variance_factor};
use crate::tile::{HALVES, HalfEnds, MAX_TILE_PIXELS, NONE_HELD};
use crate::{FilmError, Rect, SampleRange, Tiling};
use femc_math::Rgb;
use femc_stats::ExactSum;
use femc_stats::exact::{BufferedSums, RadianceSum};
use std::ops::Range;

const SUMS_MAGIC: &[u8; 8] = b"FEMCLAYR";
const PIXELS_MAGIC: &[u8; 8] = b"FEMCLPIX";
const SUMS_VERSION: u32 = 2;
const PIXELS_VERSION: u32 = 1;
const SUM_BYTES: usize = 16 * 3 * HALVES;
const COUNT_BYTES: usize = 4 * HALVES;
const PIXEL_BYTES: usize = 4 * 6;
/// Maximum number of layers.
const MAX_LAYERS: u32 = 64;

/// Sums of the light of the good samples of one pixel, by half, cd/m2, without held samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LightSums(pub [[RadianceSum; 3]; HALVES]);

impl LightSums {
    /// Adds the samples of `other`, which must be different samples.
    fn merge(&mut self, other: &Self) {
        self.0.as_flattened_mut().iter_mut().zip(other.0.as_flattened()).for_each(|(a, b)| a.merge(*b));
    }

    /// Resolves the light as [`Tile`](crate::Tile) resolves its color.
    fn resolve(&self, counts: [u32; HALVES], is_held: bool) -> LayerPixel {
        let mean = |half: usize, channel: usize| match counts[half] {
            0 => 0.0,
            count => self.0[half][channel].value() / f64::from(count),
        };
        let (weights, factor) = (half_weights(counts, is_held), variance_factor(counts, is_held));
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
        let sums = bytes.chunks_exact_mut(16).zip(self.0.as_flattened());
        sums.for_each(|(field, sum)| field.copy_from_slice(&sum.units().to_le_bytes()));
        bytes
    }

    fn from_bytes(bytes: &[u8; SUM_BYTES]) -> Self {
        let sum = |at: usize| ExactSum::from_units(u128::from_le_bytes(std::array::from_fn(|i| bytes[16 * at + i])));
        Self(std::array::from_fn(|half| std::array::from_fn(|channel| sum(3 * half + channel))))
    }
}

/// Buffer for the light of samples of one pixel, see [`BufferedSums`].
#[derive(Clone, Debug, Default)]
pub struct LightBuffer([BufferedSums<60, 3>; HALVES]);

impl LightBuffer {
    /// Adds light of a sample of this half, cd/m2: finite and not negative.
    #[inline]
    pub fn add(&mut self, half: usize, color: Rgb) {
        self.0[half].add(color.to_array());
    }

    /// Returns the light that was added since the last call; `None`: there is none.
    pub fn take(&mut self) -> Option<LightSums> {
        let sums = LightSums(std::mem::take(self).0.map(BufferedSums::finish));
        (sums != LightSums::default()).then_some(sums)
    }
}

/// Light that a set of layers accepts, of all pixels of a tile, row by row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LayerSetLight {
    /// Set of layers, a bit each.
    pub layers: u64,
    /// Sums of each pixel.
    pub sums: Vec<LightSums>,
}

impl LayerSetLight {
    fn is_lit(&self) -> bool {
        self.sums.iter().any(|sums| *sums != LightSums::default())
    }
}

/// The layers of samples of a rectangle of pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LayerTile {
    rect: Rect,
    samples: SampleRange,
    layers: u32,
    /// Good samples of each half that are not held, row by row.
    counts: Vec<[u32; HALVES]>,
    /// Light of each set of layers, ascending by set, each set once; sets without light are left out.
    light: Vec<LayerSetLight>,
}

impl LayerTile {
    /// Creates a tile from the good samples of each half and the light of each pixel, row by row. Sets of layers may come in any
    /// order.
    /// - errors: the data belong to other pixels or other layers.
    pub fn new(
        rect: Rect,
        samples: Range<u32>,
        layers: u32,
        counts: Vec<[u32; HALVES]>,
        light: Vec<LayerSetLight>,
    ) -> Result<Self, FilmError> {
        let area = rect.check(MAX_TILE_PIXELS)?.area() as usize;
        let samples = SampleRange::from(samples);
        if samples.is_empty() {
            return Err(FilmError::EmptyRange(samples));
        }
        check_layer_count(layers)?;
        if counts.len() != area || light.iter().any(|one| one.sums.len() != area) {
            return Err(FilmError::Corrupt("wrong number of pixels in layers"));
        }
        if light.iter().any(|one| one.layers == 0 || one.layers > all_layers(layers)) {
            return Err(FilmError::Corrupt("light belongs to other layers"));
        }
        let mut tile = Self { rect, samples, layers, counts, light: Vec::new() };
        tile.add_light(light);
        // If many sets overlap, storing the layers themselves takes less.
        if tile.light.len() > layers as usize {
            for one in std::mem::take(&mut tile.light) {
                let own = (0..layers).map(|layer| 1 << layer).filter(|layer| one.layers & layer != 0);
                tile.add_light(own.map(|layers| LayerSetLight { layers, sums: one.sums.clone() }));
            }
        }
        Ok(tile)
    }

    /// Adds light of the same pixels.
    fn add_light(&mut self, light: impl IntoIterator<Item = LayerSetLight>) {
        for one in light.into_iter().filter(LayerSetLight::is_lit) {
            match self.light.binary_search_by_key(&one.layers, |known| known.layers) {
                Ok(at) => self.light[at].sums.iter_mut().zip(&one.sums).for_each(|(mine, theirs)| mine.merge(theirs)),
                Err(at) => self.light.insert(at, one),
            }
        }
    }

    /// Returns the pixels.
    pub fn rect(&self) -> Rect {
        self.rect
    }

    /// Returns the samples.
    pub fn samples(&self) -> SampleRange {
        self.samples
    }

    /// Returns the number of layers.
    pub fn layers(&self) -> u32 {
        self.layers
    }

    /// Unites the parts of a tile: its samples from `first_sample` on. Parts may come in any order, and a repeated part counts
    /// once. Samples before `start_header` are left out, and the halves are held from `ends` on.
    /// - errors: parts of different pixels or layers, with a gap, overlapping, or with samples on both sides of an end; no parts.
    pub fn from_parts(mut parts: Vec<Self>, first_sample: u32, ends: HalfEnds) -> Result<Self, FilmError> {
        parts.retain(|part| part.samples.end > first_sample);
        parts.sort_by_key(|part| part.samples);
        parts.dedup_by_key(|part| part.samples);
        let mut parts = parts.into_iter();
        let mut all = parts.next().ok_or(FilmError::Corrupt("the tile has no layers"))?;
        all.hold(ends)?;
        for mut part in parts {
            if part.rect != all.rect {
                return Err(FilmError::OtherPixels { expected: all.rect, found: part.rect });
            }
            if part.layers != all.layers {
                return Err(FilmError::Corrupt("wrong number of layers"));
            }
            if part.samples.start != all.samples.end {
                return Err(FilmError::Gap(all.rect));
            }
            part.hold(ends)?;
            all.samples.end = part.samples.end;
            let counts = all.counts.as_flattened_mut().iter_mut().zip(part.counts.as_flattened());
            counts.for_each(|(mine, theirs)| *mine = mine.saturating_add(*theirs));
            all.add_light(part.light);
        }
        Ok(all)
    }

    fn hold(&mut self, ends: HalfEnds) -> Result<(), FilmError> {
        for (half, end) in ends.into_iter().enumerate() {
            if self.samples.start >= end {
                self.counts.iter_mut().for_each(|counts| counts[half] = 0);
                let sums = self.light.iter_mut().flat_map(|one| &mut one.sums);
                sums.for_each(|sums| sums.0[half] = Default::default());
            } else if self.samples.end > end {
                return Err(FilmError::Corrupt("a sample range crosses the boundary between the halves"));
            }
        }
        let light = std::mem::take(&mut self.light);
        self.add_light(light);
        Ok(())
    }

    /// Returns the pixels of one layer, row by row.
    fn resolve(&self, layer: u32, is_held: bool) -> impl Iterator<Item = LayerPixel> {
        let own: Vec<_> = self.light.iter().filter(|one| one.layers >> layer & 1 == 1).collect();
        self.counts.iter().enumerate().map(move |(at, counts)| {
            let mut sums = LightSums::default();
            own.iter().for_each(|one| sums.merge(&one.sums[at]));
            sums.resolve(*counts, is_held)
        })
    }

    /// Encodes the layers. Equal sums give equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        let Rect { x, y, width, height } = self.rect;
        let head = [self.layers, x, y, width, height, self.samples.start, self.samples.end, self.light.len() as u32];
        let mut out = header_with_words(SUMS_MAGIC, SUMS_VERSION, head);
        self.light.iter().for_each(|one| out.extend_from_slice(&one.layers.to_le_bytes()));
        let mut planes = to_planes(&self.counts, |counts| counts_to_bytes(*counts));
        self.light.iter().for_each(|one| planes.extend(to_planes(&one.sums, |sums| sums.to_bytes())));
        compress_and_seal(out, &planes)
    }

    /// Decodes layers; damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, FilmError> {
        let mut reader = read_header(SUMS_MAGIC, SUMS_VERSION, bytes)?;
        let [layers] = reader.words()?;
        check_layer_count(layers)?;
        let [x, y, width, height] = reader.words()?;
        let rect = Rect { x, y, width, height }.check(MAX_TILE_PIXELS)?;
        let samples = reader.range()?;
        let [sets] = reader.words()?;
        if sets > layers {
            return Err(FilmError::Corrupt("more sets of layers than layers"));
        }
        let sets = (0..sets).map(|_| reader.long()).collect::<Result<Vec<_>, _>>()?;
        if !sets.is_sorted_by(|a, b| a < b) || sets.iter().any(|&set| set == 0 || set > all_layers(layers)) {
            return Err(FilmError::Corrupt("light belongs to other layers"));
        }
        let area = rect.area() as usize;
        let planes = reader.decompress(area * (COUNT_BYTES + sets.len() * SUM_BYTES))?;
        let (counts, planes) = planes.split_at(area * COUNT_BYTES);
        let counts = from_planes(counts, area, counts_from_bytes);
        if counts.iter().any(|counts| counts.iter().map(|&it| u64::from(it)).sum::<u64>() > u64::from(samples.len())) {
            return Err(FilmError::Corrupt("more samples than its ranges hold"));
        }
        let sums = planes.chunks_exact(area * SUM_BYTES).map(|planes| from_planes(planes, area, LightSums::from_bytes));
        let light: Vec<_> = sets.into_iter().zip(sums).map(|(layers, sums)| LayerSetLight { layers, sums }).collect();
        if light.iter().any(|one| !one.is_lit()) {
            return Err(FilmError::Corrupt("the layers have no light"));
        }
        Ok(Self { rect, samples, layers, counts, light })
    }
}

/// Returns the set of all layers, a bit each.
fn all_layers(layers: u32) -> u64 {
    u64::MAX >> (MAX_LAYERS - layers)
}

fn counts_to_bytes(counts: [u32; HALVES]) -> [u8; COUNT_BYTES] {
    let mut bytes = [0; COUNT_BYTES];
    bytes.chunks_exact_mut(4).zip(counts).for_each(|(field, count)| field.copy_from_slice(&count.to_le_bytes()));
    bytes
}

fn counts_from_bytes(bytes: &[u8; COUNT_BYTES]) -> [u32; HALVES] {
    std::array::from_fn(|half| u32::from_le_bytes(std::array::from_fn(|i| bytes[4 * half + i])))
}

fn header_with_words<const N: usize>(magic: &[u8; 8], version: u32, words: [u32; N]) -> Vec<u8> {
    let mut out = start_header(magic, version);
    words.into_iter().for_each(|word| out.extend_from_slice(&word.to_le_bytes()));
    out
}

fn check_layer_count(layers: u32) -> Result<usize, FilmError> {
    (1..=MAX_LAYERS).contains(&layers).then_some(layers as usize).ok_or(FilmError::Corrupt("invalid number of layers"))
}

/// Resolved pixel of a layer: mean and estimated variance of the mean.
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

/// Resolved layers of some tiles of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerPiece {
    tiling: Tiling,
    tiles: Range<usize>,
    layers: u32,
    /// Samples of each tile.
    samples: Vec<SampleRange>,
    /// Pixels, tile by tile, layer by layer, row by row.
    pixels: Vec<LayerPixel>,
}

impl LayerPiece {
    /// Creates a piece without tiles; the first tile added is number `first`.
    pub fn new(tiling: Tiling, first: usize) -> Self {
        Self { tiling, tiles: first..first, layers: 0, samples: Vec::new(), pixels: Vec::new() }
    }

    /// Adds the next tile.
    /// - errors: it is not the next tile, or it has another number of layers.
    pub fn put(&mut self, tile: &LayerTile, ends: HalfEnds) -> Result<(), FilmError> {
        if self.tiling.rect(self.tiles.end) != Some(tile.rect) {
            return Err(FilmError::NotInFrame(tile.rect));
        }
        if self.layers != 0 && self.layers != tile.layers {
            return Err(FilmError::Corrupt("wrong number of layers"));
        }
        self.layers = tile.layers;
        self.tiles.end += 1;
        self.samples.push(tile.samples);
        self.pixels.extend((0..tile.layers).flat_map(|layer| tile.resolve(layer, ends != NONE_HELD)));
        Ok(())
    }

    /// Returns the tiling of the film.
    pub fn tiling(&self) -> Tiling {
        self.tiling
    }

    /// Returns the numbers of the tiles.
    pub fn tiles(&self) -> Range<usize> {
        self.tiles.clone()
    }

    /// Returns the samples of each tile.
    pub fn samples(&self) -> &[SampleRange] {
        &self.samples
    }

    /// Encodes the tiles. Equal pixels give equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        let Tiling { width, height, edge } = self.tiling;
        let [start, end] = [self.tiles.start, self.tiles.end].map(|tile| tile as u32);
        let mut out = header_with_words(PIXELS_MAGIC, PIXELS_VERSION, [self.layers, width, height, edge, start, end]);
        let bounds = self.samples.iter().flat_map(|range| [range.start, range.end]);
        bounds.for_each(|word| out.extend_from_slice(&word.to_le_bytes()));
        compress_and_seal(out, &to_planes(&self.pixels, |pixel| pixel.to_bytes()))
    }

    /// Decodes tiles; damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, FilmError> {
        let mut reader = read_header(PIXELS_MAGIC, PIXELS_VERSION, bytes)?;
        let [layers] = reader.words()?;
        let count = check_layer_count(layers)?;
        let (tiling, tiles) = reader.tiles()?;
        let samples = tiles.clone().map(|_| reader.range()).collect::<Result<Vec<_>, _>>()?;
        let area: u64 = tiles.clone().filter_map(|tile| tiling.rect(tile)).map(|rect| rect.area()).sum();
        if area > MAX_TILE_PIXELS {
            return Err(FilmError::Corrupt("more pixels than a group of tiles can have"));
        }
        let pixels = reader.planes(count * area as usize, LayerPixel::from_bytes)?;
        Ok(Self { tiling, tiles, layers, samples, pixels })
    }
}

/// One layer of a frame, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerImage {
    /// Name of its channels.
    pub name: String,
    /// Mean, cd/m2.
    pub color: Vec<[f32; 3]>,
    /// Estimated variance of the mean, by channel; see [`FrameImage`](crate::FrameImage).
    pub variance: Vec<[f32; 3]>,
}

impl LayerImage {
    /// Creates black layers of a film.
    pub fn black(names: impl IntoIterator<Item = String>, width: u32, height: u32) -> Vec<Self> {
        let black = vec![[0.0; 3]; width as usize * height as usize];
        names.into_iter().map(|name| Self { name, color: black.clone(), variance: black.clone() }).collect()
    }

    /// Copies the pixels of a piece to their place.
    /// - errors: the piece belongs to another film or to other layers.
    pub fn put(all: &mut [Self], piece: &LayerPiece) -> Result<(), FilmError> {
        let film = piece.tiling.width as usize * piece.tiling.height as usize;
        if all.len() != piece.layers as usize || all.iter().any(|layer| layer.color.len() != film) {
            return Err(FilmError::Corrupt("the layers belong to another frame"));
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
