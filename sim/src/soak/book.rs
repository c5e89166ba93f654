//! Ended jobs that wait for their audit.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use femc_model::JobId;
use femc_queue::Note;
use femc_schedule::Fact;

use crate::audit::{Violation, log, noted};
use crate::shared::{Reports, Shared, State};
use crate::tasks::job_of;

/// Longer than any message travels.
const SETTLED: Duration = Duration::from_secs(120);

#[derive(Debug, Default)]
struct Pages {
    /// End times of the jobs that are not audited yet.
    ended: BTreeMap<JobId, Duration>,
    /// Last audited job. All earlier jobs are audited, too.
    audited: u64,
}

/// List of ended jobs. Clones share it.
#[derive(Debug, Clone, Default)]
pub(super) struct Book(Arc<Mutex<Pages>>);

impl Book {
    fn lock(&self) -> MutexGuard<'_, Pages> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes that a job has ended and nobody will control it any more.
    pub(super) fn ended(&self, job: JobId, now: Duration) {
        self.lock().ended.insert(job, now);
    }

    /// Returns the number of jobs that have ended so far.
    pub(super) fn jobs(&self) -> u64 {
        let pages = self.lock();
        pages.audited + pages.ended.len() as u64
    }

    /// Audits the jobs that ended long before `now`, in the order of their numbers, and drops their data.
    pub(super) fn settle(&self, shared: &Shared, now: Duration) {
        let mut pages = self.lock();
        let before = pages.audited;
        let is_due = |ended: &Duration| now.saturating_sub(*ended) >= SETTLED;
        while pages.ended.get(&JobId(pages.audited + 1)).is_some_and(is_due) {
            pages.audited += 1;
            let job = JobId(pages.audited);
            pages.ended.remove(&job);
        }
        if pages.audited > before {
            let mut state = shared.lock();
            let wrong = close(&mut state, JobId(pages.audited));
            state.wrong.extend(wrong);
        }
    }
}

/// Removes the data of the jobs up to `last`, and returns the violations in it.
fn close(state: &mut State, last: JobId) -> Vec<Violation> {
    let mut records = Vec::new();
    for record in std::mem::take(&mut state.disk.history) {
        match Fact::decode(&record) {
            Ok((_, fact)) => match job_of(&fact) {
                Some(job) if job > last => state.disk.history.push(record),
                Some(_) => records.push(record),
                None => {}
            },
            Err(error) => return vec![error.into()],
        }
    }
    let [accepted, reported] = [&mut state.accepted, &mut state.reported].map(|reports| take(reports, last));
    let mut wrong = log(&records, [&accepted, &reported], &state.leases).unwrap_or_else(|error| vec![error.into()]);
    let (notes, left) =
        std::mem::take(&mut state.disk.notes).into_iter().partition(|note: &Note| note.subject <= last.0);
    state.disk.notes = left;
    wrong.extend(noted(&records, &notes, state.disk.tail()).unwrap_or_else(|error| vec![error.into()]));
    state.leases.forget_until(last);
    state.chronicle.forget_until(last);
    state.answers.forget_until(last);
    state.queues.forget_until(last);
    wrong
}

/// Removes and returns the reports of the jobs up to `last`.
fn take(reports: &mut Reports, last: JobId) -> Reports {
    let (taken, left) = std::mem::take(reports).into_iter().partition(|(task, _)| task.job <= last);
    *reports = left;
    taken
}
