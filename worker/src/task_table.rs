//! Table of the tasks that the worker holds, and the queue of the waiting ones.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};

use femc_model::{
    Assignment, Digest, Epoch, Failure, HeldLease, JobSpec, Lane, LogDestination, Phase, ResourceUsage, Role,
    StageKind, StageKindProperties, TaskKey, TaskProgress,
};
use femc_proto::Client;
use tokio::sync::Notify;
use tokio::time::Instant;

use crate::cache::{FrameInputs, TargetSource};
use crate::clock::Stopwatch;
use crate::execute::Product;
use crate::log::TaskLog;
use crate::meter::{Meter, UsageAccount};
use crate::outbox::RestoredResult;

/// A task under a lease.
#[derive(Debug)]
pub(crate) struct Task {
    pub(crate) assignment: Assignment,
    pub(crate) spec: Arc<JobSpec>,
    pub(crate) client: Client,
    /// Set when the lease is over.
    pub(crate) cancel: AtomicBool,
    /// Units of work done, such as pixel samples. A task that joins outputs counts its inputs read.
    pub(crate) units: AtomicU64,
    phase: AtomicU8,
    /// Outcome of the task, kept until the coordinator has answered, because a session may end in between.
    outcome: OnceLock<Outcome>,
    /// Log of the running task.
    pub(crate) log: TaskLog,
    /// Usage so far: processor time, bytes moved, rays.
    pub(crate) account: UsageAccount,
    arrived: Stopwatch,
    /// Seconds that the task waited for its turn.
    wait_seconds: OnceLock<f64>,
    /// Duration of the task in seconds, and the log's text.
    final_log: OnceLock<(f64, String)>,
    /// Usage before the worker's restart, for a task that was done then.
    usage_before_restart: Option<ResourceUsage>,
}

/// Outcome of a task.
pub(crate) type Outcome = Result<Product, Failure>;

impl Task {
    pub(crate) fn new(assignment: Assignment, spec: Arc<JobSpec>, client: Client, meter: &Meter) -> Self {
        let (cancel, units, phase) = (AtomicBool::new(false), AtomicU64::new(0), AtomicU8::new(0));
        let (outcome, log, written) = (OnceLock::new(), TaskLog::default(), OnceLock::new());
        let (account, arrived, waited) = (meter.open_account(), Stopwatch::start(), OnceLock::new());
        let earlier = None;
        Self {
            assignment,
            spec,
            client,
            cancel,
            units,
            phase,
            outcome,
            log,
            final_log: written,
            account,
            arrived,
            wait_seconds: waited,
            usage_before_restart: earlier,
        }
    }

    /// Creates a task that this worker finished before its restart.
    pub(crate) fn from_restored(restored: RestoredResult, client: Client, meter: &Meter) -> Self {
        let RestoredResult { assignment, spec, product, usage, log } = restored;
        let task = Self { usage_before_restart: usage, ..Self::new(assignment, Arc::new(spec), client, meter) };
        if let Some((seconds, text)) = log {
            task.set_final_log(seconds, text);
        }
        task.set_outcome(Ok(product));
        task
    }

    /// Returns the lease as a later session registers it.
    pub(crate) fn lease(&self) -> HeldLease {
        self.lease_with_key(self.spec.key())
    }

    /// Returns the lease like [`Self::lease`], for a job whose key is known.
    pub(crate) fn lease_with_key(&self, job: Digest) -> HeldLease {
        let (task, epoch) = self.key();
        HeldLease { task, epoch, steps: self.assignment.spec.steps.clone(), job }
    }

    /// Returns the farm's properties of this task kind.
    pub(crate) fn properties(&self) -> StageKindProperties {
        self.assignment.task.stage.kind.properties()
    }

    /// Returns the outputs of other tasks that the task's frame depends on.
    pub(crate) fn frame_inputs(&self) -> FrameInputs {
        let artifact = |role| self.assignment.spec.inputs_of_role(role).next().map(|input| input.output.artifact);
        let targets = match self.assignment.task.stage.kind {
            StageKind::Render => artifact(Role::Targets).map_or(TargetSource::Frame, TargetSource::Stored),
            _ => TargetSource::None,
        };
        FrameInputs { light: artifact(Role::Field), targets }
    }

