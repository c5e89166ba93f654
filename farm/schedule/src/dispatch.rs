//! Dispatch: leases ready tasks to workers with room. The reasons why a task waits are derived from the same predicates.

use std::collections::BTreeSet;
use std::ops::{ControlFlow, Range};

use femc_model::{
    Assignment, Digest, Epoch, JobId, Lane, NextRound, Scope, Stage, TaskKey, TaskSpec, Tick, WaitReason, WorkerId,
};

use crate::Command;
use crate::lease_table::{LeaseKey, Worker};
use crate::ledger::{Job, StageRound};
use crate::ready_tasks::ReadyTasks;
use crate::scheduler::Scheduler;
use crate::shared::ContentState;

/// Result of the search for a task.
enum Pick {
    Task(TaskKey),
    /// A shared job must begin first: the job and the frame that need it, and the key of its content.
    BeginShared(JobId, u32, Digest),
    /// There are ready tasks, but none for this worker.
    NotForThisWorker,
    NothingReady,
}

impl Scheduler {
    /// Leases ready tasks until the workers or the tasks run out. Workers with the fewest tasks come first, so that no worker
    /// fetches a task ahead that another one could begin immediately. Each lane has its own queues: join tasks never wait for
    /// render tasks.
    pub(crate) fn dispatch(&mut self, now: Tick, out: &mut Vec<Command>) {
        if now < self.dispatch_from {
            return;
        }
        // The compute pass may open frames whose first tasks are join tasks.
        for lane in [Lane::Join, Lane::Compute, Lane::Join] {
            self.dispatch_lane(lane, now, out);
        }
    }

    fn dispatch_lane(&mut self, lane: Lane, now: Tick, out: &mut Vec<Command>) {
        let mut next = (0, WorkerId(0));
        while self.has_ready(lane)
            && let Some((held, id)) = self.table.next_spare_worker(lane, next)
        {
            next = (held, WorkerId(id.0 + 1));
            let Some(worker) = self.table.workers.get(&id) else { continue };
            if !worker.is_fit(&self.config, now) {
                continue;
            }
            match self.pick_task(id, lane, now) {
                Pick::Task(task) => self.assign_next(id, task, now, out),
                Pick::BeginShared(job, frame, key) => {
                    self.begin_shared(job, frame, key, id, now, out);
                    next = (held, id);
                }
                Pick::NotForThisWorker => {}
                Pick::NothingReady => return,
            }
        }
    }

    /// Checks whether there may be ready tasks in a lane. Reduce tasks are ready only for moments, so jobs without any are not
    /// searched for them.
    fn has_ready(&self, lane: Lane) -> bool {
        match lane {
            Lane::Compute => true,
            Lane::Join => !self.joinable.is_empty(),
        }
    }

    /// Returns the first ready task of a lane that the worker may take: jobs in their order of service, frames in order, later
    /// stages before earlier ones.
    fn pick_task(&mut self, id: WorkerId, lane: Lane, now: Tick) -> Pick {
        loop {
            match self.pick_open(id, lane, now) {
                ControlFlow::Break(pick) => return pick,
                ControlFlow::Continue(job) => {
                    if let (Some(known), Some(ready_tasks)) = (self.ledger.jobs.get(&job), self.ready.get_mut(&job)) {
                        ready_tasks.open_next(known);
                        self.update_joinable(job);
                    }
                }
            }
        }
    }

    /// Searches the open frames like [`Self::pick_task`]. Continues with a job if another of its frames must be opened before the
    /// result is known.
    fn pick_open(&self, id: WorkerId, lane: Lane, now: Tick) -> ControlFlow<Pick, JobId> {
        let mut best = Pick::NothingReady;
        let Some(worker) = self.table.workers.get(&id) else { return ControlFlow::Break(best) };
        let has_shared = lane == Lane::Join && self.joinable.iter().any(|job| job.is_shared());
        for job_id in self.order.jobs_by_service() {
            let (Some(job), Some(ready_tasks)) = (self.ledger.jobs.get(&job_id), self.ready.get(&job_id)) else {
                continue;
            };
            if lane == Lane::Join && !has_shared && !self.joinable.contains(&job_id) {
                continue;
            }
            if !worker.has_tags(&job.spec.tags) || self.is_quarantined_for(job, ready_tasks, id, now) {
                best = Pick::NotForThisWorker;
                continue;
            }
            match self.first_ready(job_id, id, lane, now) {
                Pick::NotForThisWorker => best = Pick::NotForThisWorker,
                Pick::NothingReady => {}
                found => return ControlFlow::Break(found),
            }
            if lane == Lane::Compute && ready_tasks.has_unopened(job) && ready_tasks.may_open(id, &self.table) {
                return ControlFlow::Continue(job_id);
            }
        }
        ControlFlow::Break(best)
    }

