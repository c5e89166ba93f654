//! Workers and their leases: the volatile half of the state, which a restart discards.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::ops::Range;

use femc_model::{
    Epoch, Failure, Intake, JobId, Lane, Phase, Registration, Stage, TaskKey, TaskProgress, Tick, WorkerId,
};

use crate::Config;
use crate::affinity::Locality;
use crate::leases::Leases;

/// Key of a lease. A task may be leased twice, see `speculate.rs`.
pub(crate) type LeaseKey = (TaskKey, Epoch);

/// A worker's session.
#[derive(Debug, Clone)]
pub(crate) struct Worker {
    pub(crate) registration: Registration,
    /// Its leases, oldest first. In each lane it works on the first unfinished ones.
    pub(crate) held: VecDeque<WorkerLease>,
    /// Sums over `held`, by lane.
    queues: [LaneQueue; Lane::ALL.len()],
    /// Time up to which it is charged, while it holds a lease.
    charged_until: Tick,
    /// Intake that the worker wants: `Open` or `Off`.
    pub(crate) wanted_intake: Intake,
    /// Intake that the scheduler grants it.
    pub(crate) intake: Intake,
    /// Time of its last message.
    pub(crate) last_message: Tick,
    /// Time of the last progress of any of its tasks.
    pub(crate) last_progress: Tick,
    /// Time until which it gets no tasks.
    pub(crate) back_off_until: Tick,
    /// Number of infrastructure failures in a row.
    pub(crate) infrastructure_failures: u32,
    /// The last infrastructure failure.
    pub(crate) last_infrastructure_failure: Option<Failure>,
    pub(crate) completed: u64,
    pub(crate) failed: u64,
    pub(crate) locality: Locality,
}

/// A lease that a worker holds.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WorkerLease {
    pub(crate) epoch: Epoch,
    pub(crate) task: TaskKey,
    /// Expected duration of the task in milliseconds, from the pace of its stage.
    expected: u64,
    /// Whether the worker has computed the task and uploads its result.
    is_uploading: bool,
}

impl WorkerLease {
    fn sort_key(&self) -> (Epoch, TaskKey) {
        (self.epoch, self.task)
    }

    fn lane(&self) -> Lane {
        self.task.stage.kind.properties().lane
    }
}

/// Summary of the leases that a worker holds in one lane.
#[derive(Debug, Clone, Copy, Default)]
struct LaneQueue {
    leases: usize,
    /// Number of leases whose result is being uploaded.
    uploading: usize,
    /// Sum of the expected durations in milliseconds.
    expected: u64,
}

impl Worker {
    /// Number of leases that count against its room in a lane. For join tasks, only the leases of that lane count, so that no
    /// render task delays them.
    fn load(&self, lane: Lane) -> usize {
        match lane {
            Lane::Compute => self.held.len(),
            Lane::Join => self.queues[lane as usize].leases,
        }
    }

    fn insert(&mut self, held: WorkerLease) {
        let queue = &mut self.queues[held.lane() as usize];
        queue.leases += 1;
        queue.expected = queue.expected.saturating_add(held.expected);
        let newer = self.held.partition_point(|other| other.sort_key() < held.sort_key());
        self.held.insert(newer, held);
    }

    fn remove(&mut self, (task, epoch): &LeaseKey) {
        let Ok(index) = self.held.binary_search_by_key(&(*epoch, *task), WorkerLease::sort_key) else { return };
        if let Some(held) = self.held.remove(index) {
            let queue = &mut self.queues[held.lane() as usize];
            queue.leases -= 1;
            queue.uploading -= usize::from(held.is_uploading);
            queue.expected = queue.expected.saturating_sub(held.expected);
        }
    }

    /// Notes that the task is computed and its result is being uploaded.
    fn note_uploading(&mut self, (task, epoch): &LeaseKey) {
        let Ok(index) = self.held.binary_search_by_key(&(*epoch, *task), WorkerLease::sort_key) else { return };
        let held = &mut self.held[index];
        let is_new = !std::mem::replace(&mut held.is_uploading, true);
        self.queues[held.lane() as usize].uploading += usize::from(is_new);
    }

