//! What the log says of jobs and workers, record by record, told by the records alone; and what it must never say.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use femc_model::{
    Control, Drain, Epoch, Failure, JobId, JobSpec, JobState, JobStatus, Quarantined, Stage, TaskKey, Tick,
};
use femc_schedule::{Casualty, Evidence, Fact};

use crate::audit::Violation;
use crate::contents::Contents;
use crate::tasks::{counted, job_of, tried};

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

/// What went wrong with a task.
#[derive(Debug, Default)]
struct Trouble {
    failures: u32,
    /// Deaths of workers, by lease.
    deaths: BTreeMap<Epoch, Casualty>,
    /// A failure put it aside, and of what was leased after this one nothing is its.
    until: Option<Epoch>,
}

impl Trouble {
    /// The rule by which a task is put aside: three failures, or five deaths that are known of one worker or are of several.
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

    /// A process lives, and so has not died of it; what is put aside stays so.
    fn lives(&mut self, instance: u64) {
        if !self.is_aside() {
            self.deaths.retain(|_, death| (death.instance, death.evidence) != (instance, Evidence::Presumed));
        }
    }
}

/// A job, or what jobs share.
#[derive(Debug)]
pub(crate) struct Record {
    pub(crate) spec: Box<JobSpec>,
    /// Its frames; of what is shared the one that stands for it.
    pub(crate) frames: Vec<u32>,
    /// Where it stood, from which place on.
    standings: Vec<(Place, Standing)>,
    controls: Vec<(Place, Control)>,
    /// What went wrong with tasks since the last retry.
    troubles: BTreeMap<TaskKey, Trouble>,
    /// Seconds of the results of each frame that is not finished.
    busy: BTreeMap<u32, f64>,
    /// The same of those that are.
    finished: BTreeMap<u32, f64>,
    doom: Option<Failure>,
    /// When it ended last, by the coordinator's clock.
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

    /// Whether nothing more will come of it, unless somebody tries it again.
    pub(crate) fn is_over(&self) -> bool {
        let Standing { hold, doomed, .. } = self.now();
        hold == Hold::Cancelled || doomed
    }

    /// Whether nobody holds it.
    pub(crate) fn may_run(&self) -> bool {
        let Standing { hold, doomed, .. } = self.now();
        hold == Hold::Free && !doomed
    }

    /// Whether a frame is not finished, and none of its tasks is put aside.
    pub(crate) fn is_left(&self, frame: u32) -> bool {
        let mut aside = self.troubles.iter().filter(|(_, trouble)| trouble.is_aside());
        !self.finished.contains_key(&frame) && !aside.any(|(task, _)| task.stage.frame == frame)
    }

    /// Whether a task of it is put aside.
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
    pub(crate) jobs: BTreeMap<JobId, Record>,
    pub(crate) contents: Contents,
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
        let Self { incarnations, keep_ended, records, contents, .. } = before;
        *self = Self { incarnations, keep_ended, records, contents: contents.anew(), ..Self::default() };
    }

    /// The number of the coordinator that began last.
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
            // Also one that was finished, and whose image was lost: what it took was taken.
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
                    // What is done and lost later is tried anew.
                    if result.task.stage.kind.is_cut() {
                        record.troubles.remove(&tried(result.task));
                    }
                    *record.busy.entry(frame).or_default() += result.result.seconds;
                    if result.finishes(&record.spec) {
                        let busy = record.busy.remove(&frame).unwrap_or(0.0);
                        record.finished.insert(frame, busy);
                        record.troubles.retain(|task, _| task.stage.frame != frame);
                        let finished = record.finished.len() as u32;
                        // What was paused and is done all the same is not held any longer.
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

    /// Notes when jobs ended, if they have: the one that a record is about, and those that may wait for what it is about.
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

    /// A job is forgotten: it must have ended long enough ago.
    fn forget(&mut self, job: JobId, tick: Tick) -> Option<Violation> {
        self.forgotten.insert(job);
        self.keys.retain(|_, other| *other != job);
        let record = self.jobs.remove(&job).filter(|_| !job.is_shared())?;
        let is_due = record.ended.zip(self.keep_ended).is_some_and(|(ended, keep)| tick.since(ended) >= keep);
        (!is_due).then_some(Violation::ForgottenEarly { job })
    }

    /// What is wrong with a lease that a worker's process gets: an operator's word holds over restarts of the coordinator.
    pub(crate) fn may_work(&self, instance: u64, incarnation: u32, now: Duration) -> Option<Violation> {
        /// Longer than what was said before is on its way.
        const SLACK: Duration = Duration::from_secs(25);
        let (under, since) = *self.drained.get(&instance)?;
        (incarnation > under || now.saturating_sub(since) > SLACK).then_some(Violation::Drained { instance })
    }

    /// When an operator drained a worker's process, if it is drained.
    pub(crate) fn drained_since(&self, instance: u64) -> Option<Duration> {
        self.drained.get(&instance).map(|(_, since)| *since)
    }

    /// Whether an answer is what the log said at some moment since `place`.
    pub(crate) fn agrees(&self, status: &JobStatus, place: Place) -> Option<Violation> {
        let job = status.job;
        let wrong = |what: String| Some(Violation::Answer { job, what });
        let Some(record) = self.jobs.get(&job) else {
            let is_known = self.has_forgotten(job);
            return if is_known { None } else { wrong("there is such a job".into()) };
        };
        let spec = &record.spec;
        if (&status.name, &status.owner, status.frames_total as usize) != (&spec.name, &spec.owner, spec.frames.len()) {
            return wrong(format!("it is {} of {}", status.name, status.owner));
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

    /// Whether somebody gave the job's tasks another chance since `place`.
    pub(crate) fn is_retried_since(&self, job: JobId, place: Place) -> bool {
        self.jobs.get(&job).is_some_and(|record| record.is_retried_since(place))
    }

    /// What is wrong with a lease that is given out: nothing is leased that failures have put aside.
    pub(crate) fn may_lease(&self, task: TaskKey, epoch: Epoch) -> Option<Violation> {
        let until = self.jobs.get(&task.job)?.troubles.get(&tried(task))?.until?;
        (epoch > until).then_some(Violation::Aside { task, epoch })
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
    pub(crate) fn holds(&self, job: JobId, control: &Control, place: Place) -> Option<Violation> {
        let record = self.jobs.get(&job)?;
        let is_written = record.controls.iter().any(|(at, written)| *at > place && written == control);
        let is_so = |standing: Standing| match control {
            Control::Pause => standing.hold == Hold::Paused,
            Control::Resume => standing.hold == Hold::Free,
            // A job that was deleted is not there.
            Control::Cancel | Control::Delete => false,
            Control::Retry | Control::RetryFrames(_) => standing.hold != Hold::Cancelled && !standing.doomed,
            Control::Priority(priority) => standing.priority == *priority,
        };
        let holds = is_written || record.since(place).any(is_so);
        (!holds).then(|| Violation::Unwritten { job, control: control.clone() })
    }

    /// Whether a refusal because the job has ended is right at some moment since `place`.
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

    /// Seconds of the results of a finished frame.
    pub(crate) fn busy(&self, job: JobId, frame: u32) -> Option<f64> {
        self.jobs.get(&job)?.finished.get(&frame).copied()
    }
}

/// Failures after which a task is put aside.
const ATTEMPTS: u32 = 3;
/// Deaths of workers after which it is.
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
