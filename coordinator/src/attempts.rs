//! Records of ended attempts, on their way to the notes beside the log. There is one note per job and batch, with any number of
//! attempts.

use std::collections::BTreeMap;

use femc_model::{AttemptRecord, JobId, Refusal};
use femc_proto::{AttemptPage, JobShape};
use femc_queue::{Note, NotePage, Queue};
use femc_schedule::{Fact, SnapshotError, decode_attempts, encode_attempts};

use crate::actor::Actor;

/// Ended attempts by job, and the jobs whose attempts must be deleted.
#[derive(Debug, Default)]
pub(crate) struct EndedAttempts {
    attempts: BTreeMap<JobId, Vec<AttemptRecord>>,
    forgotten: Vec<u64>,
}

impl EndedAttempts {
    pub(crate) fn put(&mut self, attempt: AttemptRecord) {
        self.attempts.entry(attempt.task.job).or_default().push(attempt);
    }

    /// Drops the attempts of a job that is deleted.
    pub(crate) fn on_fact(&mut self, fact: &Fact) {
        if let Fact::JobRemoved { job } = fact {
            self.attempts.remove(job);
            self.forgotten.push(job.0);
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.attempts.is_empty() && self.forgotten.is_empty()
    }

    /// Takes out the notes to store, and the jobs whose notes must be deleted.
    pub(crate) fn take(&mut self) -> Result<(Vec<Note>, Vec<u64>), SnapshotError> {
        let Self { attempts, forgotten } = std::mem::take(self);
        let notes: Result<Vec<Note>, SnapshotError> = (attempts.into_iter())
            .map(|(job, attempts)| Ok(Note { subject: job.0, bytes: encode_attempts(&attempts)? }))
            .collect();
        Ok((notes?, forgotten))
    }
}

/// Decodes a page of notes. Invalid notes are left out.
pub(crate) fn decode_page(page: NotePage) -> AttemptPage {
    let read = |note: Vec<u8>| {
        decode_attempts(&note).unwrap_or_else(|error| {
            tracing::warn!(%error, "cannot read saved attempts");
            Vec::new()
        })
    };
    AttemptPage { attempts: page.notes.into_iter().flat_map(read).collect(), next: page.next }
}

impl<Q: Queue> Actor<Q> {
    pub(crate) fn shape(&self, job: JobId) -> Result<JobShape, Refusal> {
        let spec = self.scheduler.spec(job).ok_or(Refusal::NoSuchJob { job })?;
        Ok(JobShape { spec: Box::new(spec.clone()), chunk_size: self.scheduler.chunk_size(job) })
    }
}
