//! How much goes into one lease: as many grains of a tile as fit the time that a task is meant to take, and less of them when
//! there is not enough for everybody. What the farm knows of a job's pace decides; before it knows anything, a grain is all.

use std::ops::Range;

use femc_model::{Grains, StageKind, TaskKey};

use crate::desk::Desk;
use crate::floor::Size;
use crate::ledger::Job;
use crate::pace::Pace;
use crate::scheduler::Scheduler;

impl Scheduler {
    /// The grains of the lease that begins with this ready task; a task of another kind is its own key.
    pub(crate) fn share(&self, task: &TaskKey) -> Range<u32> {
        let first = task.index..task.index + 1;
        let (Some(job), Some(desk)) = (self.ledger.jobs.get(&task.job), self.desks.get(&task.job)) else {
            return first;
        };
        let grains = job.grains(task.stage.round);
        if task.stage.kind != StageKind::Render || grains.per_tile() == 1 {
            return first;
        }
        let run = ready_run(task, job, desk, &grains);
        let samples = grains.pixel_samples(&first);
        let Some(milliseconds) = desk.pace.render(samples).or_else(|| self.heard(task, samples)) else { return first };
        let fit = |time: u64| (time / milliseconds.max(1)).clamp(1, u64::from(Grains::MOST));
        let (least, most) = (fit(self.config.least_task), fit(self.config.task));
        let holders = self.floor.workers.len().max(1) as u64 * u64::from(1 + self.config.prefetch);
        let each = ready(job, desk, &grains, holders * most) / holders;
        let count = each.clamp(least.min(most), most) as u32;
        run.start..run.end.min(run.start + count)
    }

    /// Milliseconds that so many pixel samples of the job would take at the pace of its running tasks, before any is done.
    fn heard(&self, task: &TaskKey, samples: u64) -> Option<u64> {
        let running = self.floor.of_job(task.job).filter_map(|((task, _), lease)| lease.progress(task));
        let (spent, done) = running.fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
        (done > 0).then(|| (u128::from(spent) * u128::from(samples)).div_ceil(u128::from(done)) as u64)
    }

    /// How much the task is, as far as one can tell.
    pub(crate) fn size(&self, task: &TaskKey, run: &Range<u32>) -> Size {
        let (job, desk) = (self.ledger.jobs.get(&task.job), self.desks.get(&task.job));
        let samples = match task.stage.kind {
            StageKind::Render => job.map_or(0, |job| job.grains(task.stage.round).pixel_samples(run)),
            StageKind::Gather | StageKind::Merge => 0,
        };
        let expected = desk.and_then(|desk| match task.stage.kind {
            StageKind::Render => desk.pace.render(samples),
            StageKind::Gather => desk.pace.gather(),
            StageKind::Merge => desk.pace.merge(),
        });
        Size { samples, milliseconds: expected.unwrap_or(Pace::FIRST) }
    }

    /// Learns from a task that has taken `milliseconds`. Returns how long the job's tasks take on the average, if its tiles are
    /// not cut further; `None` while no tile is done.
    pub(crate) fn learn(&mut self, task: &TaskKey, size: Size, milliseconds: u64) -> Option<u64> {
        let job = self.ledger.jobs.get(&task.job)?;
        let pace = &mut self.desks.get_mut(&task.job)?.pace;
        match task.stage.kind {
            StageKind::Render => pace.note_render(size.samples, milliseconds),
            StageKind::Gather => pace.note_gather(milliseconds),
            StageKind::Merge => pace.note_merge(milliseconds),
        }
        let grains = job.grains(task.stage.round);
        let (tiles, tile) = (u64::from(grains.tiles()), pace.render(grains.of_a_tile())?);
        Some((tile.saturating_mul(tiles).saturating_add(pace.merge().unwrap_or(tile))) / (tiles + 1))
    }
}

/// The ready grains from the task's on, within its tile. One that has failed stands alone: its attempts are its own.
fn ready_run(task: &TaskKey, job: &Job, desk: &Desk, grains: &Grains) -> Range<u32> {
    let ready = desk.open.get(task.stage.frame).map_or(task.index, |open| open.grains.run(task.index).end);
    let run = task.index..ready.min(grains.of_tile(grains.tile(task.index)).end).max(task.index + 1);
    let trouble = job.frames.get(&task.stage.frame).and_then(|frame| frame.first_trouble(&run));
    match trouble {
        Some(key) => run.start..key.max(run.start + 1),
        None => run,
    }
}

/// Ready grains of the job, counted up to about `enough`.
fn ready(job: &Job, desk: &Desk, grains: &Grains, enough: u64) -> u64 {
    let unopened = job.spec.frames.len() - desk.cursor.min(job.spec.frames.len());
    let mut ready = unopened as u64 * u64::from(grains.all().end);
    for (_, open) in desk.open.ready() {
        if ready >= enough {
            break;
        }
        ready += u64::from(open.grains.count());
    }
    ready
}
