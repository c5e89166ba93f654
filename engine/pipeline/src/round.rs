//! Decision after a round of samples: which tiles of a frame get more samples.
//!
//! The decision is a function of the tiles' own samples. It does not depend on clocks, order of arrival, or number of workers, so
//! every process decides alike. The one exception is [`StopCondition::Time`], which the user requests ([`crate::budget`]): the
//! image states how its samples were divided, and the same division gives the same image ([`SampleAllocation`](crate::Allocation)).
//!
//! A rule that stops on the same estimates that it reports favors estimates that look good, and those are the ones that miss a rare
//! bright path. Such images are too dark (by a third in examples with heavy tails). Here the samples of a tile form two independent
//! halves, A and B, which grow by rounds of a fixed size. The number of A's samples that count is the end of the first round after
//! which B's samples alone, in the same number as A's, promise the requested error, and vice versa. So each number is a function of
//! samples that are independent of those that it counts. For every number the mean of A is unbiased, hence A's is, B's is, and the
//! image's, (A + B) / 2, is. Both halves are drawn until both have ended, since each is needed to end the other. Samples of a half
//! after its end are held and do not count.

use crate::budget;
use crate::settings::{Settings, StopCondition};
use femc_film::tile::{HALVES, HalfEnds};
use femc_film::{SamplingState, TileErrors};

/// Decision after a round of samples.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RoundVerdict {
    /// Another round of all tiles.
    Continue,
    /// Another round, at the end of which each tile has this total number of samples a pixel. No tile has fewer than now.
    Steps(Vec<u32>),
    /// The frame is finished.
    Done,
}

/// Number of samples a pixel after which a block without light is not refined any more.
pub const UNLIT_SPP: u32 = 64;

impl Settings {
    /// Returns the decision after a round, and the ends of the halves of the tiles.
    /// - `tiles`: all tiles of the frame, in order;
    /// - `before`: state left by the decision before; `None`: this is the first one;
    /// - `seconds`: seconds since the frame's first lease, only for [`StopCondition::Time`];
    /// - `planned`: samples a pixel at the end of the next round; `None`: this was the last one.
    pub fn verdict(
        &self,
        tiles: &[TileErrors],
        before: Option<SamplingState>,
        seconds: f64,
        planned: Option<u32>,
    ) -> (RoundVerdict, SamplingState) {
        let mut stops = before.unwrap_or_else(|| SamplingState::after_first_round(tiles));
        let verdict = match (self.stop, &self.allocation) {
            (StopCondition::Error(most), _) => {
                for (tile, ends) in tiles.iter().zip(&mut stops.ends) {
                    end_halves(tile, stops.floors, most, ends);
                }
                next_verdict(tiles, &stops.ends, planned)
            }
            (StopCondition::Time(_), Some(allocation)) => allocation.verdict(tiles, &mut stops, planned.is_some()),
            (StopCondition::Time(most), None) => budget::verdict(most, tiles, &mut stops, seconds, planned.is_some()),
            (StopCondition::Spp(_), _) => RoundVerdict::Done,
        };
        (verdict, stops)
    }
}

/// Returns the decision if tiles end one by one.
fn next_verdict(tiles: &[TileErrors], ends: &[HalfEnds], planned: Option<u32>) -> RoundVerdict {
    let Some(planned) = planned else { return RoundVerdict::Done };
    let is_enough = |(tile, ends): &(&TileErrors, &HalfEnds)| ends.iter().all(|&end| end <= tile.samples.end);
    let all = || tiles.iter().zip(ends);
    let enough = all().filter(is_enough).count();
    if enough == tiles.len() {
        return RoundVerdict::Done;
    }
    if enough == 0 {
        return RoundVerdict::Continue;
    }
    let steps = |it: (&TileErrors, &HalfEnds)| {
        let samples = it.0.samples.end;
        if is_enough(&it) { samples } else { planned.max(samples) }
    };
    RoundVerdict::Steps(all().map(steps).collect())
}

