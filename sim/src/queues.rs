//! Guarantees about the queues of workers. The messages between coordinators and workers are checked against them.
//!
//! Depth: the tasks that wait at a worker take little time, by the pace of their own job and stage. Back-off: a worker on which
//! tasks of a job fail pauses, each time for twice as long. Order: no worker is leased a task that computes while it could join
//! finished results. Drain: a drained worker keeps no task that it has not begun.
//!
//! The checks use the durations that the simulation has drawn. They never ask the scheduler.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

use femc_model::{Assignment, Digest, Epoch, Failure, FailureVerdict, FromWorker, JobId, Lane, Phase, TaskKey};
use femc_schedule::{Config, Fact};

use crate::audit::Violation;
use crate::faults::Fault;
use crate::leases::SessionNumber;
use crate::shared::State;
use crate::switch::MAX_DELAY;
use crate::task_durations::TaskDurations;
use crate::tasks::fact_job;

/// Bits of an epoch that count the leases of one incarnation.
const LEASE_BITS: u32 = 40;
/// Failures of different tasks, none done in between, after which a worker pauses.
const FAILURES_BEFORE_PAUSE: usize = 3;
/// Expected duration of a task before any task of its stage is done, in milliseconds.
const INITIAL_ESTIMATE: u64 = 1_000;
/// Time for which grants are kept.
const GRANT_MEMORY: Duration = Duration::from_secs(60);

type LeaseKey = (Epoch, TaskKey);

fn incarnation(epoch: Epoch) -> u32 {
    (epoch.0 >> LEASE_BITS) as u32
}

fn lane(task: &TaskKey) -> Lane {
    task.stage.kind.properties().lane
}

/// Checks whether a failure counts as a failed attempt of the task: it panicked, or inputs are lost. A lost scene ends the job.
/// - `bundle`: scene of the job.
fn is_of_task(failure: &Failure, bundle: Option<Digest>) -> bool {
    match failure.verdict() {
        FailureVerdict::Retry => true,
        FailureVerdict::Rebuild(lost) => bundle.is_some_and(|bundle| !lost.contains(&bundle)),
        FailureVerdict::Fatal | FailureVerdict::Infrastructure | FailureVerdict::Cancelled => false,
    }
}

/// A lease that a worker holds.
#[derive(Debug, Clone, Copy)]
struct LeaseState {
    /// Shortest duration that its coordinator can expect, in milliseconds.
    min_milliseconds: u64,
    /// Its worker had to pause before this lease.
    is_probe: bool,
    /// Its worker has reported that it is computed.
    is_computed: bool,
    /// Time at which its worker reported a failure of the task itself.
    failed: Option<Duration>,
}

impl LeaseState {
    /// A lease of an earlier session.
    const CARRIED_OVER: Self = Self { min_milliseconds: 0, is_probe: false, is_computed: false, failed: None };
}

/// Failures of one job on one worker with no task done in between.
#[derive(Debug, Default)]
struct FailureStreak {
    tasks: BTreeSet<TaskKey>,
    /// Time of the failure with which the first pause begins.
    first_pause: Option<Duration>,
    /// Failed leases that were granted after that.
    probes: u32,
}

impl FailureStreak {
    /// Counts a failure. Returns whether the first pause begins with it.
    fn add_failure(&mut self, task: TaskKey, is_probe: bool, at: Duration) -> bool {
        self.tasks.insert(task);
        if self.first_pause.is_some() {
            self.probes += u32::from(is_probe);
            return false;
        }
        if self.tasks.len() >= FAILURES_BEFORE_PAUSE {
            self.first_pause = Some(at);
        }
        self.first_pause.is_some()
    }

    /// End of the latest pause: no task is leased before. Each pause is twice as long as the one before it.
    fn pause_end(&self, limits: &Config) -> Option<Duration> {
        let pause = |number: u32| limits.back_off.saturating_mul(1 << number.min(20)).min(limits.max_back_off);
        let pauses: u64 = (0..=self.probes).map(pause).sum();
        self.first_pause.map(|begun| begun + Duration::from_millis(pauses))
    }
}

/// A worker's session.
#[derive(Debug)]
struct WorkerSession {
    host: usize,
    instance: u64,
    engine: String,
    held: BTreeMap<LeaseKey, LeaseState>,
    streaks: BTreeMap<JobId, FailureStreak>,
}

