//! What a worker needs to know, and why it may end.

use std::fmt;
use std::hash::{BuildHasher as _, RandomState};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use femc_model::Assignment;
use femc_proto::{CallError, Dial};

use crate::{Cache, Journal, MemoryLimit, MemoryOutbox, Metrics, Shift};

/// A worker's configuration.
#[derive(Debug, Clone)]
pub struct Config {
    /// The coordinator's address, such as `http://127.0.0.1:7878`.
    pub join: String,
    /// Name for people.
    pub name: String,
    /// Threads that render; 0: as many as the machine runs at once.
    pub threads: usize,
    /// What the worker offers; a job may ask for tags.
    pub tags: Vec<String>,
    /// Scenes and frames ready to render; workers of one process may share it.
    pub cache: Cache,
    /// How long to look for a coordinator that is away; `None`: forever.
    pub patience: Option<Duration>,
    /// What to do when asked to stop.
    pub at_stop: AtStop,
    /// Tells this worker from all others, and from an earlier one that had its name.
    pub instance: u64,
    /// Build of the engine, as the coordinator is told; a simulation has several.
    pub engine: String,
    /// How to reach the coordinator.
    pub dial: Dial,
    /// Threads that do the tasks, or a simulation of them.
    pub hands: Hands,
    /// Where results are kept until the coordinator has acknowledged them; `None`: in memory.
    pub outbox: Option<OutboxPlace>,
    /// Where it writes down what it computes.
    pub journal: Journal,
    /// The most memory that it may use before it gives tasks back.
    pub memory: Option<MemoryLimit>,
    /// Niceness of the threads that compute, 0 to 19; `None`: as it is.
    pub nice: Option<u8>,
    /// Hours in which the worker takes tasks.
    pub shift: Shift,
    /// It stops after so long without a task; `None`: never.
    pub idle_limit: Option<Duration>,
    /// Where it counts what it does.
    pub metrics: Metrics,
}

/// Where a worker keeps results that are not acknowledged.
#[derive(Debug, Clone)]
pub enum OutboxPlace {
    /// On disk.
    Folder(OutboxConfig),
    /// In memory, for simulations.
    Memory(MemoryOutbox),
}

/// A folder in which a worker keeps results.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OutboxConfig {
    /// A folder of its own; it is made.
    pub folder: PathBuf,
    /// Most bytes in it.
    pub limit: u64,
    /// What to do when another worker uses it.
    pub if_taken: IfTaken,
}

/// What to do when another worker uses the folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IfTaken {
    /// Do not start.
    Fail,
    /// Take the first that is free of `FOLDER-2`, `FOLDER-3` and so on.
    NextFree,
}

/// Who does a worker's tasks.
#[derive(Debug, Clone, Default)]
pub enum Hands {
    /// Threads of their own, beside the asynchronous ones.
    #[default]
    Threads,
    /// The runtime itself, in the time that [`Pace`] says: for simulations.
    Simulated(Pace),
}

/// How long a task takes in a simulation, and what becomes of it.
#[derive(Clone)]
pub struct Pace(Arc<Fates>);

type Fates = dyn Fn(&Assignment) -> (Duration, Fate) + Send + Sync;

/// What becomes of a task in a simulation.
#[derive(Clone)]
pub enum Fate {
    /// It is done.
    Done,
    /// Its code panics at the end.
    Panics,
    /// At the end it calls this, which is to end the worker's process, and does nothing more.
    Kills(Arc<dyn Fn() + Send + Sync>),
}

impl Pace {
    /// As `pace` says; every task is done.
    pub fn by(pace: impl Fn(&Assignment) -> Duration + Send + Sync + 'static) -> Self {
        Self::fated(move |assignment| (pace(assignment), Fate::Done))
    }

    /// As `fate` says.
    pub fn fated(fate: impl Fn(&Assignment) -> (Duration, Fate) + Send + Sync + 'static) -> Self {
        Self(Arc::new(fate))
    }

    pub(crate) fn of(&self, assignment: &Assignment) -> (Duration, Fate) {
        (self.0)(assignment)
    }
}

impl fmt::Debug for Pace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Pace")
    }
}

/// What a worker does when it is asked to stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AtStop {
    /// It gives back all that it holds, at once.
    GiveBack,
    /// It finishes the tasks that run and gives back those that wait, at once, and those that have not ended in time.
    Finish {
        /// In time for what stops it: the system's own patience ends, too.
        within: Duration,
    },
}

impl Config {
    /// A worker of the coordinator at `join`, with every thread of the machine and nothing special.
    pub fn new(join: impl Into<String>) -> Self {
        Self {
            join: join.into(),
            name: "worker".into(),
            threads: 0,
            tags: Vec::new(),
            cache: Cache::default(),
            patience: None,
            at_stop: AtStop::GiveBack,
            instance: RandomState::new().hash_one(std::process::id()),
            engine: crate::engine().into(),
            dial: Dial::tcp(),
            hands: Hands::Threads,
            outbox: None,
            journal: Journal::default(),
            memory: None,
            nice: None,
            shift: Shift::default(),
            idle_limit: None,
            metrics: Metrics::default(),
        }
    }
}

/// Why a worker ended without being asked to.
#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    /// The coordinator's address is none, it refuses this worker, or it was away for too long.
    #[error(transparent)]
    Call(#[from] CallError),
    /// The folder for results cannot be used.
    #[error("outbox {}: {message}", folder.display())]
    Outbox {
        /// The folder for results.
        folder: PathBuf,
        /// Error of the operating system.
        message: String,
    },
    /// The threads cannot have the niceness.
    #[error("niceness {niceness}: {message}")]
    Nice {
        /// Niceness from the configuration, 0..=19.
        niceness: u8,
        /// Error of the operating system.
        message: String,
    },
    /// The threads that compute cannot be started.
    #[error("cannot start threads: {0}; give a smaller --threads, or allow more processes (ulimit -u)")]
    Threads(String),
}
