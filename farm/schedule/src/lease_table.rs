//! Who is there and who holds what: the half of the state that a restart forgets.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use femc_model::{
    Epoch, Failure, Intake, JobId, Phase, Registration, Stage, StageKind, TaskKey, TaskProgress, Tick, WorkerId,
};

use crate::Config;
use crate::affinity::AtHand;

/// A lease's name: a task may be leased twice, see `speculate.rs`.
pub(crate) type LeaseKey = (TaskKey, Epoch);

/// A worker's session.
#[derive(Debug, Clone)]
pub(crate) struct Worker {
    pub(crate) registration: Registration,
    /// Oldest first: that is the one that it works on.
    pub(crate) held: BTreeSet<(Epoch, TaskKey)>,
    /// Until then its time is charged, while it holds something.
    charged: Tick,
    /// Intake that the worker wants: `Open` or `Off`.
    pub(crate) wish: Intake,
    /// Intake that the scheduler grants it.
    pub(crate) intake: Intake,
    /// Last message.
    pub(crate) seen: Tick,
    /// Last progress of any of its tasks.
    pub(crate) moved: Tick,
    /// No tasks until then.
    pub(crate) rests_until: Tick,
    /// Failures of its surroundings in a row.
    pub(crate) mishaps: u32,
    /// The last of them.
    pub(crate) trouble: Option<Failure>,
    pub(crate) completed: u64,
    pub(crate) failed: u64,
    /// Tasks that it may hold beyond `prefetch`, because they are short.
    depth: usize,
    pub(crate) at_hand: AtHand,
}

impl Worker {
    pub(crate) fn capacity(&self, config: &Config) -> usize {
        (self.registration.slots.max(1) + config.prefetch) as usize + self.depth
    }

    pub(crate) fn has_tags(&self, tags: &[String]) -> bool {
        tags.iter().all(|tag| self.registration.tags.contains(tag))
    }

    /// Whether it gets more tasks.
    pub(crate) fn is_open(&self) -> bool {
        self.intake == Intake::Open
    }

    /// Whether it is there, well, and wants work.
    pub(crate) fn is_fit(&self, config: &Config, now: Tick) -> bool {
        self.is_open() && now >= self.rests_until && !self.is_silent(config, now)
    }

    /// Whether it has not been heard of for as long as a lease lasts.
    pub(crate) fn is_silent(&self, config: &Config, now: Tick) -> bool {
        now.since(self.seen) >= config.lease
    }
}

/// How much a task is.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Size {
    /// Units of work.
    pub(crate) units: u64,
    /// Milliseconds that it is expected to take.
    pub(crate) milliseconds: u64,
}

/// A task in a worker's hands.
#[derive(Debug, Clone)]
pub(crate) struct Lease {
    pub(crate) worker: WorkerId,
    /// The end of its run of grains; it begins with the task's key.
    end: u32,
    pub(crate) size: Size,
    /// Milliseconds that it is expected to take yet: its owner's claim.
    pub(crate) claim: u64,
    pub(crate) granted: Tick,
    pub(crate) deadline: Tick,
    /// Last progress.
    moved: Tick,
    pub(crate) phase: Phase,
    /// When its worker began to compute, at the earliest.
    began: Option<Tick>,
    /// Units of work, or inputs joined.
    done: u64,
}

impl Lease {
    /// The grains that it covers.
    pub(crate) fn run(&self, task: &TaskKey) -> Range<u32> {
        task.index..self.end
    }

    /// Units of work of a task that is cut, so far, as heard.
    pub(crate) fn units(&self, task: &TaskKey) -> u64 {
        if task.stage.kind.is_cut() { self.done } else { 0 }
    }

    /// Milliseconds and units of its computation so far, as heard; `None` before there are any.
    pub(crate) fn progress(&self, task: &TaskKey) -> Option<(u64, u64)> {
        let (began, units) = (self.began?, self.units(task));
        (units > 0).then(|| (self.moved.since(began), units))
    }
}

