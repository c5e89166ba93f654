//! The ready tasks of a job that runs: derived from the ledger and the leases, never written down.

use std::collections::{BTreeMap, VecDeque};
use std::ops::Range;

use femc_model::{JobId, Stage, TaskKey, Tick, Wait, WorkerId};

use crate::RangeSet;
use crate::lease_table::LeaseTable;
use crate::ledger::{Job, Place};
use crate::open::{OpenUnit, OpenUnits};
use crate::pace::Pace;
use crate::quarantine::WorkerQuarantine;

/// The ready tasks of one job, and what the scheduler remembers of its tries.
#[derive(Debug, Clone, Default)]
pub(crate) struct ReadyTasks {
    /// Position in the job's frames: those before it are open, finished or blocked.
    pub(crate) cursor: usize,
    pub(crate) open: OpenUnits,
    /// Worker on which a task failed last.
    pub(crate) avoid: BTreeMap<TaskKey, WorkerId>,
    /// What kept its tasks from being done.
    pub(crate) mishaps: Mishaps,
    /// Workers on which its tasks keep failing.
    pub(crate) quarantine: WorkerQuarantine,
    pub(crate) stale_messages: u64,
    /// Second leases of late tasks.
    pub(crate) copies: u64,
    pub(crate) rate: Rate,
    pub(crate) pace: Pace,
}

impl ReadyTasks {
    /// Forgets what is ready and opens again every frame in work, before the ones that nobody has begun.
    pub(crate) fn rebuild(&mut self, id: JobId, job: &Job, table: &LeaseTable) {
        let opened = std::mem::take(&mut self.open);
        let opened: Vec<u32> = opened.iter().map(|(frame, _)| frame).chain(job.units.keys().copied()).collect();
        self.cursor = 0;
        let own = job.has_job_stages().then_some(Stage::OF_JOB);
        for frame in own.into_iter().chain(opened) {
            self.refresh(id, job, frame, table);
        }
    }

    /// Derives again what of one frame is ready; what the job's own stages can do with a frame that has ended is ready, too.
    pub(crate) fn refresh(&mut self, id: JobId, job: &Job, frame: u32, table: &LeaseTable) {
        if !job.is_open(frame) {
            self.open.remove(frame);
            if job.has_job_stages() && frame != Stage::OF_JOB {
                let runnable = job.unit(Stage::OF_JOB).runnable_after_frame(&job.shape(Stage::OF_JOB), frame);
                self.add_runnable(id, Stage::OF_JOB, runnable, job, table);
            }
            return;
        }
        let (unit, shape) = (job.unit(frame), job.shape(frame));
        let mut open = OpenUnit::new(frame, unit.open(&shape), &shape);
        table.of_frame(id, frame).for_each(|((task, _), lease)| open.remove(&task.stage, lease.run(&task)));
        self.open.put(frame, open);
    }

    /// Takes notice of a completion: what reads this task may be ready now.
    /// - `round`: the round that the frame was in before.
    pub(crate) fn completed(&mut self, task: &TaskKey, round: u32, job: &Job, table: &LeaseTable) {
        let frame = task.stage.frame;
        let unit = job.units.get(&frame).filter(|unit| unit.round == round && job.is_open(frame));
        let Some(unit) = unit.filter(|_| !job.spec.graph.closes(task.stage.number)) else {
            self.refresh(task.job, job, frame, table);
            return;
        };
        self.add_runnable(task.job, frame, unit.runnable_after(&job.shape(frame), &task.stage, task.index), job, table);
    }

    /// More of a frame can run; what is held is not ready.
    fn add_runnable(&mut self, id: JobId, frame: u32, runnable: Vec<(Place, RangeSet)>, job: &Job, table: &LeaseTable) {
        let shape = job.shape(frame);
        for (place, mut keys) in runnable {
            let Some(kind) = shape.template(place.1).map(|template| template.kind) else { continue };
            let stage = Stage { frame, round: place.0, number: place.1, kind };
            table.of_stage(id, stage).for_each(|run| keys.remove(run));
            if !keys.is_empty() {
                self.open.change(frame, |open| open.add(frame, place, &keys, &shape));
            }
        }
    }

