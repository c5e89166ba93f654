//! What may be asked: a job at a glance, all jobs, the frames of one, the workers.

use femc_model::{
    FrameParts, FrameProgress, FrameRecord, JobId, JobState, JobStatus, LeaseLeft, Quarantined, Refusal, Stage,
    StageKind, TaskKey, Tick, WorkerId, WorkerStatus,
};

use crate::floor::LeaseKey;
use crate::ledger::frame::Frame;
use crate::ledger::{Hold, Job};
use crate::scheduler::Scheduler;

impl Scheduler {
    /// Every job, in order of submission.
    pub fn jobs(&self, now: Tick) -> Vec<JobStatus> {
        self.ledger.jobs.keys().filter_map(|&job| self.status(job, now).ok()).collect()
    }

    /// One job.
    pub fn status(&self, id: JobId, now: Tick) -> Result<JobStatus, Refusal> {
        let job = self.job(id)?;
        let desk = self.desks.get(&id).ok_or(Refusal::NoSuchJob { job: id })?;
        let mut workers: Vec<_> = self.floor.of_job(id).map(|(_, lease)| lease.worker).collect();
        workers.sort_unstable();
        workers.dedup();
        let spec = &job.spec;
        let bad_finished: u64 = job.finished.values().map(|finished| finished.record.bad_samples).sum();
        let bad_active: u64 = job.frames.values().map(|f| f.merged_bad_samples + f.fresh_bad_samples).sum();
        let first_lease = self.floor.of_job(id).map(|(_, lease)| lease.granted).min();
        let began = job.began.into_iter().chain(first_lease).min();
        Ok(JobStatus {
            job: id,
            name: spec.name.clone(),
            owner: spec.owner.clone(),
            priority: spec.priority,
            state: self.state(job, began.is_some()),
            failure: job.doom.clone(),
            frames_total: spec.frames.len() as u32,
            frames_done: job.finished.len() as u32,
            frames_failed: job.blocked.len() as u32,
            active: self.active(id, job),
            workers: workers.len() as u32,
            samples_done: self.samples(id),
            samples_planned: spec.frames.len() as u64
                * spec.grid.pixels()
                * u64::from(spec.rounds.last().copied().unwrap_or(0)),
            samples_per_second: desk.rate.per_second(),
            bad_samples: bad_finished + bad_active,
            relative_error: job.relative_error,
            seconds: began.map_or(0, |began| job.ended.unwrap_or(now).since(began)) as f64 / 1000.0,
            quarantined: quarantined(id, job),
            stale_messages: desk.stale_messages,
            copies: desk.copies,
            waits: self.waits(id, job, desk, now),
        })
    }

    /// The finished frames of a job, ascending.
    pub fn frames(&self, id: JobId) -> Result<Vec<FrameRecord>, Refusal> {
        Ok(self.job(id)?.finished.values().map(|finished| finished.record.clone()).collect())
    }

    /// What there is of a job's frames in work, ascending.
    pub fn parts(&self, id: JobId) -> Result<Vec<FrameParts>, Refusal> {
        let job = self.job(id)?;
        let parts = |(&number, frame): (&u32, &Frame)| FrameParts {
            frame: number,
            grid: job.spec.grid,
            sums: frame.sums.into_iter().chain(frame.groups.sums_before()).collect(),
            tiles: frame.parts_there(0..u32::MAX).collect(),
            groups: frame.groups.pixels(),
        };
        let has_some =
            |parts: &FrameParts| !(parts.sums.is_empty() && parts.tiles.is_empty() && parts.groups.is_empty());
        Ok(job.frames.iter().map(parts).filter(has_some).collect())
    }

    /// The workers, in order of joining.
    pub fn workers(&self, now: Tick) -> Vec<WorkerStatus> {
        let status = |(&worker, known): (_, &crate::floor::Worker)| WorkerStatus {
            worker,
            name: known.registration.name.clone(),
            threads: known.registration.threads,
            tags: known.registration.tags.clone(),
            tasks: sorted(known.held.iter().map(|(_, task)| *task)),
            silent: now.since(known.seen),
            completed: known.completed,
            failed: known.failed,
            intake: known.intake,
            engine: known.registration.engine.clone(),
        };
        self.floor.workers.iter().map(status).collect()
    }