    /// Expected milliseconds of the running tasks of a lane: the first unfinished ones.
    fn running_milliseconds(&self, lane: Lane) -> u64 {
        if self.queues[lane as usize].leases == 0 {
            return 0;
        }
        let unfinished = self.held.iter().filter(|held| held.lane() == lane && !held.is_uploading);
        unfinished.take(self.slots()).fold(0, |sum, held| sum.saturating_add(held.expected))
    }

    /// Checks whether it may get one more task of this lane. The waiting tasks are limited to some seconds of work beyond the
    /// running ones, according to the pace of their stages.
    pub(crate) fn has_room(&self, lane: Lane, config: &Config) -> bool {
        let (slots, load, queue) = (self.slots(), self.load(lane), self.queues[lane as usize]);
        let waiting = || queue.expected.saturating_sub(self.running_milliseconds(lane));
        let shallow = slots + config.prefetch as usize;
        if load < shallow {
            queue.leases - queue.uploading <= slots || waiting() <= config.queue
        } else {
            load < shallow + Config::MAX_AHEAD && waiting() < config.ahead
        }
    }

    fn slots(&self) -> usize {
        self.registration.slots.max(1) as usize
    }

    /// Bills its time until now to the job of its oldest lease.
    fn take_charge(&mut self, job: JobId, oldest: &mut Lease, now: Tick) -> Charge {
        let milliseconds = now.since(std::mem::replace(&mut self.charged_until, now));
        let expected = milliseconds.min(oldest.claim);
        oldest.claim -= expected;
        Charge { job, milliseconds, expected }
    }

    pub(crate) fn has_tags(&self, tags: &[String]) -> bool {
        tags.iter().all(|tag| self.registration.tags.contains(tag))
    }

    /// Checks whether it gets more tasks.
    pub(crate) fn is_open(&self) -> bool {
        self.intake == Intake::Open
    }

    /// Checks whether it is open, does not rest, and is not silent.
    pub(crate) fn is_fit(&self, config: &Config, now: Tick) -> bool {
        self.is_open() && now >= self.back_off_until && !self.is_silent(config, now)
    }

    /// Checks whether its last message is at least a lease's duration old.
    pub(crate) fn is_silent(&self, config: &Config, now: Tick) -> bool {
        now.since(self.last_message) >= config.lease
    }
}

/// A worker's time to be charged to the job of the oldest lease that the worker holds.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Charge {
    pub(crate) job: JobId,
    pub(crate) milliseconds: u64,
    /// Part of `milliseconds` that the lease had claimed.
    pub(crate) expected: u64,
}

/// Size of a task.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LeaseSize {
    /// Units of work.
    pub(crate) units: u64,
    /// Expected duration in milliseconds.
    pub(crate) milliseconds: u64,
}

/// A lease of a task to a worker.
#[derive(Debug, Clone)]
pub(crate) struct Lease {
    pub(crate) worker: WorkerId,
    /// End of its run of sample chunks, which begins with the task's index.
    end: u32,
    pub(crate) size: LeaseSize,
    /// Remaining expected milliseconds: its owner's claim.
    pub(crate) claim: u64,
    pub(crate) granted: Tick,
    pub(crate) deadline: Tick,
    /// Time of the last progress.
    last_progress: Tick,
    pub(crate) phase: Phase,
    /// Earliest possible time at which its worker began to compute.
    began: Option<Tick>,
    /// Finished units of work, or joined inputs.
    done_units: u64,
}

impl Lease {
    /// Returns the sample chunks that it covers.
    pub(crate) fn run(&self, task: &TaskKey) -> Range<u32> {
        task.index..self.end
    }

    /// Returns the reported units of work so far, if its task is divided into sample chunks; otherwise 0.
    pub(crate) fn units(&self, task: &TaskKey) -> u64 {
        if task.stage.kind.is_divided() { self.done_units } else { 0 }
    }

    /// Returns the milliseconds and units of its computation so far, as reported; `None` before the first units.
    pub(crate) fn progress(&self, task: &TaskKey) -> Option<(u64, u64)> {
        let (began, units) = (self.began?, self.units(task));
        (units > 0).then(|| (self.last_progress.since(began), units))
    }
}

