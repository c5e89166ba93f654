//! Total numbers of jobs, tasks, leases and workers, for monitoring the farm.

use femc_model::{Intake, JobId, JobState, StageKind, Tick};

use crate::ledger::Job;
use crate::scheduler::Scheduler;

/// Key figures of the farm.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FarmStats {
    /// Number of jobs by state.
    pub jobs: Vec<(JobState, u64)>,
    /// Number of tasks that could be leased now, by kind. Divided tasks count each sample chunk, of which a lease may cover
    /// several.
    pub ready: Vec<(StageKind, u64)>,
    /// Number of leases by kind.
    pub leased: Vec<(StageKind, u64)>,
    /// Number of quarantined tasks.
    pub quarantined: u64,
    /// Number of pixel samples that the unfinished frames of running jobs may still take.
    pub samples_left: u64,
    /// Number of connected workers by standing.
    pub workers: Vec<(WorkerStanding, u64)>,
    /// Number of render threads of these workers.
    pub threads: u64,
    /// Milliseconds of worker time charged to owners so far.
    pub used: u64,
    /// Number of messages refused since the start because their lease was over.
    pub stale_messages: u64,
}

/// State of a worker with respect to tasks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WorkerStanding {
    /// The worker holds a task.
    Busy,
    /// The worker would accept a task.
    Idle,
    /// The worker rests after an infrastructure failure, or is silent.
    Unfit,
    /// The worker accepts no tasks: it is leaving or off duty.
    Off,
    /// An operator has drained the worker.
    Drained,
}

impl WorkerStanding {
    const ALL: [Self; 5] = [Self::Busy, Self::Idle, Self::Unfit, Self::Off, Self::Drained];
}

const STATES: [JobState; 6] =
    [JobState::Queued, JobState::Running, JobState::Paused, JobState::Done, JobState::Failed, JobState::Cancelled];
const KINDS: [StageKind; StageKind::ALL.len()] = StageKind::ALL;

impl Scheduler {
    /// Computes the key figures. Visits all jobs, leases and workers.
    pub fn stats(&self, now: Tick) -> FarmStats {
        let mut left = 0_u64;
        let mut ready = [0; KINDS.len()];
        let shared = self.ledger.shared_jobs().filter(|(_, shared)| self.is_wanted(shared)).map(|(id, _)| id);
        for id in self.order.jobs().chain(shared) {
            let Some(job) = self.ledger.jobs.get(&id) else { continue };
            left = left.saturating_add(if id.is_shared() { 0 } else { self.samples_left(id, job) });
            let counts = self.ready_counts(id, job);
            ready.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
        }
        let states: Vec<JobState> = self.ledger.submitted_jobs().map(|(id, job)| self.state_of(id, job)).collect();
        let leases: Vec<StageKind> = self.table.leases.iter().map(|((task, _), _)| task.stage.kind).collect();
        let workers: Vec<WorkerStanding> =
            self.table.workers.values().map(|worker| self.standing(worker, now)).collect();
        FarmStats {
            jobs: count(&STATES, &states),
            ready: KINDS.into_iter().zip(ready).collect(),
            leased: count(&KINDS, &leases),
            quarantined: self.ledger.jobs.values().map(quarantined_count).sum(),
            samples_left: left,
            workers: count(&WorkerStanding::ALL, &workers),
            threads: self.table.workers.values().map(|worker| u64::from(worker.registration.threads)).sum(),
            used: self.used_times().map(|(_, used)| used.charged).sum(),
            stale_messages: self.stale_messages,
        }
    }

    /// Counts the tasks of a job that could be leased now, by kind. Frames that have not begun count with their first round.
    fn ready_counts(&self, id: JobId, job: &Job) -> [u64; KINDS.len()] {
        let Some(ready_tasks) = self.ready.get(&id) else { return [0; KINDS.len()] };
        let mut ready = [0; KINDS.len()];
        let has_content = |frame: u32, number: u16| {
            let key = job.content_key(frame).filter(|_| job.spec.graph.reads_content(number));
            key.is_none_or(|key| self.ledger.shared_jobs_of(&key).any(|(_, _, shared)| shared.is_done()))
        };
        let unopened = job.frames().get(ready_tasks.cursor..).unwrap_or_default().iter().copied();
        let unopened: Vec<u32> =
            unopened.filter(|&frame| job.is_open(frame) && ready_tasks.open.get(frame).is_none()).collect();
        let first = unopened.first().map(|&frame| (job.new_progress(frame), job.graph_view(frame)));
        for ((_, number), keys) in first.iter().flat_map(|(progress, view)| progress.runnable(view)) {
            let kind = job.spec.graph.stage(number).map_or(KINDS[0], |template| template.kind);
            let frames = unopened.iter().filter(|&&frame| has_content(frame, number)).count() as u64;
            ready[kind.index()] += frames * u64::from(keys.count());
        }
        let open = ready_tasks.open.ready().flat_map(|(_, open)| open.stages());
        for (stage, keys) in open.filter(|(stage, _)| has_content(stage.frame, stage.number)) {
            ready[stage.kind.index()] += u64::from(keys.count());
        }
        ready
    }

    fn samples_left(&self, id: JobId, job: &Job) -> u64 {
        let open = job.frames().len() - job.frames_done() - job.frames_blocked();
        let taken = self.units_done(id).saturating_sub(job.finished_units());
        (open as u64).saturating_mul(job.spec.samples_of_frame()).saturating_sub(taken)
    }

    fn standing(&self, worker: &crate::lease_table::Worker, now: Tick) -> WorkerStanding {
        match worker.intake {
            Intake::Drained => WorkerStanding::Drained,
            Intake::Off => WorkerStanding::Off,
            Intake::Open if !worker.is_fit(&self.config, now) => WorkerStanding::Unfit,
            Intake::Open if worker.held.is_empty() => WorkerStanding::Idle,
            Intake::Open => WorkerStanding::Busy,
        }
    }
}

fn quarantined_count(job: &Job) -> u64 {
    job.unfinished.values().map(|progress| progress.quarantined().count() as u64).sum()
}

/// Counts how many of `things` are of each kind, including kinds without any.
fn count<K: Copy + PartialEq>(kinds: &[K], things: &[K]) -> Vec<(K, u64)> {
    kinds.iter().map(|kind| (*kind, things.iter().filter(|thing| *thing == kind).count() as u64)).collect()
}
