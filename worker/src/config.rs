//! A worker's configuration, and the errors that can end a worker.

use std::fmt;
use std::hash::{BuildHasher as _, RandomState};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use femc_model::Assignment;
use femc_proto::{CallError, Dialer};

use crate::{Cache, Journal, MemoryLimit, MemoryOutbox, Metrics, WorkingHours};

/// A worker's configuration.
#[derive(Debug, Clone)]
pub struct Config {
    /// The coordinator's address, such as `http://127.0.0.1:7878`.
    pub coordinator: String,
    /// Name shown to people.
    pub name: String,
    /// Number of render threads; 0: as many as the machine runs at once.
    pub threads: usize,
    /// Tags that the worker offers. A job may require tags.
    pub tags: Vec<String>,
    /// Cache of scenes and prepared frames. Workers of one process may share it.
    pub cache: Cache,
    /// Time limit for reconnecting to a coordinator that is away; `None`: no limit.
    pub reconnect_limit: Option<Duration>,
    /// Behavior when the worker is asked to stop.
    pub stop_behavior: StopBehavior,
    /// Number that identifies this run of the worker. It differs from that of all other workers, also from an earlier one with the
    /// same name.
    pub instance: u64,
    /// Engine build that the worker reports to the coordinator. A simulation uses several.
    pub engine: String,
    /// Way to connect to the coordinator.
    pub dial: Dialer,
    /// Threads that execute the tasks, or a simulation of them.
    pub executor: Executor,
    /// Storage for results until the coordinator acknowledges them; `None`: in memory.
    pub outbox: Option<OutboxStorage>,
    /// Record of the tasks being computed.
    pub journal: Journal,
    /// Memory limit above which the worker gives tasks back.
    pub memory: Option<MemoryLimit>,
    /// Niceness of the threads that compute, 0 to 19; `None`: unchanged.
    pub niceness: Option<u8>,
    /// Hours in which the worker takes tasks.
    pub working_hours: WorkingHours,
    /// Longest time without a task before the worker stops; `None`: no limit.
    pub idle_limit: Option<Duration>,
    /// Counters of the worker.
    pub metrics: Metrics,
}

/// Storage for results that are not acknowledged yet.
#[derive(Debug, Clone)]
pub enum OutboxStorage {
    /// On disk.
    Folder(OutboxConfig),
    /// In memory, for simulations.
    Memory(MemoryOutbox),
}

/// A folder in which a worker keeps results.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OutboxConfig {
    /// Folder for this worker alone; created if missing.
    pub folder: PathBuf,
    /// Largest total size of the files, bytes.
    pub limit: u64,
    /// Behavior when another worker uses the folder.
    pub on_conflict: OutboxConflict,
}

/// Behavior when another worker uses the outbox folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutboxConflict {
    /// The worker does not start.
    Fail,
    /// The worker takes the first free folder of `FOLDER-2`, `FOLDER-3` and so on.
    NextFree,
}

/// Executor of a worker's tasks.
#[derive(Debug, Clone, Default)]
pub enum Executor {
    /// Dedicated threads, separate from those of the asynchronous runtime.
    #[default]
    Threads,
    /// The runtime itself, with task durations from [`TaskSimulation`], for simulations.
    Simulated(TaskSimulation),
}

/// Durations and outcomes of tasks in a simulation.
#[derive(Clone)]
pub struct TaskSimulation(Arc<SimulateFn>);

type SimulateFn = dyn Fn(&Assignment) -> (Duration, SimulatedOutcome) + Send + Sync;

/// Outcome of a task in a simulation.
#[derive(Clone)]
pub enum SimulatedOutcome {
    /// The task succeeds.
    Done,
    /// The task's code panics at the end.
    Panic,
    /// At the end, the task calls this function, which must end the worker's process, and does nothing more.
    KillProcess(Arc<dyn Fn() + Send + Sync>),
}

impl TaskSimulation {
    /// Creates a pace with durations from `duration`. Every task succeeds.
    pub fn from_durations(duration: impl Fn(&Assignment) -> Duration + Send + Sync + 'static) -> Self {
        Self::from_outcomes(move |assignment| (duration(assignment), SimulatedOutcome::Done))
    }

    /// Creates a pace with durations and outcomes from `outcome`.
    pub fn from_outcomes(
        outcome: impl Fn(&Assignment) -> (Duration, SimulatedOutcome) + Send + Sync + 'static,
    ) -> Self {
        Self(Arc::new(outcome))
    }

    pub(crate) fn simulate(&self, assignment: &Assignment) -> (Duration, SimulatedOutcome) {
        (self.0)(assignment)
    }
}

impl fmt::Debug for TaskSimulation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Pace")
    }
}

/// Behavior of a worker that is asked to stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopBehavior {
    /// Gives back all tasks at once.
    GiveBack,
    /// Finishes the running tasks. Gives waiting tasks back at once, and running tasks when the time is over.
    Finish {
        /// Time limit for the running tasks. It must be shorter than the time after which the system kills the process.
        within: Duration,
    },
}

impl Config {
    /// Creates the default configuration of a worker for the coordinator at `coordinator`: it uses every thread of the machine.
    pub fn new(coordinator: impl Into<String>) -> Self {
        Self {
            coordinator: coordinator.into(),
            name: "worker".into(),
            threads: 0,
            tags: Vec::new(),
            cache: Cache::default(),
            reconnect_limit: None,
            stop_behavior: StopBehavior::GiveBack,
            instance: RandomState::new().hash_one(std::process::id()),
            engine: crate::engine().into(),
            dial: Dialer::tcp(),
            executor: Executor::Threads,
            outbox: None,
            journal: Journal::default(),
            memory: None,
            niceness: None,
            working_hours: WorkingHours::default(),
            idle_limit: None,
            metrics: Metrics::default(),
        }
    }
}

/// Error that ends a worker which was not asked to stop.
#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    /// The coordinator's address is invalid, the coordinator refuses this worker, or it was away for too long.
    #[error(transparent)]
    Call(#[from] CallError),
    /// The outbox folder cannot be used.
    #[error("outbox {}: {message}", folder.display())]
    Outbox {
        /// Outbox folder.
        folder: PathBuf,
        /// Error of the operating system.
        message: String,
    },
    /// The niceness cannot be set for the threads.
    #[error("niceness {niceness}: {message}")]
    Nice {
        /// Niceness from the configuration, 0..=19.
        niceness: u8,
        /// Error of the operating system.
        message: String,
    },
    /// The compute threads cannot be started.
    #[error("cannot start threads: {0}; give a smaller --threads, or allow more processes (ulimit -u)")]
    Threads(String),
}
