//! Logs that workers write while they run a task.

use serde::{Deserialize, Serialize};

use crate::{Artifact, Epoch, TaskKey, Tick};

/// Outcome of an attempt at a task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum AttemptOutcome {
    /// The attempt gave a result.
    Done,
    /// The attempt failed.
    Failed,
}

/// Place of a log's text.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum LogText {
    /// Inline: short, and kept by the coordinator for a while.
    Inline(String),
    /// In the store, as long as the job exists.
    Stored(Artifact),
}

impl LogText {
    /// Maximum length in bytes of a text that is sent in a message.
    pub const MAX_INLINE: usize = 2 << 10;
    /// Maximum length in bytes of a text in the store.
    pub const MAX_STORED: usize = 64 << 10;
}

/// The log of one attempt, as its worker reports it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TaskLog {
    /// Outcome of the attempt.
    pub outcome: AttemptOutcome,
    /// Duration in seconds.
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
    /// Time at which the attempt was reported.
    pub reported_at: Tick,
    /// The log.
    pub log: TaskLog,
}
