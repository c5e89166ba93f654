//! Promises on the queues of workers, each held against what passes between coordinators and workers.
//!
//! Depth: tasks that wait at a worker are worth little time by the pace of their own job and stage. Back-off: a worker on which the
//! tasks of a job fail pauses for longer and longer. Order: no worker computes for anybody while it could join what is finished.
//! Drain: a drained worker keeps no task that it has not begun.
//!
//! The durations are those that the simulation has drawn; nothing here asks the scheduler.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

use femc_model::{Assignment, Epoch, Failure, FromWorker, JobId, Lane, Phase, TaskKey};
use femc_schedule::{Config, Fact};

use crate::audit::Violation;
use crate::faults::Fault;
use crate::leases::SessionNumber;
use crate::paces::Paces;
use crate::shared::State;
use crate::tasks::job_of;

/// Bits of an epoch that count the leases of one incarnation.
const LEASE_BITS: u32 = 40;
/// Failures of different tasks, none done in between, after which a worker pauses.
const FAILURES: usize = 3;
/// Expected duration of a task while no task of its stage is done, in milliseconds.
const FIRST: u64 = 1_000;
/// Grants are kept for this time.
const MEMORY: Duration = Duration::from_secs(60);

type LeaseKey = (Epoch, TaskKey);

fn incarnation(epoch: Epoch) -> u32 {
    (epoch.0 >> LEASE_BITS) as u32
}

fn lane(task: &TaskKey) -> Lane {
    task.stage.kind.row().lane
}

/// A lease that a worker holds.
#[derive(Debug, Clone, Copy)]
struct Held {
    /// Least time that its coordinator can expect of it, in milliseconds.
    least: u64,
    /// It was given after the worker was to pause.
    is_probe: bool,
    /// Its worker has said that it is computed.
    is_computed: bool,
    /// Its worker has said that it panicked, at this time.
    panicked: Option<Duration>,
}

impl Held {
    /// A lease of an earlier session.
    const BROUGHT: Self = Self { least: 0, is_probe: false, is_computed: false, panicked: None };
}

/// Failures of one job on one worker with no task done in between.
#[derive(Debug, Default)]
struct Streak {
    tasks: BTreeSet<TaskKey>,
    /// Time of the failure with which the first pause begins.
    pauses: Option<Duration>,
    /// Leases that were given after that and failed.
    probes: u32,
}

impl Streak {
    /// A task has failed at this time; whether the first pause begins.
    fn failed(&mut self, task: TaskKey, is_probe: bool, at: Duration) -> bool {
        self.tasks.insert(task);
        if self.pauses.is_some() {
            self.probes += u32::from(is_probe);
            return false;
        }
        if self.tasks.len() >= FAILURES {
            self.pauses = Some(at);
        }
        self.pauses.is_some()
    }

    /// No task is leased before: each pause is twice as long as the one before it.
    fn ends(&self, limits: &Config) -> Option<Duration> {
        let pause = |number: u32| limits.rest.saturating_mul(1 << number.min(20)).min(limits.longest_rest);
        let pauses: u64 = (0..=self.probes).map(pause).sum();
        self.pauses.map(|begun| begun + Duration::from_millis(pauses))
    }
}

/// A worker's session.
#[derive(Debug)]
struct Seat {
    host: usize,
    instance: u64,
    engine: String,
    held: BTreeMap<LeaseKey, Held>,
    streaks: BTreeMap<JobId, Streak>,
}

impl Seat {
    fn held_in(&self, wanted: Lane) -> impl DoubleEndedIterator<Item = (&LeaseKey, &Held)> {
        self.held.iter().filter(move |((_, task), _)| lane(task) == wanted)
    }

    /// Tasks that compute and wait behind the one that runs. A worker computes one task after the other, in the order in which it
    /// gets them: before one that has begun, all are computed.
    fn waiting<'a>(&'a self, begun: &'a BTreeSet<LeaseKey>) -> impl Iterator<Item = (&'a LeaseKey, &'a Held)> {
        let last = self.held_in(Lane::Compute).map(|(key, _)| *key).rfind(|key| begun.contains(key));
        let unfinished = self
            .held_in(Lane::Compute)
            .filter(move |(key, held)| !held.is_computed && last.is_none_or(|last| **key >= last));
        unfinished.skip(1)
    }
}

/// A lease of a task that computes, as it was given out.
#[derive(Debug)]
struct Grant {
    at: Duration,
    key: LeaseKey,
    instance: u64,
    engine: String,
    /// Tasks that join which the worker held.
    joins: usize,
}