    /// Returns the first ready task of a job, or of a shared job that it waits for, that the worker may take in a lane.
    fn first_ready(&self, id: JobId, worker: WorkerId, lane: Lane, now: Tick) -> Pick {
        let mut best = Pick::NothingReady;
        let (Some(job), Some(ready_tasks)) = (self.ledger.jobs.get(&id), self.ready.get(&id)) else { return best };
        let Some(engine) = self.table.workers.get(&worker).map(|worker| &*worker.registration.engine) else {
            return best;
        };
        for (frame, open) in ready_tasks.open.ready() {
            if self.is_reserved_for_others(id, frame, worker) {
                best = Pick::NotForThisWorker;
                continue;
            }
            for (stage, keys) in open.stages() {
                if !self.table.has_tags(worker, job.tags_of(stage.number)) {
                    best = Pick::NotForThisWorker;
                    continue;
                }
                let is_in_lane = stage.kind.properties().lane == lane;
                match self.content_state(id, job, stage, engine) {
                    ContentState::Available if is_in_lane => {}
                    ContentState::Missing(key) => return Pick::BeginShared(id, frame, key),
                    // Tasks of this stage wait for a shared job, whose tasks may be in either lane.
                    ContentState::InProgress(shared) => {
                        if let Some(task) = self.ready_shared(shared, worker, lane, now) {
                            return Pick::Task(task);
                        }
                        best = Pick::NotForThisWorker;
                        continue;
                    }
                    ContentState::Elsewhere => {
                        best = Pick::NotForThisWorker;
                        continue;
                    }
                    ContentState::Available => continue,
                }
                let mut tasks = keys.iter().map(|index| TaskKey { job: id, stage: *stage, index });
                if let Some(task) = tasks.find(|task| !self.is_avoided(task, job, ready_tasks, worker)) {
                    return Pick::Task(task);
                }
                best = Pick::NotForThisWorker;
            }
        }
        best
    }

    /// Returns the first ready task of a shared job that the worker may take in a lane.
    fn ready_shared(&self, id: JobId, worker: WorkerId, lane: Lane, now: Tick) -> Option<TaskKey> {
        let (job, ready_tasks) = (self.ledger.jobs.get(&id)?, self.ready.get(&id)?);
        if job.has_ended() || self.is_quarantined_for(job, ready_tasks, worker, now) {
            return None;
        }
        let tasks = ready_tasks.open.ready().flat_map(|(_, open)| open.tasks(id));
        let mut tasks = tasks.filter(|task| task.stage.kind.properties().lane == lane);
        tasks.find(|task| self.may_take(task, job, ready_tasks, worker))
    }

    /// Leases a task to a worker.
    /// - `copy_of`: epoch of another worker's lease of this task, if this is a copy.
    pub(crate) fn assign_task(
        &mut self,
        task: TaskKey,
        run: &Range<u32>,
        copy_of: Option<Epoch>,
        worker: WorkerId,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        let Some((work, units)) = self.task_spec(&task, run, worker, now) else {
            debug_assert!(false, "the picked task does not exist: {task}");
            return;
        };
        let epoch = self.next_epoch();
        if let Some(instance) = self.table.instance(worker)
            && let Some(ready_tasks) = self.ready.get_mut(&task.job)
        {
            ready_tasks.quarantine.record_grant(instance, task);
        }
        self.grant_lease((task, epoch), run, units, worker, now);
        if copy_of.is_some() {
            self.table.copies.insert((task, epoch));
            self.ready.entry(task.job).or_default().copies += 1;
        }
        let assignment = Assignment { task, epoch, lease: self.config.lease, copy_of, spec: work };
        out.push(Command::Assign { worker, assignment });
    }

    /// Removes a run of a task from the ready tasks and enters its lease.
    /// - `units`: units of work of the run.
    pub(crate) fn grant_lease(&mut self, key: LeaseKey, run: &Range<u32>, units: u64, worker: WorkerId, now: Tick) {
        let (task, _) = &key;
        if let Some(ready_tasks) = self.ready.get_mut(&task.job) {
            ready_tasks.remove(task, run);
        }
        self.update_joinable(task.job);
        let size = self.lease_size(task, units);
        self.claim(task.job, size.milliseconds);
        self.table.grant(key, run, worker, size, &self.config, now);
    }

