//! Subjects of `femc stats` and `femc report`: jobs of a farm, or the folder of a sweep. The folder contains the records of the
//! sweep's jobs.

use super::client::{self, FarmClient};
use crate::args::ServerArgs;
use crate::exit::{Failure, usage};
use femc_model::{AttemptOutcome, JobId, LogText, Tick};
use femc_reports::attempts::{FailureLog, JobRecord, read_all};
use std::convert::Infallible;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Largest number of failures per job whose logs are fetched.
const MAX_FAILURE_LOGS: usize = 50;
/// Subfolder of a sweep's folder with one record file per job.
const RECORDS_FOLDER: &str = "jobs";

/// Subject of a report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Subject {
    /// A job of the farm, or the shared job.
    Job(JobId),
    /// Folder of a sweep.
    Sweep(PathBuf),
}

impl FromStr for Subject {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(text.parse().map_or_else(|_| Self::Sweep(text.into()), Self::Job))
    }
}

/// Failure logs that are fetched in addition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IncludedLogs {
    /// No logs.
    None,
    /// Logs of the first failures of each job.
    Failures,
}

/// Returns the records of all subjects. Folders need no farm.
pub fn records(subjects: &[Subject], logs: IncludedLogs, server: &ServerArgs) -> Result<Vec<JobRecord>, Failure> {
    let mut records = Vec::new();
    let mut jobs = Vec::new();
    for subject in subjects {
        match subject {
            Subject::Job(job) => jobs.push(*job),
            Subject::Sweep(folder) => records.extend(read_records(folder)?),
        }
    }
    if jobs.is_empty() {
        return Ok(records);
    }
    client::block_on(server, async |farm| {
        for job in jobs {
            records.push(fetch_record(farm, job, logs).await?);
        }
        Ok(records)
    })
}

fn read_records(folder: &Path) -> Result<Vec<JobRecord>, Failure> {
    let jobs = folder.join(RECORDS_FOLDER);
    if !jobs.is_dir() {
        let folder = folder.display();
        return Err(usage(format!("{folder}: neither a job's number nor the folder of a sweep whose jobs have ended")));
    }
    Ok(read_all(&jobs)?)
}

/// Returns the record file of a ticket's job within a sweep's folder.
pub fn record_file(ticket: &str) -> String {
    let digest = femc_model::Digest::compute(ticket.as_bytes()).to_string();
    format!("{RECORDS_FOLDER}/{}.json", &digest[..16])
}

/// Fetches the record of a job's attempts from the farm.
pub async fn fetch_record(farm: &FarmClient, job: JobId, logs: IncludedLogs) -> Result<JobRecord, Failure> {
    let (shape, attempts) = farm.attempts(job).await?;
    let failures = match logs {
        IncludedLogs::None => Vec::new(),
        IncludedLogs::Failures => failures(farm, job).await?,
    };
    let attempts = attempts.iter().cloned().collect();
    Ok(JobRecord { job, run: 0, variant: None, spec: *shape.spec, cut: shape.chunk_size, attempts, failures })
}

async fn failures(farm: &FarmClient, job: JobId) -> Result<Vec<FailureLog>, Failure> {
    let logs = farm.logs(job, Tick(0)).await?.into_iter();
    let mut failures = Vec::new();
    for record in logs.filter(|record| record.log.outcome == AttemptOutcome::Failed).take(MAX_FAILURE_LOGS) {
        let text = match &record.log.text {
            LogText::Inline(text) => text.clone(),
            LogText::Stored(artifact) => match farm.get(artifact).await {
                Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
                Err(failure) => format!("the log cannot be read: {failure}\n"),
            },
        };
        failures.push(FailureLog { task: record.task, worker: record.worker, text });
    }
    Ok(failures)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_a_job_and_anything_else_a_folder() {
        assert_eq!("7".parse(), Ok(Subject::Job(JobId(7))));
        assert_eq!("./7".parse(), Ok(Subject::Sweep("./7".into())));
        assert_eq!("fog".parse(), Ok(Subject::Sweep("fog".into())));
    }
}
