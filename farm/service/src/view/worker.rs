//! JSON of workers.

use femc_model::{Intake, OfflineWorker, WorkerStatus};
use serde::Serialize;

/// A worker as JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorkerJson {
    worker: u64,
    name: String,
    threads: u32,
    tags: Vec<String>,
    tasks: Vec<String>,
    silent_seconds: f64,
    completed: u64,
    failed: u64,
    intake: &'static str,
    engine: String,
}

impl From<&WorkerStatus> for WorkerJson {
    fn from(worker: &WorkerStatus) -> Self {
        Self {
            worker: worker.worker.0,
            name: worker.name.clone(),
            threads: worker.threads,
            tags: worker.tags.clone(),
            tasks: worker.tasks.iter().map(ToString::to_string).collect(),
            silent_seconds: worker.silent as f64 / 1000.0,
            completed: worker.completed,
            failed: worker.failed,
            intake: intake_name(worker.intake),
            engine: worker.engine.clone(),
        }
    }
}

impl WorkerJson {
    /// Replaces the time of silence with a transformed one.
    pub fn map_silence(self, measure: impl FnOnce(f64) -> f64) -> Self {
        Self { silent_seconds: measure(self.silent_seconds), ..self }
    }
}

/// A disconnected worker as JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OfflineJson {
    name: String,
    threads: u32,
    tags: Vec<String>,
    engine: String,
    intake: &'static str,
    last_contact: f64,
}

impl OfflineJson {
    /// Word shown in place of the intake of a disconnected worker.
    pub const OFFLINE: &str = "offline";
}

impl From<&OfflineWorker> for OfflineJson {
    fn from(worker: &OfflineWorker) -> Self {
        let OfflineWorker { name, threads, tags, engine, last_contact: heard } = worker.clone();
        Self { name, threads, tags, engine, intake: Self::OFFLINE, last_contact: heard as f64 / 1000.0 }
    }
}

/// Returns in one word whether a worker gets more tasks.
pub fn intake_name(intake: Intake) -> &'static str {
    match intake {
        Intake::Open => "open",
        Intake::Off => "off",
        Intake::Drained => "draining",
    }
}
