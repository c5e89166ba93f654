//! What the log says of jobs and workers, record by record, told by the records alone; and what it must never say.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use femc_model::{Control, Drain, Failure, JobId, JobSpec, JobState, JobStatus, TaskKey, Tick};
use femc_schedule::Fact;

use crate::audit::Violation;
use crate::tasks::{counted, tried};

/// A number of records: those of the log so far.
pub(crate) type Place = u64;

/// What a person has done to a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Hold {
    Free,
    Paused,
    Cancelled,
}

/// Where a job stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Standing {
    finished: u32,
    hold: Hold,
    doomed: bool,
    priority: u8,
}

/// A job.
#[derive(Debug)]
struct Record {
    spec: Box<JobSpec>,
    /// Where it stood, from which place on.
    standings: Vec<(Place, Standing)>,
    controls: Vec<(Place, Control)>,
    /// Failures since the last retry.
    failures: BTreeMap<TaskKey, u32>,
    /// Seconds of the results of each frame that is not finished.
    busy: BTreeMap<u32, f64>,
    /// The same of those that are.
    finished: BTreeMap<u32, f64>,
    doom: Option<Failure>,
    /// When it ended last, by the coordinator's clock; frames that only a retry can move are not seen here.
    ended: Option<Tick>,
}

impl Record {
    fn now(&self) -> Standing {
        self.standings.last().map_or(
            Standing { finished: 0, hold: Hold::Free, doomed: false, priority: self.spec.priority },
            |(_, last)| *last,
        )
    }

    fn has_ended(&self) -> bool {
        let Standing { finished, hold, doomed, .. } = self.now();
        hold == Hold::Cancelled || doomed || finished as usize == self.spec.frames.len()
    }

    fn stands(&mut self, place: Place, standing: Standing) {
        if standing != self.now() {
            self.standings.push((place, standing));
        }
    }

    /// Where it stood since a place.
    fn since(&self, place: Place) -> impl Iterator<Item = Standing> + '_ {
        let first = self.standings.iter().rposition(|(at, _)| *at <= place).unwrap_or(0);
        self.standings.iter().skip(first).map(|(_, standing)| *standing)
    }
}

/// The log so far.
#[derive(Debug, Default)]
pub(crate) struct Chronicle {
    records: Place,
    jobs: BTreeMap<JobId, Record>,
    last: u64,
    keys: BTreeMap<String, JobId>,
    forgotten: BTreeSet<JobId>,
    /// Of all logs that there were.
    incarnations: BTreeSet<u32>,
    /// Workers that get no tasks: under which incarnation and when that was written.
    drained: BTreeMap<u64, (u32, Duration)>,
    incarnation: u32,
    /// Jobs up to this one are not followed any longer.
    settled: u64,
    /// After how many milliseconds a job that has ended may be forgotten.
    pub(crate) keep_ended: Option<u64>,
}

impl Chronicle {
    pub(crate) fn place(&self) -> Place {
        self.records
    }

    /// A log begins that knows of nothing.
    pub(crate) fn anew(&mut self) {
        let before = std::mem::take(self);
        let Self { incarnations, keep_ended, records, .. } = before;
        *self = Self { incarnations, keep_ended, records, ..Self::default() };
    }

    pub(crate) fn spec(&self, job: JobId) -> Option<&JobSpec> {
        self.jobs.get(&job).map(|record| &*record.spec)
    }

    pub(crate) fn job_of_key(&self, key: &str) -> Option<JobId> {
        self.keys.get(key).copied()
    }

    pub(crate) fn has_forgotten(&self, job: JobId) -> bool {
        self.forgotten.contains(&job) || job.0 <= self.settled
    }

    /// Nothing is kept of the jobs up to `last`.
    pub(crate) fn forget_until(&mut self, last: JobId) {
        self.settled = self.settled.max(last.0);
        self.jobs.retain(|job, _| *job > last);
        self.keys.retain(|_, job| *job > last);
        self.forgotten.retain(|job| *job > last);
    }

