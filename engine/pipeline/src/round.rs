//! What follows a round of samples: which tiles of a frame get more of them.
//!
//! The decision is a function of the tiles' own samples. It knows no clock, no order of arrival, no number of workers: all of
//! them decide alike. The one exception is [`Stop::Time`], for which a person asks: the clock ends the frame as a whole then,
//! and its samples are not the same another time.

use crate::settings::{Settings, Stop};

/// What a frame does after a round of samples.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RoundVerdict {
    /// Another round, of all tiles.
    Continue,
    /// Another round, at the end of which each tile has so many samples a pixel in all; no tile has fewer than now.
    Steps(Vec<u32>),
    /// The frame is finished.
    Done,
}

/// A tile after a round.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TileState {
    /// Samples a pixel that it has.
    pub samples: u32,
    /// Largest relative error of its blocks, 95 %.
    pub error: f64,
}

/// Seconds of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameTime {
    /// Since its first task was begun.
    pub so_far: f64,
    /// That the next round takes, as the rounds until now did.
    pub next: f64,
}

impl Settings {
    /// What follows a round.
    /// - `tiles`: all tiles of the frame, in order;
    /// - `time`: for [`Stop::Time`] alone;
    /// - `planned`: samples a pixel at the end of the next round; `None`: this was the last one.
    ///
    /// A tile whose error is as asked for is left alone; should it be too large again later, against a darker frame, the tile goes
    /// on. The rule looks at the estimates that it stops, which biases dim, spiky tiles slightly downward; rounds that double
    /// keep that small.
    pub fn verdict(&self, tiles: &[TileState], time: FrameTime, planned: Option<u32>) -> RoundVerdict {
        let Some(planned) = planned else { return RoundVerdict::Done };
        let is_enough = |tile: &TileState| match self.stop {
            Stop::Spp(_) => true,
            Stop::Error(e) => tile.error <= e,
            Stop::Time(t) => time.so_far + time.next > t,
        };
        let enough = tiles.iter().filter(|tile| is_enough(tile)).count();
        if enough == tiles.len() {
            return RoundVerdict::Done;
        }
        if enough == 0 {
            return RoundVerdict::Continue;
        }
        let steps = |tile: &TileState| if is_enough(tile) { tile.samples } else { planned.max(tile.samples) };
        RoundVerdict::Steps(tiles.iter().map(steps).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIME: FrameTime = FrameTime { so_far: 4.0, next: 2.0 };

    fn verdict(stop: Stop, errors: &[f64], planned: Option<u32>) -> RoundVerdict {
        let tile = |(place, &error): (usize, &f64)| TileState { samples: [16, 32][place % 2], error };
        let tiles: Vec<TileState> = errors.iter().enumerate().map(tile).collect();
        Settings { stop, ..Settings::default() }.verdict(&tiles, TIME, planned)
    }

    #[test]
    fn a_tile_whose_error_is_reached_gets_nothing_and_the_others_what_is_planned() {
        let stop = Stop::Error(0.05);
        assert_eq!(verdict(stop, &[0.06, 0.05, 0.01, 0.2], Some(64)), RoundVerdict::Steps(vec![64, 32, 16, 64]));
        assert_eq!(verdict(stop, &[0.06, f64::INFINITY], Some(64)), RoundVerdict::Continue);
        assert_eq!(verdict(stop, &[0.05, 0.0], Some(64)), RoundVerdict::Done);
        assert_eq!(verdict(stop, &[f64::NAN], Some(64)), RoundVerdict::Continue, "nothing is known of it");
        assert_eq!(verdict(stop, &[0.06, 0.2], None), RoundVerdict::Done, "it was the last round");
    }

    #[test]
    fn the_clock_counts_only_where_a_time_was_asked_for_and_then_for_the_whole_frame() {
        assert_eq!(verdict(Stop::Time(7.0), &[0.0, 9.0], Some(64)), RoundVerdict::Continue);
        assert_eq!(
            verdict(Stop::Time(5.0), &[0.0, 9.0], Some(64)),
            RoundVerdict::Done,
            "the next round takes too long"
        );
        let late = Settings { stop: Stop::Error(0.05), ..Settings::default() };
        let tiles = [TileState { samples: 16, error: 0.1 }];
        let time = FrameTime { so_far: 1e9, next: 1e9 };
        assert_eq!(late.verdict(&tiles, time, Some(32)), late.verdict(&tiles, TIME, Some(32)));
    }
}
