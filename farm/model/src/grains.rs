//! How a render stage is numbered: the samples of each of its tiles are cut into equal shares, the grains, so that one lease
//! may cover as many of them as fit its time.

use std::num::NonZeroU64;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::{Grid, JobSpec};

/// How finely the tiles of a job are cut; fixed for its life.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Cut {
    /// Not at all: a task is all samples of a tile's round.
    #[default]
    Whole,
    /// Into grains of so many pixel samples, or up to twice as many.
    Grains(NonZeroU64),
}

/// The keys of one render stage: grain `g` of tile `t` is the key `t * per_tile + g`. A task is a run of grains of one tile;
/// its key is that of the first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grains {
    grid: Grid,
    samples: Range<u32>,
    per_tile: u32,
}

impl Grains {
    /// Most grains of a tile.
    pub const MOST: u32 = 64;

    /// Of a round of the job's frames; of a round beyond the last: one grain a tile, without samples.
    pub fn of(spec: &JobSpec, round: u32, cut: Cut) -> Self {
        let samples = spec.samples(round);
        let mut grains = Self { grid: spec.grid, samples, per_tile: 1 };
        if let Cut::Grains(size) = cut {
            let most = grains.samples.len().clamp(1, Self::MOST as usize) as u64;
            grains.per_tile = (grains.of_a_tile() / size).clamp(1, most) as u32;
        }
        grains
    }

    /// Pixel samples of a tile that is not at the film's far edges.
    pub fn of_a_tile(&self) -> u64 {
        let [width, height] = self.grid.film.map(|side| u64::from(side.min(self.grid.tile)));
        width * height * self.samples.len() as u64
    }

    /// Tiles of the film.
    pub fn tiles(&self) -> u32 {
        self.grid.tiles()
    }

    /// Grains of a tile.
    pub fn per_tile(&self) -> u32 {
        self.per_tile
    }

    /// All keys.
    pub fn all(&self) -> Range<u32> {
        0..self.tiles() * self.per_tile
    }

    /// The tile that a key belongs to.
    pub fn tile(&self, key: u32) -> u32 {
        key / self.per_tile
    }

    /// The keys of a tile.
    pub fn of_tile(&self, tile: u32) -> Range<u32> {
        tile * self.per_tile..(tile + 1) * self.per_tile
    }

    /// Sample indices, the same for each pixel, of a run of one tile's grains.
    pub fn samples(&self, run: &Range<u32>) -> Range<u32> {
        let first = self.of_tile(self.tile(run.start)).start;
        self.bound(run.start - first)..self.bound(run.end - first)
    }

    /// Pixel samples of a run of one tile's grains; a tile at the film's edge may have fewer pixels.
    pub fn pixel_samples(&self, run: &Range<u32>) -> u64 {
        let pixels = self.grid.rect(self.tile(run.start)).map_or(0, |rect| rect.pixels());
        pixels * self.samples(run).len() as u64
    }

    /// The run from `first` that holds just these samples; `None`: there is no such run.
    pub fn run(&self, first: u32, samples: &Range<u32>) -> Option<Range<u32>> {
        if first >= self.all().end {
            return None;
        }
        let keys = first..self.of_tile(self.tile(first)).end;
        keys.map(|last| first..last + 1).find(|run| self.samples(run) == *samples)
    }

    /// The run from `first` of which a result has so many pixel samples; of tiles that are not cut, the tile.
    pub fn run_of(&self, first: u32, pixel_samples: u64) -> Option<Range<u32>> {
        if self.per_tile == 1 {
            return Some(first..first.saturating_add(1));
        }
        let pixels = self.grid.rect(self.tile(first))?.pixels();
        let spp = u32::try_from(pixel_samples / pixels).ok()?;
        let start = self.samples(&(first..first)).start;
        self.run(first, &(start..start.checked_add(spp)?)).filter(|run| self.pixel_samples(run) == pixel_samples)
    }

    /// Where the samples of grain number `grain` of a tile begin.
    fn bound(&self, grain: u32) -> u32 {
        let spp = u64::from(self.samples.end - self.samples.start);
        self.samples.start + (spp * u64::from(grain) / u64::from(self.per_tile)) as u32
    }
}

#[cfg(test)]
mod tests {
    use crate::Digest;

    use super::*;

    fn spec(film: [u32; 2], rounds: &[u32]) -> JobSpec {
        JobSpec {
            name: "fog".into(),
            bundle: Digest::of(b"scene"),
            entry: "fog.mgf".into(),
            settings: "{}".into(),
            frames: vec![1],
            grid: Grid { film, tile: 8 },
            rounds: rounds.to_vec(),
            priority: 50,
            owner: "me".into(),
            tags: vec![],
        }
    }

    fn grains(rounds: &[u32], round: u32, size: u64) -> Grains {
        Grains::of(&spec([20, 8], rounds), round, NonZeroU64::new(size).map_or(Cut::Whole, Cut::Grains))
    }

    #[test]
    fn the_grains_of_a_tile_hold_each_sample_of_the_round_once_and_none_is_empty() {
        for (rounds, size) in [(&[7, 100, 101][..], 64), (&[7, 100, 101], 200), (&[1000, 65_000], 1), (&[3], 1 << 40)] {
            for round in 0..rounds.len() as u32 {
                let grains = grains(rounds, round, size);
                assert!((1..=Grains::MOST).contains(&grains.per_tile()));
                for tile in 0..grains.tiles() {
                    let mut next = spec([20, 8], rounds).samples(round);
                    for key in grains.of_tile(tile) {
                        let samples = grains.samples(&(key..key + 1));
                        assert!(samples.start == next.start && !samples.is_empty(), "{samples:?} after {next:?}");
                        assert_eq!(grains.tile(key), tile);
                        next.start = samples.end;
                    }
                    assert!(next.is_empty(), "{next:?} is in no grain");
                }
            }
        }
    }

    #[test]
    fn a_run_is_found_by_its_samples_and_nothing_else_is_one() {
        let grains = grains(&[10, 50], 1, 320);
        assert_eq!((grains.per_tile(), grains.all()), (8, 0..24));
        for tile in 0..3 {
            let pixels = if tile == 2 { 32 } else { 64 };
            for first in grains.of_tile(tile) {
                for end in first + 1..=grains.of_tile(tile).end {
                    let (run, samples) = (first..end, grains.samples(&(first..end)));
                    assert_eq!(grains.run(first, &samples), Some(run.clone()));
                    assert_eq!(grains.pixel_samples(&run), pixels * u64::from(5 * (end - first)));
                    assert_eq!(grains.run_of(first, grains.pixel_samples(&run)), Some(run.clone()));
                    assert_eq!(grains.run_of(first, grains.pixel_samples(&run) + 1), None);
                    assert_eq!(grains.run(first, &(samples.start..samples.end + 1)), None);
                    assert_eq!(grains.run(first, &(samples.start + 1..samples.end)), None);
                }
            }
        }
        assert_eq!(grains.run(24, &(10..15)), None, "beyond the last tile");
    }

    #[test]
    fn tiles_that_are_not_cut_are_whole_whatever_their_result_says() {
        let grains = Grains::of(&spec([20, 8], &[4]), 0, Cut::Whole);
        assert_eq!((grains.all(), grains.run_of(2, 77), grains.samples(&(1..2))), (0..3, Some(2..3), 0..4));
    }
}
