//! Binary format of tiles: a versioned little-endian header, a checksum, and the zstd-compressed sums.
//!
//! | bytes | content |
//! | --- | --- |
//! | 8 | `FEMCTILE`; `FEMCTHMB` for a thumbnail, whose pixels have the samples of a block |
//! | 4 | format version, 4 |
//! | 16 | BLAKE3 of everything after this field, first half |
//! | 4 x 4 | x, y, width, height |
//! | 4 + 8 n | number of sample ranges; start and end of each |
//! | 2 x 4 | for each half, the first held sample; 2^32 - 1: none |
//! | 8 | rays traced for the samples |
//! | 4 x 8 + 5 x 4 | bad samples: count of each kind; whether there is a first one, its row, column, sample and kind |
//! | rest | zstd frame of the sums |
//!
//! The sums are stored as byte planes (the lowest byte of the first sum of all pixels, then the next): high bytes are mostly zero
//! and compress to nothing. The checksum is verified before anything is allocated. The header determines the size of the plain
//! sums, so a wrong length is refused.

use crate::thumbnail::THUMBNAIL_BLOCK_EDGE;
use crate::tile::{HALVES, MAX_TILE_PIXELS, PixelSums};
use crate::{BadKind, BadSample, BadSamples, FilmError, Rect, SampleRange, Tile, Tiling};
use femc_math::sampler::REPLICATES;
use femc_stats::ExactSum;
use std::ops::Range;

const MAGIC: &[u8; 8] = b"FEMCTILE";
const THUMBNAIL_MAGIC: &[u8; 8] = b"FEMCTHMB";
const VERSION: u32 = 4;
const CHECKSUM: usize = 16;
const PREFIX: usize = MAGIC.len() + 4 + CHECKSUM;
const WIDE_SUMS: usize = 3 * HALVES + REPLICATES + 1;
const PIXEL_BYTES: usize = 16 * WIDE_SUMS + 3 * 8 + 4 * (1 + HALVES + REPLICATES + HALVES);
/// Maximum number of sample ranges of a tile.
const MAX_RANGES: u32 = 1 << 16;
/// Compression level: fast, because the data that remains after the byte planes is noise.
const COMPRESSION_LEVEL: i32 = 1;

impl Tile {
    /// Encodes the tile. Equal sums give equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        self.encode_as(MAGIC)
    }

    /// Decodes a tile; damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, FilmError> {
        Self::decode_as(MAGIC, 1, bytes)
    }

    /// Encodes a thumbnail.
    pub fn encode_thumbnail(&self) -> Vec<u8> {
        self.encode_as(THUMBNAIL_MAGIC)
    }

    /// Decodes a thumbnail; damage of any kind is an error.
    pub fn decode_thumbnail(bytes: &[u8]) -> Result<Self, FilmError> {
        Self::decode_as(THUMBNAIL_MAGIC, THUMBNAIL_BLOCK_EDGE * THUMBNAIL_BLOCK_EDGE, bytes)
    }

    fn encode_as(&self, magic: &[u8; 8]) -> Vec<u8> {
        let mut out = start_header(magic, VERSION);
        let mut word = |w: u32| out.extend_from_slice(&w.to_le_bytes());
        let Rect { x, y, width, height } = self.rect;
        [x, y, width, height].into_iter().for_each(&mut word);
        word(self.ranges.len() as u32);
        self.ranges.iter().flat_map(|range| [range.start, range.end]).for_each(&mut word);
        self.ends.into_iter().chain(to_words(self.rays)).for_each(&mut word);
        put_bad_samples(&self.bad, word);
        compress_and_seal(out, &to_planes(&self.pixels, to_bytes))
    }

    /// Decodes a tile or a thumbnail.
    /// - `area`: pixels of the film in a pixel of the tile.
    fn decode_as(magic: &[u8; 8], area: u32, bytes: &[u8]) -> Result<Self, FilmError> {
        let mut reader = read_header(magic, VERSION, bytes)?;
        let [x, y, width, height] = reader.words()?;
        let rect = Rect { x, y, width, height }.check(MAX_TILE_PIXELS)?;
        let ranges = reader.ranges()?;
        let ends = reader.words()?;
        let work = reader.long()?;
        let bad = reader.bad_samples(rect)?;
        let pixels = reader.planes(rect.area() as usize, from_bytes)?;
        let most = ranges.iter().map(|r| u64::from(r.len())).sum::<u64>() * u64::from(area);
        if pixels
            .iter()
            .any(|p| p.hits > p.samples() || p.counted_samples() > p.samples() || u64::from(p.samples()) > most)
        {
            return Err(FilmError::Corrupt("more samples than its ranges hold"));
        }
        if pixels.iter().flat_map(|p| p.peak).any(|peak| !(0.0..=f32::MAX).contains(&peak)) {
            return Err(FilmError::Corrupt("invalid luminances"));
        }
        Ok(Self { rect, ranges, ends, pixels, bad, rays: work })
    }
}

