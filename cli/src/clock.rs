//! The program's one clock: everything else is given its readings.

use std::time::{Duration, Instant};

/// A monotonic clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct Clock;

/// A reading of the clock.
#[derive(Clone, Copy, Debug)]
pub struct Moment(Instant);

impl Clock {
    /// Now.
    pub fn now(self) -> Moment {
        Moment(Instant::now())
    }

    /// Time from `moment` to now.
    pub fn since(self, moment: Moment) -> Duration {
        self.now().0.saturating_duration_since(moment.0)
    }
}