/// Workers and leases; each lease is also in its worker's `held` and in `deadlines`.
#[derive(Debug, Clone, Default)]
pub(crate) struct LeaseTable {
    pub(crate) workers: BTreeMap<WorkerId, Worker>,
    pub(crate) leases: BTreeMap<LeaseKey, Lease>,
    /// Leases that were granted as second ones of their tasks. Few: without any, no task needs a look for its other lease.
    pub(crate) copies: BTreeSet<LeaseKey>,
    /// By epoch before task: epochs are told apart in one comparison.
    deadlines: BTreeSet<(Tick, Epoch, TaskKey)>,
    /// Workers that can hold more, those with the fewest tasks first.
    pub(crate) spare: BTreeSet<(usize, WorkerId)>,
}

impl LeaseTable {
    /// Whether a worker is there and has these tags.
    pub(crate) fn has_tags(&self, worker: WorkerId, tags: &[String]) -> bool {
        self.workers.get(&worker).is_some_and(|worker| worker.has_tags(tags))
    }

    pub(crate) fn join(&mut self, worker: WorkerId, registration: Registration, now: Tick) {
        let fresh = Worker {
            registration,
            held: BTreeSet::new(),
            charged: now,
            wish: Intake::Open,
            intake: Intake::Open,
            seen: now,
            moved: now,
            rests_until: Tick(0),
            mishaps: 0,
            trouble: None,
            completed: 0,
            failed: 0,
            depth: 0,
            at_hand: AtHand::default(),
        };
        self.workers.insert(worker, fresh);
        self.spare.insert((0, worker));
    }

    /// The process behind a session.
    pub(crate) fn instance(&self, worker: WorkerId) -> Option<u64> {
        self.workers.get(&worker).map(|worker| worker.registration.instance)
    }

    /// What a worker holds, oldest first.
    pub(crate) fn held(&self, worker: WorkerId) -> Vec<LeaseKey> {
        let held = self.workers.get(&worker).into_iter().flat_map(|known| &known.held);
        held.map(|&(epoch, task)| (task, epoch)).collect()
    }

    /// Removes a worker that holds nothing any more.
    pub(crate) fn leave(&mut self, worker: WorkerId) {
        debug_assert!(self.workers.get(&worker).is_none_or(|known| known.held.is_empty()));
        self.workers.remove(&worker);
        self.spare.remove(&(0, worker));
    }

    /// The time for which a worker has held something and that is not charged yet: it belongs to its oldest lease. Returns the
    /// job, the milliseconds, and how many of them were expected.
    pub(crate) fn bill(&mut self, worker: WorkerId, now: Tick) -> Option<(JobId, u64, u64)> {
        let holder = self.workers.get_mut(&worker)?;
        let &(epoch, task) = holder.held.first()?;
        let taken = now.since(std::mem::replace(&mut holder.charged, now));
        let lease = self.leases.get_mut(&(task, epoch))?;
        let expected = taken.min(lease.claim);
        lease.claim -= expected;
        Some((task.job, taken, expected))
    }

    /// - `run`: the task's grains.
    pub(crate) fn lease(
        &mut self,
        key: LeaseKey,
        run: &Range<u32>,
        worker: WorkerId,
        size: Size,
        config: &Config,
        now: Tick,
    ) {
        let deadline = now.after(config.lease);
        let lease = Lease {
            worker,
            end: run.end,
            size,
            claim: size.milliseconds,
            granted: now,
            deadline,
            moved: now,
            phase: Phase::Waiting,
            began: None,
            done: 0,
        };
        self.put(key, lease, config, now);
    }

