//! How the samples of a frame were divided among its tiles, to render it again.

use crate::round::RoundVerdict;
use crate::settings::MAX_SPP;
use femc_film::{SampleRange, Stops, TileErrors, Tiling};
use serde::{Deserialize, Serialize};

/// The samples of each pixel of each tile.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Allocation {
    /// The first sample that counts.
    pub begin: u32,
    /// Of each tile, in order, one past the last sample.
    pub ends: Vec<u32>,
}

/// Why an allocation is none of a frame's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AllocationError {
    /// A tile has no samples, or too many.
    #[error("an allocation of samples gives some tile none, or more than {MAX_SPP}")]
    Samples,
    /// Of a film that is cut otherwise.
    #[error("the allocation of samples is of {found} tiles; the film has {expected}")]
    Tiles {
        /// Tiles of the allocation.
        found: usize,
        /// Tiles of the film.
        expected: usize,
    },
}

impl Allocation {
    /// Of a frame whose tiles have these samples; `None`: they do not begin at the same sample, or there is no tile.
    pub fn of(samples: &[SampleRange]) -> Option<Self> {
        let begin = samples.first()?.start;
        let is_even = samples.iter().all(|range| range.start == begin);
        is_even.then(|| Self { begin, ends: samples.iter().map(|range| range.end).collect() })
    }

    /// Refuses what no frame has.
    pub(crate) fn check(&self) -> Result<(), AllocationError> {
        let is_some = |&end: &u32| end > self.begin && end <= MAX_SPP;
        if !self.ends.is_empty() && self.ends.iter().all(is_some) { Ok(()) } else { Err(AllocationError::Samples) }
    }

    /// Refuses a film of another number of tiles.
    pub(crate) fn check_tiles(&self, tiling: &Tiling) -> Result<(), AllocationError> {
        let (found, expected) = (self.ends.len(), tiling.count());
        if found == expected { Ok(()) } else { Err(AllocationError::Tiles { found, expected }) }
    }

    /// Samples a pixel at the end of each round: what is before the first sample that counts, or what all tiles have; then the rest.
    pub(crate) fn rounds(&self) -> Vec<u32> {
        let (least, most) = (self.ends.iter().min().copied(), self.ends.iter().max().copied());
        let first = if self.begin > 0 { Some(self.begin) } else { least };
        let mut rounds: Vec<u32> = first.into_iter().chain(most).collect();
        rounds.dedup();
        rounds
    }

    /// What follows the first round: all the rest.
    pub(crate) fn next(&self, tiles: &[TileErrors], stops: &mut Stops, may_go_on: bool) -> RoundVerdict {
        let is_whole = tiles.iter().zip(&self.ends).all(|(tile, &end)| tile.samples.end >= end);
        if is_whole || !may_go_on {
            return RoundVerdict::Done;
        }
        stops.pace.begin = self.begin;
        RoundVerdict::Steps(self.ends.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_allocation_is_rendered_in_two_rounds_at_most() {
        let rounds = |begin, ends: &[u32]| Allocation { begin, ends: ends.to_vec() }.rounds();
        assert_eq!(rounds(4, &[5, 90, 17]), [4, 90]);
        assert_eq!(rounds(0, &[9, 7]), [7, 9]);
        assert_eq!(rounds(0, &[9, 9]), [9]);
    }

    #[test]
    fn what_no_frame_has_is_refused() {
        let refused = |begin, ends: &[u32]| Allocation { begin, ends: ends.to_vec() }.check().is_err();
        assert!(refused(0, &[]) && refused(0, &[1, 0]) && refused(4, &[9, 4]) && refused(0, &[MAX_SPP + 1]));
        assert!(!refused(4, &[9, 5]));
        let tiling = Tiling::new(64, 32, 32).unwrap();
        let tiles = |count| Allocation { begin: 0, ends: vec![3; count] }.check_tiles(&tiling);
        assert_eq!((tiles(2), tiles(3)), (Ok(()), Err(AllocationError::Tiles { found: 3, expected: 2 })));
    }
}
