//! The coordinator's one clock.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use femc_model::Tick;
use tokio::time::Instant;

/// Where the coordinator's time comes from: a source that never goes back. A simulation has its own.
#[derive(Clone)]
pub struct Time(Arc<dyn Fn() -> Duration + Send + Sync>);

impl Time {
    /// From `source`, which says how long ago some fixed moment was.
    pub fn by(source: impl Fn() -> Duration + Send + Sync + 'static) -> Self {
        Self(Arc::new(source))
    }
}

impl Default for Time {
    fn default() -> Self {
        let started = Instant::now();
        Self::by(move || started.elapsed())
    }
}

impl fmt::Debug for Time {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Time")
    }
}

/// Gives the scheduler its time: it goes on from where the log ended.
#[derive(Debug, Clone)]
pub(crate) struct Clock {
    base: Tick,
    time: Time,
    started: Duration,
}

impl Clock {
    pub(crate) fn from(base: Tick, time: Time) -> Self {
        Self { base, started: (time.0)(), time }
    }

    pub(crate) fn now(&self) -> Tick {
        let passed = (self.time.0)().saturating_sub(self.started);
        self.base.after(u64::try_from(passed.as_millis()).unwrap_or(u64::MAX))
    }
}