/// Ends each half of a tile if the other half says that the number of samples is sufficient.
fn end_halves(tile: &TileErrors, floors: [f64; HALVES], max_error: f64, ends: &mut HalfEnds) {
    let samples = tile.samples.end;
    let unlit = if samples >= UNLIT_SPP { 0.0 } else { f64::INFINITY };
    for (half, floor) in floors.into_iter().enumerate() {
        let other = &mut ends[HALVES - 1 - half];
        if *other > samples && tile.worst_error(half, floor, unlit) <= max_error {
            *other = samples;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_film::tile::NONE_HELD;
    use femc_film::{Block, HalfBlock, Rect, TileBlock, TimedProgress};

    const TIME: f64 = 4.0;
    const RECT: Rect = Rect { x: 0, y: 0, width: 1, height: 1 };

    /// Creates a tile of one block with luminance 1 and the relative error of each half. `None`: the half has found no light.
    fn tile(samples: u32, errors: [Option<f64>; 2]) -> TileErrors {
        let half = |error: Option<f64>| match error {
            Some(error) => HalfBlock { sum: 1.0, bound: 2.0 * (error / 1.959_964).powi(2) },
            None => HalfBlock { sum: 0.0, bound: 0.0 },
        };
        let block = Block { rect: RECT, sum: 1.0, variance: 0.0, freedom: 3.0 };
        let blocks = vec![TileBlock { block, halves: errors.map(half) }];
        TileErrors { samples: (0..samples).into(), bad: 0, rays: 0, ends: NONE_HELD, blocks }
    }

    fn stops(tiles: usize) -> Option<SamplingState> {
        Some(SamplingState { floors: [0.01; 2], ends: vec![NONE_HELD; tiles], progress: TimedProgress::default() })
    }

    fn settings(stop: StopCondition) -> Settings {
        Settings { stop, ..Settings::default() }
    }

    #[test]
    fn halves_stop_by_each_other_and_tiles_when_both_have_stopped() {
        let errors = [[0.04, 0.04], [0.06, 0.04], [0.04, 0.06], [0.06, 0.06]].map(|pair| pair.map(Some));
        let tiles = errors.map(|pair| tile(16, pair));
        let (verdict, left) = settings(StopCondition::Error(0.05)).verdict(&tiles, stops(4), TIME, Some(24));
        assert_eq!(left.ends, [[16, 16], [16, u32::MAX], [u32::MAX, 16], NONE_HELD]);
        assert_eq!(verdict, RoundVerdict::Steps(vec![16, 24, 24, 24]));

        // In the next round, the half that ended no longer affects its own end.
        let errors = [[0.9, 0.9], [0.01, 0.9], [0.9, 0.9], [0.01, 0.01]].map(|pair| pair.map(Some));
        let tiles: Vec<TileErrors> = errors.into_iter().zip([16, 24, 24, 24]).map(|(e, n)| tile(n, e)).collect();
        let (verdict, left) = settings(StopCondition::Error(0.05)).verdict(&tiles, Some(left), TIME, Some(32));
        assert_eq!(left.ends, [[16, 16], [16, 24], [u32::MAX, 16], [24, 24]]);
        assert_eq!(verdict, RoundVerdict::Steps(vec![16, 24, 32, 24]));
        let (verdict, _) = settings(StopCondition::Error(0.05)).verdict(&tiles, Some(left), TIME, None);
        assert_eq!(verdict, RoundVerdict::Done, "it was the last round");
    }

    #[test]
    fn unlit_tiles_continue_to_a_limit_and_unknown_ones_continue() {
        let is_over = |samples: u32, errors: [Option<f64>; 2]| {
            let tiles = [tile(samples, errors)];
            settings(StopCondition::Error(0.05)).verdict(&tiles, stops(1), TIME, Some(samples + 8)).0
                == RoundVerdict::Done
        };
        assert!(!is_over(UNLIT_SPP - 8, [None; 2]) && is_over(UNLIT_SPP, [None; 2]));
        assert!(!is_over(UNLIT_SPP, [None, Some(0.9)]));
        assert!(!is_over(UNLIT_SPP, [Some(f64::INFINITY); 2]));
    }

    #[test]
    fn dark_blocks_are_measured_against_the_first_round_floor() {
        let tiles = [tile(16, [Some(0.5); 2])];
        let with = |floors| {
            let before = Some(SamplingState { floors, ..stops(1).unwrap() });
            settings(StopCondition::Error(0.05)).verdict(&tiles, before, TIME, Some(24)).1.ends[0]
        };
        assert_eq!(with([10.1, 9.9]), [u32::MAX, 16], "the floor that a half's error is measured against is its own");
        let (_, first) = settings(StopCondition::Error(0.05)).verdict(&tiles, None, TIME, Some(24));
        assert_eq!(first.floors, [0.01; 2], "a hundredth of the mean");
    }

    #[test]
    fn the_clock_counts_only_where_a_time_was_asked_for() {
        let tiles = [tile(16, [Some(0.0); 2]), tile(16, [Some(9.0); 2])];
        let verdict = |stop, time| settings(stop).verdict(&tiles, stops(2), time, Some(64));
        let late = 1e9;
        assert_eq!(verdict(StopCondition::Time(5.0), late).0, RoundVerdict::Done);
        assert_eq!(verdict(StopCondition::Error(0.05), late), verdict(StopCondition::Error(0.05), TIME));
    }
}