    fn put(&mut self, key: LeaseKey, lease: Lease, config: &Config, now: Tick) {
        let worker = lease.worker;
        self.deadlines.insert((lease.deadline, key.1, key.0));
        self.leases.insert(key, lease);
        if let Some(holder) = self.workers.get_mut(&worker) {
            self.spare.remove(&(holder.held.len(), worker));
            if holder.held.is_empty() {
                holder.charged = now;
            }
            holder.held.insert((key.1, key.0));
            holder.at_hand.note(&key.0);
            if holder.held.len() < holder.capacity(config) {
                self.spare.insert((holder.held.len(), worker));
            }
        }
    }

    /// The worker's tasks take so many milliseconds.
    pub(crate) fn pace(&mut self, worker: WorkerId, milliseconds: u64, config: &Config) {
        let Some(holder) = self.workers.get_mut(&worker) else { return };
        holder.depth = config.depth(milliseconds);
        let place = (holder.held.len(), worker);
        if place.0 < holder.capacity(config) {
            self.spare.insert(place);
        } else {
            self.spare.remove(&place);
        }
    }

    /// Takes a lease out; what its worker has used is charged before.
    pub(crate) fn release(&mut self, key: &LeaseKey) -> Option<Lease> {
        let lease = self.leases.remove(key)?;
        self.copies.remove(key);
        self.deadlines.remove(&(lease.deadline, key.1, key.0));
        if let Some(holder) = self.workers.get_mut(&lease.worker) {
            self.spare.remove(&(holder.held.len(), lease.worker));
            holder.held.remove(&(key.1, key.0));
            self.spare.insert((holder.held.len(), lease.worker));
        }
        Some(lease)
    }

    /// Puts a lease into the hands of another session of its worker, as it was granted; `false`: there is no such lease.
    pub(crate) fn hand_over(&mut self, key: &LeaseKey, worker: WorkerId, config: &Config, now: Tick) -> bool {
        let is_copy = self.copies.contains(key);
        let Some(lease) = self.release(key) else { return false };
        let (deadline, phase) = (now.after(config.lease), Phase::Waiting);
        let lease = Lease { worker, deadline, moved: now, phase, began: None, done: 0, ..lease };
        self.put(*key, lease, config, now);
        if is_copy {
            self.copies.insert(*key);
        }
        true
    }

    /// The lease, if this worker holds it under this epoch.
    pub(crate) fn lease_of(&self, worker: WorkerId, task: &TaskKey, epoch: Epoch) -> Option<&Lease> {
        self.leases.get(&(*task, epoch)).filter(|lease| lease.worker == worker)
    }