/// Workers and leases. Each lease is also in its worker's `held`.
#[derive(Debug, Clone, Default)]
pub(crate) struct LeaseTable {
    pub(crate) workers: BTreeMap<WorkerId, Worker>,
    pub(crate) leases: Leases,
    /// Leases that were granted as copies. There are few; without any, no task must be searched for its other lease.
    pub(crate) copies: BTreeSet<LeaseKey>,
    /// Lower bound of all deadlines.
    earliest_deadline: Tick,
    /// Number of workers by build of the engine.
    builds: BTreeMap<String, usize>,
    /// Workers with room in a lane, those with the lowest load first.
    spare_workers: [BTreeSet<(usize, WorkerId)>; Lane::ALL.len()],
}

impl LeaseTable {
    /// Checks whether a worker is connected and has these tags.
    pub(crate) fn has_tags(&self, worker: WorkerId, tags: &[String]) -> bool {
        self.workers.get(&worker).is_some_and(|worker| worker.has_tags(tags))
    }

    pub(crate) fn join(&mut self, worker: WorkerId, registration: Registration, now: Tick) {
        *self.builds.entry(registration.engine.clone()).or_default() += 1;
        let fresh = Worker {
            registration,
            held: VecDeque::new(),
            queues: Default::default(),
            charged_until: now,
            wanted_intake: Intake::Open,
            intake: Intake::Open,
            last_message: now,
            last_progress: now,
            back_off_until: Tick(0),
            infrastructure_failures: 0,
            last_infrastructure_failure: None,
            completed: 0,
            failed: 0,
            locality: Locality::default(),
        };
        let before = self.workers.insert(worker, fresh);
        debug_assert!(before.is_none(), "the session exists already");
        for spare in &mut self.spare_workers {
            spare.insert((0, worker));
        }
    }

    /// Returns the builds of the engine that have workers.
    pub(crate) fn builds(&self) -> impl ExactSizeIterator<Item = &str> {
        self.builds.keys().map(String::as_str)
    }

    /// Returns the process of a session.
    pub(crate) fn instance(&self, worker: WorkerId) -> Option<u64> {
        self.workers.get(&worker).map(|worker| worker.registration.instance)
    }

    /// Returns the leases of a worker, oldest first.
    pub(crate) fn leases_of_worker(&self, worker: WorkerId) -> Vec<LeaseKey> {
        let held = self.workers.get(&worker).into_iter().flat_map(|known| &known.held);
        held.map(|held| (held.task, held.epoch)).collect()
    }

    /// Returns the first worker with room in a lane, from this position on. Workers with the lowest load come first.
    pub(crate) fn next_spare_worker(&self, lane: Lane, from: (usize, WorkerId)) -> Option<(usize, WorkerId)> {
        self.spare_workers[lane as usize].range(from..).next().copied()
    }

    /// Removes a worker from the workers with room, before its leases change.
    fn remove_spare_worker(&mut self, worker: WorkerId) {
        let Some(holder) = self.workers.get(&worker) else { return };
        for lane in Lane::ALL {
            self.spare_workers[lane as usize].remove(&(holder.load(lane), worker));
        }
    }

    /// Enters a worker among the workers with room, after its leases have changed.
    fn add_spare_worker(&mut self, worker: WorkerId, config: &Config) {
        let Some(holder) = self.workers.get(&worker) else { return };
        for lane in Lane::ALL {
            if holder.has_room(lane, config) {
                self.spare_workers[lane as usize].insert((holder.load(lane), worker));
            }
        }
    }

