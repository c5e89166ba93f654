//! The coordinator's one clock.

use std::time::Instant;

use femc_model::Tick;

/// Gives the scheduler its time: it goes on from where the log ended.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Clock {
    base: Tick,
    started: Instant,
}

impl Clock {
    pub(crate) fn from(base: Tick) -> Self {
        Self { base, started: Instant::now() }
    }

    pub(crate) fn now(&self) -> Tick {
        self.base.after(u64::try_from(self.started.elapsed().as_millis()).unwrap_or(u64::MAX))
    }
}