    /// Takes in what is being written now; what is wrong with it.
    pub(crate) fn take(
        &mut self,
        tick: Tick,
        fact: &Fact,
        now: Duration,
        asked: &[(JobId, Control)],
    ) -> Vec<Violation> {
        self.records += 1;
        let (place, mut wrong) = (self.records, Vec::new());
        match fact {
            Fact::Opened { incarnation } => {
                self.incarnation = *incarnation;
                if !self.incarnations.insert(*incarnation) {
                    wrong.push(Violation::Incarnation { incarnation: *incarnation });
                }
            }
            Fact::Submitted { job, key, spec } => {
                if job.0 <= self.last {
                    wrong.push(Violation::Renumbered { job: *job });
                }
                self.last = self.last.max(job.0);
                if let Some(key) = key {
                    let before = self.keys.insert(key.clone(), *job);
                    wrong.extend(before.map(|before| Violation::KeyMoved { key: key.clone(), jobs: [before, *job] }));
                }
                let mut record = Record {
                    spec: spec.clone(),
                    standings: Vec::new(),
                    controls: Vec::new(),
                    failures: BTreeMap::new(),
                    busy: BTreeMap::new(),
                    finished: BTreeMap::new(),
                    doom: None,
                    ended: None,
                };
                record.standings.push((place, record.now()));
                self.jobs.insert(*job, record);
            }
            Fact::Drained { instance, drain } => match drain {
                Drain::Begin => drop(self.drained.insert(*instance, (self.incarnation, now))),
                Drain::Undo => drop(self.drained.remove(instance)),
            },
            Fact::Controlled { job, control } => {
                if !asked.contains(&(*job, *control)) {
                    wrong.push(Violation::Unasked { job: *job, control: *control });
                }
                if let Some(record) = self.jobs.get_mut(job) {
                    record.steered(place, *control, tick);
                }
            }
            Fact::Doomed { job, failure } => {
                if let Some(record) = self.jobs.get_mut(job) {
                    record.doom = Some(failure.clone());
                    record.stands(place, Standing { doomed: true, ..record.now() });
                    record.ended.get_or_insert(tick);
                }
            }
            Fact::Failed { task, .. } => {
                if let Some(record) = self.jobs.get_mut(&task.job) {
                    *record.failures.entry(tried(*task)).or_default() += 1;
                }
            }
            Fact::Died { task, end, .. } => {
                if let Some(record) = self.jobs.get_mut(&task.job) {
                    for index in task.index..*end {
                        *record.failures.entry(tried(TaskKey { index, ..*task })).or_default() += 1;
                    }
                }
            }
            Fact::Forgotten { job } => wrong.extend(self.forget(*job, tick)),
            _ => {}
        }
        if let Some(result) = counted(fact).filter(|result| result.task.job.0 > self.settled) {
            let (job, frame) = (result.task.job, result.task.stage.frame);
            match self.jobs.get_mut(&job).filter(|record| !record.has_ended()) {
                None => wrong.push(Violation::AfterEnd { task: result.task, epoch: result.epoch }),
                Some(record) => {
                    *record.busy.entry(frame).or_default() += result.seconds;
                    if result.finishes {
                        let busy = record.busy.remove(&frame).unwrap_or(0.0);
                        record.finished.insert(frame, busy);
                        let finished = record.finished.len() as u32;
                        record.stands(place, Standing { finished, ..record.now() });
                        if record.has_ended() {
                            record.ended = Some(tick);
                        }
                    }
                }
            }
        }
        wrong
    }

    /// A job is forgotten: it must have ended long enough ago.
    fn forget(&mut self, job: JobId, tick: Tick) -> Option<Violation> {
        self.forgotten.insert(job);
        self.keys.retain(|_, other| *other != job);
        let record = self.jobs.remove(&job)?;
        // One whose frames are blocked has ended, too.
        let is_blocked = record.failures.values().any(|&failures| failures >= ATTEMPTS);
        let is_due = match (record.ended, self.keep_ended) {
            (_, None) => false,
            (Some(ended), Some(keep)) => tick.since(ended) >= keep,
            (None, Some(_)) => is_blocked,
        };
        (!is_due).then_some(Violation::ForgottenEarly { job })
    }

    /// What is wrong with a lease that a worker's process gets: an operator's word holds over restarts of the coordinator.
    pub(crate) fn may_work(&self, instance: u64, incarnation: u32, now: Duration) -> Option<Violation> {
        /// Longer than what was said before is on its way.
        const SLACK: Duration = Duration::from_secs(25);
        let (under, since) = *self.drained.get(&instance)?;
        (incarnation > under || now.saturating_sub(since) > SLACK).then_some(Violation::Drained { instance })
    }

