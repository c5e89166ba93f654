//! Causes of task failures, and their consequences. The variant decides the consequence, never the text.

use serde::{Deserialize, Serialize};

use crate::Digest;

/// Root cause of a failed task, as its worker reports it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum Failure {
    /// The scene cannot be read or prepared. It would fail on every worker.
    #[error("scene: {message}")]
    Scene {
        /// Error of the importer or of the preparation.
        message: String,
    },
    /// The settings cannot be parsed.
    #[error("settings: {message}")]
    Settings {
        /// Error of the settings' parser.
        message: String,
    },
    /// The task's code panicked.
    #[error("panic: {message}")]
    Panicked {
        /// The panic's message.
        message: String,
    },
    /// The worker was alive, but the task made no progress for too long.
    #[error("no progress for {seconds} s")]
    Stalled {
        /// Seconds without progress.
        seconds: u64,
    },
    /// Artifacts that the task needs are not in the store, cannot be decoded, or do not fit the task.
    #[error("{} artifacts are lost: {message}", digests.len())]
    LostInputs {
        /// Digests of all lost artifacts.
        digests: Vec<Digest>,
        /// Fault of one of the artifacts.
        message: String,
    },
    /// The artifact store refused a request or did not respond.
    #[error("store: {message}")]
    Store {
        /// Error of the store.
        message: String,
    },
    /// The worker's disk or memory is used up.
    #[error("out of resources: {message}")]
    Resources {
        /// Resource that is used up, and the error of the system.
        message: String,
    },
    /// The worker gave the task back, either on request or because it is shutting down.
    #[error("cancelled")]
    Cancelled,
    /// Workers died while they computed the task.
    #[error("workers died {deaths} times while computing this task; the last one was {worker}")]
    Killed {
        /// Number of workers that died while they computed the task.
        deaths: u32,
        /// Name of the last worker that died.
        worker: String,
    },
    /// The result, or an input, exceeds the size limit of the artifact store. It would do so on every worker.
    #[error("an artifact exceeds {limit} bytes, the size limit of the farm's store")]
    TooLarge {
        /// Limit in bytes.
        limit: u64,
    },
}

/// Consequence of a failure for the task.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum FailureVerdict {
    /// The task itself failed. This counts as an attempt. Retry it on another worker.
    Retry,
    /// Recreate these artifacts first.
    Rebuild(Vec<Digest>),
    /// Every attempt would fail in the same way. The job has failed.
    Fatal,
    /// The task is not at fault. Retry it; the worker gets no tasks for a while.
    Infrastructure,
    /// Nothing is at fault. Retry.
    Cancelled,
}

impl Failure {
    /// All names that [`Failure::cause`] returns.
    pub const CAUSES: [&str; 10] = [
        "scene",
        "settings",
        "panicked",
        "stalled",
        "lost_inputs",
        "store",
        "resources",
        "cancelled",
        "killed",
        "too_large",
    ];

    /// Returns the cause in one word, for counters.
    pub const fn cause(&self) -> &'static str {
        match self {
            Self::Scene { .. } => "scene",
            Self::Settings { .. } => "settings",
            Self::Panicked { .. } => "panicked",
            Self::Stalled { .. } => "stalled",
            Self::LostInputs { .. } => "lost_inputs",
            Self::Store { .. } => "store",
            Self::Resources { .. } => "resources",
            Self::Cancelled => "cancelled",
            Self::Killed { .. } => "killed",
            Self::TooLarge { .. } => "too_large",
        }
    }

    /// Returns the consequence. The match is exhaustive, so every new failure must choose one.
    pub fn verdict(&self) -> FailureVerdict {
        match self {
            Self::Scene { .. } | Self::Settings { .. } | Self::TooLarge { .. } => FailureVerdict::Fatal,
            Self::Panicked { .. } | Self::Stalled { .. } | Self::Killed { .. } => FailureVerdict::Retry,
            Self::LostInputs { digests, .. } => FailureVerdict::Rebuild(digests.clone()),
            Self::Store { .. } | Self::Resources { .. } => FailureVerdict::Infrastructure,
            Self::Cancelled => FailureVerdict::Cancelled,
        }
    }
}
