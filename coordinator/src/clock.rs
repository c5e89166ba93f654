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
    /// Where it stands.
    stopped: Option<Duration>,
}

impl Clock {
    pub(crate) fn from(base: Tick, time: Time) -> Self {
        Self { base, started: (time.0)(), time, stopped: None }
    }

    pub(crate) fn now(&self) -> Tick {
        let passed = self.stopped.unwrap_or_else(|| (self.time.0)()).saturating_sub(self.started);
        self.base.after(u64::try_from(passed.as_millis()).unwrap_or(u64::MAX))
    }

    /// Lets it stand still.
    pub(crate) fn stop(&mut self) {
        self.stopped.get_or_insert_with(|| (self.time.0)());
    }

    /// Lets it go on from where it stands.
    pub(crate) fn go_on(&mut self) {
        if let Some(stopped) = self.stopped.take() {
            self.started += (self.time.0)().saturating_sub(stopped);
        }
    }
}
