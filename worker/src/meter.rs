//! Resource usage of tasks. Processor time is measured for the whole process: reading a scene, building its trees, rendering on a
//! pool, encoding, hashing and sending happen on many threads, and no thread's clock says which task it worked for.
//!
//! The meter reads the process's clock whenever a task begins or ends, or begins or ends a wait for the network. It shares the time
//! since the last reading evenly among the tasks that compute. If none computes, it shares the time among those that move bytes. If
//! none moves bytes either, it shares the time among those that wait for their turn or for a thread; their frames are being
//! prepared. The sum over all tasks is the process's time while it had any task. Its time without tasks counts as idle. Both
//! together are the process's total time. The shares of tasks that run side by side are not exact. Workers of one process share one
//! meter. If the coordinator is in the process, its time is included too.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, LazyLock, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::memory;

/// Current activity of a task, in rising order. The tasks with the highest activity share the processor time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Activity {
    /// Waiting for its turn or for a thread.
    Waiting,
    /// Downloading inputs or uploading the result.
    Transferring,
    /// Computing.
    Computing,
}

/// Account of a task's usage. Dropping it closes it: the task keeps the time charged so far.
#[derive(Debug)]
pub(crate) struct UsageAccount {
    meter: Meter,
    number: u64,
    /// Nanoseconds of processor time.
    cpu: Arc<AtomicU64>,
    pub(crate) fetched: AtomicU64,
    pub(crate) sent: AtomicU64,
    pub(crate) rays: AtomicU64,
    /// Nanoseconds from the task's beginning until its inputs were ready.
    preparation: AtomicU64,
    /// Peak memory of the process, bytes; 0: unknown.
    peak: AtomicU64,
}

impl UsageAccount {
    pub(crate) fn set_activity(&self, activity: Activity) {
        self.meter.0.lock().set_activity(self.number, activity);
    }

    /// Runs `work`, which waits for the network. The task computes before and after it.
    pub(crate) fn transfer<T>(&self, work: impl FnOnce() -> T) -> T {
        self.set_activity(Activity::Transferring);
        let done = work();
        self.set_activity(Activity::Computing);
        done
    }

    /// Records that the task begins to compute.
    pub(crate) fn begin(&self) {
        let mut state = self.meter.0.lock();
        if self.meter.0.clock.is_some() && state.computing_count() == 0 {
            memory::reset_peak();
        }
        state.set_activity(self.number, Activity::Computing);
    }

    /// Records that the task has a result or a failure.
    pub(crate) fn end(&self) {
        if self.meter.0.clock.is_some() {
            self.peak.store(memory::peak().unwrap_or(0), Ordering::Relaxed);
        }
        self.set_activity(Activity::Transferring);
    }

    pub(crate) fn set_preparation(&self, after: Duration) {
        self.preparation.store(u64::try_from(after.as_nanos()).unwrap_or(u64::MAX), Ordering::Relaxed);
    }

    /// Returns the seconds from the task's beginning until its inputs were ready.
    pub(crate) fn preparation(&self) -> f64 {
        Duration::from_nanos(self.preparation.load(Ordering::Relaxed)).as_secs_f64()
    }

    /// Returns the processor seconds until now.
    pub(crate) fn cpu(&self) -> f64 {
        self.meter.0.lock().charge_elapsed();
        Duration::from_nanos(self.cpu.load(Ordering::Relaxed)).as_secs_f64()
    }

    /// Returns the peak memory of the process in bytes while this task or one beside it computed.
    pub(crate) fn peak(&self) -> Option<u64> {
        Some(self.peak.load(Ordering::Relaxed)).filter(|peak| *peak > 0)
    }
}

impl Drop for UsageAccount {
    fn drop(&mut self) {
        let mut state = self.meter.0.lock();
        state.charge_elapsed();
        state.accounts.remove(&self.number);
    }
}

/// Meter that reads processor time and shares it among tasks. Clones share it.
#[derive(Debug, Clone)]
pub(crate) struct Meter(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    clock: Option<fn() -> Duration>,
    state: Mutex<MeterState>,
}

#[derive(Debug, Default)]
struct MeterState {
    clock: Option<fn() -> Duration>,
    last_reading: Duration,
    numbers: u64,
    /// Processor time while no account was open.
    idle: Duration,
    accounts: BTreeMap<u64, (Activity, Arc<AtomicU64>)>,
}

impl Meter {
    /// Returns the meter of this process.
    pub(crate) fn for_process() -> Self {
        static METER: LazyLock<Meter> = LazyLock::new(|| Meter::with_clock(Some(process_time)));
        METER.clone()
    }

    /// Creates a meter without processor time, so that a simulation gives the same result every time.
    pub(crate) fn without_clock() -> Self {
        Self::with_clock(None)
    }

    fn with_clock(clock: Option<fn() -> Duration>) -> Self {
        Self(Arc::new(Shared { clock, state: Mutex::new(MeterState { clock, ..MeterState::default() }) }))
    }

