//! Deaths of workers during tasks, and their consequences for the tasks.
//!
//! A death is **known** if the worker comes back and its own journal names the task. A death is **presumed** if a session broke, or
//! its leases expired in silence, while the task was being computed, and the process has not come back within
//! [`Config::presumed`](crate::Config::presumed). If the process comes back later, only its link was lost, and the death is
//! withdrawn. The computed tasks are those that the worker reported as such, or, without a report, its oldest lease. A worker that
//! is drained or leaves does not count as dead.
//!
//! Five deaths quarantine a task, unless all are of one worker and some only presumed: then the machine may be the cause. Killing
//! workers by hand is harmless, unless it hits the same task five times before the task is done. A death counts against every part
//! of the lease, and these parts are leased one by one from then on. It does not count while another lease covers any of them,
//! because that lease may still succeed. Tasks that a worker merely prepared ahead are not counted.

use std::collections::BTreeSet;
use std::ops::Range;

use femc_model::{Death, Epoch, HeldLease, JobId, Phase, TaskKey, Tick, WorkerId};
use serde::{Deserialize, Serialize};

use crate::lease_table::LeaseKey;
use crate::ledger::Ledger;
use crate::scheduler::Scheduler;
use crate::{Command, Fact};

/// Evidence of a death.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum DeathEvidence {
    /// The worker has not come back.
    Presumed,
    /// The worker's own journal.
    Journal,
}

/// A worker's death while it computed a task under one lease.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorkerDeath {
    /// Epoch of the lease.
    pub epoch: Epoch,
    /// Name of the worker.
    pub worker: String,
    /// Process of the worker.
    pub instance: u64,
    /// Evidence of the death: reported by the worker, or presumed.
    pub evidence: DeathEvidence,
}

#[derive(Debug, Clone)]
struct PendingDeath {
    task: TaskKey,
    run: Range<u32>,
    death: WorkerDeath,
    /// Time from which the death counts.
    counts_from: Tick,
}

/// Deaths that do not count yet.
#[derive(Debug, Clone, Default)]
pub(crate) struct PendingDeaths {
    pending: Vec<PendingDeath>,
    /// Processes with a presumed death that counts.
    presumed: BTreeSet<u64>,
}

impl PendingDeaths {
    pub(crate) fn from_ledger(ledger: &Ledger) -> Self {
        Self { pending: Vec::new(), presumed: ledger.presumed_dead() }
    }
}

impl Scheduler {
    /// Returns the leases that a worker is probably computing.
    fn computing_leases(&self, worker: WorkerId) -> Vec<LeaseKey> {
        let held = self.table.leases_of_worker(worker);
        let phase = |key: &LeaseKey| self.table.leases.get(key).map_or(Phase::Waiting, |lease| lease.phase);
        if held.iter().all(|key| phase(key) == Phase::Waiting) {
            return held.into_iter().take(1).collect();
        }
        held.into_iter().filter(|key| matches!(phase(key), Phase::Preparing | Phase::Working)).collect()
    }

    /// Notes that a worker may have died of the tasks that it computes under the affected leases.
    pub(crate) fn presume_death(&mut self, worker: WorkerId, is_affected: impl Fn(&LeaseKey) -> bool, now: Tick) {
        let leases = self.computing_leases(worker);
        let Some(known) = self.table.workers.get(&worker).filter(|known| known.is_open()) else { return };
        // A process dies once. Leases that it was granted after its last message were not what it computed.
        let is_presumed_death = |death: &WorkerDeath| {
            (death.instance, death.evidence) == (known.registration.instance, DeathEvidence::Presumed)
        };
        let is_pending = self.pending_deaths.pending.iter().any(|pending| is_presumed_death(&pending.death));
        if is_pending || self.pending_deaths.presumed.contains(&known.registration.instance) {
            return;
        }
        for key in leases.into_iter().filter(is_affected) {
            let Some(lease) = self.table.leases.get(&key) else { continue };
            let (worker, instance) = (known.registration.name.clone(), known.registration.instance);
            let casualty = WorkerDeath { epoch: key.1, worker, instance, evidence: DeathEvidence::Presumed };
            let from = now.after(self.config.presume_dead_after);
            self.pending_deaths.pending.push(PendingDeath {
                task: key.0,
                run: lease.run(&key.0),
                death: casualty,
                counts_from: from,
            });
        }
    }

