//! Ready tasks of a job. They are derived from the ledger and the leases and never stored.

use std::collections::{BTreeMap, VecDeque};
use std::ops::Range;

use femc_model::{JobId, Stage, TaskKey, Tick, WaitReason, WorkerId};

use crate::RangeSet;
use crate::lease_table::LeaseTable;
use crate::ledger::{Job, StageRound};
use crate::open_frames::{OpenFrame, OpenFrames};
use crate::pace::Pace;
use crate::quarantine::WorkerQuarantine;

/// Ready tasks of one job, with the scheduler's volatile records of its attempts.
#[derive(Debug, Clone, Default)]
pub(crate) struct ReadyTasks {
    /// Position in the job's frames: all frames before it are open, finished or blocked.
    pub(crate) cursor: usize,
    pub(crate) open: OpenFrames,
    /// Worker on which a task failed last.
    pub(crate) last_failed_on: BTreeMap<TaskKey, WorkerId>,
    /// Infrastructure failures of its tasks.
    pub(crate) infrastructure_failures: InfrastructureFailures,
    /// Workers on which its tasks keep failing.
    pub(crate) quarantine: WorkerQuarantine,
    pub(crate) stale_messages: u64,
    /// Number of copies of late tasks.
    pub(crate) copies: u64,
    pub(crate) sample_rate: SampleRate,
    pub(crate) pace: Pace,
}

impl ReadyTasks {
    /// Rederives all ready tasks, and reopens every frame in progress before those that have not begun.
    pub(crate) fn rebuild(&mut self, id: JobId, job: &Job, table: &LeaseTable) {
        let opened = std::mem::take(&mut self.open);
        let opened: Vec<u32> = opened.iter().map(|(frame, _)| frame).chain(job.unfinished.keys().copied()).collect();
        self.cursor = 0;
        let own = job.has_job_stages().then_some(Stage::JOB_FRAME);
        for frame in own.into_iter().chain(opened) {
            self.refresh(id, job, frame, table);
        }
    }

    /// Rederives the ready tasks of one frame. If the frame has ended, adds the tasks of the job's own stages that can run now.
    pub(crate) fn refresh(&mut self, id: JobId, job: &Job, frame: u32, table: &LeaseTable) {
        if !job.is_open(frame) {
            self.open.remove(frame);
            if job.has_job_stages() && frame != Stage::JOB_FRAME {
                let runnable =
                    job.progress(Stage::JOB_FRAME).runnable_after_frame(&job.graph_view(Stage::JOB_FRAME), frame);
                self.add_runnable(id, Stage::JOB_FRAME, runnable, job, table);
            }
            return;
        }
        let (progress, view) = (job.progress(frame), job.graph_view(frame));
        let mut open = OpenFrame::new(frame, progress.runnable(&view), &view);
        table.leases_of_frame(id, frame).for_each(|((task, _), lease)| open.remove(&task.stage, lease.run(&task)));
        self.open.put(frame, open);
    }

    /// Updates the ready tasks after a completion: tasks that read its outputs may be ready now.
    /// - `round`: round of the frame before the completion.
    pub(crate) fn update_after(&mut self, task: &TaskKey, round: u32, job: &Job, table: &LeaseTable) {
        let frame = task.stage.frame;
        let progress = job.unfinished.get(&frame).filter(|unit| unit.round == round && job.is_open(frame));
        let Some(progress) = progress.filter(|_| !job.spec.graph.closes_loop(task.stage.number)) else {
            self.refresh(task.job, job, frame, table);
            return;
        };
        self.add_runnable(
            task.job,
            frame,
            progress.runnable_after(&job.graph_view(frame), &task.stage, task.index),
            job,
            table,
        );
    }

    /// Adds tasks of a frame that can run, except leased ones.
    fn add_runnable(
        &mut self,
        id: JobId,
        frame: u32,
        runnable: Vec<(StageRound, RangeSet)>,
        job: &Job,
        table: &LeaseTable,
    ) {
        let view = job.graph_view(frame);
        for (stage_round, mut keys) in runnable {
            let Some(kind) = view.template(stage_round.1).map(|template| template.kind) else { continue };
            let stage = Stage { frame, round: stage_round.0, number: stage_round.1, kind };
            table.leased_keys_of_stage(id, stage).for_each(|run| keys.remove_range(run));
            if !keys.is_empty() {
                self.open.change(frame, |open| open.add(frame, stage_round, &keys, &view));
            }
        }
    }

