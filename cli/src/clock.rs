//! The program's only clock. All other code receives its readings.

use std::time::{Duration, Instant};

/// A monotonic clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct Clock;

/// A reading of the clock.
#[derive(Clone, Copy, Debug)]
pub struct Moment(Instant);

impl Clock {
    /// Returns the current reading.
    pub fn now(self) -> Moment {
        Moment(Instant::now())
    }

    /// Returns the time from `moment` to now.
    pub fn since(self, moment: Moment) -> Duration {
        self.now().0.saturating_duration_since(moment.0)
    }
}