    /// Whether an answer is what the log said at some moment since `place`.
    pub(crate) fn agrees(&self, status: &JobStatus, place: Place) -> Option<Violation> {
        let job = status.job;
        let told = |what: String| Some(Violation::Told { job, what });
        let Some(record) = self.jobs.get(&job) else {
            let is_known = self.has_forgotten(job);
            return if is_known { None } else { told("there is such a job".into()) };
        };
        let spec = &record.spec;
        if (&status.name, &status.owner, status.frames_total as usize) != (&spec.name, &spec.owner, spec.frames.len()) {
            return told(format!("it is {} of {}", status.name, status.owner));
        }
        let frames = status.frames_total;
        let is_so = |standing: Standing| {
            let Standing { finished, hold, doomed, priority } = standing;
            let is_blocked = status.frames_failed > 0 && finished + status.frames_failed == frames;
            (status.frames_done, status.priority, status.failure.is_some()) == (finished, priority, doomed)
                && match status.state {
                    JobState::Done => finished == frames,
                    JobState::Cancelled => hold == Hold::Cancelled && finished < frames,
                    JobState::Failed => hold != Hold::Cancelled && finished < frames && (doomed || is_blocked),
                    JobState::Paused => hold == Hold::Paused && finished < frames && !doomed,
                    JobState::Queued | JobState::Running => hold == Hold::Free && finished < frames && !doomed,
                }
        };
        if !record.since(place).any(is_so) {
            let JobStatus { state, frames_done, frames_failed, priority, .. } = status;
            return told(format!("{state:?}, {frames_done} frames done, {frames_failed} failed, priority {priority}"));
        }
        let is_retried = record.controls.iter().any(|(at, control)| *at > place && *control == Control::Retry);
        let counts = |task: &TaskKey| record.failures.get(&tried(*task)).copied().unwrap_or(0);
        let invented = status.quarantined.iter().find(|it| it.attempts > counts(&it.task) || it.attempts < ATTEMPTS);
        invented.filter(|_| !is_retried).map(|it| Violation::Attempts {
            task: it.task,
            told: it.attempts,
            logged: counts(&it.task),
        })
    }

    /// Why a job has failed, if that is explained: its doom, or tasks that have failed as often as they may.
    pub(crate) fn explains(&self, status: &JobStatus) -> bool {
        let Some(record) = self.jobs.get(&status.job) else { return true };
        match &record.doom {
            Some(doom) => status.failure.as_ref() == Some(doom),
            None => !status.quarantined.is_empty(),
        }
    }

    /// Whether what was acknowledged since `place` was done by then.
    pub(crate) fn holds(&self, job: JobId, control: Control, place: Place) -> Option<Violation> {
        let record = self.jobs.get(&job)?;
        let is_written = record.controls.iter().any(|(at, written)| *at > place && *written == control);
        let is_so = |standing: Standing| match control {
            Control::Pause => standing.hold == Hold::Paused,
            Control::Resume => standing.hold == Hold::Free,
            Control::Cancel => false,
            Control::Retry => standing.hold != Hold::Cancelled && !standing.doomed,
            Control::Priority(priority) => standing.priority == priority,
        };
        let holds = is_written || record.since(place).any(is_so);
        (!holds).then_some(Violation::Unwritten { job, control })
    }

    /// Whether a refusal because the job has ended is right at some moment since `place`.
    pub(crate) fn may_refuse(&self, job: JobId, control: Control, place: Place) -> Option<Violation> {
        let record = self.jobs.get(&job)?;
        let frames = record.spec.frames.len() as u32;
        let has_ended = |standing: Standing| match control {
            Control::Retry => standing.finished == frames,
            _ => standing.hold == Hold::Cancelled || standing.doomed || standing.finished == frames,
        };
        // One whose frames are blocked has ended, too.
        let is_blocked = control != Control::Retry && record.failures.values().any(|&failures| failures >= ATTEMPTS);
        let is_right = is_blocked || record.since(place).any(has_ended);
        (!is_right).then_some(Violation::Refused { job, control })
    }

    /// Seconds of the results of a finished frame.
    pub(crate) fn busy(&self, job: JobId, frame: u32) -> Option<f64> {
        self.jobs.get(&job)?.finished.get(&frame).copied()
    }
}

/// Failures after which a task is put aside.
const ATTEMPTS: u32 = 3;

impl Record {
    fn steered(&mut self, place: Place, control: Control, tick: Tick) {
        self.controls.push((place, control));
        let before = self.now();
        let after = match control {
            Control::Pause => Standing { hold: Hold::Paused, ..before },
            Control::Resume => Standing { hold: Hold::Free, ..before },
            Control::Cancel => Standing { hold: Hold::Cancelled, ..before },
            Control::Retry => Standing { hold: Hold::Free, doomed: false, ..before },
            Control::Priority(priority) => Standing { priority, ..before },
        };
        self.stands(place, after);
        if control == Control::Retry {
            self.failures.clear();
            (self.doom, self.ended) = (None, None);
        } else if self.has_ended() {
            self.ended.get_or_insert(tick);
        }
    }
}