    /// Checks whether another frame may be opened. At most one more frame may be open than there are workers. For a worker without
    /// leases twice as many may be open, so that frames which only workers of another build can continue do not keep it idle.
    pub(crate) fn may_open(&self, worker: WorkerId, table: &LeaseTable) -> bool {
        let is_idle = table.workers.get(&worker).is_some_and(|worker| worker.held.is_empty());
        self.open.frames() <= table.workers.len() * if is_idle { 2 } else { 1 }
    }

    /// Checks whether there are frames that have not been visited yet. Possibly none of them can be opened.
    pub(crate) fn has_unopened(&self, job: &Job) -> bool {
        self.cursor < job.frames().len()
    }

    /// Opens the next frame that has not begun; `false` if there is none.
    pub(crate) fn open_next(&mut self, job: &Job) -> bool {
        while let Some(&frame) = job.frames().get(self.cursor) {
            self.cursor += 1;
            if job.is_open(frame) && self.open.get(frame).is_none() {
                let (progress, view) = (job.progress(frame), job.graph_view(frame));
                self.open.put(frame, OpenFrame::new(frame, progress.runnable(&view), &view));
                return true;
            }
        }
        false
    }

    /// Checks whether all sample chunks of the run are ready.
    pub(crate) fn is_ready(&self, task: &TaskKey, run: &Range<u32>) -> bool {
        let open = self.open.get(task.stage.frame).and_then(|open| open.ready_keys(&task.stage));
        open.is_some_and(|keys| keys.covers(run))
    }

    /// Removes a run of a task from the ready tasks, because it is leased.
    pub(crate) fn remove(&mut self, task: &TaskKey, run: &Range<u32>) {
        self.open.change(task.stage.frame, |frame| frame.remove(&task.stage, run.clone()));
    }
}

/// Tasks whose last attempt ended with an infrastructure failure. Only for display: no state depends on it.
#[derive(Debug, Clone, Default)]
pub(crate) struct InfrastructureFailures(BTreeMap<TaskKey, String>);

impl InfrastructureFailures {
    /// Maximum number of tasks in the table.
    const MAX_TASKS: usize = 1024;

    pub(crate) fn insert(&mut self, task: TaskKey, message: String) {
        if self.0.len() < Self::MAX_TASKS || self.0.contains_key(&task) {
            self.0.insert(task, message);
        }
    }

    pub(crate) fn remove(&mut self, task: &TaskKey) {
        self.0.remove(task);
    }

    /// Counts the tasks for which `is_open` holds, and returns the failure of one of them.
    pub(crate) fn wait_reason(&self, is_open: impl Fn(&TaskKey) -> bool) -> Option<WaitReason> {
        let mut open = self.0.iter().filter(|(task, _)| is_open(task));
        let (_, message) = open.next()?;
        Some(WaitReason::InfrastructureFailures { tasks: 1 + open.count() as u32, message: message.clone() })
    }
}

/// Sampling rate of a job.
#[derive(Debug, Clone, Default)]
pub(crate) struct SampleRate {
    /// Times with the samples up to then, once a second, for the last ten seconds.
    points: VecDeque<(Tick, u64)>,
}

impl SampleRate {
    const SAMPLE_INTERVAL: u64 = 1_000;
    const MAX_POINTS: usize = 10;

    pub(crate) fn is_due(&self, now: Tick) -> bool {
        self.points.back().is_none_or(|(last, _)| now.since(*last) >= Self::SAMPLE_INTERVAL)
    }

    pub(crate) fn record(&mut self, now: Tick, samples: u64) {
        if self.points.len() > Self::MAX_POINTS {
            self.points.pop_front();
        }
        self.points.push_back((now, samples));
    }

    /// Returns the samples per second; 0 until two points are known.
    pub(crate) fn per_second(&self) -> f64 {
        match (self.points.front(), self.points.back()) {
            (Some((from, first)), Some((to, last))) if to > from => {
                last.saturating_sub(*first) as f64 * 1000.0 / to.since(*from) as f64
            }
            _ => 0.0,
        }
    }
}
