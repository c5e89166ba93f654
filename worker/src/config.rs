//! What a worker needs to know, and why it may end.

use std::time::Duration;

use femc_proto::CallError;

use crate::Cache;

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
}

/// What a worker does when it is asked to stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AtStop {
    /// It gives back all that it holds, at once.
    GiveBack,
    /// It finishes the tasks that run and gives back those that wait.
    Finish,
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
        }
    }
}

/// Why a worker ended without being asked to.
#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    /// The coordinator's address is none, it refuses this worker, or it was away for too long.
    #[error(transparent)]
    Call(#[from] CallError),
    /// The render threads cannot be started.
    #[error("render threads: {0}")]
    Threads(String),
}