    /// Withdraws the presumed deaths of a process that has sent a message.
    pub(crate) fn withdraw_deaths(&mut self, instance: u64, now: Tick, out: &mut Vec<Command>) {
        let is_presumed_death =
            |death: &WorkerDeath| (death.instance, death.evidence) == (instance, DeathEvidence::Presumed);
        self.pending_deaths.pending.retain(|pending| !is_presumed_death(&pending.death));
        if self.pending_deaths.presumed.remove(&instance) {
            self.record_fact(Fact::WorkerReturned { instance }, now, out);
        }
    }

    /// Withdraws the presumed deaths of a session's process.
    pub(crate) fn record_alive(&mut self, worker: WorkerId, now: Tick, out: &mut Vec<Command>) {
        if self.pending_deaths.pending.is_empty() && self.pending_deaths.presumed.is_empty() {
            return;
        }
        if let Some(instance) = self.table.instance(worker) {
            self.withdraw_deaths(instance, now, out);
        }
    }

    /// Handles the report of a returning worker about its death: the tasks in its journal killed it, and no others.
    pub(crate) fn handle_death_report(&mut self, worker: WorkerId, death: &Death, now: Tick, out: &mut Vec<Command>) {
        self.withdraw_deaths(death.instance, now, out);
        if self.ledger.side.is_drained(death.instance) {
            return;
        }
        let Some(name) = self.table.workers.get(&worker).map(|known| known.registration.name.clone()) else { return };
        for held in &death.computing {
            let Some(run) = self.run_of(held) else { continue };
            let (worker, instance, evidence) = (name.clone(), death.instance, DeathEvidence::Journal);
            let casualty = WorkerDeath { epoch: held.epoch, worker, instance, evidence };
            self.pending_deaths.pending.push(PendingDeath { task: held.task, run, death: casualty, counts_from: now });
        }
    }

    /// Keeps a joining worker from the tasks of which a worker of its name has died, so that another worker does them.
    pub(crate) fn avoid_after_death(&mut self, worker: WorkerId) {
        let Some(known) = self.table.workers.get(&worker) else { return };
        for PendingDeath { task, run, death: casualty, .. } in &self.pending_deaths.pending {
            if casualty.worker == known.registration.name
                && !self.table.workers.values().any(|other| other.registration.instance == casualty.instance)
                && let Some(ready_tasks) = self.ready.get_mut(&task.job)
            {
                ready_tasks.last_failed_on.extend(run.clone().map(|index| (TaskKey { index, ..*task }, worker)));
            }
        }
    }

    /// Returns the keys of a lease that a worker reports, if it is a lease of this farm.
    pub(crate) fn run_of(&self, HeldLease { task, steps, job: key, .. }: &HeldLease) -> Option<Range<u32>> {
        let job = self.ledger.jobs.get(&task.job).filter(|job| job.spec.key() == *key)?;
        let (progress, view) = (job.progress(task.stage.frame), job.graph_view(task.stage.frame));
        let is_of_kind = view.template(task.stage.number).is_some_and(|template| template.kind == task.stage.kind);
        let chunks = progress.chunks(&view, (task.stage.round, task.stage.number)).filter(|_| is_of_kind)?;
        chunks.find_run(task.index, steps)
    }

    /// Counts the deaths whose time has come.
    pub(crate) fn count_deaths(&mut self, now: Tick, out: &mut Vec<Command>) {
        if self.pending_deaths.pending.is_empty() {
            return;
        }
        for pending in std::mem::take(&mut self.pending_deaths.pending) {
            let PendingDeath { task, run, death: casualty, counts_from: from } = &pending;
            if now < *from || self.table.covers_any(task.job, task.stage, run) {
                self.pending_deaths.pending.push(pending);
                continue;
            }
            if !self.ledger.jobs.get(&task.job).is_some_and(|job| job.needs_any_of(task, run)) {
                continue;
            }
            if casualty.evidence == DeathEvidence::Presumed {
                self.pending_deaths.presumed.insert(casualty.instance);
            }
            self.record_fact(Fact::WorkerDied { task: *task, end: run.end, death: casualty.clone() }, now, out);
            self.revoke_ended(task.job, out);
            self.refresh_task(task);
            out.push(Command::JobChanged(task.job));
        }
    }

    /// Discards deaths that do not count yet, because a person retries the job's tasks.
    /// - `is_meant`: selects the frames.
    pub(crate) fn discard_deaths(&mut self, job: JobId, is_meant: impl Fn(u32) -> bool) {
        self.pending_deaths.pending.retain(|pending| pending.task.job != job || !is_meant(pending.task.stage.frame));
    }
}
