//! Queries: the status of one or all jobs, the frames of a job, the workers.

use std::collections::{BTreeMap, BTreeSet};

use femc_model::{
    Digest, FrameParts, FrameProgress, FrameRecord, Intake, JobId, JobState, JobStatus, LeaseStatus, QuarantinedTask,
    Refusal, Stage, StageKind, TaskKey, Tick, WorkerId, WorkerStatus,
};

use crate::lease_table::LeaseKey;
use crate::ledger::{Hold, Job, Progress};
use crate::scheduler::Scheduler;

impl Scheduler {
    /// Returns the status of every job, in order of submission.
    pub fn jobs(&self, now: Tick) -> Vec<JobStatus> {
        self.ledger.submitted_jobs().filter_map(|(job, _)| self.status(job, now).ok()).collect()
    }

    /// Returns the status of every job that has not ended or is wanted, and the numbers of all jobs.
    pub fn changed_jobs(&self, is_wanted: impl Fn(JobId) -> bool, now: Tick) -> (Vec<JobStatus>, BTreeSet<JobId>) {
        let mut numbers = BTreeSet::new();
        let mut changed = Vec::new();
        for (id, job) in self.ledger.submitted_jobs() {
            numbers.insert(id);
            if !job.has_ended() || is_wanted(id) {
                changed.extend(self.status(id, now).ok());
            }
        }
        (changed, numbers)
    }

    /// Returns the status of a job.
    pub fn status(&self, id: JobId, now: Tick) -> Result<JobStatus, Refusal> {
        let job = self.job(id)?;
        let ready_tasks = self.ready.get(&id).ok_or(Refusal::NoSuchJob { job: id })?;
        let mut workers: Vec<_> = self.table.leases_of_job(id).map(|(_, lease)| lease.worker).collect();
        workers.sort_unstable();
        workers.dedup();
        let spec = &job.spec;
        let bad_finished: u64 = job.finished.values().map(|finished| finished.record.bad_samples).sum();
        let bad_active: u64 = job.unfinished.values().map(|progress| progress.bad_samples).sum();
        let first_lease = self.table.leases_of_job(id).map(|(_, lease)| lease.granted).min();
        let began = job.began.into_iter().chain(first_lease).min();
        let worst = job.worst_frame();
        Ok(JobStatus {
            job: id,
            name: spec.name.clone(),
            owner: spec.owner.clone(),
            scene: spec.entry.clone(),
            notes: spec.notes.clone(),
            priority: spec.priority,
            state: self.state(job, began.is_some()),
            failure: job.failure.clone().or_else(|| {
                self.stuck_shared(job).filter(|_| job.has_ended()).find_map(|(_, shared)| shared.failure.clone())
            }),
            frames_total: spec.frames.len() as u32,
            frames_done: job.frames_done() as u32,
            frames_failed: job.frames_blocked() as u32,
            active: self.active_frames(id, job),
            workers: workers.len() as u32,
            samples_done: self.units_done(id),
            samples_planned: spec.samples_of_frame().saturating_mul(spec.frames.len() as u64),
            samples_per_second: ready_tasks.sample_rate.per_second(),
            bad_samples: bad_finished + bad_active,
            relative_error: worst.and_then(|(_, error, _)| error),
            blocks: worst.and_then(|(.., blocks)| blocks),
            worst_frame: worst.map(|(frame, ..)| frame),
            error_target: None,
            seconds: began.map_or(0, |began| job.ended.unwrap_or(now).since(began)) as f64 / 1000.0,
            quarantined: quarantined_tasks(id, job)
                .into_iter()
                .chain(self.stuck_shared(job).flat_map(|(id, it)| quarantined_tasks(id, it)))
                .collect(),
            stale_messages: ready_tasks.stale_messages,
            copies: ready_tasks.copies,
            waits: self.wait_reasons(id, job, ready_tasks, now),
            submitted: self.config.clock_zero.map(|zero| zero.saturating_add(job.submitted().0)),
            submitted_date: job.date,
        })
    }

