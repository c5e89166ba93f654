//! What a farm recorded of a job, which a sweep keeps in its folder.

use crate::exit::{Failure, failed};
use femc_model::{AttemptRecord, Cut, JobId, JobSpec, TaskKey};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::Path;

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

impl JobRecord {
    /// As `path`, whole or not at all.
    pub fn write(&self, path: &Path) -> Result<(), Failure> {
        let text = serde_json::to_vec(self).map_err(failed)?;
        femc_film::file::write_atomic(path, &text).map_err(failed)
    }

    /// All that were written into `folder`, the earliest run first.
    pub fn read_all(folder: &Path) -> Result<Vec<Self>, Failure> {
        let at = |path: &Path, error: &dyn std::fmt::Display| failed(format!("{}: {error}", path.display()));
        let entries = fs::read_dir(folder).map_err(|e| at(folder, &e))?;
        let mut all = Vec::new();
        for entry in entries {
            let path = entry.map_err(|e| at(folder, &e))?.path();
            if path.extension().is_some_and(|extension| extension == "json") {
                let text = fs::read(&path).map_err(|e| at(&path, &e))?;
                all.push(serde_json::from_slice::<Self>(&text).map_err(|e| at(&path, &e))?);
            }
        }
        all.sort_by_key(|record| (record.run, record.job));
        Ok(all)
    }
}
