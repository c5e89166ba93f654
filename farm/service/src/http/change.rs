//! Requests that change the farm: controlling jobs and draining workers. Each job or worker of a request is processed separately.
//! The response lists refused ones beside successful ones, and each has its own line in the audit log.

use ::http::Response;
use femc_model::{Control, Drain, JobId, Refusal, WorkerId, WorkerName};
use serde::{Deserialize, Serialize};

use super::Http;
use super::answer::{self, Body};
use super::fault::{self, Fault};
use crate::access::{Caller, Outcome, Trail};
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
struct Changed<T, R> {
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
const MOST: usize = 1000;

impl<S: Send + 'static> Http<S> {
    /// Controls jobs.
    pub(super) async fn control(
        &self,
        json: &[u8],
        caller: Option<&Caller>,
        trail: &Trail,
    ) -> Result<Response<Body>, Fault> {
        let ControlJson { jobs, action, priority, frames } = parse(json)?;
        few(jobs.len(), "jobs")?;
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
        let mut changed = Changed { done: Vec::new(), refused: Vec::new() };
        for job in jobs {
            let part = trail.part();
            part.job(JobId(job));
            part.what(&format!("{control:?}"));
            let steered = self.0.farm.steer(&self.0.store, caller, JobId(job), control.clone()).await;
            self.told(&part, steered.as_ref().err());
            match steered {
                Ok(()) => changed.done.push(job),
                Err(no) => {
                    changed.refused.push(RefusedJob { job, code: fault::code(&no), message: no.to_string() });
                }
            }
        }
        Ok(answer::json(&changed))
    }

    /// Drains workers, or ends the drain.
    pub(super) async fn drain(&self, json: &[u8], trail: &Trail) -> Result<Response<Body>, Fault> {
        let DrainJson { workers, action } = parse(json)?;
        few(workers.len(), "workers")?;
        let drain = match action {
            DrainAction::Begin => Drain::Begin,
            DrainAction::Undo => Drain::Undo,
        };
        let mut changed = Changed { done: Vec::new(), refused: Vec::new() };
        for worker in workers {
            let worker = match worker {
                WorkerRef::Number(number) => WorkerName::Number(WorkerId(number)),
                WorkerRef::Name(name) => WorkerName::Name(name),
            };
            let part = trail.part();
            part.what(&format!("{drain:?} {worker}"));
            let name = worker.to_string();
            let drained = self.0.farm.ask(|reply| Call::Drain { worker, drain, reply }).await;
            self.told(&part, drained.as_ref().err());
            match drained {
                Ok(sessions) => changed.done.extend(sessions.iter().map(|session| session.0)),
                Err(no) => changed.refused.push(RefusedWorker {
                    worker: name,
                    code: fault::code(&no),
                    message: no.to_string(),
                }),
            }
        }
        Ok(answer::json(&changed))
    }

    /// Writes the audit entry of one part.
    fn told(&self, part: &Trail, refusal: Option<&Refusal>) {
        match refusal {
            None => self.note(part, Outcome::Done, "ok", ""),
            Some(no) => {
                let fault = Fault::from(no.clone());
                self.note(part, fault.outcome(), fault.code(), &no.to_string());
            }
        }
    }
}

fn parse<'a, T: Deserialize<'a>>(json: &'a [u8]) -> Result<T, Fault> {
    serde_json::from_slice(json).map_err(|error| invalid("body", &error.to_string()))
}

fn few(count: usize, what: &str) -> Result<(), Fault> {
    if count <= MOST { Ok(()) } else { Err(invalid(what, &format!("at most {MOST} at a time"))) }
}

fn invalid(field: &str, message: &str) -> Fault {
    Fault::Invalid { field: field.into(), message: message.into() }
}