    /// Returns the description of a task for its worker, and its units of work.
    fn task_spec(&self, task: &TaskKey, run: &Range<u32>, worker: WorkerId, now: Tick) -> Option<(TaskSpec, u64)> {
        let job = self.ledger.jobs.get(&task.job)?;
        let (progress, view) = (job.progress(task.stage.frame), job.graph_view(task.stage.frame));
        let stage_round: StageRound = (task.stage.round, task.stage.number);
        let chunks = progress.chunks(&view, stage_round)?;
        let engine = &*self.table.workers.get(&worker)?.registration.engine;
        let key = job.content_key(task.stage.frame);
        let shared = key.and_then(|key| self.ledger.shared_job_of(&key, engine)).map(|(_, shared)| shared);
        let (item, is_cut) = (chunks.task(task.index), task.stage.kind.is_divided());
        let may_continue = job.spec.graph.is_looped(task.stage.number) && view.may_continue(task.stage.round);
        let spec = TaskSpec {
            item,
            steps: chunks.steps(run),
            inputs: progress.inputs(&view, stage_round, item, shared),
            hints: job.hint_inputs(&task.stage, item, engine),
            steps_taken: progress.steps_taken(&view, stage_round, item),
            next_round: if may_continue { NextRound::Possible } else { NextRound::Impossible },
            elapsed: if is_cut { 0 } else { now.since(progress.began) },
            busy_seconds: if is_cut { 0.0 } else { progress.busy_seconds },
        };
        Some((spec, chunks.units(run)))
    }

    /// Returns the reasons why tasks of this job wait; empty if none waits.
    pub(crate) fn wait_reasons(&self, id: JobId, job: &Job, ready_tasks: &ReadyTasks, now: Tick) -> Vec<WaitReason> {
        let mut waits = Vec::new();
        for &frame in &job.blocked {
            let tasks = job.unfinished.get(&frame).map_or(0, |progress| progress.quarantined().count() as u32);
            if tasks > 0 || frame == Stage::JOB_FRAME {
                waits.push(WaitReason::Quarantined { frame, tasks });
            }
        }
        waits.extend(self.stuck_waits(job));
        if job.has_ended() {
            return waits;
        }
        let reruns = job.unfinished.iter().filter(|(_, progress)| progress.is_rerun);
        waits.extend(reruns.map(|(&frame, _)| WaitReason::ImageLost { frame }));
        let is_leased = |task: &TaskKey| self.table.leases_of_task(task).next().is_some();
        let is_open = |task: &TaskKey| is_leased(task) || ready_tasks.is_ready(task, &(task.index..task.index + 1));
        waits.extend(ready_tasks.infrastructure_failures.wait_reason(is_open));
        if !job.is_runnable() {
            waits.push(WaitReason::Paused);
            return waits;
        }
        for (frame, open) in ready_tasks.open.iter() {
            waits.extend(open.stages().next().is_none().then(|| idle_wait(job, frame)).flatten());
        }
        let is_ready = ready_tasks.open.ready().next().is_some();
        if is_ready || ready_tasks.has_unopened(job) {
            let none: &[String] = &[];
            let stages = ready_tasks.open.ready().flat_map(|(_, open)| open.stages());
            let needed: BTreeSet<(&[String], Lane)> =
                stages.map(|(stage, _)| (job.tags_of(stage.number), stage.kind.properties().lane)).collect();
            let needed = if needed.is_empty() { BTreeSet::from([(none, Lane::Compute)]) } else { needed };
            let missing = needed
                .into_iter()
                .filter_map(|(tags, lane)| self.no_worker_wait(id, job, tags, lane, ready_tasks, now));
            let mut missing: Vec<WaitReason> = missing.collect();
            missing.dedup();
            waits.extend(missing);
            waits.extend(self.silent_wait(job, now));
            waits.extend(self.back_off_wait(job, now));
            waits.extend(self.quarantine_wait(job, ready_tasks, now));
            waits.extend(self.avoided_wait(job, ready_tasks));
            waits.extend(self.other_build_wait(id, job, ready_tasks, now));
            waits.extend(self.shared_waits(job));
        }
        waits
    }

