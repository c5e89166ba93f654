//! Ended jobs that wait for their audit.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use femc_model::JobId;
use femc_queue::Note;
use femc_schedule::Fact;

use crate::audit::{Violation, check_attempt_records, check_records};
use crate::shared::{ResultSet, Shared, State};
use crate::tasks::fact_job;

/// Longer than any message travels.
const AUDIT_DELAY: Duration = Duration::from_secs(120);

#[derive(Debug, Default)]
struct AuditState {
    /// End times of the jobs that are not audited yet.
    ended: BTreeMap<JobId, Duration>,
    /// Last audited job. All earlier jobs are audited, too.
    audited: u64,
}

/// List of ended jobs. Clones share it.
#[derive(Debug, Clone, Default)]
pub(super) struct AuditQueue(Arc<Mutex<AuditState>>);

impl AuditQueue {
    fn lock(&self) -> MutexGuard<'_, AuditState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes that a job has ended and nobody will control it any more.
    pub(super) fn push(&self, job: JobId, now: Duration) {
        self.lock().ended.insert(job, now);
    }

    /// Returns the number of jobs that have ended so far.
    pub(super) fn ended_jobs(&self) -> u64 {
        let audit = self.lock();
        audit.audited + audit.ended.len() as u64
    }

    /// Audits the jobs that ended long before `now`, in the order of their numbers, and drops their data.
    pub(super) fn audit_due(&self, shared: &Shared, now: Duration) {
        let mut audit = self.lock();
        let before = audit.audited;
        let is_due = |ended: &Duration| now.saturating_sub(*ended) >= AUDIT_DELAY;
        while audit.ended.get(&JobId(audit.audited + 1)).is_some_and(is_due) {
            audit.audited += 1;
            let job = JobId(audit.audited);
            audit.ended.remove(&job);
        }
        if audit.audited > before {
            let mut state = shared.lock();
            let wrong = audit_until(&mut state, JobId(audit.audited));
            state.violations.extend(wrong);
        }
    }
}

/// Removes the data of the jobs up to `last`, and returns the violations in it.
fn audit_until(state: &mut State, last: JobId) -> Vec<Violation> {
    let mut records = Vec::new();
    for record in std::mem::take(&mut state.disk.history) {
        match Fact::decode(&record) {
            Ok((_, fact)) => match fact_job(&fact) {
                Some(job) if job > last => state.disk.history.push(record),
                Some(_) => records.push(record),
                None => {}
            },
            Err(error) => return vec![error.into()],
        }
    }
    let [accepted, reported] = [&mut state.accepted, &mut state.reported].map(|reports| take_reports(reports, last));
    let mut wrong =
        check_records(&records, [&accepted, &reported], &state.leases).unwrap_or_else(|error| vec![error.into()]);
    let (notes, left) =
        std::mem::take(&mut state.disk.notes).into_iter().partition(|note: &Note| note.subject <= last.0);
    state.disk.notes = left;
    wrong.extend(check_attempt_records(&records, &notes, state.disk.tail()).unwrap_or_else(|error| vec![error.into()]));
    state.leases.drop_until(last);
    state.history.drop_until(last);
    state.requests.drop_until(last);
    state.queues.drop_until(last);
    wrong
}

/// Removes and returns the reports of the jobs up to `last`.
fn take_reports(reports: &mut ResultSet, last: JobId) -> ResultSet {
    let (taken, left) = std::mem::take(reports).into_iter().partition(|(task, _)| task.job <= last);
    *reports = left;
    taken
}