impl WorkerSession {
    fn leases_in(&self, wanted: Lane) -> impl DoubleEndedIterator<Item = (&LeaseKey, &LeaseState)> {
        self.held.iter().filter(move |((_, task), _)| lane(task) == wanted)
    }

    /// Tasks that compute and wait behind the one that runs. A worker computes one task after the other, in the order of their
    /// leases: when one has begun, all before it are computed.
    fn waiting<'a>(&'a self, begun: &'a BTreeSet<LeaseKey>) -> impl Iterator<Item = (&'a LeaseKey, &'a LeaseState)> {
        let last = self.leases_in(Lane::Compute).map(|(key, _)| *key).rfind(|key| begun.contains(key));
        let unfinished = self
            .leases_in(Lane::Compute)
            .filter(move |(key, held)| !held.is_computed && last.is_none_or(|last| **key >= last));
        unfinished.skip(1)
    }
}

/// A lease of a task that computes, at the time when it was granted.
#[derive(Debug)]
struct Grant {
    at: Duration,
    key: LeaseKey,
    instance: u64,
    engine: String,
    /// Number of tasks that join and that the worker held.
    joins: usize,
    /// A session had ended, and its coordinator possibly did not know.
    is_end_unknown: bool,
}

/// The queues of all workers, by the messages of their sessions.
#[derive(Debug, Default)]
pub(crate) struct WorkerQueues {
    /// Durations of tasks, and the farm's settings.
    pub(crate) settings: Option<(TaskDurations, Config)>,
    /// The coordinators' clocks may be wrong.
    has_wrong_clocks: bool,
    workers: BTreeMap<SessionNumber, WorkerSession>,
    /// Leases whose computation has begun.
    begun: BTreeSet<LeaseKey>,
    /// Stages of jobs of which a coordinator knows a finished task, with the time of that result.
    measured_stages: BTreeMap<(u32, JobId, u16), Duration>,
    /// Stages of jobs whose leases outlived a session. A coordinator may expect too little time of their tasks.
    inexact: BTreeSet<(JobId, u16)>,
    /// Jobs whose tasks failed on a worker, with its process.
    failed_on: BTreeSet<(JobId, u64)>,
    /// Tasks that have been leased.
    leased: BTreeSet<TaskKey>,
    /// Time of the latest record about a frame of a job.
    frames: BTreeMap<(JobId, u32), Duration>,
    /// Time of the latest record about a job that is not about one of its frames.
    jobs: BTreeMap<JobId, Duration>,
    /// Latest leases that compute, oldest first.
    grants: VecDeque<Grant>,
    /// Time of the latest end of a session.
    last_end: Option<Duration>,
}

impl WorkerQueues {
    /// Prepares for the faults of a plan.
    pub(crate) fn allow_for(&mut self, mut faults: impl Iterator<Item = Fault>) {
        let is_clock = |fault| matches!(fault, Fault::ClockJumps(..) | Fault::ClockDrifts(..));
        self.has_wrong_clocks |= faults.any(is_clock);
    }

    /// Drops the jobs of a log that is lost.
    pub(crate) fn reset(&mut self) {
        self.measured_stages.clear();
        self.inexact.clear();
        self.failed_on.clear();
        self.leased.clear();
        self.frames.clear();
        self.jobs.clear();
        self.grants.clear();
        self.workers.values_mut().for_each(|worker| worker.streaks.clear());
    }

    /// Drops this job and all earlier ones.
    pub(crate) fn drop_until(&mut self, last: JobId) {
        self.begun.retain(|(_, task)| task.job > last);
        self.measured_stages.retain(|(_, job, _), _| *job > last);
        self.inexact.retain(|(job, _)| *job > last);
        self.failed_on.retain(|(job, _)| *job > last);
        self.leased.retain(|task| task.job > last);
        self.frames.retain(|(job, _), _| *job > last);
        self.jobs.retain(|job, _| *job > last);
    }

    /// Notes the start of a session.
    /// - `host`, `instance`: number of the worker's host, and its process.
    /// - `carried_over`: leases of an earlier session.
    pub(crate) fn begin_session(
        &mut self,
        session: SessionNumber,
        [host, instance]: [u64; 2],
        engine: &str,
        carried_over: impl Iterator<Item = LeaseKey>,
    ) {
        let held: BTreeMap<LeaseKey, LeaseState> = carried_over.map(|key| (key, LeaseState::CARRIED_OVER)).collect();
        self.inexact.extend(held.keys().map(|(_, task)| (task.job, task.stage.number)));
        let engine = engine.to_owned();
        let worker = WorkerSession { host: host as usize, instance, engine, held, streaks: BTreeMap::new() };
        self.workers.insert(session, worker);
    }