    /// Returns the reason why no worker takes ready tasks of a stage.
    /// - `tags`: tags of the stage, in addition to the job's;
    /// - `lane`: lane of the stage.
    fn no_worker_wait(
        &self,
        id: JobId,
        job: &Job,
        tags: &[String],
        lane: Lane,
        ready_tasks: &ReadyTasks,
        now: Tick,
    ) -> Option<WaitReason> {
        if now < self.dispatch_from {
            return Some(WaitReason::Regrouping { milliseconds: self.dispatch_from.since(now) });
        }
        if self.table.workers.is_empty() {
            return Some(WaitReason::NoWorkers);
        }
        let all: Vec<String> = job.spec.tags.iter().chain(tags).cloned().collect();
        let capable: Vec<&Worker> = self.table.workers.values().filter(|worker| worker.has_tags(&all)).collect();
        if capable.is_empty() {
            return Some(WaitReason::NoWorkerWithTags(all));
        }
        let capable_count = capable.len();
        let capable: Vec<&Worker> = capable.into_iter().filter(|worker| worker.is_open()).collect();
        if capable.is_empty() {
            return Some(WaitReason::WorkersDraining { workers: capable_count as u32 });
        }
        let fit: Vec<&&Worker> = capable.iter().filter(|worker| worker.is_fit(&self.config, now)).collect();
        let is_trusted =
            |worker: &&&Worker| ready_tasks.quarantine.remaining(worker.registration.instance, now).is_none();
        let trusted: Vec<&&Worker> = fit.iter().copied().filter(is_trusted).collect();
        let fit = if trusted.is_empty() { fit } else { trusted };
        if fit.is_empty() {
            let rests = capable.iter().any(|worker| !worker.is_silent(&self.config, now));
            return rests.then_some(WaitReason::AllWorkersBackingOff);
        }
        if !fit.iter().any(|worker| worker.has_room(lane, &self.config)) {
            let mut before = self.order.jobs_by_service().take_while(|&job| job != id);
            let holds = |other: &JobId| self.table.leases_of_job(*other).next().is_some();
            return Some(match before.find(holds) {
                Some(other) => WaitReason::BehindJob(other),
                None => WaitReason::WorkersBusy { workers: fit.len() as u32 },
            });
        }
        None
    }
}

impl Scheduler {
    /// Counts ready tasks that are kept from the worker on which they failed last.
    fn avoided_wait(&self, job: &Job, ready_tasks: &ReadyTasks) -> Option<WaitReason> {
        let is_kept = |(task, worker): &(&TaskKey, &WorkerId)| {
            let first = task.index..task.index + 1;
            ready_tasks.is_ready(task, &first) && self.is_avoided(task, job, ready_tasks, **worker)
        };
        let tasks = ready_tasks.last_failed_on.iter().filter(is_kept).count() as u32;
        (tasks > 0).then_some(WaitReason::WorkersAvoided { tasks })
    }

    /// Reports capable workers that are silent.
    fn silent_wait(&self, job: &Job, now: Tick) -> Option<WaitReason> {
        let silent: Vec<u64> = self
            .capable_workers(job)
            .filter(|w| w.is_silent(&self.config, now))
            .map(|w| now.since(w.last_message))
            .collect();
        let seconds = silent.iter().max()? / 1000;
        Some(WaitReason::WorkersSilent { workers: silent.len() as u32, seconds })
    }

    /// Reports capable workers that rest after an infrastructure failure, with the failure of the one that resumes first.
    fn back_off_wait(&self, job: &Job, now: Tick) -> Option<WaitReason> {
        let rests = |worker: &&Worker| now < worker.back_off_until && !worker.is_silent(&self.config, now);
        let next = self.capable_workers(job).filter(rests).min_by_key(|worker| worker.back_off_until)?;
        let seconds = next.back_off_until.since(now).div_ceil(1000);
        let workers = self.capable_workers(job).filter(rests).count() as u32;
        next.last_infrastructure_failure.clone().map(|failure| WaitReason::WorkersBackingOff {
            workers,
            seconds,
            failure,
        })
    }

    /// Returns the workers that accept tasks and have the job's tags.
    pub(crate) fn capable_workers(&self, job: &Job) -> impl Iterator<Item = &Worker> {
        self.table.workers.values().filter(|worker| worker.is_open() && worker.has_tags(&job.spec.tags))
    }

