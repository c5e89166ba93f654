//! Who is there and who holds what: the half of the state that a restart forgets.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::ops::Range;

use femc_model::{
    Epoch, Failure, Intake, JobId, Lane, Phase, Registration, Stage, TaskKey, TaskProgress, Tick, WorkerId,
};

use crate::Config;
use crate::affinity::Locality;
use crate::leases::Leases;

/// A lease's name: a task may be leased twice, see `speculate.rs`.
pub(crate) type LeaseKey = (TaskKey, Epoch);

/// A worker's session.
#[derive(Debug, Clone)]
pub(crate) struct Worker {
    pub(crate) registration: Registration,
    /// Its leases, oldest first: in each lane it works on the first of those that it has not finished.
    pub(crate) held: VecDeque<Held>,
    /// Sums over `held`, by lane.
    queues: [Queue; Lane::ALL.len()],
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
    pub(crate) locality: Locality,
}

/// A lease in the hands of a worker.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Held {
    pub(crate) epoch: Epoch,
    pub(crate) task: TaskKey,
    /// Milliseconds that the task is expected to take, by the pace of its own stage.
    expected: u64,
    /// The worker has computed it and sends its result.
    is_uploading: bool,
}

impl Held {
    fn place(&self) -> (Epoch, TaskKey) {
        (self.epoch, self.task)
    }

    fn lane(&self) -> Lane {
        self.task.stage.kind.row().lane
    }
}

/// What a worker holds in one lane.
#[derive(Debug, Clone, Copy, Default)]
struct Queue {
    leases: usize,
    /// Leases whose result is on its way.
    uploading: usize,
    /// Milliseconds that all of them are expected to take.
    expected: u64,
}

impl Worker {
    /// Number of leases that count against its room in a lane. For tasks that join, these are the leases of that lane alone, so that
    /// no render task delays them.
    fn load(&self, lane: Lane) -> usize {
        match lane {
            Lane::Compute => self.held.len(),
            Lane::Join => self.queues[lane as usize].leases,
        }
    }

    fn insert(&mut self, held: Held) {
        let queue = &mut self.queues[held.lane() as usize];
        queue.leases += 1;
        queue.expected = queue.expected.saturating_add(held.expected);
        let newer = self.held.partition_point(|other| other.place() < held.place());
        self.held.insert(newer, held);
    }

    fn remove(&mut self, (task, epoch): &LeaseKey) {
        let Ok(place) = self.held.binary_search_by_key(&(*epoch, *task), Held::place) else { return };
        if let Some(held) = self.held.remove(place) {
            let queue = &mut self.queues[held.lane() as usize];
            queue.leases -= 1;
            queue.uploading -= usize::from(held.is_uploading);
            queue.expected = queue.expected.saturating_sub(held.expected);
        }
    }

    /// The task is computed, and its result is on its way.
    fn note_uploading(&mut self, (task, epoch): &LeaseKey) {
        let Ok(place) = self.held.binary_search_by_key(&(*epoch, *task), Held::place) else { return };
        let held = &mut self.held[place];
        let is_new = !std::mem::replace(&mut held.is_uploading, true);
        self.queues[held.lane() as usize].uploading += usize::from(is_new);
    }

    /// Milliseconds that the tasks of a lane which run now are expected to take: the first ones that are not finished.
    fn running(&self, lane: Lane) -> u64 {
        if self.queues[lane as usize].leases == 0 {
            return 0;
        }
        let unfinished = self.held.iter().filter(|held| held.lane() == lane && !held.is_uploading);
        unfinished.take(self.slots()).fold(0, |sum, held| sum.saturating_add(held.expected))
    }

    /// Whether it may be given one more task of this lane. What waits there is worth at most some seconds beyond what runs, by the
    /// pace of the stages that the waiting tasks belong to.
    pub(crate) fn has_room(&self, lane: Lane, config: &Config) -> bool {
        let (slots, load, queue) = (self.slots(), self.load(lane), self.queues[lane as usize]);
        let waiting = || queue.expected.saturating_sub(self.running(lane));
        let shallow = slots + config.prefetch as usize;
        if load < shallow {
            queue.leases - queue.uploading <= slots || waiting() <= config.queue
        } else {
            load < shallow + Config::DEEPEST && waiting() < config.ahead
        }
    }

    fn slots(&self) -> usize {
        self.registration.slots.max(1) as usize
    }