    /// Notes the end of a session.
    pub(crate) fn end_session(&mut self, session: SessionNumber, now: Duration) {
        self.workers.remove(&session);
        self.last_end = Some(now);
    }

    /// Notes that a worker begins to compute a task.
    pub(crate) fn observe_start(&mut self, task: TaskKey, epoch: Epoch) {
        self.begun.insert((epoch, task));
    }

    /// Notes the time of a record of the log.
    pub(crate) fn observe_fact(&mut self, fact: &Fact, now: Duration) {
        let frame = match fact {
            Fact::Done { task, .. }
            | Fact::Failed { task, .. }
            | Fact::WorkerDied { task, .. }
            | Fact::OutputsLost { task } => Some((task.job, task.stage.frame)),
            Fact::Restarted { job, frame } | Fact::BuildAssigned { job, frame, .. } => Some((*job, *frame)),
            _ => None,
        };
        match (frame, fact_job(fact)) {
            (Some(frame), _) => drop(self.frames.insert(frame, now)),
            (None, Some(job)) => drop(self.jobs.insert(job, now)),
            (None, None) => {}
        }
    }

    /// Notes that a lease of a session has ended.
    pub(crate) fn observe_lease_end(&mut self, session: SessionNumber, task: TaskKey, epoch: Epoch) {
        if let Some(worker) = self.workers.get_mut(&session) {
            worker.held.remove(&(epoch, task));
        }
    }
}

impl State {
    /// Notes a message of a worker. A heartbeat of a drained worker that still has waiting tasks breaks a guarantee: workers send
    /// two heartbeats per second, and the answer to the first one after the drain tells the worker to return its waiting tasks.
    pub(crate) fn observe_message(
        &mut self,
        session: SessionNumber,
        message: &FromWorker,
        now: Duration,
    ) -> Option<Violation> {
        let Self { queues, history: log_history, delayed: late, .. } = self;
        let worker = queues.workers.get_mut(&session)?;
        match message {
            FromWorker::Heartbeat { tasks, .. } => {
                for progress in tasks.iter().filter(|progress| progress.phase == Phase::Uploading) {
                    if let Some(held) = worker.held.get_mut(&(progress.epoch, progress.task)) {
                        held.is_computed = true;
                    }
                }
                let since = log_history.drained_since(worker.instance)?;
                /// Extra time for worlds in which messages of workers may be late, even several heartbeats in a row.
                const LATE_MESSAGE_SLACK: Duration = Duration::from_secs(20);
                let slack = if *late > 0 { LATE_MESSAGE_SLACK } else { Duration::ZERO }
                    + log_history.shared_stages.propagation_delay.get();
                let waits = tasks.iter().find(|progress| progress.phase == Phase::Waiting)?;
                let milliseconds = now.saturating_sub(since).as_millis() as u64;
                let kept =
                    Violation::KeptWhileDrained { instance: worker.instance, task: waits.task, milliseconds, at: now };
                (now.saturating_sub(since) > slack).then_some(kept)
            }
            FromWorker::Completed { task, .. } => {
                worker.streaks.remove(&task.job);
                None
            }
            FromWorker::Failed { task, epoch, failure, .. } => {
                let is_given_back = *failure == Failure::Cancelled;
                if let Some(held) = worker.held.get_mut(&(*epoch, *task)) {
                    held.is_computed = true;
                    let bundle = log_history.spec(task.job).map(|spec| spec.bundle);
                    held.failed = is_of_task(failure, bundle).then_some(now);
                }
                if !is_given_back {
                    queues.failed_on.insert((task.job, worker.instance));
                } else if log_history.drained_since(worker.instance).is_some() {
                    self.count_action("tasks given back by drained workers");
                }
                None
            }
            _ => None,
        }
    }

    /// Notes that a coordinator has accepted a report, which ends the lease.
    pub(crate) fn observe_accepted(&mut self, session: SessionNumber, task: TaskKey, epoch: Epoch, now: Duration) {
        let is_done = self.reported.contains(&(task, epoch));
        let failing_host = self.failing_worker;
        let Self { queues, .. } = self;
        let Some(worker) = queues.workers.get_mut(&session) else { return };
        let Some(held) = worker.held.remove(&(epoch, task)) else { return };
        if is_done {
            worker.streaks.remove(&task.job);
            queues.measured_stages.entry((incarnation(epoch), task.job, task.stage.number)).or_insert(now);
        }
        if let Some(at) = held.failed {
            let pauses = worker.streaks.entry(task.job).or_default().add_failure(task, held.is_probe, at);
            let is_alone = failing_host == Some(worker.host);
            if pauses {
                self.count_action(if is_alone {
                    "pauses of lone sick workers"
                } else {
                    "pauses of other sick workers"
                });
            }
        }
    }