/// The queues of all workers as seen on the way.
#[derive(Debug, Default)]
pub(crate) struct Queues {
    /// Durations of tasks, and the farm's settings.
    pub(crate) world: Option<(Paces, Config)>,
    /// Coordinators' clocks are not right.
    is_untimed: bool,
    seats: BTreeMap<SessionNumber, Seat>,
    /// Leases whose computation has begun.
    begun: BTreeSet<LeaseKey>,
    /// Stages of jobs of which a coordinator knows a task that is done, and since when.
    known: BTreeMap<(u32, JobId, u16), Duration>,
    /// Stages of jobs whose leases outlived a session: a coordinator may take them for shorter than they are.
    blurred: BTreeSet<(JobId, u16)>,
    /// Jobs of which tasks failed on a process.
    troubled: BTreeSet<(JobId, u64)>,
    /// Tasks that were leased.
    leased: BTreeSet<TaskKey>,
    /// Latest record on a frame of a job.
    frames: BTreeMap<(JobId, u32), Duration>,
    /// Latest record on a job that is on no frame of it.
    jobs: BTreeMap<JobId, Duration>,
    /// Latest leases that compute, oldest first.
    grants: VecDeque<Grant>,
}

impl Queues {
    /// Faults that may come from now on.
    pub(crate) fn expect(&mut self, mut faults: impl Iterator<Item = Fault>) {
        let is_clock = |fault| matches!(fault, Fault::ClockJumps(..) | Fault::ClockDrifts(..));
        self.is_untimed |= faults.any(is_clock);
    }

    /// A log begins that knows of nothing.
    pub(crate) fn anew(&mut self) {
        self.known.clear();
        self.blurred.clear();
        self.troubled.clear();
        self.leased.clear();
        self.frames.clear();
        self.jobs.clear();
        self.grants.clear();
        self.seats.values_mut().for_each(|seat| seat.streaks.clear());
    }

    /// Keeps nothing of this job and those before it.
    pub(crate) fn forget_until(&mut self, last: JobId) {
        self.begun.retain(|(_, task)| task.job > last);
        self.known.retain(|(_, job, _), _| *job > last);
        self.blurred.retain(|(job, _)| *job > last);
        self.troubled.retain(|(job, _)| *job > last);
        self.leased.retain(|task| task.job > last);
        self.frames.retain(|(job, _), _| *job > last);
        self.jobs.retain(|job, _| *job > last);
    }

    /// A session of a worker's process begins, and these leases come with it.
    pub(crate) fn joined(
        &mut self,
        session: SessionNumber,
        [host, instance]: [u64; 2],
        engine: &str,
        brought: impl Iterator<Item = LeaseKey>,
    ) {
        let held: BTreeMap<LeaseKey, Held> = brought.map(|key| (key, Held::BROUGHT)).collect();
        self.blurred.extend(held.keys().map(|(_, task)| (task.job, task.stage.number)));
        let engine = engine.to_owned();
        let seat = Seat { host: host as usize, instance, engine, held, streaks: BTreeMap::new() };
        self.seats.insert(session, seat);
    }

    /// A session ends.
    pub(crate) fn left(&mut self, session: SessionNumber) {
        self.seats.remove(&session);
    }

    /// A worker begins to compute.
    pub(crate) fn begins(&mut self, task: TaskKey, epoch: Epoch) {
        self.begun.insert((epoch, task));
    }

    /// Something is written on a frame or a job.
    pub(crate) fn written(&mut self, fact: &Fact, now: Duration) {
        let frame = match fact {
            Fact::Done { task, .. } | Fact::Failed { task, .. } | Fact::Died { task, .. } | Fact::Lost { task } => {
                Some((task.job, task.stage.frame))
            }
            Fact::Restarted { job, frame } | Fact::Built { job, frame, .. } => Some((*job, *frame)),
            _ => None,
        };
        match (frame, job_of(fact)) {
            (Some(frame), _) => drop(self.frames.insert(frame, now)),
            (None, Some(job)) => drop(self.jobs.insert(job, now)),
            (None, None) => {}
        }
    }

    /// A lease of a session is over.
    pub(crate) fn over(&mut self, session: SessionNumber, task: TaskKey, epoch: Epoch) {
        if let Some(seat) = self.seats.get_mut(&session) {
            seat.held.remove(&(epoch, task));
        }
    }
}

