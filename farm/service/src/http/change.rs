//! Requests that change the farm: controlling jobs and draining workers. Each job or worker of a request is processed separately.
//! The response lists refused ones beside successful ones, and each has its own line in the audit log.

use ::http::Response;
use femc_model::{Control, Drain, JobId, Refusal, WorkerId, WorkerSelector};
use serde::{Deserialize, Serialize};

use super::Http;
use super::error::{self, HttpError};
use super::response::{self, Body};
use crate::access::{AuditEntry, Caller, Outcome};
use crate::call::Call;

/// Action on jobs, as JSON.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ControlJson {
    jobs: Vec<u64>,
    action: Action,
    priority: Option<u8>,
    /// Frame numbers to which a retry is limited.
    frames: Option<Vec<u32>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Action {
    Pause,
    Resume,
    Cancel,
    Retry,
    Priority,
    Delete,
}

/// Action on workers, as JSON.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct DrainJson {
    workers: Vec<WorkerRef>,
    action: DrainAction,
}

/// A worker, by number or name.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum WorkerRef {
    Number(u64),
    Name(String),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum DrainAction {
    Begin,
    Undo,
}

/// Result of the actions.
#[derive(Serialize)]
struct ChangeOutcome<T, R> {
    done: Vec<T>,
    refused: Vec<R>,
}

#[derive(Serialize)]
struct RefusedJob {
    job: u64,
    code: &'static str,
    message: String,
}

#[derive(Serialize)]
struct RefusedWorker {
    worker: String,
    code: &'static str,
    message: String,
}

/// Maximum number of jobs or workers in a request.
const MAX_SELECTED: usize = 1000;

impl<S: Send + 'static> Http<S> {
    /// Controls jobs.
    pub(super) async fn control(
        &self,
        json: &[u8],
        caller: Option<&Caller>,
        audit_entry: &AuditEntry,
    ) -> Result<Response<Body>, HttpError> {
        let ControlJson { jobs, action, priority, frames } = parse(json)?;
        check_count(jobs.len(), "jobs")?;
        let control = match (action, priority, frames) {
            (Action::Pause, None, None) => Control::Pause,
            (Action::Resume, None, None) => Control::Resume,
            (Action::Cancel, None, None) => Control::Cancel,
            (Action::Delete, None, None) => Control::Delete,
            (Action::Retry, None, None) => Control::Retry,
            (Action::Retry, None, Some(frames)) => Control::RetryFrames(frames),
            (Action::Priority, Some(priority), None) if priority <= 100 => Control::Priority(priority),
            (_, _, Some(_)) => return Err(invalid("frames", "allowed only with the action `retry`")),
            (Action::Priority, _, None) => return Err(invalid("priority", "expected a whole number from 0 to 100")),
            (_, Some(_), None) => return Err(invalid("priority", "allowed only with the action `priority`")),
        };
        let mut changed = ChangeOutcome { done: Vec::new(), refused: Vec::new() };
        for job in jobs {
            let part = audit_entry.split_part();
            part.set_job(JobId(job));
            part.set_action(&format!("{control:?}"));
            let steered = self.0.farm.control_job(&self.0.store, caller, JobId(job), control.clone()).await;
            self.audit_part(&part, steered.as_ref().err());
            match steered {
                Ok(()) => changed.done.push(job),
                Err(no) => {
                    changed.refused.push(RefusedJob { job, code: error::code(&no), message: no.to_string() });
                }
            }
        }
        Ok(response::json(&changed))
    }

    /// Drains workers, or ends the drain.
    pub(super) async fn drain(&self, json: &[u8], audit_entry: &AuditEntry) -> Result<Response<Body>, HttpError> {
        let DrainJson { workers, action } = parse(json)?;
        check_count(workers.len(), "workers")?;
        let drain = match action {
            DrainAction::Begin => Drain::Begin,
            DrainAction::Undo => Drain::Undo,
        };
        let mut changed = ChangeOutcome { done: Vec::new(), refused: Vec::new() };
        for worker in workers {
            let worker = match worker {
                WorkerRef::Number(number) => WorkerSelector::Number(WorkerId(number)),
                WorkerRef::Name(name) => WorkerSelector::Name(name),
            };
            let part = audit_entry.split_part();
            part.set_action(&format!("{drain:?} {worker}"));
            let name = worker.to_string();
            let drained = self.0.farm.call(|reply| Call::Drain { worker, drain, reply }).await;
            self.audit_part(&part, drained.as_ref().err());
            match drained {
                Ok(sessions) => changed.done.extend(sessions.iter().map(|session| session.0)),
                Err(no) => changed.refused.push(RefusedWorker {
                    worker: name,
                    code: error::code(&no),
                    message: no.to_string(),
                }),
            }
        }
        Ok(response::json(&changed))
    }

    /// Writes the audit entry of one part.
    fn audit_part(&self, part: &AuditEntry, refusal: Option<&Refusal>) {
        match refusal {
            None => self.write_audit_entry(part, Outcome::Done, "ok", ""),
            Some(no) => {
                let error = HttpError::from(no.clone());
                self.write_audit_entry(part, error.outcome(), error.code(), &no.to_string());
            }
        }
    }
}

fn parse<'a, T: Deserialize<'a>>(json: &'a [u8]) -> Result<T, HttpError> {
    serde_json::from_slice(json).map_err(|error| invalid("body", &error.to_string()))
}

fn check_count(count: usize, field: &str) -> Result<(), HttpError> {
    if count <= MAX_SELECTED { Ok(()) } else { Err(invalid(field, &format!("at most {MAX_SELECTED} at a time"))) }
}

fn invalid(field: &str, message: &str) -> HttpError {
    HttpError::Invalid { field: field.into(), message: message.into() }
}
