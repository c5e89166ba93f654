//! Recorded attempts of a job.

use femc_model::{AttemptRecord, ChunkSize, JobId, JobSpec, TaskKey};
use serde::{Deserialize, Serialize};

/// A job and the attempts at its tasks.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct JobRecord {
    /// Number of the job.
    pub job: JobId,
    /// Run of a sweep that submitted the job, in Unix milliseconds; 0 if nothing is kept. Each coordinator has its own clock.
    pub run: u64,
    /// Variant that the job renders, if it belongs to a sweep.
    pub variant: Option<String>,
    /// Specification of the job, as submitted.
    pub spec: JobSpec,
    /// Division of its tasks into chunks.
    pub cut: ChunkSize,
    /// Attempts, each once, ordered by task and lease.
    pub attempts: Vec<AttemptRecord>,
    /// Logs of the failed attempts.
    pub failures: Vec<FailureLog>,
}

/// Log of a failed attempt.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FailureLog {
    /// Task of the attempt.
    pub task: TaskKey,
    /// Name of the worker.
    pub worker: String,
    /// Text of the log.
    pub text: String,
}