    /// Returns the place for the log of an attempt with this outcome.
    pub(crate) fn log_destination(&self, outcome: Option<&Outcome>) -> LogDestination {
        match outcome {
            Some(Ok(_)) => self.properties().log,
            Some(Err(_)) | None => LogDestination::Store,
        }
    }

    /// Records that the task's turn has come. Further calls change nothing.
    pub(crate) fn begin(&self) {
        if self.wait_seconds.set(self.arrived.seconds()).is_ok() {
            self.log.begin();
            self.account.begin();
        }
    }

    /// Returns the number of pixel samples taken.
    fn samples_taken(&self) -> u64 {
        if self.properties().is_divided { self.units.load(Ordering::Relaxed) } else { 0 }
    }

    /// Checks that the task's turn has come.
    pub(crate) fn is_begun(&self) -> bool {
        self.wait_seconds.get().is_some()
    }

    /// Returns the usage so far; `None` if the task has not begun.
    pub(crate) fn usage(&self) -> Option<ResourceUsage> {
        if let Some(earlier) = self.usage_before_restart {
            let sent = earlier.sent + self.account.sent.load(Ordering::Relaxed);
            return Some(ResourceUsage { cpu: earlier.cpu + self.account.cpu(), sent, ..earlier });
        }
        let wait = *self.wait_seconds.get()?;
        let until_now = || self.log.seconds().unwrap_or(0.0);
        Some(ResourceUsage {
            wait,
            wall: self.final_log.get().map_or_else(until_now, |(seconds, _)| *seconds),
            preparation: self.account.preparation(),
            cpu: self.account.cpu(),
            peak: self.account.peak(),
            samples: self.samples_taken(),
            rays: self.account.rays.load(Ordering::Relaxed),
            fetched: self.account.fetched.load(Ordering::Relaxed),
            sent: self.account.sent.load(Ordering::Relaxed),
        })
    }

    /// Stores the outcome unless there is one already.
    pub(crate) fn set_outcome(&self, outcome: Outcome) {
        let _ = self.outcome.set(outcome);
    }

    /// Stores the log as it will be reported.
    pub(crate) fn set_final_log(&self, seconds: f64, text: String) {
        let _ = self.final_log.set((seconds, text));
    }

    /// Returns the duration of the task in seconds, and the log's text.
    pub(crate) fn final_log(&self) -> Option<&(f64, String)> {
        self.final_log.get()
    }

    pub(crate) fn outcome(&self) -> Option<&Outcome> {
        self.outcome.get()
    }

    /// Returns the size of the task's result in bytes, if it has one.
    pub(crate) fn result_bytes(&self) -> Option<u64> {
        let product = self.outcome()?.as_ref().ok()?;
        Some(product.artifacts.iter().map(|bytes| bytes.len() as u64).sum())
    }

    pub(crate) fn key(&self) -> (TaskKey, Epoch) {
        (self.assignment.task, self.assignment.epoch)
    }

    pub(crate) fn set_phase(&self, phase: Phase) {
        self.phase.store(phase as u8, Ordering::Relaxed);
    }

    pub(crate) fn is_cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }

    pub(crate) fn progress(&self) -> TaskProgress {
        let phase = match self.phase.load(Ordering::Relaxed) {
            0 => Phase::Waiting,
            1 => Phase::Preparing,
            2 => Phase::Working,
            _ => Phase::Uploading,
        };
        let (task, epoch) = self.key();
        TaskProgress { task, epoch, phase, units: self.units.load(Ordering::Relaxed) }
    }
}

#[derive(Debug, Default)]
struct State {
    held: BTreeMap<(TaskKey, Epoch), Arc<Task>>,
    /// Waiting tasks, oldest first.
    waiting: Vec<Arc<Task>>,
    closed: bool,
    /// Time when the table was first found empty; `None` while it holds tasks.
    idle: Option<Instant>,
}

