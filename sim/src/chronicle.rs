//! History of jobs and workers, derived from the records of the log alone. Also checks each record against it.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use femc_model::{
    Control, Drain, Epoch, Failure, JobId, JobSpec, JobState, JobStatus, Quarantined, Stage, TaskKey, Tick,
};
use femc_schedule::{Casualty, Evidence, Fact};

use crate::audit::Violation;
use crate::contents::Contents;
use crate::tasks::{counted, job_of, tried};

/// Position in the log: number of records so far.
pub(crate) type Place = u64;

/// Effect of the controls of a person on a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Hold {
    Free,
    Paused,
    Cancelled,
}

/// State of a job at one position of the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Standing {
    finished: u32,
    hold: Hold,
    doomed: bool,
    priority: u8,
}

/// Failures of a task.
#[derive(Debug, Default)]
struct Trouble {
    failures: u32,
    /// Deaths of workers, by lease.
    deaths: BTreeMap<Epoch, Casualty>,
    /// Last epoch before failures quarantined the task. Later leases must not be of this task.
    until: Option<Epoch>,
}

impl Trouble {
    /// Checks whether the task is quarantined: after three failures, or after five deaths that are proved by a worker's journal or
    /// are of several workers.
    fn is_aside(&self) -> bool {
        let known = self.deaths.values().filter(|death| death.evidence == Evidence::Journal).count();
        let workers: BTreeSet<&str> = self.deaths.values().map(|death| death.worker.as_str()).collect();
        self.failures >= ATTEMPTS || known >= DEATHS || (self.deaths.len() >= DEATHS && workers.len() > 1)
    }

    fn tries(&self) -> u32 {
        self.failures + self.deaths.len() as u32
    }

    fn failed(&mut self, until: Epoch) {
        self.failures += 1;
        if self.failures >= ATTEMPTS {
            self.until.get_or_insert(until);
        }
    }

    fn died(&mut self, casualty: &Casualty) {
        let known = self.deaths.entry(casualty.epoch).or_insert_with(|| casualty.clone());
        known.evidence = known.evidence.max(casualty.evidence);
    }

    /// Notes that a process is alive, so a presumed death of it is withdrawn. A quarantined task stays quarantined.
    fn lives(&mut self, instance: u64) {
        if !self.is_aside() {
            self.deaths.retain(|_, death| (death.instance, death.evidence) != (instance, Evidence::Presumed));
        }
    }
}

/// A job, or a set of shared stages.
#[derive(Debug)]
pub(crate) struct Record {
    pub(crate) spec: Box<JobSpec>,
    /// Frames of the job. Shared stages have one frame that stands for them.
    pub(crate) frames: Vec<u32>,
    /// States of the job, each with the position from which it holds.
    standings: Vec<(Place, Standing)>,
    controls: Vec<(Place, Control)>,
    /// Failures of tasks since the last retry.
    troubles: BTreeMap<TaskKey, Trouble>,
    /// Seconds of the results of each unfinished frame.
    busy: BTreeMap<u32, f64>,
    /// Seconds of the results of each finished frame.
    finished: BTreeMap<u32, f64>,
    doom: Option<Failure>,
    /// Time at which the job ended last, on the coordinator's clock.
    ended: Option<Tick>,
}

impl Record {
    fn new(spec: Box<JobSpec>, frames: Vec<u32>, place: Place) -> Self {
        let first = Standing { finished: 0, hold: Hold::Free, doomed: false, priority: spec.priority };
        Self {
            spec,
            frames,
            standings: vec![(place, first)],
            controls: Vec::new(),
            troubles: BTreeMap::new(),
            busy: BTreeMap::new(),
            finished: BTreeMap::new(),
            doom: None,
            ended: None,
        }
    }

    fn now(&self) -> Standing {
        self.standings.last().map_or(
            Standing { finished: 0, hold: Hold::Free, doomed: false, priority: self.spec.priority },
            |(_, last)| *last,
        )
    }

    pub(crate) fn has_ended(&self) -> bool {
        self.is_over() || self.now().finished as usize == self.frames.len()
    }

    /// Checks whether the job is cancelled or doomed. Only a retry can continue it.
    pub(crate) fn is_over(&self) -> bool {
        let Standing { hold, doomed, .. } = self.now();
        hold == Hold::Cancelled || doomed
    }

    /// Checks that the job is not paused, cancelled or doomed.
    pub(crate) fn may_run(&self) -> bool {
        let Standing { hold, doomed, .. } = self.now();
        hold == Hold::Free && !doomed
    }