/// Starts a header: magic, version, and space for the checksum.
pub(crate) fn start_header(magic: &[u8; 8], version: u32) -> Vec<u8> {
    let mut out = magic.to_vec();
    out.extend_from_slice(&version.to_le_bytes());
    out.extend_from_slice(&[0; CHECKSUM]);
    out
}

/// Splits a 64-bit number into words, the lower one first.
pub(crate) fn to_words(number: u64) -> [u32; 2] {
    [number as u32, (number >> 32) as u32]
}

/// Writes bad samples as words.
pub(crate) fn put_bad_samples(bad: &BadSamples, mut word: impl FnMut(u32)) {
    bad.counts.iter().flat_map(|&count| to_words(count)).for_each(&mut word);
    let first = bad.first.map_or([0; 5], |b| [1, b.y, b.x, b.sample, b.kind as u32]);
    first.into_iter().for_each(&mut word);
}

/// Appends the compressed byte planes to the header, and fills in the checksum.
pub(crate) fn compress_and_seal(mut out: Vec<u8>, planes: &[u8]) -> Vec<u8> {
    // Compression into a growing buffer in memory cannot fail. If it does, the result does not decode.
    out.extend(zstd::bulk::compress(planes, COMPRESSION_LEVEL).unwrap_or_default());
    seal(out)
}

/// Fills in the checksum of everything after it.
pub(crate) fn seal(mut out: Vec<u8>) -> Vec<u8> {
    let sum = blake3::hash(&out[PREFIX..]);
    out[PREFIX - CHECKSUM..PREFIX].copy_from_slice(&sum.as_bytes()[..CHECKSUM]);
    out
}

/// Verifies magic, version and checksum, and returns a reader of the rest.
pub(crate) fn read_header<'a>(magic: &[u8; 8], version: u32, bytes: &'a [u8]) -> Result<Reader<'a>, FilmError> {
    let (prefix, body) = bytes.split_at_checked(PREFIX).ok_or(FilmError::Corrupt("the data are truncated"))?;
    if prefix[..magic.len()] != magic[..] {
        return Err(FilmError::Corrupt("the magic bytes are wrong"));
    }
    let mut reader = Reader(&prefix[magic.len()..]);
    let found = reader.word()?;
    if found != version {
        return Err(FilmError::Version { found, expected: version });
    }
    if blake3::hash(body).as_bytes()[..CHECKSUM] != *reader.0 {
        return Err(FilmError::Corrupt("checksum mismatch"));
    }
    Ok(Reader(body))
}

/// Reader of the remaining bytes.
pub(crate) struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    /// Returns all remaining bytes.
    pub(crate) fn rest(self) -> &'a [u8] {
        self.0
    }

    /// Decodes the pixels of compressed byte planes.
    pub(crate) fn planes<T, const N: usize>(
        self,
        count: usize,
        from_bytes: impl Fn(&[u8; N]) -> T,
    ) -> Result<Vec<T>, FilmError> {
        Ok(from_planes(&self.decompress(count * N)?, count, from_bytes))
    }

    /// Decompresses the remaining bytes, which must give `size` bytes.
    pub(crate) fn decompress(self, size: usize) -> Result<Vec<u8>, FilmError> {
        if zstd::zstd_safe::get_frame_content_size(self.0).ok().flatten() != Some(size as u64) {
            return Err(FilmError::Corrupt("wrong number of pixels"));
        }
        let plain = zstd::bulk::decompress(self.0, size).map_err(|_| FilmError::Corrupt("pixels do not decompress"))?;
        if plain.len() == size { Ok(plain) } else { Err(FilmError::Corrupt("wrong number of pixels")) }
    }

    fn word(&mut self) -> Result<u32, FilmError> {
        let (word, rest) = self.0.split_first_chunk().ok_or(FilmError::Corrupt("the data are truncated"))?;
        self.0 = rest;
        Ok(u32::from_le_bytes(*word))
    }

    pub(crate) fn words<const N: usize>(&mut self) -> Result<[u32; N], FilmError> {
        let mut words = [0; N];
        for word in &mut words {
            *word = self.word()?;
        }
        Ok(words)
    }

    pub(crate) fn long(&mut self) -> Result<u64, FilmError> {
        let [low, high] = self.words()?;
        Ok(u64::from(low) | (u64::from(high) << 32))
    }

    /// Reads the tiling of a film, and a range of its tiles, at least one.
    pub(crate) fn tiles(&mut self) -> Result<(Tiling, Range<usize>), FilmError> {
        let [width, height, edge, start, end] = self.words()?;
        let (tiling, tiles) = (Tiling::new(width, height, edge)?, start as usize..end as usize);
        // Every tile takes at least one more byte. Refuse a header that claims more tiles, before it makes the reader allocate
        // memory for them.
        if tiles.is_empty() || tiles.end > tiling.count() || tiles.len() > self.0.len() {
            return Err(FilmError::Corrupt("invalid tiles"));
        }
        Ok((tiling, tiles))
    }

    /// Reads a sample range, which must not be empty.
    pub(crate) fn range(&mut self) -> Result<SampleRange, FilmError> {
        let [start, end] = self.words()?;
        let range = SampleRange { start, end };
        if range.is_empty() { Err(FilmError::EmptyRange(range)) } else { Ok(range) }
    }

    pub(crate) fn ranges(&mut self) -> Result<Vec<SampleRange>, FilmError> {
        let count = self.word()?;
        if !(1..=MAX_RANGES).contains(&count) || self.0.len() < 8 * count as usize {
            return Err(FilmError::Corrupt("invalid number of sample ranges"));
        }
        let mut ranges = Vec::with_capacity(count as usize);
        let mut past = 0;
        for _ in 0..count {
            let [start, end] = self.words()?;
            if start < past || end <= start {
                return Err(FilmError::Corrupt("sample ranges out of order"));
            }
            past = end;
            ranges.push(SampleRange { start, end });
        }
        Ok(ranges)
    }

    pub(crate) fn bad_samples(&mut self, rect: Rect) -> Result<BadSamples, FilmError> {
        let mut counts = [0; 4];
        for count in &mut counts {
            *count = self.long()?;
        }
        let [present, y, x, sample, kind] = self.words()?;
        let first = match (present, BadKind::ALL.get(kind as usize)) {
            (0, _) => None,
            (1, Some(&kind)) if rect.contains(x, y) => Some(BadSample { y, x, sample, kind }),
            _ => return Err(FilmError::Corrupt("invalid record of a bad sample")),
        };
        Ok(BadSamples { counts, first })
    }
}

