//! Resolved features of several tiles and of a frame.

use super::sums::mean;
use super::tile::VERSION;
use super::{FeatureLayout, FeatureTile, RANKS};
use crate::codec::{compress_and_seal, read_header, start_header, to_planes};
use crate::{FilmError, SampleRange, Tiling};
use std::collections::BTreeSet;
use std::ops::Range;

const MAGIC: &[u8; 8] = b"FEMCFPIX";

/// Resolved features of some tiles of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FeaturePiece {
    tiling: Tiling,
    tiles: Range<usize>,
    layout: FeatureLayout,
    /// Samples of each tile.
    samples: Vec<SampleRange>,
    /// Bits of floats: tile by tile, channel by channel, row by row.
    channels: Vec<u32>,
}

impl FeaturePiece {
    /// Creates a piece without tiles; the first tile added is number `first`.
    pub fn new(tiling: Tiling, first: usize) -> Self {
        let layout = FeatureLayout::default();
        Self { tiling, tiles: first..first, layout, samples: Vec::new(), channels: Vec::new() }
    }

    /// Adds the next tile.
    /// - errors: it is not the next tile, or it has other features.
    pub fn put(&mut self, tile: &FeatureTile) -> Result<(), FilmError> {
        if self.tiling.rect(self.tiles.end) != Some(tile.rect()) {
            return Err(FilmError::NotInFrame(tile.rect()));
        }
        if !self.tiles.is_empty() && self.layout != tile.layout() {
            return Err(FilmError::Corrupt("wrong number of features"));
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
        for kind in &sums.id_counts {
            let ranked: Vec<[(u32, f32); RANKS]> = kind
                .pixels()
                .zip(&sums.counts)
                .map(|(pixel, [samples, hits])| {
                    rank_ids(pixel, samples - hits).map(|[id, count]| (id, share(count, *samples)))
                })
                .collect();
            for rank in 0..RANKS {
                self.channels.extend(ranked.iter().map(|pixel| pixel[rank].0));
                self.channels.extend(ranked.iter().map(|pixel| pixel[rank].1.to_bits()));
            }
        }
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
        let FeatureLayout { values, ids } = self.layout;
        let Tiling { width, height, edge } = self.tiling;
        let [start, end] = [self.tiles.start, self.tiles.end].map(|tile| tile as u32);
        let mut out = start_header(MAGIC, VERSION);
        let bounds = self.samples.iter().flat_map(|range| [range.start, range.end]);
        let words = [values, ids, width, height, edge, start, end].into_iter().chain(bounds);
        words.for_each(|word| out.extend_from_slice(&word.to_le_bytes()));
        compress_and_seal(out, &to_planes(&self.channels, |bits| bits.to_le_bytes()))
    }

    /// Decodes tiles; damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, FilmError> {
        let mut reader = read_header(MAGIC, VERSION, bytes)?;
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

/// Ranks the ids by their number of samples, in descending order; ties go to the lowest id. Missing entries are zeros.
/// - `misses`: number of samples without a hit, whose id is 0.
fn rank_ids(pixel: &[[u32; 2]], misses: u32) -> [[u32; 2]; RANKS] {
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
    /// Channels, each row by row. First the values: means over the samples with a hit, 0 without hits. Then the coverage: the
    /// fraction of samples with a hit. Then, for each kind of ids, [`RANKS`] times an id, as the bits of a float, and the fraction
    /// of the samples that belong to it. Samples without a hit have the id 0.
    pub channels: Vec<Vec<f32>>,
}

impl FeatureImage {
    /// Creates the features of a film without hits.
    pub fn new(layout: FeatureLayout, width: u32, height: u32) -> Self {
        let nothing = vec![0.0; width as usize * height as usize];
        Self { layout, width, height, channels: vec![nothing; layout.channels()] }
    }

    /// Copies the pixels of a piece to their place.
    /// - errors: the piece belongs to another film or has other features.
    pub fn put(&mut self, piece: &FeaturePiece) -> Result<(), FilmError> {
        if (piece.layout, piece.tiling.width, piece.tiling.height) != (self.layout, self.width, self.height) {
            return Err(FilmError::Corrupt("the features belong to another frame"));
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

    /// Returns the ids of a kind that pixels have, without the id of nothing.
    pub fn ids(&self, kind: usize) -> BTreeSet<u32> {
        let first = self.layout.values as usize + 1 + 2 * RANKS * kind;
        let ranks = self.channels[first..first + 2 * RANKS].chunks_exact(2);
        let pairs = ranks.flat_map(|rank| rank[0].iter().zip(&rank[1]));
        pairs.filter(|(_, share)| **share > 0.0).map(|(id, _)| id.to_bits()).filter(|id| *id != 0).collect()
    }
}
