//! The ready tasks of a job that runs: derived from the ledger and the leases, never written down.

use std::collections::{BTreeMap, VecDeque};
use std::ops::Range;

use femc_model::{JobId, Stage, StageKind, TaskKey, Tick, WorkerId};

use crate::RangeSet;
use crate::distrust::Distrust;
use crate::floor::Floor;
use crate::ledger::Job;
use crate::ledger::frame::Frame;
use crate::pace::Pace;

/// A frame whose tasks may be leased.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct OpenFrame {
    pub(crate) round: u32,
    /// Grains of its tiles that nobody holds.
    pub(crate) grains: RangeSet,
    /// Whether the merge can run and nobody holds it.
    pub(crate) merge: bool,
}

/// A job on the table.
#[derive(Debug, Clone, Default)]
pub(crate) struct Desk {
    /// Position in the job's frames: those before it are open, finished or blocked.
    pub(crate) cursor: usize,
    pub(crate) open: BTreeMap<u32, OpenFrame>,
    /// Worker on which a task failed last.
    pub(crate) avoid: BTreeMap<TaskKey, WorkerId>,
    /// Workers on which its tasks keep failing.
    pub(crate) distrust: Distrust,
    pub(crate) stale_messages: u64,
    pub(crate) rate: Rate,
    pub(crate) pace: Pace,
}

impl Desk {
    /// Forgets what is ready and opens again every frame in work, before the ones that nobody has begun.
    pub(crate) fn rebuild(&mut self, id: JobId, job: &Job, floor: &Floor) {
        let opened: Vec<u32> = self.open.keys().chain(job.frames.keys()).copied().collect();
        self.open.clear();
        self.cursor = 0;
        for frame in opened {
            self.refresh(id, job, frame, floor);
        }
    }

    /// Derives again what of one frame is ready.
    pub(crate) fn refresh(&mut self, id: JobId, job: &Job, frame: u32, floor: &Floor) {
        if !job.is_open(frame) {
            self.open.remove(&frame);
            return;
        }
        let round = job.round(frame);
        let keys = job.grains(round);
        let (mut grains, mut merge) = match job.frames.get(&frame) {
            Some(frame) => (frame.open_grains(&keys), frame.merge_is_open(&keys)),
            None => (RangeSet::full(keys.all()), false),
        };
        floor.of_stage(id, Stage { frame, round, kind: StageKind::Render }).for_each(|run| grains.remove(run));
        merge &= floor.of_stage(id, Stage { frame, round, kind: StageKind::Merge }).next().is_none();
        self.open.insert(frame, OpenFrame { round, grains, merge });
    }

    /// Takes notice of a completion: only the last of a round makes anything ready.
    pub(crate) fn completed(&mut self, task: &TaskKey, job: &Job, floor: &Floor) {
        let keys = job.grains(task.stage.round);
        let goes_on = |frame: &Frame| frame.round == task.stage.round && !frame.is_rendered(&keys);
        let frame = task.stage.frame;
        if !job.is_open(frame) || !job.frames.get(&frame).is_some_and(goes_on) {
            self.refresh(task.job, job, frame, floor);
        }
    }

    /// Opens the next frame that nobody has begun; `false` where there is none.
    pub(crate) fn open_next(&mut self, job: &Job) -> bool {
        while let Some(&frame) = job.spec.frames.get(self.cursor) {
            self.cursor += 1;
            if job.is_open(frame) && !self.open.contains_key(&frame) {
                let grains = RangeSet::full(job.grains(0).all());
                self.open.insert(frame, OpenFrame { round: 0, grains, merge: false });
                return true;
            }
        }
        false
    }

    /// Whether the task is on the table, with all of its grains.
    pub(crate) fn is_ready(&self, task: &TaskKey, run: &Range<u32>) -> bool {
        let open = self.open.get(&task.stage.frame).filter(|open| open.round == task.stage.round);
        open.is_some_and(|open| match task.stage.kind {
            StageKind::Render => open.grains.covers(run),
            StageKind::Merge => open.merge && task.index == 0,
        })
    }

    /// Takes a task off the table, because it is leased.
    pub(crate) fn take(&mut self, task: &TaskKey, run: &Range<u32>) {
        let Some(frame) = self.open.get_mut(&task.stage.frame) else { return };
        match task.stage.kind {
            StageKind::Render => frame.grains.remove(run.clone()),
            StageKind::Merge => frame.merge = false,
        }
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
