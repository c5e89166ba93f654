//! What a worker wrote down while it did a task.

use serde::{Deserialize, Serialize};

use crate::{Artifact, Epoch, TaskKey, Tick};

/// How an attempt at a task ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Attempt {
    /// With a result.
    Done,
    /// With a failure.
    Failed,
}

/// Where the text of a log is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum LogText {
    /// Here: short, and kept by the coordinator for a while.
    Inline(String),
    /// In the store, for as long as the job is known.
    Stored(Artifact),
}

impl LogText {
    /// Most bytes of a text that travels in a message.
    pub const INLINE: usize = 2 << 10;
    /// Most bytes of a text in the store.
    pub const STORED: usize = 64 << 10;
}

/// The log of one attempt, as its worker reports it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TaskLog {
    /// Outcome of the attempt.
    pub attempt: Attempt,
    /// Seconds that it took.
    pub seconds: f64,
    /// Text of the log, inline or stored.
    pub text: LogText,
}

/// The log of one attempt, as the farm keeps it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LogRecord {
    /// The task.
    pub task: TaskKey,
    /// Epoch of the lease.
    pub epoch: Epoch,
    /// Name of the worker.
    pub worker: String,
    /// When the attempt was reported.
    pub at: Tick,
    /// The log.
    pub log: TaskLog,
}