    /// Notes a new lease, and returns the guarantees that it breaks.
    pub(crate) fn check_lease(&mut self, session: SessionNumber, lease: &Assignment, now: Duration) -> Vec<Violation> {
        let wrong = [
            self.check_pause(session, lease, now),
            self.check_depth(session, lease, now),
            self.check_order(session, lease),
        ];
        let patience = self.history.shared_stages.propagation_delay.get();
        let has_late_messages = self.delayed > 0 || self.duplicated > 0;
        let Self { queues, history: log_history, .. } = self;
        let Some(worker) = queues.workers.get_mut(&session) else { return Vec::new() };
        let (task, key) = (lease.task, (lease.epoch, lease.task));
        let spec = log_history.spec(task.job);
        let own = queues.settings.as_ref().zip(spec).map_or(0, |((paces, _), spec)| paces.min_duration(lease, spec));
        let known = queues.measured_stages.get(&(incarnation(lease.epoch), task.job, task.stage.number));
        let is_known = known.is_some_and(|&since| now.saturating_sub(since) > patience);
        let least = if queues.inexact.contains(&(task.job, task.stage.number)) {
            0
        } else if is_known {
            own
        } else {
            own.min(INITIAL_ESTIMATE)
        };
        let is_probe = worker.streaks.get(&task.job).is_some_and(|streak| streak.first_pause.is_some());
        if lane(&task) == Lane::Compute && lease.copy_of.is_none() {
            let (joins, engine) = (worker.leases_in(Lane::Join).count(), worker.engine.clone());
            let is_end_recent = queues.last_end.is_some_and(|end| now.saturating_sub(end) <= MAX_DELAY + patience);
            let is_end_unknown = has_late_messages && is_end_recent;
            queues.grants.push_back(Grant { at: now, key, instance: worker.instance, engine, joins, is_end_unknown });
            while queues.grants.front().is_some_and(|grant| now.saturating_sub(grant.at) > GRANT_MEMORY) {
                queues.grants.pop_front();
            }
        }
        worker.held.insert(key, LeaseState { min_milliseconds: least, is_probe, is_computed: false, failed: None });
        queues.leased.insert(task);
        wrong.into_iter().flatten().collect()
    }

    /// Back-off: after three tasks of a job have failed on a worker, it is leased no task of the job for one second, and then one
    /// task. Each further failure doubles the pause. Lost inputs are failures, as panics are. The guarantee holds for lone workers
    /// and others: beside a healthy worker the pauses are longer.
    ///
    /// The scheduler counts only the failures that it has accepted, so the check begins at the acceptance. Failures of tasks that
    /// waited at the worker when the pause began do not double the pause. Worlds with wrong clocks are left out.
    fn check_pause(&self, session: SessionNumber, lease: &Assignment, now: Duration) -> Option<Violation> {
        /// The coordinators' clocks count milliseconds.
        const SLACK: Duration = Duration::from_millis(10);
        let (_, limits) = self.queues.settings.as_ref().filter(|_| !self.queues.has_wrong_clocks)?;
        let worker = self.queues.workers.get(&session)?;
        let streak = worker.streaks.get(&lease.task.job)?;
        let (begun, ends) = (streak.first_pause?, streak.pause_end(limits)?);
        (now + SLACK < ends).then(|| Violation::PauseTooShort {
            instance: worker.instance,
            task: lease.task,
            failures: FAILURES_BEFORE_PAUSE as u32 + streak.probes,
            milliseconds: now.saturating_sub(begun).as_millis() as u64,
            pause: (ends - begun).as_millis() as u64,
            at: now,
        })
    }