    /// Checks that a frame is unfinished and none of its tasks is quarantined.
    pub(crate) fn is_left(&self, frame: u32) -> bool {
        let mut aside = self.troubles.iter().filter(|(_, trouble)| trouble.is_aside());
        !self.finished.contains_key(&frame) && !aside.any(|(task, _)| task.stage.frame == frame)
    }

    /// Checks whether a task of the job is quarantined.
    pub(crate) fn is_in_trouble(&self) -> bool {
        self.troubles.values().any(Trouble::is_aside)
    }

    fn trouble(&mut self, task: TaskKey) -> &mut Trouble {
        self.troubles.entry(tried(task)).or_default()
    }

    fn stands(&mut self, place: Place, standing: Standing) {
        if standing != self.now() {
            self.standings.push((place, standing));
        }
    }

    /// Returns the states of the job since a position.
    fn since(&self, place: Place) -> impl Iterator<Item = Standing> + '_ {
        let first = self.standings.iter().rposition(|(at, _)| *at <= place).unwrap_or(0);
        self.standings.iter().skip(first).map(|(_, standing)| *standing)
    }
}

/// History of the log so far.
#[derive(Debug, Default)]
pub(crate) struct Chronicle {
    records: Place,
    pub(crate) jobs: BTreeMap<JobId, Record>,
    pub(crate) contents: Contents,
    last: u64,
    keys: BTreeMap<String, JobId>,
    forgotten: BTreeSet<JobId>,
    /// Incarnations of all logs so far.
    incarnations: BTreeSet<u32>,
    /// Drained workers, each with the incarnation and the time of that record.
    drained: BTreeMap<u64, (u32, Duration)>,
    incarnation: u32,
    /// Last job that is not tracked any more. All earlier jobs are not tracked either.
    settled: u64,
    /// Milliseconds after which an ended job may expire.
    pub(crate) keep_ended: Option<u64>,
}

impl Chronicle {
    pub(crate) fn place(&self) -> Place {
        self.records
    }

    /// Begins an empty log.
    pub(crate) fn anew(&mut self) {
        let before = std::mem::take(self);
        let Self { incarnations, keep_ended, records, contents, .. } = before;
        *self = Self { incarnations, keep_ended, records, contents: contents.anew(), ..Self::default() };
    }