    /// Removes a worker that holds no lease any more.
    pub(crate) fn leave(&mut self, worker: WorkerId) {
        debug_assert!(self.workers.get(&worker).is_none_or(|known| known.held.is_empty()));
        for spare in &mut self.spare_workers {
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

    /// Bills the uncharged time for which a worker has held leases.
    pub(crate) fn take_charge(&mut self, worker: WorkerId, now: Tick) -> Option<Charge> {
        let holder = self.workers.get_mut(&worker)?;
        let &WorkerLease { epoch, task, .. } = holder.held.front()?;
        let lease = self.leases.get_mut(&(task, epoch))?;
        Some(holder.take_charge(task.job, lease, now))
    }

    /// Enters a lease.
    /// - `run`: sample chunks of the task.
    pub(crate) fn grant(
        &mut self,
        key: LeaseKey,
        run: &Range<u32>,
        worker: WorkerId,
        size: LeaseSize,
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
            last_progress: now,
            phase: Phase::Waiting,
            began: None,
            done_units: 0,
        };
        self.insert_lease(key, lease, config, now);
    }

    fn insert_lease(&mut self, key: LeaseKey, lease: Lease, config: &Config, now: Tick) {
        let worker = lease.worker;
        let held = WorkerLease { epoch: key.1, task: key.0, expected: lease.size.milliseconds, is_uploading: false };
        self.earliest_deadline = self.earliest_deadline.min(lease.deadline);
        self.leases.insert(key, lease);
        self.remove_spare_worker(worker);
        if let Some(holder) = self.workers.get_mut(&worker) {
            if holder.held.is_empty() {
                holder.charged_until = now;
            }
            holder.insert(held);
            holder.locality.record_assignment(&key.0);
        }
        self.add_spare_worker(worker, config);
    }

    /// Removes a lease. Returns also the bill for its worker's time until now.
    pub(crate) fn release(&mut self, key: &LeaseKey, config: &Config, now: Tick) -> Option<(Lease, Option<Charge>)> {
        let mut lease = self.leases.remove(key)?;
        self.copies.remove(key);
        let worker = lease.worker;
        self.remove_spare_worker(worker);
        let Some(holder) = self.workers.get_mut(&worker) else { return Some((lease, None)) };
        let bill = match holder.held.front() {
            Some(&WorkerLease { epoch, task, .. }) if (task, epoch) == *key => {
                Some(holder.take_charge(task.job, &mut lease, now))
            }
            Some(&WorkerLease { epoch, task, .. }) => {
                self.leases.get_mut(&(task, epoch)).map(|oldest| holder.take_charge(task.job, oldest, now))
            }
            None => None,
        };
        holder.remove(key);
        self.add_spare_worker(worker, config);
        Some((lease, bill))
    }

    /// Hands a lease over to another session of its worker, with its original grant; `false`: there is no such lease. The worker's
    /// time must be charged before.
    pub(crate) fn hand_over(&mut self, key: &LeaseKey, worker: WorkerId, config: &Config, now: Tick) -> bool {
        let is_copy = self.copies.contains(key);
        let Some((lease, _)) = self.release(key, config, now) else { return false };
        let (deadline, phase) = (now.after(config.lease), Phase::Waiting);
        let lease = Lease { worker, deadline, last_progress: now, phase, began: None, done_units: 0, ..lease };
        self.insert_lease(*key, lease, config, now);
        if is_copy {
            self.copies.insert(*key);
        }
        true
    }

    /// Returns the lease if this worker holds it under this epoch.
    pub(crate) fn lease_held_by(&self, worker: WorkerId, task: &TaskKey, epoch: Epoch) -> Option<&Lease> {
        self.leases.get(&(*task, epoch)).filter(|lease| lease.worker == worker)
    }

    /// Returns the leases of a task: none, one, or one and its copy.
    pub(crate) fn leases_of_task(&self, task: &TaskKey) -> impl Iterator<Item = (LeaseKey, &Lease)> + use<'_> {
        self.leases.of_task(task)
    }