    /// Depth: one task may always wait behind the running one. A second one may wait if the first takes at most two seconds. More
    /// may wait if all waiting tasks take less than a fifth of a second together, up to 64 beyond the prefetched ones.
    ///
    /// The duration of a task is the shortest one by the pace of its own job and stage. Before a task of the stage is done, it is
    /// at most one second, because its coordinator knows no pace yet. Two kinds of tasks do not count: tiles that take equally long
    /// whatever their size, and tasks of a stage whose leases outlived a session, because their coordinator has not seen all of
    /// their time. Worlds with wrong clocks are left out.
    fn check_depth(&mut self, session: SessionNumber, lease: &Assignment, now: Duration) -> Option<Violation> {
        let (_, limits) = self.queues.settings.as_ref().filter(|_| !self.queues.has_wrong_clocks)?;
        let worker = self.queues.workers.get(&session).filter(|_| lane(&lease.task) == Lane::Compute)?;
        let waiting: Vec<u64> = worker.waiting(&self.queues.begun).map(|(_, held)| held.min_milliseconds).collect();
        let (count, milliseconds) = (waiting.len(), waiting.iter().sum::<u64>());
        let is_too_much = match count {
            0 => false,
            1 => milliseconds > limits.queue,
            _ => milliseconds >= limits.ahead || count > Config::MAX_AHEAD + limits.prefetch as usize,
        };
        let (instance, task) = (worker.instance, lease.task);
        let is_bounded = limits.ahead < INITIAL_ESTIMATE && milliseconds > 0;
        match count {
            2.. if is_bounded => self.count_action("leases of short tasks behind several that wait"),
            1 if is_bounded => self.count_action("leases behind one task that waits"),
            _ => {}
        }
        is_too_much.then_some(Violation::QueueTooDeep { instance, task, count, milliseconds, at: now })
    }

    /// Order: a task that joins does not wait for tasks that compute. After the last record about its frame, no worker that could
    /// take it is leased a task that computes, of this job or of another.
    ///
    /// The check looks back at the first lease of each such task. A worker could take it if it has the same build, held at most one
    /// other task that joins, and no task of the job has failed there. The check allows for the longest time until every host knows
    /// what the log says.
    ///
    /// The task may have been leased before, to a worker that had just died: the relay keeps a session open until its last late
    /// message is sent. No worker receives a lease that the coordinator grants meanwhile. The check leaves out such leases.
    fn check_order(&mut self, session: SessionNumber, lease: &Assignment) -> Option<Violation> {
        let queues = &self.queues;
        let TaskKey { job, stage, .. } = lease.task;
        let worker = queues.workers.get(&session)?;
        let reads_content = self.history.spec(job)?.graph.reads_content(stage.number);
        let is_first = lease.copy_of.is_none() && !queues.leased.contains(&lease.task);
        if lane(&lease.task) != Lane::Join || reads_content || !is_first {
            return None;
        }
        let frame = queues.frames.get(&(job, stage.frame)).copied().unwrap_or_default();
        let since = frame.max(queues.jobs.get(&job).copied().unwrap_or_default());
        let from = since + self.history.shared_stages.propagation_delay.get();
        let could = |grant: &&Grant| {
            grant.at > from
                && !grant.is_end_unknown
                && incarnation(grant.key.0) == incarnation(lease.epoch)
                && grant.engine == worker.engine
                && grant.joins <= 1
                && !queues.failed_on.contains(&(job, grant.instance))
        };
        let starved = queues.grants.iter().find(could).map(|grant| Violation::JoinStarved {
            task: lease.task,
            instance: grant.instance,
            other: grant.key.1,
            milliseconds: grant.at.saturating_sub(since).as_millis() as u64,
            at: grant.at,
        });
        let owner = |job: JobId| self.history.spec(job).map(|spec| spec.owner.as_str());
        let is_beside = worker.waiting(&queues.begun).any(|((_, task), _)| owner(task.job) != owner(job));
        if is_beside {
            self.count_action("joins beside waiting tasks of another owner");
        }
        starved
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panics_and_lost_inputs_are_failures_of_the_task() {
        let [scene, input] = [b"scene".as_slice(), b"input"].map(Digest::compute);
        let (message, limit) = (String::new(), 1);
        let lost = |digest| Failure::LostInputs { digests: vec![digest], message: message.clone() };
        assert!(is_of_task(&Failure::Panicked { message: message.clone() }, Some(scene)));
        assert!(is_of_task(&lost(input), Some(scene)));
        assert!(!is_of_task(&lost(scene), Some(scene)), "the job ends");
        assert!(!is_of_task(&Failure::Store { message: message.clone() }, Some(scene)));
        assert!(!is_of_task(&Failure::TooLarge { limit }, Some(scene)));
        assert!(!is_of_task(&Failure::Cancelled, Some(scene)));
    }
}