    /// Returns the stuck shared jobs that block frames of a job.
    pub(crate) fn stuck_shared(&self, job: &Job) -> impl Iterator<Item = (JobId, &Job)> {
        let keys = job.blocked.iter().filter_map(|&frame| job.content_key(frame)).collect::<BTreeSet<Digest>>();
        let shared = self.ledger.shared_jobs().filter(|(_, shared)| shared.is_stuck());
        shared.filter(move |(_, shared)| shared.shared.as_ref().is_some_and(|it| keys.contains(&it.key)))
    }

    /// Returns the records of a job's finished frames, ascending; that of the job's own stages, if finished, comes first.
    pub fn frames(&self, id: JobId) -> Result<Vec<FrameRecord>, Refusal> {
        Ok(self.job(id)?.finished.values().map(|finished| finished.record.clone()).collect())
    }

    /// Returns the existing parts of a job's frames in progress, ascending.
    pub fn partial_frames(&self, id: JobId) -> Result<Vec<FrameParts>, Refusal> {
        let job = self.job(id)?;
        let parts = |(&frame, progress): (&u32, &Progress)| {
            let outputs = progress.preview_outputs(&job.graph_view(frame));
            FrameParts { frame, grid: job.spec.grid, outputs }
        };
        Ok(job.unfinished.iter().map(parts).filter(|parts| !parts.outputs.is_empty()).collect())
    }

    /// Returns the task of a job's frame in progress that made an artifact.
    pub fn producer(&self, id: JobId, digest: &Digest) -> Result<Option<TaskKey>, Refusal> {
        let job = self.job(id)?;
        let task = |(&frame, progress): (&u32, &Progress)| {
            let ((round, number), index) = *progress.producers(&[*digest]).first()?;
            let kind = job.graph_view(frame).template(number)?.kind;
            Some(TaskKey { job: id, stage: Stage { frame, round, number, kind }, index })
        };
        Ok(job.unfinished.iter().find_map(task))
    }

    /// Returns the connected workers, in order of joining.
    pub fn workers(&self, now: Tick) -> Vec<WorkerStatus> {
        let status = |(&worker, known): (_, &crate::lease_table::Worker)| WorkerStatus {
            worker,
            name: known.registration.name.clone(),
            threads: known.registration.threads,
            tags: known.registration.tags.clone(),
            tasks: sorted(known.held.iter().map(|held| held.task)),
            silent: now.since(known.last_message),
            completed: known.completed,
            failed: known.failed,
            intake: known.intake,
            engine: known.registration.engine.clone(),
        };
        self.table.workers.iter().map(status).collect()
    }

    /// Returns the leases of one worker, with their remaining time.
    pub fn leases(&self, worker: WorkerId, now: Tick) -> Vec<LeaseStatus> {
        let lease = |key: LeaseKey| {
            let lease = self.table.leases.get(&key)?;
            Some(LeaseStatus { task: key.0, epoch: key.1, remaining: lease.deadline.since(now) })
        };
        self.table.leases_of_worker(worker).into_iter().filter_map(lease).collect()
    }

    /// Returns the intake that is granted to a worker.
    pub fn intake(&self, worker: WorkerId) -> Intake {
        self.table.workers.get(&worker).map_or(Intake::Open, |known| known.intake)
    }

    /// Checks whether a job has ended, as far as is known now, or does not exist.
    pub fn has_ended(&self, job: JobId) -> bool {
        self.ledger.jobs.get(&job).is_none_or(Job::has_ended)
    }

    /// Returns the number of messages refused since the start because their lease was over.
    pub fn stale_messages(&self) -> u64 {
        self.stale_messages
    }

    /// Returns the state of a job.
    pub(crate) fn state_of(&self, id: JobId, job: &Job) -> JobState {
        self.state(job, job.began.is_some() || self.table.leases_of_job(id).next().is_some())
    }

