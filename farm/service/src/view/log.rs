//! JSON of the log of an attempt.

use femc_model::{AttemptOutcome, LogRecord};
use serde::Serialize;

/// A log as JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LogJson {
    task: String,
    epoch: u64,
    worker: String,
    attempt: &'static str,
    seconds: f64,
    text: String,
}

impl LogJson {
    /// Makes the JSON from a record and the text of its log.
    pub fn new(record: &LogRecord, text: String) -> Self {
        Self {
            task: record.task.to_string(),
            epoch: record.epoch.0,
            worker: record.worker.clone(),
            attempt: match record.log.outcome {
                AttemptOutcome::Done => "done",
                AttemptOutcome::Failed => "failed",
            },
            seconds: record.log.seconds,
            text,
        }
    }
}
