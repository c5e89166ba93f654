//! Requests of people and the answers to them. Each answer is checked against the log of its time.

use std::collections::BTreeMap;

use femc_model::{Control, Digest, JobId, JobState, JobStatus, Refusal, TaskKey};

use crate::audit::Violation;
use crate::chronicle::Place;
use crate::shared::Shared;

/// Requests of people, and what they know about the current log.
#[derive(Debug, Default)]
pub(crate) struct Answers {
    /// Controls that people requested, with or without an answer.
    pub(crate) controls: Vec<(JobId, Control)>,
    /// Jobs by the key of their submission, each with the position of the log at the first answer.
    keys: BTreeMap<String, (JobId, Place)>,
    /// Quarantined tasks, each with its attempts and the positions of the log at the question and at the answer.
    aside: BTreeMap<TaskKey, (u32, [Place; 2])>,
}

impl Answers {
    pub(crate) fn forget_until(&mut self, last: JobId) {
        self.controls.retain(|(job, _)| *job > last);
        self.keys.retain(|_, (job, _)| *job > last);
        self.aside.retain(|task, _| task.job > last);
    }
}

/// Time of a question: the log and its length then.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Asked {
    log: u32,
    place: Place,
}

impl Shared {
    pub(crate) fn asks(&self) -> Asked {
        let state = self.lock();
        Asked { log: state.disk.logs, place: state.chronicle.place() }
    }

    /// Checks whether another log has begun since the question.
    pub(crate) fn is_over(&self, asked: Asked) -> bool {
        self.lock().disk.logs != asked.log
    }

    fn heard(&self, asked: Asked, wrong: impl FnOnce(&mut crate::shared::State) -> Option<Violation>) {
        let mut state = self.lock();
        if state.disk.logs == asked.log
            && !state.disk.has_ghosts()
            && let Some(wrong) = wrong(&mut state)
        {
            let now = turmoil::sim_elapsed().unwrap_or_default();
            state.note(now, &format!("WRONG: {wrong}"));
            state.wrong.push(wrong);
        }
    }

    /// Checks the answer to a submission.
    pub(crate) fn hears_job(&self, asked: Asked, key: &str, job: JobId) {
        self.heard(asked, |state| {
            let heard = (job, state.chronicle.place());
            let known = state.answers.keys.entry(key.to_owned()).or_insert(heard);
            let before = (known.0 != job).then(|| std::mem::replace(known, heard).0);
            let has_forgotten = before.is_some_and(|before| state.chronicle.has_forgotten(before));
            let moved = |before| Violation::KeyMoved { key: key.to_owned(), jobs: [before, job] };
            let is_known = state.chronicle.job_of_key(key) == Some(job) || state.chronicle.has_forgotten(job);
            let gone = (!is_known).then_some(Violation::Gone { job });
            before.filter(|_| !has_forgotten).map(moved).or(gone)
        });
    }

    /// Notes that a person is about to send a control.
    pub(crate) fn steers(&self, job: JobId, control: &Control) {
        let mut state = self.lock();
        let asked = (job, control.clone());
        if !state.answers.controls.contains(&asked) {
            state.answers.controls.push(asked);
        }
    }

    /// Checks the answer to a control.
    pub(crate) fn hears_steered(&self, asked: Asked, job: JobId, control: &Control, answer: &Result<(), Refusal>) {
        self.heard(asked, |state| match answer {
            Ok(()) => state.chronicle.holds(job, control, asked.place),
            Err(Refusal::Ended { .. }) => state.chronicle.may_refuse(job, control, asked.place),
            Err(Refusal::NoSuchJob { .. }) => state.gone(job),
            Err(_) => None,
        });
    }

    /// Checks the answer to a status request.
    pub(crate) fn hears_status(&self, asked: Asked, job: JobId, answer: &Result<JobStatus, Refusal>) {
        self.heard(asked, |state| match answer {
            Ok(status) => {
                let unexplained = status.state == JobState::Failed && !state.chronicle.explains(status);
                let why =
                    || Violation::Unexplained { status: format!("{:?} {:?}", status.failure, status.quarantined) };
                let disagrees = state.chronicle.agrees(status, asked.place).or_else(|| unexplained.then(why));
                disagrees.or_else(|| state.fewer(status, asked.place))
            }
            Err(Refusal::NoSuchJob { .. }) => state.gone(job),
            Err(_) => None,
        });
    }

    /// Checks the bytes of a fetched artifact.
    pub(crate) fn receives(&self, digest: &Digest, bytes: &[u8]) {
        let found = Digest::of(bytes);
        if found != *digest {
            self.lock().wrong.push(Violation::Delivered { digest: *digest, found });
        }
    }

    /// Checks a list of all jobs.
    pub(crate) fn hears_list(&self, asked: Asked, answer: &[JobStatus]) {
        self.heard(asked, |state| {
            let listed: Vec<JobId> = answer.iter().map(|status| status.job).collect();
            let is_missing = |(job, since): &(JobId, Place)| *since <= asked.place && !listed.contains(job);
            let missing = state.answers.keys.values().copied().filter(is_missing).find_map(|(job, _)| state.gone(job));
            missing.or_else(|| answer.iter().find_map(|status| state.chronicle.agrees(status, asked.place)))
        });
    }
}

impl crate::shared::State {
    /// Finds attempts that decreased since an earlier answer.
    fn fewer(&mut self, status: &JobStatus, asked: Place) -> Option<Violation> {
        let heard = self.chronicle.place();
        let mut wrong = None;
        for it in &status.quarantined {
            let known = self.answers.aside.get(&it.task);
            if let Some(&(before, [since, by])) = known
                && by <= asked
                && it.attempts < before
                && !self.chronicle.is_retried_since(it.task.job, since)
            {
                wrong = Some(Violation::Fewer { task: it.task, before, answered: it.attempts });
            }
            if known.is_none_or(|&(_, [since, _])| since <= asked) {
                self.answers.aside.insert(it.task, (it.attempts, [asked, heard]));
            }
        }
        wrong
    }

    /// Checks a missing job: it must have expired.
    fn gone(&self, job: JobId) -> Option<Violation> {
        (!self.chronicle.has_forgotten(job)).then_some(Violation::Gone { job })
    }
}
