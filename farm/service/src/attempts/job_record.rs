//! What a farm recorded of a job.

use femc_model::{AttemptRecord, Cut, JobId, JobSpec, TaskKey};
use serde::{Deserialize, Serialize};

/// A job and what the attempts at its tasks took.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct JobRecord {
    /// Its number.
    pub job: JobId,
    /// Which run of a sweep asked, in Unix milliseconds; 0 where nothing is kept. Coordinators count their time each for itself.
    pub run: u64,
    /// The variant that it renders, of a sweep.
    pub variant: Option<String>,
    /// Specification of the job, as submitted.
    pub spec: JobSpec,
    /// How its tiles are cut.
    pub cut: Cut,
    /// Each once, by task and lease.
    pub attempts: Vec<AttemptRecord>,
    /// What was written down of those that failed.
    pub failures: Vec<FailureLog>,
}

/// A failed attempt's log.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FailureLog {
    /// At this task.
    pub task: TaskKey,
    /// Name of the worker.
    pub worker: String,
    /// As it was written.
    pub text: String,
}
