//! The program's only clock. All other code receives its readings.

use std::time::{Duration, Instant};

/// A monotonic clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct Clock;

/// A reading of the clock.
#[derive(Clone, Copy, Debug)]
pub struct Timestamp(Instant);

impl Clock {
    /// Returns the current reading.
    pub fn now(self) -> Timestamp {
        Timestamp(Instant::now())
    }

    /// Returns the time from `start` to now.
    pub fn since(self, start: Timestamp) -> Duration {
        self.now().0.saturating_duration_since(start.0)
    }
}
