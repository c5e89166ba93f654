//! What attempts took, on its way to the place beside the log: a note a job and batch, however many attempts it holds.

use std::collections::BTreeMap;

use femc_model::{AttemptRecord, JobId, Refusal};
use femc_proto::{AttemptPage, JobShape};
use femc_queue::{Note, Page, Queue};
use femc_schedule::{Fact, SnapshotError, decode_attempts, encode_attempts};

use crate::actor::Actor;

/// Attempts that have ended, by job, and jobs whose attempts nobody wants any more.
#[derive(Debug, Default)]
pub(crate) struct Ended {
    attempts: BTreeMap<JobId, Vec<AttemptRecord>>,
    forgotten: Vec<u64>,
}

impl Ended {
    pub(crate) fn put(&mut self, attempt: AttemptRecord) {
        self.attempts.entry(attempt.task.job).or_default().push(attempt);
    }

    /// A job that is forgotten has no attempts.
    pub(crate) fn on_fact(&mut self, fact: &Fact) {
        if let Fact::Forgotten { job } = fact {
            self.attempts.remove(job);
            self.forgotten.push(job.0);
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.attempts.is_empty() && self.forgotten.is_empty()
    }

    /// What is to be kept, and the jobs whose notes go.
    pub(crate) fn take(&mut self) -> Result<(Vec<Note>, Vec<u64>), SnapshotError> {
        let Self { attempts, forgotten } = std::mem::take(self);
        let notes: Result<Vec<Note>, SnapshotError> = (attempts.into_iter())
            .map(|(job, attempts)| Ok(Note { subject: job.0, bytes: encode_attempts(&attempts)? }))
            .collect();
        Ok((notes?, forgotten))
    }
}

/// What a page of notes says; one that makes no sense is left out.
pub(crate) fn page(page: Page) -> AttemptPage {
    let read = |note: Vec<u8>| {
        decode_attempts(&note).unwrap_or_else(|error| {
            tracing::warn!(%error, "attempts that were noted cannot be read");
            Vec::new()
        })
    };
    AttemptPage { attempts: page.notes.into_iter().flat_map(read).collect(), next: page.next }
}

impl<Q: Queue> Actor<Q> {
    pub(crate) fn shape(&self, job: JobId) -> Result<JobShape, Refusal> {
        let spec = self.scheduler.spec(job).ok_or(Refusal::NoSuchJob { job })?;
        Ok(JobShape { spec: Box::new(spec.clone()), cut: self.scheduler.cut(job) })
    }
}