    /// Returns the number of the coordinator that began last.
    pub(crate) fn incarnation(&self) -> u32 {
        self.incarnation
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

    /// Drops the jobs up to `last`.
    pub(crate) fn forget_until(&mut self, last: JobId) {
        self.settled = self.settled.max(last.0);
        self.jobs.retain(|job, _| *job > last);
        self.keys.retain(|_, job| *job > last);
        self.forgotten.retain(|job| *job > last);
    }

    /// Applies a record that is being written, and returns its violations.
    pub(crate) fn take(
        &mut self,
        tick: Tick,
        fact: &Fact,
        now: Duration,
        asked: &[(JobId, Control)],
    ) -> Vec<Violation> {
        self.records += 1;
        let place = self.records;
        let mut wrong: Vec<Violation> = self.judge_shared(fact).into_iter().collect();
        match fact {
            Fact::Opened { incarnation } => {
                self.incarnation = *incarnation;
                if !self.incarnations.insert(*incarnation) {
                    wrong.push(Violation::Incarnation { incarnation: *incarnation });
                }
            }
            Fact::Submitted { job, key, spec, .. } => {
                if job.0 <= self.last {
                    wrong.push(Violation::Renumbered { job: *job });
                }
                self.last = self.last.max(job.0);
                if let Some(key) = key {
                    let before = self.keys.insert(key.clone(), *job);
                    wrong.extend(before.map(|before| Violation::KeyMoved { key: key.clone(), jobs: [before, *job] }));
                }
                let frames = spec.frames.clone();
                self.jobs.insert(*job, Record::new(spec.clone(), frames, place));
            }
            Fact::Shared { job, spec, .. } => {
                self.jobs.insert(*job, Record::new(spec.clone(), vec![Stage::OF_JOB], place));
            }
            Fact::Drained { instance, drain } => match drain {
                Drain::Begin => drop(self.drained.insert(*instance, (self.incarnation, now))),
                Drain::Undo => drop(self.drained.remove(instance)),
            },
            Fact::Controlled { job, control } => {
                if !job.is_shared() && !asked.contains(&(*job, control.clone())) {
                    wrong.push(Violation::Unasked { job: *job, control: control.clone() });
                }
                if let Some(record) = self.jobs.get_mut(job) {
                    record.steered(place, control);
                }
            }
            Fact::Doomed { job, failure } => {
                if let Some(record) = self.jobs.get_mut(job) {
                    record.doom = Some(failure.clone());
                    record.stands(place, Standing { doomed: true, ..record.now() });
                }
            }
            Fact::Failed { task, until, .. } => {
                if let Some(record) = self.jobs.get_mut(&task.job) {
                    record.trouble(*task).failed(*until);
                }
            }
            Fact::Died { task, end, casualty } => {
                if let Some(record) = self.jobs.get_mut(&task.job) {
                    (task.index..*end).for_each(|index| record.trouble(TaskKey { index, ..*task }).died(casualty));
                }
            }
            Fact::Lives { instance } => {
                let troubles = self.jobs.values_mut().flat_map(|record| record.troubles.values_mut());
                troubles.for_each(|trouble| trouble.lives(*instance));
            }
            // Also a finished frame whose image was lost. The time that it took still counts.
            Fact::Restarted { job, frame } => {
                if let Some(record) = self.jobs.get_mut(job)
                    && let Some(busy) = record.finished.remove(frame)
                {
                    record.busy.insert(*frame, busy);
                    let finished = record.finished.len() as u32;
                    record.stands(place, Standing { finished, ..record.now() });
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
                    // A success resets the failures. If the result is lost later, the task is tried afresh.
                    if result.task.stage.kind.is_cut() {
                        record.troubles.remove(&tried(result.task));
                    }
                    *record.busy.entry(frame).or_default() += result.result.seconds;
                    if result.finishes(&record.spec) {
                        let busy = record.busy.remove(&frame).unwrap_or(0.0);
                        record.finished.insert(frame, busy);
                        record.troubles.retain(|task, _| task.stage.frame != frame);
                        let finished = record.finished.len() as u32;
                        // A job that finishes while paused is not paused any more.
                        let is_done = record.finished.len() == record.frames.len();
                        let hold = if is_done { Hold::Free } else { record.now().hold };
                        record.stands(place, Standing { finished, hold, ..record.now() });
                    }
                }
            }
        }
        self.note_shared(fact, now);
        self.note_ends(fact, tick);
        wrong
    }

    /// Notes when jobs end: the job of the record, and the jobs that may wait for it.
    fn note_ends(&mut self, fact: &Fact, tick: Tick) {
        let Some(job) = job_of(fact) else { return };
        let of = |other: &&JobId| **other == job || job.is_shared();
        let ended = |job: &JobId| self.jobs.get(job).is_some_and(|it| it.has_ended() || self.is_blocked(it));
        let ends: Vec<(JobId, bool)> = self.jobs.keys().filter(of).map(|job| (*job, ended(job))).collect();
        for (job, has_ended) in ends {
            let Some(record) = self.jobs.get_mut(&job) else { continue };
            record.ended = if has_ended { record.ended.or(Some(tick)) } else { None };
        }
    }

    /// Expires a job. It must have ended long enough ago.
    fn forget(&mut self, job: JobId, tick: Tick) -> Option<Violation> {
        self.forgotten.insert(job);
        self.keys.retain(|_, other| *other != job);
        let record = self.jobs.remove(&job).filter(|_| !job.is_shared())?;
        let is_due = record.ended.zip(self.keep_ended).is_some_and(|(ended, keep)| tick.since(ended) >= keep);
        (!is_due).then_some(Violation::ForgottenEarly { job })
    }

    /// Checks a lease to a worker's process against drains. A drain survives restarts of the coordinator.
    pub(crate) fn may_work(&self, instance: u64, incarnation: u32, now: Duration) -> Option<Violation> {
        /// Longer than any earlier message travels.
        const SLACK: Duration = Duration::from_secs(25);
        let (under, since) = *self.drained.get(&instance)?;
        (incarnation > under || now.saturating_sub(since) > SLACK).then_some(Violation::Drained { instance })
    }

    /// Returns the time at which an operator drained a worker's process, if it is drained.
    pub(crate) fn drained_since(&self, instance: u64) -> Option<Duration> {
        self.drained.get(&instance).map(|(_, since)| *since)
    }

    /// Checks that an answer agrees with the log at some position since `place`.
    pub(crate) fn agrees(&self, status: &JobStatus, place: Place) -> Option<Violation> {
        let job = status.job;
        let wrong = |what: String| Some(Violation::Answer { job, what });
        let Some(record) = self.jobs.get(&job) else {
            let is_known = self.has_forgotten(job);
            return if is_known { None } else { wrong("the job exists".into()) };
        };
        let spec = &record.spec;
        if (&status.name, &status.owner, status.frames_total as usize) != (&spec.name, &spec.owner, spec.frames.len()) {
            return wrong(format!("the job is {} of {}", status.name, status.owner));
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
            return wrong(format!("{state:?}, {frames_done} frames done, {frames_failed} failed, priority {priority}"));
        }
        let trouble = |task: &TaskKey| self.jobs.get(&task.job)?.troubles.get(&tried(*task));
        let tries = |task: &TaskKey| trouble(task).map_or(0, Trouble::tries);
        let is_invented = |it: &&Quarantined| {
            let is_known = it.attempts <= tries(&it.task) && trouble(&it.task).is_some_and(Trouble::is_aside);
            !is_known && !self.has_forgotten(it.task.job) && !self.is_retried_since(it.task.job, place)
        };
        let invented = status.quarantined.iter().find(is_invented);
        invented.map(|it| Violation::Attempts { task: it.task, answered: it.attempts, logged: tries(&it.task) })
    }

    /// Checks whether somebody retried the job's tasks since `place`.
    pub(crate) fn is_retried_since(&self, job: JobId, place: Place) -> bool {
        self.jobs.get(&job).is_some_and(|record| record.is_retried_since(place))
    }

    /// Checks that a new lease is not of a quarantined task.
    pub(crate) fn may_lease(&self, task: TaskKey, epoch: Epoch) -> Option<Violation> {
        let until = self.jobs.get(&task.job)?.troubles.get(&tried(task))?.until?;
        (epoch > until).then_some(Violation::Aside { task, epoch })
    }

    /// Checks whether the failure of a job is explained: by its doom, or by quarantined tasks.
    pub(crate) fn explains(&self, status: &JobStatus) -> bool {
        let Some(record) = self.jobs.get(&status.job) else { return true };
        match &record.doom {
            Some(doom) => status.failure.as_ref() == Some(doom),
            None => !status.quarantined.is_empty(),
        }
    }

    /// Checks that a control that was acknowledged since `place` is in the log by now.
    pub(crate) fn holds(&self, job: JobId, control: &Control, place: Place) -> Option<Violation> {
        let record = self.jobs.get(&job)?;
        let is_written = record.controls.iter().any(|(at, written)| *at > place && written == control);
        let is_so = |standing: Standing| match control {
            Control::Pause => standing.hold == Hold::Paused,
            Control::Resume => standing.hold == Hold::Free,
            // A deleted job has no record.
            Control::Cancel | Control::Delete => false,
            Control::Retry | Control::RetryFrames(_) => standing.hold != Hold::Cancelled && !standing.doomed,
            Control::Priority(priority) => standing.priority == *priority,
        };
        let holds = is_written || record.since(place).any(is_so);
        (!holds).then(|| Violation::Unwritten { job, control: control.clone() })
    }

    /// Checks that a refusal because the job has ended was right at some position since `place`.
    pub(crate) fn may_refuse(&self, job: JobId, control: &Control, place: Place) -> Option<Violation> {
        let record = self.jobs.get(&job)?;
        let frames = record.spec.frames.len() as u32;
        let is_retry = matches!(control, Control::Retry | Control::RetryFrames(_));
        let has_ended = |standing: Standing| match is_retry {
            true => standing.finished == frames,
            false => standing.hold == Hold::Cancelled || standing.doomed || standing.finished == frames,
        };
        let is_blocked = !is_retry && self.is_blocked(record);
        let is_right = is_blocked || record.since(place).any(has_ended);
        (!is_right).then(|| Violation::Refused { job, control: control.clone() })
    }

    /// Returns the seconds of the results of a finished frame.
    pub(crate) fn busy(&self, job: JobId, frame: u32) -> Option<f64> {
        self.jobs.get(&job)?.finished.get(&frame).copied()
    }
}

/// Failures after which a task is quarantined.
const ATTEMPTS: u32 = 3;
/// Deaths of workers after which a task is quarantined.
const DEATHS: usize = 5;

impl Record {
    fn is_retried_since(&self, place: Place) -> bool {
        self.controls
            .iter()
            .any(|(at, control)| *at > place && matches!(control, Control::Retry | Control::RetryFrames(_)))
    }

    fn steered(&mut self, place: Place, control: &Control) {
        self.controls.push((place, control.clone()));
        let before = self.now();
        let after = match control {
            Control::Pause => Standing { hold: Hold::Paused, ..before },
            Control::Resume => Standing { hold: Hold::Free, ..before },
            Control::Cancel => Standing { hold: Hold::Cancelled, ..before },
            Control::Retry => Standing { hold: Hold::Free, doomed: false, ..before },
            Control::Priority(priority) => Standing { priority: *priority, ..before },
            Control::RetryFrames(_) | Control::Delete => before,
        };
        self.stands(place, after);
        match control {
            Control::Retry => {
                self.troubles.clear();
                self.doom = None;
            }
            Control::RetryFrames(frames) => self.troubles.retain(|task, _| !frames.contains(&task.stage.frame)),
            Control::Pause | Control::Resume | Control::Cancel | Control::Priority(_) | Control::Delete => {}
        }
    }
}
