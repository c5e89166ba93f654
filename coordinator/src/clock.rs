//! Clock of the coordinator.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use femc_model::Tick;
use tokio::time::Instant;

/// Source of the coordinator's time. A simulation has its own, which may go back, as the clock of a machine that was moved may.
#[derive(Clone)]
pub struct TimeSource(Arc<dyn Fn() -> Duration + Send + Sync>);

impl TimeSource {
    /// Makes a time source from `source`, which returns the time since some fixed moment.
    pub fn from_fn(source: impl Fn() -> Duration + Send + Sync + 'static) -> Self {
        Self(Arc::new(source))
    }
}

impl Default for TimeSource {
    fn default() -> Self {
        let started = Instant::now();
        Self::from_fn(move || started.elapsed())
    }
}

impl fmt::Debug for TimeSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Time")
    }
}

/// Clock of the scheduler. It resumes where the log ended and never goes back. If its source goes back, the clock continues from
/// its present value with the new readings.
#[derive(Debug)]
pub(crate) struct Clock {
    base: Tick,
    time: TimeSource,
    reading: Mutex<Reading>,
}

/// Last reading of the source, and the total elapsed time.
#[derive(Debug)]
struct Reading {
    last: Duration,
    passed: Duration,
    is_stopped: bool,
}

impl Clock {
    pub(crate) fn new(base: Tick, time: TimeSource) -> Self {
        let shown = Reading { last: (time.0)(), passed: Duration::ZERO, is_stopped: false };
        Self { base, reading: Mutex::new(shown), time }
    }

    pub(crate) fn now(&self) -> Tick {
        let passed = self.update_reading(|_| {});
        self.base.after(u64::try_from(passed.as_millis()).unwrap_or(u64::MAX))
    }

    /// Stops the clock.
    pub(crate) fn stop(&self) {
        self.update_reading(|shown| shown.is_stopped = true);
    }

    /// Resumes the clock from its present value.
    pub(crate) fn resume(&self) {
        self.update_reading(|shown| shown.is_stopped = false);
    }

    /// Returns the total elapsed time, then applies `change`.
    fn update_reading(&self, change: impl FnOnce(&mut Reading)) -> Duration {
        let time = (self.time.0)();
        // A poisoned lock is safe to use: a panic in the few lines under it leaves no partial change.
        let mut shown = self.reading.lock().unwrap_or_else(PoisonError::into_inner);
        let passed = if shown.is_stopped { Duration::ZERO } else { time.saturating_sub(shown.last) };
        shown.passed += passed;
        shown.last = time;
        change(&mut shown);
        shown.passed
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::time::SystemTime;

    use femc_queue::Memory;
    use femc_schedule::{Ledger, Roster, Scheduler};
    use femc_store::Store;
    use tokio::sync::mpsc;

    use super::*;
    use crate::Config;
    use crate::actor::Actor;

    /// The time source is tokio's clock, which is the machine's monotonic clock. Setting the date does not change it.
    #[tokio::test(start_paused = true)]
    async fn coordinator_clock_follows_elapsed_time_and_not_the_date() {
        let config = Config::default();
        let (scheduler, _) = Scheduler::new(config.scheduler.clone(), Ledger::default());
        let (_asks, watchers) = mpsc::channel(1);
        let actor =
            Actor::new(scheduler, Memory::default(), Store::in_memory(), 0, Roster::default(), watchers, &config);
        let [time, configured] = [TimeSource::default(), config.time].map(|time| Clock::new(Tick(0), time));
        let clocks = [time, configured, actor.clock];
        let show = || clocks.each_ref().map(|clock| clock.now().0);
        let date = SystemTime::now();
        // The date advances by a few ticks while tokio's clock stands still.
        while date.elapsed().is_ok_and(|passed| passed < Duration::from_millis(3)) {}
        assert_eq!(show(), [0; 3], "the date goes on, and time stands still");
        for (passes, shows) in [(1, 1), (999, 1_000), (86_400_000, 86_401_000)] {
            tokio::time::advance(Duration::from_millis(passes)).await;
            assert_eq!(show(), [shows; 3], "time goes by, and the date is the same");
        }
    }

    #[test]
    fn a_source_that_goes_back_does_not_turn_time_back_nor_hold_it() {
        let source = Arc::new(AtomicU64::new(10_000));
        let shows = source.clone();
        let clock =
            Clock::new(Tick(5), TimeSource::from_fn(move || Duration::from_millis(shows.load(Ordering::Relaxed))));
        let after = |milliseconds| {
            source.store(milliseconds, Ordering::Relaxed);
            clock.now().0
        };
        assert_eq!([11_000, 4_000, 4_500, 4_400, 14_400].map(after), [1_005, 1_005, 1_505, 1_505, 11_505]);
        clock.stop();
        assert_eq!([20_000, 21_000].map(after), [11_505, 11_505]);
        clock.resume();
        assert_eq!(after(21_500), 12_005);
    }
}