    /// Its time until now, of which its oldest lease is this one, of this job.
    fn bill(&mut self, job: JobId, oldest: &mut Lease, now: Tick) -> Bill {
        let milliseconds = now.since(std::mem::replace(&mut self.charged, now));
        let expected = milliseconds.min(oldest.claim);
        oldest.claim -= expected;
        Bill { job, milliseconds, expected }
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

/// A worker's time that is to be charged: it belongs to the oldest lease that the worker holds.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bill {
    pub(crate) job: JobId,
    pub(crate) milliseconds: u64,
    /// How many of them were expected.
    pub(crate) expected: u64,
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

/// Workers and leases; each lease is also in its worker's `held`.
#[derive(Debug, Clone, Default)]
pub(crate) struct LeaseTable {
    pub(crate) workers: BTreeMap<WorkerId, Worker>,
    pub(crate) leases: Leases,
    /// Leases that were granted as second ones of their tasks. Few: without any, no task needs a look for its other lease.
    pub(crate) copies: BTreeSet<LeaseKey>,
    /// No lease ends before.
    ends_from: Tick,
    /// How many workers there are of each build of the engine.
    builds: BTreeMap<String, usize>,
    /// Workers that can hold more tasks of a lane, those with the fewest tasks of it first.
    spare: [BTreeSet<(usize, WorkerId)>; Lane::ALL.len()],
}

impl LeaseTable {
    /// Whether a worker is there and has these tags.
    pub(crate) fn has_tags(&self, worker: WorkerId, tags: &[String]) -> bool {
        self.workers.get(&worker).is_some_and(|worker| worker.has_tags(tags))
    }

    pub(crate) fn join(&mut self, worker: WorkerId, registration: Registration, now: Tick) {
        *self.builds.entry(registration.engine.clone()).or_default() += 1;
        let fresh = Worker {
            registration,
            held: VecDeque::new(),
            queues: Default::default(),
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
            locality: Locality::default(),
        };
        let before = self.workers.insert(worker, fresh);
        debug_assert!(before.is_none(), "a session that there is already");
        for spare in &mut self.spare {
            spare.insert((0, worker));
        }
    }

    /// The builds of the engine of which there are workers.
    pub(crate) fn builds(&self) -> impl ExactSizeIterator<Item = &str> {
        self.builds.keys().map(String::as_str)
    }

    /// The process behind a session.
    pub(crate) fn instance(&self, worker: WorkerId) -> Option<u64> {
        self.workers.get(&worker).map(|worker| worker.registration.instance)
    }

    /// What a worker holds, oldest first.
    pub(crate) fn held(&self, worker: WorkerId) -> Vec<LeaseKey> {
        let held = self.workers.get(&worker).into_iter().flat_map(|known| &known.held);
        held.map(|held| (held.task, held.epoch)).collect()
    }

    /// Workers that can hold more tasks of a lane, those with the fewest of it first; from this place on.
    pub(crate) fn next_spare(&self, lane: Lane, from: (usize, WorkerId)) -> Option<(usize, WorkerId)> {
        self.spare[lane as usize].range(from..).next().copied()
    }

    /// Takes a worker out of the workers with room, before what it holds changes.
    fn close_room(&mut self, worker: WorkerId) {
        let Some(holder) = self.workers.get(&worker) else { return };
        for lane in Lane::ALL {
            self.spare[lane as usize].remove(&(holder.load(lane), worker));
        }
    }

    /// Notes a worker's room, after what it holds has changed.
    fn open_room(&mut self, worker: WorkerId, config: &Config) {
        let Some(holder) = self.workers.get(&worker) else { return };
        for lane in Lane::ALL {
            if holder.has_room(lane, config) {
                self.spare[lane as usize].insert((holder.load(lane), worker));
            }
        }
    }

    /// Removes a worker that holds nothing any more.
    pub(crate) fn leave(&mut self, worker: WorkerId) {
        debug_assert!(self.workers.get(&worker).is_none_or(|known| known.held.is_empty()));
        for spare in &mut self.spare {
            spare.remove(&(0, worker));
        }
        let Some(known) = self.workers.remove(&worker) else { return };
        if let Some(count) = self.builds.get_mut(&known.registration.engine) {
            *count -= 1;
            if *count == 0 {
                self.builds.remove(&known.registration.engine);
            }
        }
    }

    /// The time for which a worker has held something and that is not charged yet.
    pub(crate) fn bill(&mut self, worker: WorkerId, now: Tick) -> Option<Bill> {
        let holder = self.workers.get_mut(&worker)?;
        let &Held { epoch, task, .. } = holder.held.front()?;
        let lease = self.leases.get_mut(&(task, epoch))?;
        Some(holder.bill(task.job, lease, now))
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
        let held = Held { epoch: key.1, task: key.0, expected: lease.size.milliseconds, is_uploading: false };
        self.ends_from = self.ends_from.min(lease.deadline);
        self.leases.insert(key, lease);
        self.close_room(worker);
        if let Some(holder) = self.workers.get_mut(&worker) {
            if holder.held.is_empty() {
                holder.charged = now;
            }
            holder.insert(held);
            holder.locality.note(&key.0);
        }
        self.open_room(worker, config);
    }

    /// Takes a lease out; returns also what is to be charged for the time of its worker until now.
    pub(crate) fn release(&mut self, key: &LeaseKey, config: &Config, now: Tick) -> Option<(Lease, Option<Bill>)> {
        let mut lease = self.leases.remove(key)?;
        self.copies.remove(key);
        let worker = lease.worker;
        self.close_room(worker);
        let Some(holder) = self.workers.get_mut(&worker) else { return Some((lease, None)) };
        let bill = match holder.held.front() {
            Some(&Held { epoch, task, .. }) if (task, epoch) == *key => Some(holder.bill(task.job, &mut lease, now)),
            Some(&Held { epoch, task, .. }) => {
                self.leases.get_mut(&(task, epoch)).map(|oldest| holder.bill(task.job, oldest, now))
            }
            None => None,
        };
        holder.remove(key);
        self.open_room(worker, config);
        Some((lease, bill))
    }

    /// Puts a lease into the hands of another session of its worker, as it was granted; `false`: there is no such lease. What the
    /// worker has used is charged before.
    pub(crate) fn hand_over(&mut self, key: &LeaseKey, worker: WorkerId, config: &Config, now: Tick) -> bool {
        let is_copy = self.copies.contains(key);
        let Some((lease, _)) = self.release(key, config, now) else { return false };
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
    pub(crate) fn of_task(&self, task: &TaskKey) -> impl Iterator<Item = (LeaseKey, &Lease)> + use<'_> {
        self.leases.of_task(task)
    }

    /// Workers that have nothing to do in a lane.
    pub(crate) fn idle(&self, lane: Lane) -> impl Iterator<Item = WorkerId> + '_ {
        self.spare[lane as usize].range((0, WorkerId(0))..(1, WorkerId(0))).map(|&(_, worker)| worker)
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
        let (mut over, mut finished) = (Vec::new(), Vec::new());
        for progress in tasks {
            let key = (progress.task, progress.epoch);
            let Some(lease) = self.leases.get_mut(&key).filter(|lease| lease.worker == worker) else {
                over.push(key);
                continue;
            };
            if progress.phase == Phase::Uploading && lease.phase != Phase::Uploading {
                finished.push(key);
            }
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
                lease.deadline = now.after(config.lease);
            }
        }
        if let Some(holder) = self.workers.get_mut(&worker).filter(|_| !finished.is_empty()) {
            finished.iter().for_each(|key| holder.note_uploading(key));
            self.open_room(worker, config);
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
    pub(crate) fn expired(&mut self, now: Tick) -> Vec<LeaseKey> {
        if now < self.ends_from {
            return Vec::new();
        }
        // Heartbeats renew all that are held: this is rare.
        self.ends_from = self.leases.iter().map(|(_, lease)| lease.deadline).min().unwrap_or(Tick(u64::MAX));
        let ended = self.leases.iter().filter(|(_, lease)| lease.deadline <= now);
        let mut ended: Vec<_> = ended.map(|((task, epoch), lease)| (lease.deadline, epoch, task)).collect();
        ended.sort_unstable();
        ended.into_iter().map(|(_, epoch, task)| (task, epoch)).collect()
    }

    /// The keys of a stage that are leased.
    pub(crate) fn of_stage(&self, job: JobId, stage: Stage) -> impl Iterator<Item = Range<u32>> + '_ {
        self.leases.of_stage(job, stage).map(|((task, _), lease)| lease.run(&task))
    }

    /// Whether some of a stage's keys are leased: leases of a stage cover different keys, or a copy just the same.
    pub(crate) fn covers(&self, job: JobId, stage: Stage, keys: &Range<u32>) -> bool {
        let last = self.leases.last_before(job, stage, keys.end);
        last.is_some_and(|((task, _), lease)| lease.run(&task).end > keys.start)
    }

    /// The leases of a frame.
    pub(crate) fn of_frame(&self, job: JobId, frame: u32) -> impl Iterator<Item = (LeaseKey, &Lease)> + '_ {
        self.leases.of_frames(job, frame..=frame)
    }

    /// The leases of a job.
    pub(crate) fn of_job(&self, job: JobId) -> impl Iterator<Item = (LeaseKey, &Lease)> + '_ {
        self.leases.of_frames(job, 0..=u32::MAX)
    }
}

/// Without progress for so many milliseconds a lease is not renewed.
fn stall(phase: Phase, config: &Config) -> u64 {
    match phase {
        Phase::Waiting | Phase::Preparing => config.preparation_stall,
        Phase::Working | Phase::Uploading => config.stall,
    }
}
