//! History of jobs and workers, derived from the records of the log alone. Also checks each record against it.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use femc_model::{
    Control, Drain, Epoch, Failure, JobId, JobSpec, JobState, JobStatus, QuarantinedTask, Stage, TaskKey, Tick,
};
use femc_schedule::{DeathEvidence, Fact, WorkerDeath};

use crate::audit::Violation;
use crate::shared_stages::SharedStages;
use crate::tasks::{counted_result, fact_job, failure_key};

/// Position in the log: number of records so far.
pub(crate) type LogPosition = u64;

/// Effect of the controls of a person on a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ControlState {
    Free,
    Paused,
    Cancelled,
}

/// State of a job at one position of the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct JobSnapshot {
    finished: u32,
    control: ControlState,
    has_failed: bool,
    priority: u8,
}

/// Failures of a task.
#[derive(Debug, Default)]
struct TaskFailures {
    failures: u32,
    /// Deaths of workers, by lease.
    deaths: BTreeMap<Epoch, WorkerDeath>,
    /// Last epoch before failures quarantined the task. Later leases must not be of this task.
    quarantined_after: Option<Epoch>,
}

impl TaskFailures {
    /// Checks whether the task is quarantined: after three failures, or after five deaths that are proved by a worker's journal or
    /// are of several workers.
    fn is_quarantined(&self) -> bool {
        let known = self.deaths.values().filter(|death| death.evidence == DeathEvidence::Journal).count();
        let workers: BTreeSet<&str> = self.deaths.values().map(|death| death.worker.as_str()).collect();
        self.failures >= MAX_FAILURES || known >= MAX_DEATHS || (self.deaths.len() >= MAX_DEATHS && workers.len() > 1)
    }

    fn attempts(&self) -> u32 {
        self.failures + self.deaths.len() as u32
    }

    fn add_failure(&mut self, until: Epoch) {
        self.failures += 1;
        if self.failures >= MAX_FAILURES {
            self.quarantined_after.get_or_insert(until);
        }
    }

    fn add_death(&mut self, worker_death: &WorkerDeath) {
        let known = self.deaths.entry(worker_death.epoch).or_insert_with(|| worker_death.clone());
        known.evidence = known.evidence.max(worker_death.evidence);
    }

    /// Notes that a process is alive, so a presumed death of it is withdrawn. A quarantined task stays quarantined.
    fn withdraw_presumed_deaths(&mut self, instance: u64) {
        if !self.is_quarantined() {
            self.deaths.retain(|_, death| (death.instance, death.evidence) != (instance, DeathEvidence::Presumed));
        }
    }
}

/// A job, or a set of shared stages.
#[derive(Debug)]
pub(crate) struct JobHistory {
    pub(crate) spec: Box<JobSpec>,
    /// Frames of the job. Shared stages have one frame that stands for them.
    pub(crate) frames: Vec<u32>,
    /// States of the job, each with the position from which it holds.
    states: Vec<(LogPosition, JobSnapshot)>,
    controls: Vec<(LogPosition, Control)>,
    /// Failures of tasks since the last retry.
    task_failures: BTreeMap<TaskKey, TaskFailures>,
    /// Seconds of the results of each unfinished frame.
    busy: BTreeMap<u32, f64>,
    /// Seconds of the results of each finished frame.
    finished: BTreeMap<u32, f64>,
    failure: Option<Failure>,
    /// Time at which the job ended last, on the coordinator's clock.
    ended: Option<Tick>,
}

impl JobHistory {
    fn new(spec: Box<JobSpec>, frames: Vec<u32>, position: LogPosition) -> Self {
        let first =
            JobSnapshot { finished: 0, control: ControlState::Free, has_failed: false, priority: spec.priority };
        Self {
            spec,
            frames,
            states: vec![(position, first)],
            controls: Vec::new(),
            task_failures: BTreeMap::new(),
            busy: BTreeMap::new(),
            finished: BTreeMap::new(),
            failure: None,
            ended: None,
        }
    }

    fn current(&self) -> JobSnapshot {
        self.states.last().map_or(
            JobSnapshot { finished: 0, control: ControlState::Free, has_failed: false, priority: self.spec.priority },
            |(_, last)| *last,
        )
    }

