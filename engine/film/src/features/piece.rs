//! Features of several tiles and of a frame, resolved.

use super::sums::mean;
use super::tile::VERSION;
use super::{FeatureLayout, FeatureTile, RANKS};
use crate::codec::{begin, finish, open, to_planes};
use crate::{FilmError, SampleRange, Tiling};
use std::collections::BTreeSet;
use std::ops::Range;

const MAGIC: &[u8; 8] = b"FEMCFPIX";

/// The features of some tiles of a frame, resolved.
#[derive(Clone, Debug, PartialEq)]
pub struct FeaturePiece {
    tiling: Tiling,
    tiles: Range<usize>,
    layout: FeatureLayout,
    /// Of each tile.
    samples: Vec<SampleRange>,
    /// Bits of floats: tile by tile, channel by channel, row by row.
    channels: Vec<u32>,
}

impl FeaturePiece {
    /// No tiles of a film yet; the first that is put is number `first`.
    pub fn new(tiling: Tiling, first: usize) -> Self {
        let layout = FeatureLayout::default();
        Self { tiling, tiles: first..first, layout, samples: Vec::new(), channels: Vec::new() }
    }

    /// Takes the next tile in.
    /// - errors: it is another one, or has other features.
    pub fn put(&mut self, tile: &FeatureTile) -> Result<(), FilmError> {
        if self.tiling.rect(self.tiles.end) != Some(tile.rect()) {
            return Err(FilmError::NotInFrame(tile.rect()));
        }
        if !self.tiles.is_empty() && self.layout != tile.layout() {
            return Err(FilmError::Corrupt("another number of features"));
        }
        self.layout = tile.layout();
        self.tiles.end += 1;
        self.samples.push(tile.samples());
        let sums = tile.sums();
        let values = self.layout.values as usize;
        for value in 0..values {
            let pixels = sums.counts.iter().enumerate();
            let bits =
                |(at, [_, hits]): (usize, &[u32; 2])| (mean(sums.values[at * values + value], *hits) as f32).to_bits();
            self.channels.extend(pixels.map(bits));
        }
        let share = |count: u32, of: u32| if of == 0 { 0.0 } else { (f64::from(count) / f64::from(of)) as f32 };
        self.channels.extend(sums.counts.iter().map(|[samples, hits]| share(*hits, *samples).to_bits()));
        for kind in &sums.shares {
            let ranked: Vec<[(u32, f32); RANKS]> = kind
                .pixels()
                .zip(&sums.counts)
                .map(|(pixel, [samples, hits])| {
                    ranked(pixel, samples - hits).map(|[id, count]| (id, share(count, *samples)))
                })
                .collect();
            for rank in 0..RANKS {
                self.channels.extend(ranked.iter().map(|pixel| pixel[rank].0));
                self.channels.extend(ranked.iter().map(|pixel| pixel[rank].1.to_bits()));
            }
        }
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
        let FeatureLayout { values, ids } = self.layout;
        let Tiling { width, height, edge } = self.tiling;
        let [start, end] = [self.tiles.start, self.tiles.end].map(|tile| tile as u32);
        let mut out = begin(MAGIC, VERSION);
        let bounds = self.samples.iter().flat_map(|range| [range.start, range.end]);
        let words = [values, ids, width, height, edge, start, end].into_iter().chain(bounds);
        words.for_each(|word| out.extend_from_slice(&word.to_le_bytes()));
        finish(out, &to_planes(&self.channels, |bits| bits.to_le_bytes()))
    }

    /// The tiles from their bytes; damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, FilmError> {
        let mut reader = open(MAGIC, VERSION, bytes)?;
        let [values, ids] = reader.words()?;
        let layout = FeatureLayout { values, ids }.check()?;
        let (tiling, tiles) = reader.tiles()?;
        let samples = tiles.clone().map(|_| reader.range()).collect::<Result<Vec<_>, _>>()?;
        let area: u64 = tiles.clone().filter_map(|tile| tiling.rect(tile)).map(|rect| rect.area()).sum();
        let count = layout.channels() * area as usize;
        let channels = reader.planes(count, |bytes: &[u8; 4]| u32::from_le_bytes(*bytes))?;
        Ok(Self { tiling, tiles, layout, samples, channels })
    }
}

/// The ids that most samples belong to, the most first, of equal ones the lowest id; zeros where there are fewer.
/// - `misses`: samples that met nothing, whose id is 0.
fn ranked(pixel: &[[u32; 2]], misses: u32) -> [[u32; 2]; RANKS] {
    let mut sorted = pixel.to_vec();
    if misses > 0 {
        sorted.push([0, misses]);
    }
    sorted.sort_unstable_by_key(|&[id, count]| (std::cmp::Reverse(count), id));
    std::array::from_fn(|rank| sorted.get(rank).copied().unwrap_or_default())
}

/// The features of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureImage {
    layout: FeatureLayout,
    width: u32,
    height: u32,
    /// Channel by channel, row by row: the numbers, means over the samples that met something, 0 where none did; the coverage, the share
    /// of these among all; of each kind of ids [`RANKS`] times an id, whose bits are the float's, and the share of the samples that
    /// belong to it. Samples that met nothing have the id 0.
    pub channels: Vec<Vec<f32>>,
}

impl FeatureImage {
    /// A film that has met nothing.
    pub fn new(layout: FeatureLayout, width: u32, height: u32) -> Self {
        let nothing = vec![0.0; width as usize * height as usize];
        Self { layout, width, height, channels: vec![nothing; layout.channels()] }
    }

    /// Takes the pixels of a piece in.
    /// - errors: it is of another film or of other features.
    pub fn put(&mut self, piece: &FeaturePiece) -> Result<(), FilmError> {
        if (piece.layout, piece.tiling.width, piece.tiling.height) != (self.layout, self.width, self.height) {
            return Err(FilmError::Corrupt("features of another frame"));
        }
        let mut bits = piece.channels.iter();
        for rect in piece.tiles().filter_map(|tile| piece.tiling.rect(tile)) {
            for channel in &mut self.channels {
                for ((x, y), bits) in rect.pixels().zip(&mut bits) {
                    channel[y as usize * self.width as usize + x as usize] = f32::from_bits(*bits);
                }
            }
        }
        Ok(())
    }

    /// Ids of a kind that pixels have, but for that of nothing.
    pub fn ids(&self, kind: usize) -> BTreeSet<u32> {
        let first = self.layout.values as usize + 1 + 2 * RANKS * kind;
        let ranks = self.channels[first..first + 2 * RANKS].chunks_exact(2);
        let pairs = ranks.flat_map(|rank| rank[0].iter().zip(&rank[1]));
        pairs.filter(|(_, share)| **share > 0.0).map(|(id, _)| id.to_bits()).filter(|id| *id != 0).collect()
    }
}
