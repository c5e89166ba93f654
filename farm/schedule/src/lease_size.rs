//! Size of a lease: as many sample chunks of a task as fit the intended duration of a lease, and fewer when there is not enough
//! work for all workers. The size is based on the known pace of the job. While no pace is known, a lease has one sample chunk.

use std::ops::Range;

use femc_model::{Chunks, TaskKey};

use crate::lease_table::LeaseSize;
use crate::ledger::Job;
use crate::pace::Pace;
use crate::ready_tasks::ReadyTasks;
use crate::scheduler::Scheduler;

impl Scheduler {
    /// Returns the sample chunks of the lease that begins with this ready task.
    pub(crate) fn lease_run(&self, task: &TaskKey) -> Range<u32> {
        let first = task.index..task.index + 1;
        let (Some(job), Some(ready_tasks)) = (self.ledger.jobs.get(&task.job), self.ready.get(&task.job)) else {
            return first;
        };
        let Some(grains) = job.chunks(&task.stage).filter(|chunks| chunks.stride() > 1) else { return first };
        let run = ready_run(task, job, ready_tasks, &grains);
        let units = grains.units(&first);
        let expected = ready_tasks.pace.expected(task.stage.number, units);
        let Some(milliseconds) = expected.or_else(|| self.estimate_from_progress(task, units)) else { return first };
        let fit = |time: u64| (time / milliseconds.max(1)).clamp(1, u64::from(Chunks::MAX_PER_TASK));
        let (least, most) = (fit(self.config.min_work_per_lease), fit(self.config.work_per_lease));
        let holders = self.table.workers.len().max(1) as u64 * u64::from(1 + self.config.prefetch);
        let each = count_ready_chunks(job, ready_tasks, task, &grains, holders * most) / holders;
        let count = each.clamp(least.min(most), most) as u32;
        run.start..run.end.min(run.start + count)
    }

    /// Estimates the milliseconds for these units of the task's stage from the progress of its running tasks, before any is done.
    fn estimate_from_progress(&self, task: &TaskKey, units: u64) -> Option<u64> {
        let of_stage =
            self.table.leases_of_job(task.job).filter(|((other, _), _)| other.stage.number == task.stage.number);
        let running = of_stage.filter_map(|((task, _), lease)| lease.progress(&task));
        let (elapsed, done) = running.fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
        (done > 0).then(|| (u128::from(elapsed) * u128::from(units)).div_ceil(u128::from(done)) as u64)
    }

    /// Returns the size of a lease with these units of the task's stage, with its expected duration.
    pub(crate) fn lease_size(&self, task: &TaskKey, units: u64) -> LeaseSize {
        let ready_tasks = self.ready.get(&task.job);
        let expected = ready_tasks.and_then(|ready_tasks| ready_tasks.pace.expected(task.stage.number, units));
        LeaseSize { units, milliseconds: expected.unwrap_or(Pace::DEFAULT) }
    }

    /// Returns the units of work of a run of a task's sample chunks.
    pub(crate) fn units_of(&self, task: &TaskKey, run: &Range<u32>) -> u64 {
        let job = self.ledger.jobs.get(&task.job);
        job.and_then(|job| job.chunks(&task.stage)).map_or(1, |chunks| chunks.units(run))
    }

    /// Updates the pace of a stage with one of its tasks, which took `milliseconds`.
    pub(crate) fn update_pace(&mut self, task: &TaskKey, size: LeaseSize, milliseconds: u64) {
        if let Some(ready_tasks) = self.ready.get_mut(&task.job) {
            ready_tasks.pace.update(task.stage.number, size.units, milliseconds);
        }
    }
}

/// Returns the ready sample chunks of the task from its index on. A chunk that has failed before gets a lease of its own, so that
/// its attempts are its own.
fn ready_run(task: &TaskKey, job: &Job, ready_tasks: &ReadyTasks, chunks: &Chunks<'_>) -> Range<u32> {
    let open = ready_tasks.open.get(task.stage.frame).and_then(|open| open.ready_keys(&task.stage));
    let ready = open.map_or(task.index, |keys| keys.run_from(task.index).end);
    let run = task.index..ready.min(chunks.of_task(chunks.task(task.index)).end).max(task.index + 1);
    let failed_key =
        job.unfinished.get(&task.stage.frame).and_then(|progress| progress.first_failed_key(&task.stage, &run));
    match failed_key {
        Some(key) => run.start..key.max(run.start + 1),
        None => run,
    }
}

/// Counts ready sample chunks of the task's stage in all frames of the job, up to about `enough`.
fn count_ready_chunks(job: &Job, ready_tasks: &ReadyTasks, task: &TaskKey, chunks: &Chunks<'_>, enough: u64) -> u64 {
    let unopened = job.frames().len() - ready_tasks.cursor.min(job.frames().len());
    let mut ready = unopened as u64 * u64::from(chunks.all_keys().end);
    for (_, open) in ready_tasks.open.ready() {
        if ready >= enough {
            break;
        }
        let of_stage = open.stages().filter(|(stage, _)| stage.number == task.stage.number);
        ready += of_stage.map(|(_, keys)| u64::from(keys.count())).sum::<u64>();
    }
    ready
}
