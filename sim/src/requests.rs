//! Requests of people and the answers to them. Each answer is checked against the log of its time.

use std::collections::BTreeMap;

use femc_model::{Control, Digest, JobId, JobState, JobStatus, Refusal, TaskKey};

use crate::audit::Violation;
use crate::history::LogPosition;
use crate::shared::Shared;

/// Requests of people, and what they know about the current log.
#[derive(Debug, Default)]
pub(crate) struct RequestHistory {
    /// Controls that people requested, with or without an answer.
    pub(crate) controls: Vec<(JobId, Control)>,
    /// Jobs by the key of their submission, each with the position of the log at the first answer.
    keys: BTreeMap<String, (JobId, LogPosition)>,
    /// Quarantined tasks, each with its attempts and the positions of the log at the question and at the answer.
    quarantined: BTreeMap<TaskKey, (u32, [LogPosition; 2])>,
}

impl RequestHistory {
    pub(crate) fn drop_until(&mut self, last: JobId) {
        self.controls.retain(|(job, _)| *job > last);
        self.keys.retain(|_, (job, _)| *job > last);
        self.quarantined.retain(|task, _| task.job > last);
    }
}

/// Time of a question: the log and its length then.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct RequestTime {
    log: u32,
    position: LogPosition,
}

impl Shared {
    pub(crate) fn request_time(&self) -> RequestTime {
        let state = self.lock();
        RequestTime { log: state.disk.logs, position: state.history.position() }
    }

    /// Checks whether another log has begun since the question.
    pub(crate) fn is_log_lost(&self, asked_at: RequestTime) -> bool {
        self.lock().disk.logs != asked_at.log
    }

    fn check_answer(&self, asked_at: RequestTime, wrong: impl FnOnce(&mut crate::shared::State) -> Option<Violation>) {
        let mut state = self.lock();
        if state.disk.logs == asked_at.log
            && !state.disk.may_have_deposed_leader()
            && let Some(wrong) = wrong(&mut state)
        {
            let now = turmoil::sim_elapsed().unwrap_or_default();
            state.trace_event(now, &format!("WRONG: {wrong}"));
            state.violations.push(wrong);
        }
    }

    /// Checks the answer to a submission.
    pub(crate) fn check_submission(&self, asked_at: RequestTime, key: &str, job: JobId) {
        self.check_answer(asked_at, |state| {
            let heard = (job, state.history.position());
            let known = state.requests.keys.entry(key.to_owned()).or_insert(heard);
            let before = (known.0 != job).then(|| std::mem::replace(known, heard).0);
            let has_forgotten = before.is_some_and(|before| state.history.has_expired(before));
            let moved = |before| Violation::KeyMoved { key: key.to_owned(), jobs: [before, job] };
            let is_known = state.history.job_of_key(key) == Some(job) || state.history.has_expired(job);
            let gone = (!is_known).then_some(Violation::JobDisappeared { job });
            before.filter(|_| !has_forgotten).map(moved).or(gone)
        });
    }

    /// Notes that a person is about to send a control.
    pub(crate) fn record_control(&self, job: JobId, control: &Control) {
        let mut state = self.lock();
        let asked = (job, control.clone());
        if !state.requests.controls.contains(&asked) {
            state.requests.controls.push(asked);
        }
    }

    /// Checks the answer to a control.
    pub(crate) fn check_control_answer(
        &self,
        asked_at: RequestTime,
        job: JobId,
        control: &Control,
        answer: &Result<(), Refusal>,
    ) {
        self.check_answer(asked_at, |state| match answer {
            Ok(()) => state.history.check_control(job, control, asked_at.position),
            Err(Refusal::Ended { .. }) => state.history.check_refusal(job, control, asked_at.position),
            Err(Refusal::NoSuchJob { .. }) => state.check_missing_job(job),
            Err(_) => None,
        });
    }

    /// Checks the answer to a status request.
    pub(crate) fn check_status_answer(&self, asked_at: RequestTime, job: JobId, answer: &Result<JobStatus, Refusal>) {
        self.check_answer(asked_at, |state| match answer {
            Ok(status) => {
                let unexplained = status.state == JobState::Failed && !state.history.explains_failure(status);
                let why = || Violation::UnexplainedFailure {
                    status: format!("{:?} {:?}", status.failure, status.quarantined),
                };
                let disagrees = state.history.check_status(status, asked_at.position).or_else(|| unexplained.then(why));
                disagrees.or_else(|| state.check_attempts(status, asked_at.position))
            }
            Err(Refusal::NoSuchJob { .. }) => state.check_missing_job(job),
            Err(_) => None,
        });
    }

    /// Checks the bytes of a fetched artifact.
    pub(crate) fn check_download(&self, digest: &Digest, bytes: &[u8]) {
        let found = Digest::compute(bytes);
        if found != *digest {
            self.lock().violations.push(Violation::WrongBytes { digest: *digest, found });
        }
    }

    /// Checks a list of all jobs.
    pub(crate) fn check_list_answer(&self, asked_at: RequestTime, answer: &[JobStatus]) {
        self.check_answer(asked_at, |state| {
            let listed: Vec<JobId> = answer.iter().map(|status| status.job).collect();
            let is_missing = |(job, since): &(JobId, LogPosition)| *since <= asked_at.position && !listed.contains(job);
            let missing = state
                .requests
                .keys
                .values()
                .copied()
                .filter(is_missing)
                .find_map(|(job, _)| state.check_missing_job(job));
            missing.or_else(|| answer.iter().find_map(|status| state.history.check_status(status, asked_at.position)))
        });
    }
}

impl crate::shared::State {
    /// Finds attempts that decreased since an earlier answer.
    fn check_attempts(&mut self, status: &JobStatus, asked_at: LogPosition) -> Option<Violation> {
        let answered_at = self.history.position();
        let mut wrong = None;
        for it in &status.quarantined {
            let known = self.requests.quarantined.get(&it.task);
            if let Some(&(before, [since, by])) = known
                && by <= asked_at
                && it.attempts < before
                && !self.history.is_retried_since(it.task.job, since)
            {
                wrong = Some(Violation::AttemptsDecreased { task: it.task, before, answered: it.attempts });
            }
            if known.is_none_or(|&(_, [since, _])| since <= asked_at) {
                self.requests.quarantined.insert(it.task, (it.attempts, [asked_at, answered_at]));
            }
        }
        wrong
    }

    /// Checks a missing job: it must have expired.
    fn check_missing_job(&self, job: JobId) -> Option<Violation> {
        (!self.history.has_expired(job)).then_some(Violation::JobDisappeared { job })
    }
}
