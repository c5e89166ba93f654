//! Why a task was not done, and what follows from it: decided by variant, never by text.

use serde::{Deserialize, Serialize};

use crate::Digest;

/// Root cause of a task that was not done, as its worker saw it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum Failure {
    /// The scene cannot be read or prepared: it would fail everywhere.
    #[error("scene: {message}")]
    Scene {
        /// What the importer or the preparation said.
        message: String,
    },
    /// The settings cannot be understood.
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
    /// The worker was there, and the task made no progress for too long.
    #[error("no progress for {seconds} s")]
    Stalled {
        /// Seconds without progress.
        seconds: u64,
    },
    /// Artifacts that the task needs are not in the store, or do not decode, or do not fit the task.
    #[error("{} artifacts are lost: {message}", digests.len())]
    LostInputs {
        /// Digests of all lost artifacts.
        digests: Vec<Digest>,
        /// What is wrong with one of them.
        message: String,
    },
    /// The artifact store refused or was away.
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
    /// The worker gave the task back: it was told to, or is leaving.
    #[error("cancelled")]
    Cancelled,
    /// Workers died while they computed it.
    #[error("workers died {deaths} times while they computed it; the last was {worker}")]
    Killed {
        /// Workers that died over the task.
        deaths: u32,
        /// Name of the last one.
        worker: String,
    },
    /// The result, or an input, is larger than the artifact store takes: it would be so everywhere.
    #[error("an artifact of more than {limit} bytes, which is the most that the farm's store takes")]
    TooLarge {
        /// Bytes.
        limit: u64,
    },
}

/// What a failure means for the task.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Verdict {
    /// The task's own failure: counts as an attempt; try again elsewhere.
    Retry,
    /// Make these artifacts again first.
    Rebuild(Vec<Digest>),
    /// Every attempt would end the same: the job has failed.
    Fatal,
    /// Not the task's fault: try again, the worker rests a while.
    Infrastructure,
    /// Nobody's fault: try again.
    Cancelled,
}

impl Failure {
    /// All that [`Failure::cause`] says.
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

    /// In one word, for those who count.
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

    /// What follows; exhaustive, so that a new failure must choose.
    pub fn verdict(&self) -> Verdict {
        match self {
            Self::Scene { .. } | Self::Settings { .. } | Self::TooLarge { .. } => Verdict::Fatal,
            Self::Panicked { .. } | Self::Stalled { .. } | Self::Killed { .. } => Verdict::Retry,
            Self::LostInputs { digests, .. } => Verdict::Rebuild(digests.clone()),
            Self::Store { .. } | Self::Resources { .. } => Verdict::Infrastructure,
            Self::Cancelled => Verdict::Cancelled,
        }
    }
}