    /// Returns the processor time so far during which the process had no task. It includes the start of the process.
    pub(crate) fn idle(&self) -> Duration {
        let mut state = self.0.lock();
        state.charge_elapsed();
        state.idle
    }

    /// Opens the account of a task that waits for its turn.
    pub(crate) fn open_account(&self) -> UsageAccount {
        let cpu = Arc::new(AtomicU64::new(0));
        let mut state = self.0.lock();
        state.numbers += 1;
        let number = state.numbers;
        state.charge_elapsed();
        state.accounts.insert(number, (Activity::Waiting, cpu.clone()));
        let [fetched, sent, rays, preparation, peak] = [const { AtomicU64::new(0) }; 5];
        UsageAccount { meter: self.clone(), number, cpu, fetched, sent, rays, preparation, peak }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, MeterState> {
        // A panic within the few lines under this lock leaves the state consistent.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl MeterState {
    fn computing_count(&self) -> usize {
        self.accounts.values().filter(|(doing, _)| *doing == Activity::Computing).count()
    }

    fn set_activity(&mut self, number: u64, activity: Activity) {
        self.charge_elapsed();
        if let Some((known, _)) = self.accounts.get_mut(&number) {
            *known = activity;
        }
    }

    /// Shares out the time since the last reading.
    fn charge_elapsed(&mut self) {
        let Some(clock) = self.clock else { return };
        let now = clock();
        let passed = now.saturating_sub(self.last_reading);
        self.last_reading = now;
        let Some(most) = self.accounts.values().map(|(doing, _)| *doing).max() else {
            self.idle += passed;
            return;
        };
        let passed = passed.as_nanos() as u64;
        let shares: Vec<_> = self.accounts.values().filter(|(doing, _)| *doing == most).collect();
        let (share, rest) = (passed / shares.len() as u64, passed % shares.len() as u64);
        for (place, (_, cpu)) in shares.into_iter().enumerate() {
            cpu.fetch_add(share + u64::from((place as u64) < rest), Ordering::Relaxed);
        }
    }
}

/// Returns the processor time of all threads of this process since it began.
#[cfg(unix)]
pub fn process_time() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Duration::new(time.tv_sec.try_into().unwrap_or(0), time.tv_nsec.try_into().unwrap_or(0))
}

/// Returns zero: this system does not report processor time.
#[cfg(not(unix))]
pub fn process_time() -> Duration {
    Duration::ZERO
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    thread_local! {
        static TIME: Cell<u64> = const { Cell::new(0) };
    }

    fn passes(seconds: u64) {
        TIME.set(TIME.get() + seconds);
    }

    fn meter() -> Meter {
        Meter::with_clock(Some(|| Duration::from_secs(TIME.get())))
    }

    #[test]
    fn time_goes_to_computing_else_moving_else_waiting_tasks() {
        let meter = meter();
        passes(100);
        let (one, two, three) = (meter.open_account(), meter.open_account(), meter.open_account());
        passes(3);
        one.set_activity(Activity::Transferring);
        passes(4);
        two.set_activity(Activity::Computing);
        passes(10);
        three.set_activity(Activity::Computing);
        passes(10);
        assert_eq!([one.cpu(), two.cpu(), three.cpu()], [5.0, 16.0, 6.0], "before there was any task, nobody's");
    }

    #[test]
    fn the_sum_is_what_passed_and_what_is_closed_gets_no_more() {
        let meter = meter();
        let (one, two) = (meter.open_account(), meter.open_account());
        one.set_activity(Activity::Computing);
        two.set_activity(Activity::Computing);
        passes(7);
        let first = one.cpu();
        one.transfer(|| passes(2));
        drop(one);
        passes(5);
        assert_eq!((first, two.cpu()), (3.5, 10.5));
    }

    #[test]
    fn tasks_and_idleness_together_are_the_process_s_time() {
        let meter = meter();
        passes(5);
        let one = meter.open_account();
        passes(3);
        assert_eq!((one.cpu(), meter.idle()), (3.0, Duration::from_secs(5)));
        passes(2);
        drop(one);
        passes(7);
        let two = meter.open_account();
        passes(1);
        assert_eq!((two.cpu(), meter.idle()), (1.0, Duration::from_secs(5 + 7)), "of 18 s, a closed account has 5");
    }

    #[test]
    fn a_simulation_takes_no_processor_time() {
        let account = Meter::without_clock().open_account();
        account.begin();
        account.end();
        assert_eq!((account.cpu(), account.peak()), (0.0, None));
    }

    #[test]
    fn this_process_uses_its_processor() {
        if cfg!(unix) {
            let before = process_time();
            let sum: u64 = (0..20_000_000_u64).map(std::hint::black_box).sum();
            assert!(sum > 0 && process_time() > before);
        }
    }
}