    /// Returns the workers without load in a lane.
    pub(crate) fn idle_workers(&self, lane: Lane) -> impl Iterator<Item = WorkerId> + '_ {
        self.spare_workers[lane as usize].range((0, WorkerId(0))..(1, WorkerId(0))).map(|&(_, worker)| worker)
    }

    /// Renews the leases in a heartbeat, unless they are stalled. Returns the listed leases that are over.
    pub(crate) fn renew(
        &mut self,
        worker: WorkerId,
        tasks: &[TaskProgress],
        config: &Config,
        now: Tick,
    ) -> Vec<LeaseKey> {
        let Some(holder) = self.workers.get_mut(&worker) else { return Vec::new() };
        let before = std::mem::replace(&mut holder.last_message, now);
        let (mut ended, mut finished) = (Vec::new(), Vec::new());
        for progress in tasks {
            let key = (progress.task, progress.epoch);
            let Some(lease) = self.leases.get_mut(&key).filter(|lease| lease.worker == worker) else {
                ended.push(key);
                continue;
            };
            if progress.phase == Phase::Uploading && lease.phase != Phase::Uploading {
                finished.push(key);
            }
            if progress.phase == Phase::Working {
                lease.began.get_or_insert(before.max(lease.granted));
            }
            if (progress.phase, progress.units) > (lease.phase, lease.done_units) {
                (lease.phase, lease.done_units) = (progress.phase, progress.units.max(lease.done_units));
                lease.last_progress = now;
                holder.last_progress = now;
            }
        }
        for progress in tasks {
            let key = (progress.task, progress.epoch);
            let Some(lease) = self.leases.get_mut(&key).filter(|lease| lease.worker == worker) else { continue };
            let moved = if lease.phase == Phase::Waiting {
                holder.last_progress.max(lease.last_progress)
            } else {
                lease.last_progress
            };
            if now.since(moved) < stall_limit(lease.phase, config) {
                lease.deadline = now.after(config.lease);
            }
        }
        if let Some(holder) = self.workers.get_mut(&worker).filter(|_| !finished.is_empty()) {
            finished.iter().for_each(|key| holder.note_uploading(key));
            self.add_spare_worker(worker, config);
        }
        ended
    }

    /// Checks whether an expired lease was stalled although its worker is alive. Returns that worker, and the seconds without
    /// progress. A lease that expired because heartbeats were lost on the way was not stalled.
    pub(crate) fn find_stall(&self, key: &LeaseKey, config: &Config, now: Tick) -> Option<(WorkerId, u64)> {
        let lease = self.leases.get(key)?;
        let unchanged = now.since(lease.last_progress);
        let has_stalled = lease.phase != Phase::Waiting && unchanged >= stall_limit(lease.phase, config);
        (!self.is_silent(lease.worker, config, now) && has_stalled).then_some((lease.worker, unchanged / 1000))
    }

    /// Checks whether a worker has been silent for a lease's duration.
    pub(crate) fn is_silent(&self, worker: WorkerId, config: &Config, now: Tick) -> bool {
        self.workers.get(&worker).is_none_or(|known| now.since(known.last_message) >= config.lease)
    }

    /// Returns the expired leases, earliest deadline first.
    pub(crate) fn expired_leases(&mut self, now: Tick) -> Vec<LeaseKey> {
        if now < self.earliest_deadline {
            return Vec::new();
        }
        // Heartbeats renew all held leases, so this is rarely reached.
        self.earliest_deadline = self.leases.iter().map(|(_, lease)| lease.deadline).min().unwrap_or(Tick(u64::MAX));
        let ended = self.leases.iter().filter(|(_, lease)| lease.deadline <= now);
        let mut ended: Vec<_> = ended.map(|((task, epoch), lease)| (lease.deadline, epoch, task)).collect();
        ended.sort_unstable();
        ended.into_iter().map(|(_, epoch, task)| (task, epoch)).collect()
    }

    /// Returns the leased keys of a stage.
    pub(crate) fn leased_keys_of_stage(&self, job: JobId, stage: Stage) -> impl Iterator<Item = Range<u32>> + '_ {
        self.leases.of_stage(job, stage).map(|((task, _), lease)| lease.run(&task))
    }

    /// Checks whether some of a stage's keys are leased. Different leases of a stage cover different keys; a copy covers the same
    /// keys as its original.
    pub(crate) fn covers_any(&self, job: JobId, stage: Stage, keys: &Range<u32>) -> bool {
        let last = self.leases.last_before(job, stage, keys.end);
        last.is_some_and(|((task, _), lease)| lease.run(&task).end > keys.start)
    }

    /// Returns the leases of a frame.
    pub(crate) fn leases_of_frame(&self, job: JobId, frame: u32) -> impl Iterator<Item = (LeaseKey, &Lease)> + '_ {
        self.leases.of_frames(job, frame..=frame)
    }

    /// Returns the leases of a job.
    pub(crate) fn leases_of_job(&self, job: JobId) -> impl Iterator<Item = (LeaseKey, &Lease)> + '_ {
        self.leases.of_frames(job, 0..=u32::MAX)
    }
}

/// Returns the milliseconds without progress after which a lease is no longer renewed.
fn stall_limit(phase: Phase, config: &Config) -> u64 {
    match phase {
        Phase::Waiting | Phase::Preparing => config.preparation_stall,
        Phase::Working | Phase::Uploading => config.stall,
    }
}
