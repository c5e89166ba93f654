//! Speculative copies for the tail of a frame: an idle worker repeats a task that takes another worker far too long. The first
//! result counts; the other lease is revoked immediately, and its result changes nothing. The discarded work is done by workers
//! that would be idle otherwise. A task has at most two leases.

use femc_model::{Lane, TaskKey, Tick, WorkerId};

use crate::Command;
use crate::lease_table::{Lease, LeaseKey};
use crate::scheduler::Scheduler;
use crate::shared::ContentState;

impl Scheduler {
    /// Multiple of the expected duration after which a task is late.
    const LATE_FACTOR: u64 = 2;

    /// Leases late tasks a second time to idle workers, the most delayed first. These workers have no ready tasks; otherwise they
    /// would have got one.
    pub(crate) fn speculate(&mut self, now: Tick, out: &mut Vec<Command>) {
        if now < self.dispatch_from {
            return;
        }
        for lane in Lane::ALL {
            self.speculate_in_lane(lane, now, out);
        }
    }

    fn speculate_in_lane(&mut self, lane: Lane, now: Tick, out: &mut Vec<Command>) {
        let is_fit = |id: &WorkerId| self.table.workers.get(id).is_some_and(|known| known.is_fit(&self.config, now));
        let idle: Vec<WorkerId> = self.table.idle_workers(lane).filter(is_fit).collect();
        let mut late = if idle.is_empty() { Vec::new() } else { self.late_leases(lane, now) };
        for worker in idle {
            let Some(index) = late.iter().position(|key| self.may_copy(key, worker, now)) else { continue };
            let (task, epoch) = late.remove(index);
            if let Some(run) = self.table.leases.get(&(task, epoch)).map(|lease| lease.run(&task)) {
                self.assign_task(task, &run, Some(epoch), worker, now, out);
            }
        }
    }

    /// Returns the late leases of a lane without a copy, in their jobs' order of service, the most delayed first.
    fn late_leases(&self, lane: Lane, now: Tick) -> Vec<LeaseKey> {
        let mut all = Vec::new();
        let shared = self.ledger.shared_jobs().filter(|(_, shared)| self.is_wanted(shared)).map(|(id, _)| id);
        for job in self.order.jobs_by_service().chain(shared) {
            let mut late: Vec<(u64, LeaseKey)> = (self.table.leases_of_job(job))
                .filter(|((task, _), _)| task.stage.kind.properties().lane == lane)
                .filter(|((task, _), _)| self.table.leases_of_task(task).nth(1).is_none())
                .filter_map(|(key, lease)| Some((self.lateness(&key.0, lease, now)?, key)))
                .collect();
            late.sort_by_key(|&(lateness, key)| (std::cmp::Reverse(lateness), key));
            all.extend(late.into_iter().map(|(_, key)| key));
        }
        all
    }

    /// Returns the duration of a lease so far in thousandths of the expected duration; `None`: it is not late, or that is unknown.
    fn lateness(&self, task: &TaskKey, lease: &Lease, now: Tick) -> Option<u64> {
        let pace = &self.ready.get(&task.job)?.pace;
        let expected = pace.expected(task.stage.number, lease.size.units)?;
        let taken = now.since(lease.granted);
        let is_late = taken > Self::LATE_FACTOR * expected && taken > self.config.late;
        is_late.then(|| taken.saturating_mul(1_000) / expected.max(1))
    }

    fn may_copy(&self, (task, epoch): &LeaseKey, id: WorkerId, now: Tick) -> bool {
        let (Some(job), Some(ready_tasks)) = (self.ledger.jobs.get(&task.job), self.ready.get(&task.job)) else {
            return false;
        };
        let (holder, worker) = (self.table.leases.get(&(*task, *epoch)), self.table.workers.get(&id));
        // Its inputs may have been lost since it was leased.
        holder.is_some_and(|lease| lease.worker != id)
            && job.has_inputs(task)
            // It may have been quarantined in another round since.
            && !job.is_quarantined(task)
            && worker
                .is_some_and(|it| matches!(self.content_state(task.job, job, &task.stage, &it.registration.engine), ContentState::Available))
            && worker.is_some_and(|worker| self.has_tags_for(worker, job))
            && !self.is_quarantined_for(job, ready_tasks, id, now)
            && self.may_take(task, job, ready_tasks, id)
            && !self.is_reserved_for_others(task.job, task.stage.frame, id)
    }
}