    /// Reports workers that are quarantined for the job.
    fn quarantine_wait(&self, job: &Job, ready_tasks: &ReadyTasks, now: Tick) -> Option<WaitReason> {
        let quarantined = |(&id, worker): (&WorkerId, &Worker)| {
            self.quarantine_remaining(job, ready_tasks, id, now).filter(|_| worker.has_tags(&job.spec.tags))
        };
        let left: Vec<u64> = self.table.workers.iter().filter_map(quarantined).collect();
        let seconds = left.iter().min()?.div_ceil(1000);
        Some(WaitReason::WorkersQuarantined { workers: left.len() as u32, seconds })
    }
}

/// Returns the stage that a frame waits for, if no task of the frame can be leased now.
fn idle_wait(job: &Job, frame: u32) -> Option<WaitReason> {
    let (progress, view) = (job.progress(frame), job.graph_view(frame));
    let stage_round = progress.stage_rounds(&view).find(|&place| !progress.is_complete(&view, place))?;
    let needs = view.template(stage_round.1)?;
    let of_frames = needs.needs.iter().find_map(|need| {
        job.spec.graph.stage(need.stage).filter(|made| needs.scope == Scope::Job && made.scope != needs.scope)
    });
    if let Some(made) = of_frames {
        let frames = (job.frames().len() - job.frames_done()) as u32;
        return Some(WaitReason::StageWaits { frame, stage: needs.kind, needs: made.kind, tasks: frames });
    }
    let waits = view.graph.readers(stage_round.1).find_map(|(reader, _)| view.template(reader))?;
    let tasks = needs.tasks() - progress.tasks_done(stage_round);
    Some(WaitReason::StageWaits { frame, stage: waits.kind, needs: needs.kind, tasks })
}

impl Scheduler {
    /// Checks whether another worker could replace this one: it has the same build, accepts tasks of the job, has these tags, and
    /// meets `is_eligible`.
    fn has_peer(&self, job: &Job, tags: &[String], worker: WorkerId, is_eligible: impl Fn(WorkerId) -> bool) -> bool {
        let Some(own) = self.table.workers.get(&worker) else { return false };
        self.table.workers.iter().any(|(&id, other)| {
            id != worker
                && other.is_open()
                && other.has_tags(tags)
                && other.registration.engine == own.registration.engine
                && is_eligible(id)
                && self.has_tags_for(other, job)
        })
    }

    /// Checks whether the worker is quarantined for the job, because the job's tasks keep failing on it.
    pub(crate) fn is_quarantined_for(&self, job: &Job, ready_tasks: &ReadyTasks, worker: WorkerId, now: Tick) -> bool {
        self.quarantine_remaining(job, ready_tasks, worker, now).is_some()
    }

    /// Returns the remaining milliseconds of the worker's quarantine for the job. The quarantine is long if another worker that is
    /// not quarantined could take the tasks; otherwise it is the shorter one for a lone worker. `None`: the worker gets tasks.
    fn quarantine_remaining(&self, job: &Job, ready_tasks: &ReadyTasks, worker: WorkerId, now: Tick) -> Option<u64> {
        let quarantine = &ready_tasks.quarantine;
        let left = |id| quarantine.remaining(self.table.instance(id)?, now);
        let with_peer = left(worker).filter(|_| self.has_peer(job, &[], worker, |other| left(other).is_none()));
        with_peer.or_else(|| quarantine.remaining_alone(self.table.instance(worker)?, now))
    }

    /// Checks that the worker has the tags of the task's stage, and that the task is not kept from it.
    pub(crate) fn may_take(&self, task: &TaskKey, job: &Job, ready_tasks: &ReadyTasks, worker: WorkerId) -> bool {
        self.table.has_tags(worker, job.tags_of(task.stage.number)) && !self.is_avoided(task, job, ready_tasks, worker)
    }

    /// Checks whether the task is kept from this worker: it failed last on this worker, and another worker could take it. A worker
    /// on which the job's tasks keep failing does not count as another, or each would wait for the other.
    fn is_avoided(&self, task: &TaskKey, job: &Job, ready_tasks: &ReadyTasks, worker: WorkerId) -> bool {
        let is_trusted =
            |id| self.table.instance(id).is_some_and(|instance| !ready_tasks.quarantine.is_suspect(instance));
        ready_tasks.last_failed_on.get(task) == Some(&worker)
            && self.has_peer(job, job.tags_of(task.stage.number), worker, is_trusted)
    }
}