fn to_bytes(p: &PixelSums) -> [u8; PIXEL_BYTES] {
    let mut bytes = [0; PIXEL_BYTES];
    let mut at = 0;
    let mut put = |field: &[u8]| {
        bytes[at..at + field.len()].copy_from_slice(field);
        at += field.len();
    };
    p.color.as_flattened().iter().chain(&p.luminance).for_each(|sum| put(&sum.units().to_le_bytes()));
    put(&p.depth.units().to_le_bytes());
    p.albedo.iter().for_each(|sum| put(&sum.to_le_bytes()));
    [p.hits].iter().chain(&p.half_counts).chain(&p.replicate_counts).for_each(|count| put(&count.to_le_bytes()));
    p.peak.iter().for_each(|peak| put(&peak.to_le_bytes()));
    bytes
}

fn from_bytes(bytes: &[u8; PIXEL_BYTES]) -> PixelSums {
    fn field<const N: usize>(bytes: &[u8; PIXEL_BYTES], at: usize) -> [u8; N] {
        std::array::from_fn(|i| bytes[at + i])
    }
    let wide = |i: usize| u128::from_le_bytes(field(bytes, 16 * i));
    let sum = |i: usize| ExactSum::from_units(wide(i));
    let albedo = 16 * WIDE_SUMS;
    let word = |i: usize| u32::from_le_bytes(field(bytes, albedo + 3 * 8 + 4 * i));
    PixelSums {
        color: std::array::from_fn(|half| std::array::from_fn(|channel| sum(3 * half + channel))),
        luminance: std::array::from_fn(|replicate| sum(3 * HALVES + replicate)),
        depth: ExactSum::from_units(wide(WIDE_SUMS - 1)),
        albedo: [0, 1, 2].map(|i| u64::from_le_bytes(field(bytes, albedo + 8 * i))),
        hits: word(0),
        half_counts: std::array::from_fn(|half| word(1 + half)),
        replicate_counts: std::array::from_fn(|replicate| word(1 + HALVES + replicate)),
        peak: std::array::from_fn(|half| f32::from_bits(word(1 + HALVES + REPLICATES + half))),
    }
}

/// Number of pixels transposed at a time: planes lie a power of two apart, so single bytes written to them would share a cache set.
const STRIP: usize = 64;

pub(crate) fn to_planes<T, const N: usize>(pixels: &[T], to_bytes: impl Fn(&T) -> [u8; N]) -> Vec<u8> {
    let mut planes = vec![0; pixels.len() * N];
    for (strip, chunk) in pixels.chunks(STRIP).enumerate() {
        let mut block = [[0; STRIP]; N];
        for (i, pixel) in chunk.iter().enumerate() {
            block.iter_mut().zip(to_bytes(pixel)).for_each(|(row, byte)| row[i] = byte);
        }
        for (plane, row) in block.iter().enumerate() {
            let start = plane * pixels.len() + strip * STRIP;
            planes[start..start + chunk.len()].copy_from_slice(&row[..chunk.len()]);
        }
    }
    planes
}

pub(crate) fn from_planes<T, const N: usize>(
    planes: &[u8],
    count: usize,
    from_bytes: impl Fn(&[u8; N]) -> T,
) -> Vec<T> {
    let mut pixels = Vec::with_capacity(count);
    for start in (0..count).step_by(STRIP) {
        let length = STRIP.min(count - start);
        let mut block = [[0; STRIP]; N];
        for (plane, row) in block.iter_mut().enumerate() {
            let at = plane * count + start;
            row[..length].copy_from_slice(&planes[at..at + length]);
        }
        pixels.extend((0..length).map(|i| from_bytes(&std::array::from_fn(|plane| block[plane][i]))));
    }
    pixels
}
