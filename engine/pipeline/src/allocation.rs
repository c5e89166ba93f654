//! Allocation of the samples of a frame to its tiles, so that the frame can be rendered again.

use crate::round::RoundVerdict;
use crate::settings::MAX_SPP;
use femc_film::{SampleRange, SamplingState, TileErrors, Tiling};
use serde::{Deserialize, Serialize};

/// Number of samples of each pixel, by tile.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SampleAllocation {
    /// First sample that counts.
    pub begin: u32,
    /// One past the last sample of each tile, in order.
    pub ends: Vec<u32>,
}

/// Reason why an allocation is not valid for a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AllocationError {
    /// A tile has no samples, or too many.
    #[error("invalid allocation of samples: a tile has no samples, or more than {MAX_SPP}")]
    Samples,
    /// The film has another number of tiles.
    #[error("the allocation of samples has {found} tiles, but the film has {expected}")]
    Tiles {
        /// Number of tiles of the allocation.
        found: usize,
        /// Number of tiles of the film.
        expected: usize,
    },
}

impl SampleAllocation {
    /// Creates the allocation of a frame from the samples of its tiles. `None`: they do not begin at the same sample, or there is
    /// no tile.
    pub fn from_tile_samples(samples: &[SampleRange]) -> Option<Self> {
        let begin = samples.first()?.start;
        let is_even = samples.iter().all(|range| range.start == begin);
        is_even.then(|| Self { begin, ends: samples.iter().map(|range| range.end).collect() })
    }

    /// Checks that a frame can have this allocation.
    pub(crate) fn check(&self) -> Result<(), AllocationError> {
        let is_valid_end = |&end: &u32| end > self.begin && end <= MAX_SPP;
        if !self.ends.is_empty() && self.ends.iter().all(is_valid_end) { Ok(()) } else { Err(AllocationError::Samples) }
    }

    /// Checks that the film has the same number of tiles.
    pub(crate) fn check_tiles(&self, tiling: &Tiling) -> Result<(), AllocationError> {
        let (found, expected) = (self.ends.len(), tiling.count());
        if found == expected { Ok(()) } else { Err(AllocationError::Tiles { found, expected }) }
    }

    /// Returns the samples a pixel at the end of each round: those before the first sample that counts, or those that all tiles
    /// have; then the rest.
    pub(crate) fn rounds(&self) -> Vec<u32> {
        let (least, most) = (self.ends.iter().min().copied(), self.ends.iter().max().copied());
        let first = if self.begin > 0 { Some(self.begin) } else { least };
        let mut rounds: Vec<u32> = first.into_iter().chain(most).collect();
        rounds.dedup();
        rounds
    }

    /// Returns the verdict after the first round: all remaining samples.
    pub(crate) fn verdict(
        &self,
        tiles: &[TileErrors],
        state: &mut SamplingState,
        has_next_round: bool,
    ) -> RoundVerdict {
        let is_whole = tiles.iter().zip(&self.ends).all(|(tile, &end)| tile.samples.end >= end);
        if is_whole || !has_next_round {
            return RoundVerdict::Done;
        }
        state.progress.first_sample = self.begin;
        RoundVerdict::Steps(self.ends.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_allocation_is_rendered_in_two_rounds_at_most() {
        let rounds = |begin, ends: &[u32]| SampleAllocation { begin, ends: ends.to_vec() }.rounds();
        assert_eq!(rounds(4, &[5, 90, 17]), [4, 90]);
        assert_eq!(rounds(0, &[9, 7]), [7, 9]);
        assert_eq!(rounds(0, &[9, 9]), [9]);
    }

    #[test]
    fn what_no_frame_has_is_refused() {
        let refused = |begin, ends: &[u32]| SampleAllocation { begin, ends: ends.to_vec() }.check().is_err();
        assert!(refused(0, &[]) && refused(0, &[1, 0]) && refused(4, &[9, 4]) && refused(0, &[MAX_SPP + 1]));
        assert!(!refused(4, &[9, 5]));
        let tiling = Tiling::new(64, 32, 32).unwrap();
        let tiles = |count| SampleAllocation { begin: 0, ends: vec![3; count] }.check_tiles(&tiling);
        assert_eq!((tiles(2), tiles(3)), (Ok(()), Err(AllocationError::Tiles { found: 3, expected: 2 })));
    }
}