    pub(crate) fn has_ended(&self) -> bool {
        self.is_cancelled_or_failed() || self.current().finished as usize == self.frames.len()
    }

    /// Checks whether the job is cancelled or doomed. Only a retry can continue it.
    pub(crate) fn is_cancelled_or_failed(&self) -> bool {
        let JobSnapshot { control: hold, has_failed: doomed, .. } = self.current();
        hold == ControlState::Cancelled || doomed
    }

    /// Checks that the job is not paused, cancelled or doomed.
    pub(crate) fn may_run(&self) -> bool {
        let JobSnapshot { control: hold, has_failed: doomed, .. } = self.current();
        hold == ControlState::Free && !doomed
    }

    /// Checks that a frame is unfinished and none of its tasks is quarantined.
    pub(crate) fn is_pending(&self, frame: u32) -> bool {
        let mut aside = self.task_failures.iter().filter(|(_, trouble)| trouble.is_quarantined());
        !self.finished.contains_key(&frame) && !aside.any(|(task, _)| task.stage.frame == frame)
    }

    /// Checks whether a task of the job is quarantined.
    pub(crate) fn has_quarantined_task(&self) -> bool {
        self.task_failures.values().any(TaskFailures::is_quarantined)
    }

    fn failures_of(&mut self, task: TaskKey) -> &mut TaskFailures {
        self.task_failures.entry(failure_key(task)).or_default()
    }

    fn push_state(&mut self, position: LogPosition, state: JobSnapshot) {
        if state != self.current() {
            self.states.push((position, state));
        }
    }

    /// Returns the states of the job since a position.
    fn states_since(&self, position: LogPosition) -> impl Iterator<Item = JobSnapshot> + '_ {
        let first = self.states.iter().rposition(|(at, _)| *at <= position).unwrap_or(0);
        self.states.iter().skip(first).map(|(_, standing)| *standing)
    }
}

/// History of the log so far.
#[derive(Debug, Default)]
pub(crate) struct History {
    records: LogPosition,
    pub(crate) jobs: BTreeMap<JobId, JobHistory>,
    pub(crate) shared_stages: SharedStages,
    last: u64,
    keys: BTreeMap<String, JobId>,
    expired: BTreeSet<JobId>,
    /// Incarnations of all logs so far.
    incarnations: BTreeSet<u32>,
    /// Drained workers, each with the incarnation and the time of that record.
    drained: BTreeMap<u64, (u32, Duration)>,
    incarnation: u32,
    /// Last job that is not tracked any more. All earlier jobs are not tracked either.
    last_dropped: u64,
    /// Milliseconds after which an ended job may expire.
    pub(crate) keep_ended: Option<u64>,
}

impl History {
    pub(crate) fn position(&self) -> LogPosition {
        self.records
    }