    /// Whether there may be another open frame: at most one more than there are workers. For a worker that holds
    /// nothing twice as many may be open: frames that only workers of another build can go on with shall not keep it idle.
    pub(crate) fn may_open(&self, worker: WorkerId, table: &LeaseTable) -> bool {
        let is_idle = table.workers.get(&worker).is_some_and(|worker| worker.held.is_empty());
        self.open.frames() <= table.workers.len() * if is_idle { 2 } else { 1 }
    }

    /// Whether there are frames that have not been looked at yet; of those none may be left to open.
    pub(crate) fn has_unopened(&self, job: &Job) -> bool {
        self.cursor < job.frames().len()
    }

    /// Opens the next frame that nobody has begun; `false` where there is none.
    pub(crate) fn open_next(&mut self, job: &Job) -> bool {
        while let Some(&frame) = job.frames().get(self.cursor) {
            self.cursor += 1;
            if job.is_open(frame) && self.open.get(frame).is_none() {
                let (unit, shape) = (job.unit(frame), job.shape(frame));
                self.open.put(frame, OpenUnit::new(frame, unit.open(&shape), &shape));
                return true;
            }
        }
        false
    }

    /// Whether all grains of the run are ready.
    pub(crate) fn is_ready(&self, task: &TaskKey, run: &Range<u32>) -> bool {
        let open = self.open.get(task.stage.frame).and_then(|open| open.of(&task.stage));
        open.is_some_and(|keys| keys.covers(run))
    }

    /// Takes a run of a task out of what is ready, because it is leased.
    pub(crate) fn take(&mut self, task: &TaskKey, run: &Range<u32>) {
        self.open.change(task.stage.frame, |frame| frame.remove(&task.stage, run.clone()));
    }
}

/// Tasks whose last attempt ended with a failure of their surroundings. For people: nothing follows from it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Mishaps(BTreeMap<TaskKey, String>);

impl Mishaps {
    /// Most tasks that are remembered.
    const MOST: usize = 1024;

    pub(crate) fn note(&mut self, task: TaskKey, message: String) {
        if self.0.len() < Self::MOST || self.0.contains_key(&task) {
            self.0.insert(task, message);
        }
    }

    pub(crate) fn forget(&mut self, task: &TaskKey) {
        self.0.remove(task);
    }

    /// Those of which this holds, and what befell one of them.
    pub(crate) fn why_mishaps(&self, is_open: impl Fn(&TaskKey) -> bool) -> Option<Wait> {
        let mut open = self.0.iter().filter(|(task, _)| is_open(task));
        let (_, message) = open.next()?;
        Some(Wait::Mishaps { tasks: 1 + open.count() as u32, message: message.clone() })
    }
}

/// How fast samples come in.
#[derive(Debug, Clone, Default)]
pub(crate) struct Rate {
    /// Time and samples until then, once a second, for the last ten seconds.
    points: VecDeque<(Tick, u64)>,
}

impl Rate {
    const SPACING: u64 = 1_000;
    const POINTS: usize = 10;

    pub(crate) fn is_due(&self, now: Tick) -> bool {
        self.points.back().is_none_or(|(last, _)| now.since(*last) >= Self::SPACING)
    }

    pub(crate) fn note(&mut self, now: Tick, samples: u64) {
        if self.points.len() > Self::POINTS {
            self.points.pop_front();
        }
        self.points.push_back((now, samples));
    }

    /// Samples a second, 0 until two points are known.
    pub(crate) fn per_second(&self) -> f64 {
        match (self.points.front(), self.points.back()) {
            (Some((from, first)), Some((to, last))) if to > from => {
                last.saturating_sub(*first) as f64 * 1000.0 / to.since(*from) as f64
            }
            _ => 0.0,
        }
    }
}