    /// The leases of one worker, and how long they hold.
    pub fn leases(&self, worker: WorkerId, now: Tick) -> Vec<LeaseLeft> {
        let lease = |key: LeaseKey| {
            let lease = self.floor.leases.get(&key)?;
            Some(LeaseLeft { task: key.0, epoch: key.1, left: lease.deadline.since(now) })
        };
        self.floor.held(worker).into_iter().filter_map(lease).collect()
    }

    /// Messages refused since the start because their lease was over.
    pub fn stale_messages(&self) -> u64 {
        self.stale_messages
    }

    /// Where a job stands.
    pub(crate) fn state_of(&self, id: JobId, job: &Job) -> JobState {
        self.state(job, job.began.is_some() || self.floor.of_job(id).next().is_some())
    }

    fn state(&self, job: &Job, has_begun: bool) -> JobState {
        if job.finished.len() == job.spec.frames.len() {
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

    /// Pixel samples in results and running tasks.
    pub(crate) fn samples(&self, id: JobId) -> u64 {
        let Some(job) = self.ledger.jobs.get(&id) else { return 0 };
        let finished: u64 = job.finished.values().map(|f| u64::from(f.record.spp) * job.spec.grid.pixels()).sum();
        let active: u64 = job.frames.values().map(|frame| frame.samples).sum();
        let running: u64 = self.under_way(id).map(|(_, samples)| samples).sum();
        finished + active + running
    }

    /// The tasks of a job that are leased, and the pixel samples of each so far; of two leases of a task the one that is further counts.
    fn under_way(&self, id: JobId) -> impl Iterator<Item = (&TaskKey, u64)> + '_ {
        let mut leases = self.floor.of_job(id).peekable();
        std::iter::from_fn(move || {
            let ((task, _), lease) = leases.next()?;
            let mut samples = lease.samples(task);
            while let Some((_, other)) = leases.next_if(|((next, _), _)| next == task) {
                samples = samples.max(other.samples(task));
            }
            Some((task, samples))
        })
    }

    fn active(&self, id: JobId, job: &Job) -> Vec<FrameProgress> {
        let mut active: std::collections::BTreeMap<u32, FrameProgress> = std::collections::BTreeMap::new();
        let blank = |number: u32| {
            let (frame, layout) = (job.frames.get(&number), job.layout(job.round(number)));
            FrameProgress {
                frame: number,
                round: job.round(number),
                rounds: job.spec.rounds.len() as u32,
                stage: frame.map_or(StageKind::Render, |frame| frame.stage(&layout)),
                tiles_done: frame.map_or(0, |frame| frame.tiles_done(&layout)),
                tiles_total: layout.tiles(),
                running: 0,
                samples_done: frame.map_or(0, |frame| frame.samples),
                relative_error: frame.and_then(|frame| frame.relative_error),
            }
        };
        for &number in job.frames.keys() {
            active.insert(number, blank(number));
        }
        for (task, samples) in self.under_way(id) {
            let number = task.stage.frame;
            let frame = active.entry(number).or_insert_with(|| blank(number));
            frame.running += 1;
            frame.samples_done += samples;
        }
        active.into_values().collect()
    }
}

fn sorted(tasks: impl Iterator<Item = TaskKey>) -> Vec<TaskKey> {
    let mut tasks: Vec<TaskKey> = tasks.collect();
    tasks.sort_unstable();
    tasks
}

fn quarantined(id: JobId, job: &Job) -> Vec<Quarantined> {
    let mut all = Vec::new();
    for (&number, frame) in &job.frames {
        for (kind, index, trouble) in frame.quarantined() {
            let stage = Stage { frame: number, round: frame.round, kind };
            let task = TaskKey { job: id, stage, index };
            all.push(Quarantined { task, attempts: trouble.tries(), failure: trouble.failure.clone() });
        }
    }
    all
}