    /// Begins an empty log.
    pub(crate) fn reset(&mut self) {
        let before = std::mem::take(self);
        let Self { incarnations, keep_ended, records, shared_stages: contents, .. } = before;
        *self = Self { incarnations, keep_ended, records, shared_stages: contents.reset(), ..Self::default() };
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

    pub(crate) fn has_expired(&self, job: JobId) -> bool {
        self.expired.contains(&job) || job.0 <= self.last_dropped
    }

    /// Drops the jobs up to `last`.
    pub(crate) fn drop_until(&mut self, last: JobId) {
        self.last_dropped = self.last_dropped.max(last.0);
        self.jobs.retain(|job, _| *job > last);
        self.keys.retain(|_, job| *job > last);
        self.expired.retain(|job| *job > last);
    }

    /// Applies a record that is being written, and returns its violations.
    pub(crate) fn apply(
        &mut self,
        tick: Tick,
        fact: &Fact,
        now: Duration,
        requested: &[(JobId, Control)],
    ) -> Vec<Violation> {
        self.records += 1;
        let position = self.records;
        let mut wrong: Vec<Violation> = self.check_shared_stages(fact).into_iter().collect();
        match fact {
            Fact::CoordinatorStarted { incarnation } => {
                self.incarnation = *incarnation;
                if !self.incarnations.insert(*incarnation) {
                    wrong.push(Violation::IncarnationReused { incarnation: *incarnation });
                }
            }
            Fact::Submitted { job, key, spec, .. } => {
                if job.0 <= self.last {
                    wrong.push(Violation::JobNumberReused { job: *job });
                }
                self.last = self.last.max(job.0);
                if let Some(key) = key {
                    let before = self.keys.insert(key.clone(), *job);
                    wrong.extend(before.map(|before| Violation::KeyMoved { key: key.clone(), jobs: [before, *job] }));
                }
                let frames = spec.frames.clone();
                self.jobs.insert(*job, JobHistory::new(spec.clone(), frames, position));
            }
            Fact::SharedJobBegun { job, spec, .. } => {
                self.jobs.insert(*job, JobHistory::new(spec.clone(), vec![Stage::JOB_FRAME], position));
            }
            Fact::Drained { instance, drain } => match drain {
                Drain::Begin => drop(self.drained.insert(*instance, (self.incarnation, now))),
                Drain::Undo => drop(self.drained.remove(instance)),
            },
            Fact::Controlled { job, control } => {
                if !job.is_shared() && !requested.contains(&(*job, control.clone())) {
                    wrong.push(Violation::UnrequestedControl { job: *job, control: control.clone() });
                }
                if let Some(record) = self.jobs.get_mut(job) {
                    record.apply_control(position, control);
                }
            }
            Fact::JobFailed { job, failure } => {
                if let Some(record) = self.jobs.get_mut(job) {
                    record.failure = Some(failure.clone());
                    record.push_state(position, JobSnapshot { has_failed: true, ..record.current() });
                }
            }
            Fact::Failed { task, until, .. } => {
                if let Some(record) = self.jobs.get_mut(&task.job) {
                    record.failures_of(*task).add_failure(*until);
                }
            }
            Fact::WorkerDied { task, end, death: casualty } => {
                if let Some(record) = self.jobs.get_mut(&task.job) {
                    (task.index..*end)
                        .for_each(|index| record.failures_of(TaskKey { index, ..*task }).add_death(casualty));
                }
            }
            Fact::WorkerReturned { instance } => {
                let troubles = self.jobs.values_mut().flat_map(|record| record.task_failures.values_mut());
                troubles.for_each(|trouble| trouble.withdraw_presumed_deaths(*instance));
            }
            // Also a finished frame whose image was lost. The time that it took still counts.
            Fact::Restarted { job, frame } => {
                if let Some(record) = self.jobs.get_mut(job)
                    && let Some(busy) = record.finished.remove(frame)
                {
                    record.busy.insert(*frame, busy);
                    let finished = record.finished.len() as u32;
                    record.push_state(position, JobSnapshot { finished, ..record.current() });
                }
            }
            Fact::JobRemoved { job } => wrong.extend(self.expire(*job, tick)),
            _ => {}
        }
        if let Some(result) = counted_result(fact).filter(|result| result.task.job.0 > self.last_dropped) {
            let (job, frame) = (result.task.job, result.task.stage.frame);
            match self.jobs.get_mut(&job).filter(|record| !record.has_ended()) {
                None => wrong.push(Violation::CountedAfterEnd { task: result.task, epoch: result.epoch }),
                Some(record) => {
                    // A success resets the failures. If the result is lost later, the task is tried afresh.
                    if result.task.stage.kind.is_divided() {
                        record.task_failures.remove(&failure_key(result.task));
                    }
                    *record.busy.entry(frame).or_default() += result.result.seconds;
                    if result.finishes(&record.spec) {
                        let busy = record.busy.remove(&frame).unwrap_or(0.0);
                        record.finished.insert(frame, busy);
                        record.task_failures.retain(|task, _| task.stage.frame != frame);
                        let finished = record.finished.len() as u32;
                        // A job that finishes while paused is not paused any more.
                        let is_done = record.finished.len() == record.frames.len();
                        let hold = if is_done { ControlState::Free } else { record.current().control };
                        record.push_state(position, JobSnapshot { finished, control: hold, ..record.current() });
                    }
                }
            }
        }
        self.update_shared_stages(fact, now);
        self.update_ends(fact, tick);
        wrong
    }

    /// Notes when jobs end: the job of the record, and the jobs that may wait for it.
    fn update_ends(&mut self, fact: &Fact, tick: Tick) {
        let Some(job) = fact_job(fact) else { return };
        let affected = |other: &&JobId| **other == job || job.is_shared();
        let ended = |job: &JobId| self.jobs.get(job).is_some_and(|it| it.has_ended() || self.is_blocked(it));
        let ends: Vec<(JobId, bool)> = self.jobs.keys().filter(affected).map(|job| (*job, ended(job))).collect();
        for (job, has_ended) in ends {
            let Some(record) = self.jobs.get_mut(&job) else { continue };
            record.ended = if has_ended { record.ended.or(Some(tick)) } else { None };
        }
    }

    /// Expires a job. It must have ended long enough ago.
    fn expire(&mut self, job: JobId, tick: Tick) -> Option<Violation> {
        self.expired.insert(job);
        self.keys.retain(|_, other| *other != job);
        let record = self.jobs.remove(&job).filter(|_| !job.is_shared())?;
        let is_due = record.ended.zip(self.keep_ended).is_some_and(|(ended, keep)| tick.since(ended) >= keep);
        (!is_due).then_some(Violation::ExpiredEarly { job })
    }

    /// Checks a lease to a worker's process against drains. A drain survives restarts of the coordinator.
    pub(crate) fn check_drain(&self, instance: u64, incarnation: u32, now: Duration) -> Option<Violation> {
        /// Longer than any earlier message travels.
        const SLACK: Duration = Duration::from_secs(25);
        let (under, since) = *self.drained.get(&instance)?;
        (incarnation > under || now.saturating_sub(since) > SLACK).then_some(Violation::LeasedToDrained { instance })
    }

    /// Returns the time at which an operator drained a worker's process, if it is drained.
    pub(crate) fn drained_since(&self, instance: u64) -> Option<Duration> {
        self.drained.get(&instance).map(|(_, since)| *since)
    }

    /// Checks that an answer agrees with the log at some position since `position`.
    pub(crate) fn check_status(&self, status: &JobStatus, position: LogPosition) -> Option<Violation> {
        let job = status.job;
        let wrong = |what: String| Some(Violation::WrongAnswer { job, what });
        let Some(record) = self.jobs.get(&job) else {
            let is_known = self.has_expired(job);
            return if is_known { None } else { wrong("the job exists".into()) };
        };
        let spec = &record.spec;
        if (&status.name, &status.owner, status.frames_total as usize) != (&spec.name, &spec.owner, spec.frames.len()) {
            return wrong(format!("the job is {} of {}", status.name, status.owner));
        }
        let frames = status.frames_total;
        let is_so = |standing: JobSnapshot| {
            let JobSnapshot { finished, control: hold, has_failed: doomed, priority } = standing;
            let is_blocked = status.frames_failed > 0 && finished + status.frames_failed == frames;
            (status.frames_done, status.priority, status.failure.is_some()) == (finished, priority, doomed)
                && match status.state {
                    JobState::Done => finished == frames,
                    JobState::Cancelled => hold == ControlState::Cancelled && finished < frames,
                    JobState::Failed => hold != ControlState::Cancelled && finished < frames && (doomed || is_blocked),
                    JobState::Paused => hold == ControlState::Paused && finished < frames && !doomed,
                    JobState::Queued | JobState::Running => hold == ControlState::Free && finished < frames && !doomed,
                }
        };
        if !record.states_since(position).any(is_so) {
            let JobStatus { state, frames_done, frames_failed, priority, .. } = status;
            return wrong(format!("{state:?}, {frames_done} frames done, {frames_failed} failed, priority {priority}"));
        }
        let trouble = |task: &TaskKey| self.jobs.get(&task.job)?.task_failures.get(&failure_key(*task));
        let tries = |task: &TaskKey| trouble(task).map_or(0, TaskFailures::attempts);
        let is_invented = |it: &&QuarantinedTask| {
            let is_known =
                it.attempts <= tries(&it.task) && trouble(&it.task).is_some_and(TaskFailures::is_quarantined);
            !is_known && !self.has_expired(it.task.job) && !self.is_retried_since(it.task.job, position)
        };
        let invented = status.quarantined.iter().find(is_invented);
        invented.map(|it| Violation::TooManyAttempts { task: it.task, answered: it.attempts, logged: tries(&it.task) })
    }

    /// Checks whether somebody retried the job's tasks since `position`.
    pub(crate) fn is_retried_since(&self, job: JobId, position: LogPosition) -> bool {
        self.jobs.get(&job).is_some_and(|record| record.is_retried_since(position))
    }

    /// Checks that a new lease is not of a quarantined task.
    pub(crate) fn check_quarantine(&self, task: TaskKey, epoch: Epoch) -> Option<Violation> {
        let until = self.jobs.get(&task.job)?.task_failures.get(&failure_key(task))?.quarantined_after?;
        (epoch > until).then_some(Violation::LeasedWhileQuarantined { task, epoch })
    }

    /// Checks whether the failure of a job is explained: by its doom, or by quarantined tasks.
    pub(crate) fn explains_failure(&self, status: &JobStatus) -> bool {
        let Some(record) = self.jobs.get(&status.job) else { return true };
        match &record.failure {
            Some(doom) => status.failure.as_ref() == Some(doom),
            None => !status.quarantined.is_empty(),
        }
    }

    /// Checks that a control that was acknowledged since `position` is in the log by now.
    pub(crate) fn check_control(&self, job: JobId, control: &Control, position: LogPosition) -> Option<Violation> {
        let record = self.jobs.get(&job)?;
        let is_written = record.controls.iter().any(|(at, written)| *at > position && written == control);
        let is_so = |standing: JobSnapshot| match control {
            Control::Pause => standing.control == ControlState::Paused,
            Control::Resume => standing.control == ControlState::Free,
            // A deleted job has no record.
            Control::Cancel | Control::Delete => false,
            Control::Retry | Control::RetryFrames(_) => {
                standing.control != ControlState::Cancelled && !standing.has_failed
            }
            Control::Priority(priority) => standing.priority == *priority,
        };
        let holds = is_written || record.states_since(position).any(is_so);
        (!holds).then(|| Violation::LostControl { job, control: control.clone() })
    }

    /// Checks that a refusal because the job has ended was right at some position since `position`.
    pub(crate) fn check_refusal(&self, job: JobId, control: &Control, position: LogPosition) -> Option<Violation> {
        let record = self.jobs.get(&job)?;
        let frames = record.spec.frames.len() as u32;
        let is_retry = matches!(control, Control::Retry | Control::RetryFrames(_));
        let has_ended = |standing: JobSnapshot| match is_retry {
            true => standing.finished == frames,
            false => standing.control == ControlState::Cancelled || standing.has_failed || standing.finished == frames,
        };
        let is_blocked = !is_retry && self.is_blocked(record);
        let is_right = is_blocked || record.states_since(position).any(has_ended);
        (!is_right).then(|| Violation::WrongRefusal { job, control: control.clone() })
    }

    /// Returns the seconds of the results of a finished frame.
    pub(crate) fn busy_seconds(&self, job: JobId, frame: u32) -> Option<f64> {
        self.jobs.get(&job)?.finished.get(&frame).copied()
    }
}

/// Failures after which a task is quarantined.
const MAX_FAILURES: u32 = 3;
/// Deaths of workers after which a task is quarantined.
const MAX_DEATHS: usize = 5;

impl JobHistory {
    fn is_retried_since(&self, position: LogPosition) -> bool {
        self.controls
            .iter()
            .any(|(at, control)| *at > position && matches!(control, Control::Retry | Control::RetryFrames(_)))
    }

    fn apply_control(&mut self, position: LogPosition, control: &Control) {
        self.controls.push((position, control.clone()));
        let before = self.current();
        let after = match control {
            Control::Pause => JobSnapshot { control: ControlState::Paused, ..before },
            Control::Resume => JobSnapshot { control: ControlState::Free, ..before },
            Control::Cancel => JobSnapshot { control: ControlState::Cancelled, ..before },
            Control::Retry => JobSnapshot { control: ControlState::Free, has_failed: false, ..before },
            Control::Priority(priority) => JobSnapshot { priority: *priority, ..before },
            Control::RetryFrames(_) | Control::Delete => before,
        };
        self.push_state(position, after);
        match control {
            Control::Retry => {
                self.task_failures.clear();
                self.failure = None;
            }
            Control::RetryFrames(frames) => self.task_failures.retain(|task, _| !frames.contains(&task.stage.frame)),
            Control::Pause | Control::Resume | Control::Cancel | Control::Priority(_) | Control::Delete => {}
        }
    }
}