impl State {
    /// A worker says something; a drained one that still has tasks waiting breaks a promise. Heartbeats come twice a second, and the
    /// answer to the first one after the drain says that the worker is drained.
    pub(crate) fn hears_worker(
        &mut self,
        session: SessionNumber,
        message: &FromWorker,
        now: Duration,
    ) -> Option<Violation> {
        let Self { queues, chronicle, late, .. } = self;
        let seat = queues.seats.get_mut(&session)?;
        match message {
            FromWorker::Heartbeat { tasks, .. } => {
                for progress in tasks.iter().filter(|progress| progress.phase == Phase::Uploading) {
                    if let Some(held) = seat.held.get_mut(&(progress.epoch, progress.task)) {
                        held.is_computed = true;
                    }
                }
                let since = chronicle.drained_since(seat.instance)?;
                /// Longer than all answers to heartbeats of a while are late.
                const LATE: Duration = Duration::from_secs(20);
                let slack = if *late > 0 { LATE } else { Duration::ZERO } + chronicle.contents.patience.longest();
                let waits = tasks.iter().find(|progress| progress.phase == Phase::Waiting)?;
                let milliseconds = now.saturating_sub(since).as_millis() as u64;
                let kept = Violation::Kept { instance: seat.instance, task: waits.task, milliseconds, at: now };
                (now.saturating_sub(since) > slack).then_some(kept)
            }
            FromWorker::Completed { task, .. } => {
                seat.streaks.remove(&task.job);
                None
            }
            FromWorker::Failed { task, epoch, failure, .. } => {
                let is_given_back = *failure == Failure::Cancelled;
                if let Some(held) = seat.held.get_mut(&(*epoch, *task)) {
                    held.is_computed = true;
                    held.panicked = matches!(failure, Failure::Panicked { .. }).then_some(now);
                }
                if !is_given_back {
                    queues.troubled.insert((task.job, seat.instance));
                } else if chronicle.drained_since(seat.instance).is_some() {
                    self.did("tasks given back by drained workers");
                }
                None
            }
            _ => None,
        }
    }

    /// A coordinator has taken a report: the lease is over.
    pub(crate) fn takes_report(&mut self, session: SessionNumber, task: TaskKey, epoch: Epoch, now: Duration) {
        let is_done = self.reported.contains(&(task, epoch));
        let sick = self.sick;
        let Self { queues, .. } = self;
        let Some(seat) = queues.seats.get_mut(&session) else { return };
        let Some(held) = seat.held.remove(&(epoch, task)) else { return };
        if is_done {
            seat.streaks.remove(&task.job);
            queues.known.entry((incarnation(epoch), task.job, task.stage.number)).or_insert(now);
        }
        if let Some(at) = held.panicked {
            let pauses = seat.streaks.entry(task.job).or_default().failed(task, held.is_probe, at);
            let is_alone = sick == Some(seat.host);
            if pauses {
                self.did(if is_alone { "pauses of lone sick workers" } else { "pauses of other sick workers" });
            }
        }
    }

    /// A coordinator gives a lease out.
    pub(crate) fn leases_out(&mut self, session: SessionNumber, lease: &Assignment, now: Duration) -> Vec<Violation> {
        let wrong =
            [self.pauses(session, lease, now), self.goes_deep(session, lease, now), self.starves(session, lease)];
        let patience = self.chronicle.contents.patience.longest();
        let Self { queues, chronicle, .. } = self;
        let Some(seat) = queues.seats.get_mut(&session) else { return Vec::new() };
        let (task, key) = (lease.task, (lease.epoch, lease.task));
        let spec = chronicle.spec(task.job);
        let own = queues.world.as_ref().zip(spec).map_or(0, |((paces, _), spec)| paces.least(lease, spec));
        let known = queues.known.get(&(incarnation(lease.epoch), task.job, task.stage.number));
        let is_known = known.is_some_and(|&since| now.saturating_sub(since) > patience);
        let least = if queues.blurred.contains(&(task.job, task.stage.number)) {
            0
        } else if is_known {
            own
        } else {
            own.min(FIRST)
        };
        let is_probe = seat.streaks.get(&task.job).is_some_and(|streak| streak.pauses.is_some());
        if lane(&task) == Lane::Compute && lease.copy_of.is_none() {
            let (joins, engine) = (seat.held_in(Lane::Join).count(), seat.engine.clone());
            queues.grants.push_back(Grant { at: now, key, instance: seat.instance, engine, joins });
            while queues.grants.front().is_some_and(|grant| now.saturating_sub(grant.at) > MEMORY) {
                queues.grants.pop_front();
            }
        }
        seat.held.insert(key, Held { least, is_probe, is_computed: false, panicked: None });
        queues.leased.insert(task);
        wrong.into_iter().flatten().collect()
    }