    fn state(&self, job: &Job, has_begun: bool) -> JobState {
        if job.is_done() {
            JobState::Done
        } else if job.hold == Hold::Cancelled {
            JobState::Cancelled
        } else if job.has_ended() {
            JobState::Failed
        } else if job.hold == Hold::Paused {
            JobState::Paused
        } else if has_begun {
            JobState::Running
        } else {
            JobState::Queued
        }
    }

    /// Returns the units of work in results and running tasks: pixel samples.
    pub(crate) fn units_done(&self, id: JobId) -> u64 {
        let Some(job) = self.ledger.jobs.get(&id) else { return 0 };
        let active: u64 = job.unfinished.values().map(|progress| progress.units).sum();
        let running: u64 = self.running_units(id).map(|(_, units)| units).sum();
        job.finished_units() + active + running
    }

    /// Returns the leased tasks of a job with their units so far. If a task has two leases, the one with more progress counts.
    fn running_units(&self, id: JobId) -> impl Iterator<Item = (TaskKey, u64)> + '_ {
        let mut leases = self.table.leases_of_job(id).peekable();
        std::iter::from_fn(move || {
            let ((task, _), lease) = leases.next()?;
            let mut units = lease.units(&task);
            while let Some((_, other)) = leases.next_if(|((next, _), _)| *next == task) {
                units = units.max(other.units(&task));
            }
            Some((task, units))
        })
    }

    pub(crate) fn active_frames(&self, id: JobId, job: &Job) -> Vec<FrameProgress> {
        let mut active: BTreeMap<u32, FrameProgress> =
            job.unfinished.keys().map(|&frame| (frame, frame_progress(job, frame))).collect();
        for (task, units) in self.running_units(id) {
            let frame = active.entry(task.stage.frame).or_insert_with(|| frame_progress(job, task.stage.frame));
            frame.running += 1;
            frame.samples_done += units;
        }
        active.into_values().collect()
    }
}

/// Returns the progress of a frame, without its running tasks. Its main stage is the one that is divided into sample chunks, or
/// else the present one.
fn frame_progress(job: &Job, frame: u32) -> FrameProgress {
    let (progress, view) = (job.progress(frame), job.graph_view(frame));
    let stages = || view.graph.stages_of(view.scope);
    let current = progress.stage_rounds(&view).find(|&stage_round| !progress.is_complete(&view, stage_round));
    let current = current.and_then(|(_, number)| Some((number, view.template(number)?)));
    let main = stages().find(|(_, template)| template.kind.is_divided()).or(current).or_else(|| stages().next());
    let (number, tiles_total) = main.map_or((0, 0), |(number, template)| (number, template.tasks()));
    let round = if view.graph.is_looped(number) { progress.round } else { 0 };
    FrameProgress {
        frame,
        round: progress.round,
        rounds: view.graph.rounds(number),
        stage: current.or(main).map_or(StageKind::ALL[0], |(_, template)| template.kind),
        tiles_done: progress.tasks_done((round, number)),
        tiles_total,
        running: 0,
        samples_done: progress.units,
        relative_error: progress.relative_error,
        blocks: progress.blocks,
    }
}

fn sorted(tasks: impl Iterator<Item = TaskKey>) -> Vec<TaskKey> {
    let mut tasks: Vec<TaskKey> = tasks.collect();
    tasks.sort_unstable();
    tasks
}

fn quarantined_tasks(id: JobId, job: &Job) -> Vec<QuarantinedTask> {
    let mut all = Vec::new();
    for (&frame, progress) in &job.unfinished {
        for ((number, round, index), failures) in progress.quarantined() {
            let Some(template) = job.graph_view(frame).template(number) else { continue };
            let is_joined_in_rounds = !template.kind.is_divided() && job.spec.graph.is_looped(number);
            let round = if is_joined_in_rounds { progress.round } else { round };
            let stage = Stage { frame, round, number, kind: template.kind };
            let task = TaskKey { job: id, stage, index };
            all.push(QuarantinedTask { task, attempts: failures.attempt_count(), failure: failures.failure.clone() });
        }
    }
    all
}
