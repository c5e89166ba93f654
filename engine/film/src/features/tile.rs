//! Features of the samples of a tile.

use super::sums::{IdCounts, MAX_TERM};
use super::{FeatureLayout, FeatureSums};
use crate::codec::{compress_and_seal, from_planes, read_header, start_header, to_planes};
use crate::tile::MAX_TILE_PIXELS;
use crate::{FilmError, Rect, SampleRange};
use std::ops::Range;

const MAGIC: &[u8; 8] = b"FEMCFEAT";
pub(super) const VERSION: u32 = 1;

/// The features of samples of a rectangle of pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FeatureTile {
    rect: Rect,
    samples: SampleRange,
    sums: FeatureSums,
}

impl FeatureTile {
    /// Creates a tile from sums by pixel, row by row.
    /// - errors: the number of pixels is wrong.
    pub fn new(rect: Rect, samples: Range<u32>, sums: FeatureSums) -> Result<Self, FilmError> {
        let area = rect.check(MAX_TILE_PIXELS)?.area() as usize;
        let samples = SampleRange::from(samples);
        if samples.is_empty() {
            return Err(FilmError::EmptyRange(samples));
        }
        sums.layout.check()?;
        if sums.counts.len() != area {
            return Err(FilmError::Corrupt("wrong number of pixels in features"));
        }
        Ok(Self { rect, samples, sums })
    }

    /// Returns the pixels.
    pub fn rect(&self) -> Rect {
        self.rect
    }

    /// Returns the samples.
    pub fn samples(&self) -> SampleRange {
        self.samples
    }

    /// Returns the layout of a pixel.
    pub fn layout(&self) -> FeatureLayout {
        self.sums.layout
    }

    pub(super) fn sums(&self) -> &FeatureSums {
        &self.sums
    }

    /// Unites the parts of a tile: its samples from `first_sample` on. Parts may come in any order, and a repeated part counts
    /// once. Samples before `start_header` are left out.
    /// - errors: parts of different pixels or features, with a gap, or overlapping; no parts.
    pub fn from_parts(mut parts: Vec<Self>, first_sample: u32) -> Result<Self, FilmError> {
        parts.retain(|part| part.samples.end > first_sample);
        parts.sort_by_key(|part| part.samples);
        parts.dedup_by_key(|part| part.samples);
        let mut parts = parts.into_iter();
        let mut all = parts.next().ok_or(FilmError::Corrupt("the tile has no features"))?;
        for part in parts {
            if part.rect != all.rect {
                return Err(FilmError::OtherPixels { expected: all.rect, found: part.rect });
            }
            if part.sums.layout != all.sums.layout {
                return Err(FilmError::Corrupt("wrong number of features"));
            }
            if part.samples.start != all.samples.end {
                return Err(FilmError::Gap(all.rect));
            }
            all.samples.end = part.samples.end;
            all.sums.merge(&part.sums);
        }
        Ok(all)
    }

    /// Encodes the features. Equal sums give equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        let FeatureSums { layout, counts, values, id_counts: shares, .. } = &self.sums;
        let Rect { x, y, width, height } = self.rect;
        let mut out = start_header(MAGIC, VERSION);
        let head = [layout.values, layout.ids, x, y, width, height, self.samples.start, self.samples.end];
        let entries = shares.iter().map(|shares| shares.entries.len() as u32);
        head.into_iter().chain(entries).for_each(|word| out.extend_from_slice(&word.to_le_bytes()));
        let mut planes = to_planes(counts, pair_bytes);
        planes.extend(to_planes(values, |value| value.to_le_bytes()));
        for shares in shares {
            let lengths: Vec<u32> = shares.pixels().map(|pixel| pixel.len() as u32).collect();
            planes.extend(to_planes(&lengths, |length| length.to_le_bytes()));
            planes.extend(to_planes(&shares.entries, pair_bytes));
        }
        compress_and_seal(out, &planes)
    }

    /// Decodes features; damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, FilmError> {
        let mut reader = read_header(MAGIC, VERSION, bytes)?;
        let [values, ids] = reader.words()?;
        let layout = FeatureLayout { values, ids }.check()?;
        let [x, y, width, height] = reader.words()?;
        let rect = Rect { x, y, width, height }.check(MAX_TILE_PIXELS)?;
        let samples = reader.range()?;
        let area = rect.area() as usize;
        let mut entries = Vec::with_capacity(ids as usize);
        for _ in 0..ids {
            let [count] = reader.words()?;
            // A pixel cannot have more ids than samples.
            if u64::from(count) > area as u64 * u64::from(samples.len()) {
                return Err(FilmError::Corrupt("invalid number of ids"));
            }
            entries.push(count as usize);
        }
        let numbers = area * values as usize;
        let size = 8 * area + 16 * numbers + entries.iter().map(|count| 4 * area + 8 * count).sum::<usize>();
        let plain = reader.decompress(size)?;
        let mut rest = &plain[..];
        let mut take = |size: usize| {
            let (taken, left) = rest.split_at(size);
            rest = left;
            taken
        };
        let counts = from_planes(take(8 * area), area, pair);
        let sums = from_planes(take(16 * numbers), numbers, |bytes: &[u8; 16]| i128::from_le_bytes(*bytes));
        let mut shares = Vec::with_capacity(entries.len());
        for count in entries {
            let lengths = from_planes(take(4 * area), area, |bytes: &[u8; 4]| u32::from_le_bytes(*bytes));
            let kind = IdCounts::new(&lengths, from_planes(take(8 * count), count, pair));
            shares.push(kind.ok_or(FilmError::Corrupt("wrong number of ids"))?);
        }
        check(&counts, &sums, &shares, samples)?;
        Ok(Self { rect, samples, sums: FeatureSums::from_parts(layout, counts, sums, shares) })
    }
}

/// Refuses sums that no samples can give.
fn check(counts: &[[u32; 2]], values: &[i128], shares: &[IdCounts], samples: SampleRange) -> Result<(), FilmError> {
    if counts.iter().any(|[all, hits]| hits > all || *all > samples.len()) {
        return Err(FilmError::Corrupt("more samples than its ranges hold"));
    }
    let numbers = (values.len() / counts.len().max(1)).max(1);
    let most = |hits: u32| MAX_TERM.unsigned_abs() * u128::from(hits);
    let is_over = |(sums, [_, hits]): (&[i128], &[u32; 2])| sums.iter().any(|sum| sum.unsigned_abs() > most(*hits));
    if values.chunks(numbers).zip(counts).any(is_over) {
        return Err(FilmError::Corrupt("invalid features"));
    }
    let is_fit = |(pixel, [_, hits]): (&[[u32; 2]], &[u32; 2])| {
        let sum: u64 = pixel.iter().map(|entry| u64::from(entry[1])).sum();
        sum == u64::from(*hits) && pixel.iter().all(|entry| entry[1] > 0) && pixel.is_sorted_by(|a, b| a[0] < b[0])
    };
    if shares.iter().flat_map(|kind| kind.pixels().zip(counts)).all(is_fit) {
        Ok(())
    } else {
        Err(FilmError::Corrupt("invalid ids"))
    }
}

fn pair_bytes(pair: &[u32; 2]) -> [u8; 8] {
    (u64::from(pair[0]) | u64::from(pair[1]) << 32).to_le_bytes()
}

fn pair(bytes: &[u8; 8]) -> [u32; 2] {
    let both = u64::from_le_bytes(*bytes);
    [both as u32, (both >> 32) as u32]
}