    /// The leases of a task: none, one, or a second that does the same.
    pub(crate) fn of_task(&self, task: &TaskKey) -> impl Iterator<Item = (&LeaseKey, &Lease)> + '_ {
        let task = *task;
        self.leases.range((task, Epoch(0))..).take_while(move |((other, _), _)| *other == task)
    }

    /// Workers that have nothing to do.
    pub(crate) fn idle(&self) -> impl Iterator<Item = WorkerId> + '_ {
        self.spare.range((0, WorkerId(0))..(1, WorkerId(0))).map(|&(_, worker)| worker)
    }

    /// Renews the leases that a heartbeat lists, unless they stand still; returns those that are over.
    pub(crate) fn renew(
        &mut self,
        worker: WorkerId,
        tasks: &[TaskProgress],
        config: &Config,
        now: Tick,
    ) -> Vec<LeaseKey> {
        let Some(holder) = self.workers.get_mut(&worker) else { return Vec::new() };
        let before = std::mem::replace(&mut holder.seen, now);
        let mut over = Vec::new();
        for progress in tasks {
            let key = (progress.task, progress.epoch);
            let Some(lease) = self.leases.get_mut(&key).filter(|lease| lease.worker == worker) else {
                over.push(key);
                continue;
            };
            if progress.phase == Phase::Working {
                lease.began.get_or_insert(before.max(lease.granted));
            }
            if (progress.phase, progress.units) > (lease.phase, lease.done) {
                (lease.phase, lease.done) = (progress.phase, progress.units.max(lease.done));
                lease.moved = now;
                holder.moved = now;
            }
        }
        for progress in tasks {
            let key = (progress.task, progress.epoch);
            let Some(lease) = self.leases.get_mut(&key).filter(|lease| lease.worker == worker) else { continue };
            let moved = if lease.phase == Phase::Waiting { holder.moved.max(lease.moved) } else { lease.moved };
            if now.since(moved) < stall(lease.phase, config) {
                self.deadlines.remove(&(lease.deadline, key.1, key.0));
                lease.deadline = now.after(config.lease);
                self.deadlines.insert((lease.deadline, key.1, key.0));
            }
        }
        over
    }

    /// Of a lease that ran out because nothing moved, although its worker is there: that worker, and for how many seconds. One
    /// whose heartbeats were lost on the way ran out, too, and is nobody's fault.
    pub(crate) fn stalled(&self, key: &LeaseKey, config: &Config, now: Tick) -> Option<(WorkerId, u64)> {
        let lease = self.leases.get(key)?;
        let still = now.since(lease.moved);
        let has_stalled = lease.phase != Phase::Waiting && still >= stall(lease.phase, config);
        (!self.is_silent(lease.worker, config, now) && has_stalled).then_some((lease.worker, still / 1000))
    }

    /// Whether a worker has said nothing for a lease's time.
    pub(crate) fn is_silent(&self, worker: WorkerId, config: &Config, now: Tick) -> bool {
        self.workers.get(&worker).is_none_or(|known| now.since(known.seen) >= config.lease)
    }

    /// The leases whose time is up, earliest first.
    pub(crate) fn expired(&self, now: Tick) -> Vec<LeaseKey> {
        let is_up = |(deadline, ..): &&(Tick, Epoch, TaskKey)| *deadline <= now;
        self.deadlines.iter().take_while(is_up).map(|&(_, epoch, task)| (task, epoch)).collect()
    }

    /// The keys of a stage that are leased.
    pub(crate) fn of_stage(&self, job: JobId, stage: Stage) -> impl Iterator<Item = Range<u32>> + '_ {
        let key = |index, epoch| (TaskKey { job, stage, index }, Epoch(epoch));
        self.leases.range(key(0, 0)..=key(u32::MAX, u64::MAX)).map(|((task, _), lease)| lease.run(task))
    }

    /// Whether some of a stage's keys are leased: leases of a stage cover different keys, or a copy just the same.
    pub(crate) fn covers(&self, job: JobId, stage: Stage, keys: &Range<u32>) -> bool {
        let key = |index| (TaskKey { job, stage, index }, Epoch(0));
        let last = self.leases.range(key(0)..key(keys.end)).next_back();
        last.is_some_and(|((task, _), lease)| lease.run(task).end > keys.start)
    }

    /// The leases of a frame.
    pub(crate) fn of_frame(&self, job: JobId, frame: u32) -> impl Iterator<Item = (&LeaseKey, &Lease)> + '_ {
        let first = first_of(job, frame);
        let is_of_frame = move |task: &TaskKey| task.job == job && task.stage.frame == frame;
        self.leases.range((first, Epoch(0))..).take_while(move |((task, _), _)| is_of_frame(task))
    }

    /// The leases of a job.
    pub(crate) fn of_job(&self, job: JobId) -> impl Iterator<Item = (&LeaseKey, &Lease)> + '_ {
        self.leases.range((first_of(job, 0), Epoch(0))..).take_while(move |((task, _), _)| task.job == job)
    }
}

/// Before all tasks of a frame and behind those of the one before.
fn first_of(job: JobId, frame: u32) -> TaskKey {
    TaskKey { job, stage: Stage { frame, round: 0, number: 0, kind: StageKind::ALL[0] }, index: 0 }
}

/// Without progress for so many milliseconds a lease is not renewed.
fn stall(phase: Phase, config: &Config) -> u64 {
    match phase {
        Phase::Waiting | Phase::Preparing => config.preparation_stall,
        Phase::Working | Phase::Uploading => config.stall,
    }
}
