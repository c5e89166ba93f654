//! Target relative errors of frames, for statuses. They are part of a job's settings, which the scheduler does not read.

use std::collections::BTreeMap;

use femc_model::{JobId, JobStatus, Refusal, Tick};
use femc_proto::error_target;
use femc_schedule::{Fact, Scheduler};

/// Targets by job. A specification never changes, so its settings are read once.
#[derive(Debug, Default)]
pub(crate) struct ErrorTargets(BTreeMap<JobId, Option<f64>>);

impl ErrorTargets {
    /// Returns a job's status with its target.
    pub(crate) fn status(&mut self, scheduler: &Scheduler, job: JobId, now: Tick) -> Result<JobStatus, Refusal> {
        scheduler.status(job, now).map(|status| self.fill(scheduler, status))
    }

    /// Fills in the target of a status.
    pub(crate) fn fill(&mut self, scheduler: &Scheduler, status: JobStatus) -> JobStatus {
        let read = || scheduler.spec(status.job).and_then(error_target);
        let error_target = *self.0.entry(status.job).or_insert_with(read);
        JobStatus { error_target, ..status }
    }

    /// Drops the target of a deleted job.
    pub(crate) fn on_fact(&mut self, fact: &Fact) {
        if let Fact::JobRemoved { job } = fact {
            self.0.remove(job);
        }
    }
}