    /// After three tasks of a job have failed on a worker, it gets no task of the job for a second, then one. Each further failure
    /// doubles the pause. That holds whether the worker is alone or not: beside others the pauses are longer.
    fn pauses(&self, session: SessionNumber, lease: &Assignment, now: Duration) -> Option<Violation> {
        /// The coordinators' clocks count milliseconds.
        const SLACK: Duration = Duration::from_millis(10);
        let (_, limits) = self.queues.world.as_ref().filter(|_| !self.queues.is_untimed)?;
        let seat = self.queues.seats.get(&session)?;
        let streak = seat.streaks.get(&lease.task.job)?;
        let (begun, ends) = (streak.pauses?, streak.ends(limits)?);
        (now + SLACK < ends).then(|| Violation::Hasty {
            instance: seat.instance,
            task: lease.task,
            failures: FAILURES as u32 + streak.probes,
            milliseconds: now.saturating_sub(begun).as_millis() as u64,
            pause: (ends - begun).as_millis() as u64,
            at: now,
        })
    }

    /// A task may wait at a worker behind the one that runs. A second one may wait if the first is worth two seconds at most, and
    /// more if those that wait are worth a fifth of a second at most; and at most 64 beyond the usual ones. The worth of a task is
    /// the least time that it takes by the pace of its own job and stage. Before its coordinator knows any, that is one second.
    /// Of a stage that was adopted from an earlier session nothing is said: its coordinator has not seen how long it took.
    fn goes_deep(&mut self, session: SessionNumber, lease: &Assignment, now: Duration) -> Option<Violation> {
        let (_, limits) = self.queues.world.as_ref().filter(|_| !self.queues.is_untimed)?;
        let seat = self.queues.seats.get(&session).filter(|_| lane(&lease.task) == Lane::Compute)?;
        let waiting: Vec<u64> = seat.waiting(&self.queues.begun).map(|(_, held)| held.least).collect();
        let (count, milliseconds) = (waiting.len(), waiting.iter().sum::<u64>());
        let is_too_much = match count {
            0 => false,
            1 => milliseconds > limits.queue,
            _ => milliseconds >= limits.ahead || count > Config::DEEPEST + limits.prefetch as usize,
        };
        let (instance, task) = (seat.instance, lease.task);
        let is_bounded = limits.ahead < FIRST && milliseconds > 0;
        match count {
            2.. if is_bounded => self.did("leases of short tasks behind several that wait"),
            1 if is_bounded => self.did("leases behind one task that waits"),
            _ => {}
        }
        is_too_much.then_some(Violation::Deep { instance, task, count, milliseconds, at: now })
    }

    /// A task that joins waits for no task that computes: from the moment when nothing of its frame is left to do before it, no worker
    /// that could take it is given a task that computes, of its job or of any other. Judged is the first lease of such a task. A worker
    /// could take it if it is of the same build, holds at most one other task that joins, and no task of the job has failed there.
    /// That the log says so must have reached the workers.
    fn starves(&mut self, session: SessionNumber, lease: &Assignment) -> Option<Violation> {
        let queues = &self.queues;
        let TaskKey { job, stage, .. } = lease.task;
        let seat = queues.seats.get(&session)?;
        let reads_content = self.chronicle.spec(job)?.graph.reads_content(stage.number);
        let is_first = lease.copy_of.is_none() && !queues.leased.contains(&lease.task);
        if lane(&lease.task) != Lane::Join || reads_content || !is_first {
            return None;
        }
        let frame = queues.frames.get(&(job, stage.frame)).copied().unwrap_or_default();
        let since = frame.max(queues.jobs.get(&job).copied().unwrap_or_default());
        let from = since + self.chronicle.contents.patience.longest();
        let could = |grant: &&Grant| {
            grant.at > from
                && incarnation(grant.key.0) == incarnation(lease.epoch)
                && grant.engine == seat.engine
                && grant.joins <= 1
                && !queues.troubled.contains(&(job, grant.instance))
        };
        let starved = queues.grants.iter().find(could).map(|grant| Violation::Starved {
            task: lease.task,
            instance: grant.instance,
            other: grant.key.1,
            milliseconds: grant.at.saturating_sub(since).as_millis() as u64,
            at: grant.at,
        });
        let owner = |job: JobId| self.chronicle.spec(job).map(|spec| spec.owner.as_str());
        let is_beside = seat.waiting(&queues.begun).any(|((_, task), _)| owner(task.job) != owner(job));
        if is_beside {
            self.did("joins beside waiting tasks of another owner");
        }
        starved
    }
}