impl State {
    /// Takes the oldest waiting task of this lane out of the queue.
    fn take_first_waiting(&mut self, lane: Lane) -> Option<Arc<Task>> {
        let place = self.waiting.iter().position(|task| task.properties().lane == lane)?;
        Some(self.waiting.remove(place))
    }
}

/// The tasks that the worker holds. The session and the threads share the table.
#[derive(Debug, Default)]
pub(crate) struct TaskTable {
    state: Mutex<State>,
    arrived: Condvar,
    /// Counterpart of `arrived` for asynchronous waiters.
    changed: Notify,
}

impl TaskTable {
    fn lock(&self) -> MutexGuard<'_, State> {
        // A panic within the few lines under this lock leaves the state consistent.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn put(&self, task: Arc<Task>) {
        let mut state = self.lock();
        state.idle = None;
        state.held.insert(task.key(), task.clone());
        state.waiting.push(task);
        self.arrived.notify_all();
        self.changed.notify_waiters();
    }

    /// Adds a finished task.
    pub(crate) fn insert_finished(&self, task: Arc<Task>) {
        let mut state = self.lock();
        state.idle = None;
        state.held.insert(task.key(), task);
    }

    /// Takes the oldest waiting task of this lane, and blocks until there is one. Returns `None` when the table is closed.
    pub(crate) fn take(&self, lane: Lane) -> Option<Arc<Task>> {
        let mut state = self.lock();
        loop {
            if state.closed {
                return None;
            }
            if let Some(task) = state.take_first_waiting(lane) {
                return Some(task);
            }
            state = self.arrived.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Takes a task like [`Self::take`], but asynchronously.
    pub(crate) async fn take_async(&self, lane: Lane) -> Option<Arc<Task>> {
        loop {
            let changed = self.changed.notified();
            {
                let mut state = self.lock();
                if state.closed {
                    return None;
                }
                if let Some(task) = state.take_first_waiting(lane) {
                    return Some(task);
                }
            }
            changed.await;
        }
    }

    /// Returns the task if the worker still holds its lease.
    pub(crate) fn get(&self, key: &(TaskKey, Epoch)) -> Option<Arc<Task>> {
        self.lock().held.get(key).cloned()
    }

    /// Removes a task that is reported or whose lease is over. Stops it if it runs, and takes it out of the queue if it waits.
    pub(crate) fn remove(&self, key: &(TaskKey, Epoch)) -> Option<Arc<Task>> {
        let mut state = self.lock();
        let task = state.held.remove(key);
        task.iter().for_each(|task| task.cancel.store(true, Ordering::Relaxed));
        state.waiting.retain(|task| task.key() != *key);
        task
    }

    /// Removes the waiting tasks and returns them.
    pub(crate) fn take_waiting(&self) -> Vec<Arc<Task>> {
        let mut state = self.lock();
        let waiting = std::mem::take(&mut state.waiting);
        waiting.iter().for_each(|task| drop(state.held.remove(&task.key())));
        waiting
    }

    /// Returns the time since which the worker has held no task; `None` if it holds one.
    pub(crate) fn idle_since(&self) -> Option<Instant> {
        let mut state = self.lock();
        if state.held.is_empty() { Some(*state.idle.get_or_insert_with(Instant::now)) } else { None }
    }

    /// Returns all tasks that the worker holds, in order of key.
    pub(crate) fn held(&self) -> Vec<Arc<Task>> {
        self.lock().held.values().cloned().collect()
    }

    /// Checks that the worker holds no task.
    pub(crate) fn is_empty(&self) -> bool {
        self.lock().held.is_empty()
    }

    /// Stops and removes all tasks and returns them.
    pub(crate) fn clear(&self) -> Vec<Arc<Task>> {
        let mut state = self.lock();
        state.waiting.clear();
        let held = std::mem::take(&mut state.held);
        held.values().for_each(|task| task.cancel.store(true, Ordering::Relaxed));
        held.into_values().collect()
    }

    /// Ends the threads that wait for tasks.
    pub(crate) fn close(&self) {
        self.clear();
        self.lock().closed = true;
        self.arrived.notify_all();
        self.changed.notify_waiters();
    }
}
