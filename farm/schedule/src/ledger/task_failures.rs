//! Failures of an unfinished task.

use std::collections::BTreeSet;

use femc_model::{Epoch, Failure};
use serde::{Deserialize, Serialize};

use crate::{DeathEvidence, WorkerDeath};

/// Number of failed attempts after which a task is quarantined. It is a constant of the ledger, so that a log means the same to
/// every program.
const MAX_ATTEMPTS: u32 = 3;

/// Number of deaths of workers after which a task is quarantined.
const MAX_DEATHS: usize = 5;

/// Failed attempts of an unfinished task, and the deaths of workers that computed it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct TaskFailures {
    attempts: u32,
    /// Deaths, one per lease, the latest at the end.
    deaths: Vec<WorkerDeath>,
    pub(crate) failure: Failure,
    /// Epoch up to which leases are over, whatever their workers report later.
    over_until: Epoch,
}

impl TaskFailures {
    pub(super) fn new(failure: Failure) -> Self {
        Self { attempts: 0, deaths: Vec::new(), failure, over_until: Epoch(0) }
    }

    pub(crate) fn is_quarantined(&self) -> bool {
        self.attempts >= MAX_ATTEMPTS || self.is_deadly()
    }

    /// Checks whether the task has killed too many workers. Five known deaths are enough. If some of the five are only presumed,
    /// they must be of more than one worker, because a single machine may be the cause.
    fn is_deadly(&self) -> bool {
        let known = self.deaths.iter().filter(|death| death.evidence == DeathEvidence::Journal).count();
        let workers: BTreeSet<&str> = self.deaths.iter().map(|death| death.worker.as_str()).collect();
        known >= MAX_DEATHS || (self.deaths.len() >= MAX_DEATHS && workers.len() > 1)
    }

    /// Returns the number of tries: failed attempts and deaths.
    pub(crate) fn attempt_count(&self) -> u32 {
        self.attempts + self.deaths.len() as u32
    }

    /// Checks whether this lease was over when the last failure was counted.
    pub(super) fn is_lease_over(&self, epoch: Epoch) -> bool {
        epoch <= self.over_until
    }

    pub(super) fn add_failure(&mut self, until: Epoch, failure: &Failure) {
        self.attempts += 1;
        self.over_until = self.over_until.max(until);
        self.failure = failure.clone();
    }

    pub(super) fn add_death(&mut self, death: &WorkerDeath) {
        match self.deaths.iter_mut().find(|known| known.epoch == death.epoch) {
            Some(known) => known.evidence = known.evidence.max(death.evidence),
            None => self.deaths.push(death.clone()),
        }
        // Deaths of a single worker never quarantine a task, so a limited number of them is enough.
        let oldest = || self.deaths.iter().position(|death| death.evidence == DeathEvidence::Presumed);
        if self.deaths.len() > 2 * MAX_DEATHS
            && let Some(oldest) = oldest()
        {
            self.deaths.remove(oldest);
        }
        self.failure = Failure::Killed { deaths: self.deaths.len() as u32, worker: death.worker.clone() };
    }

    /// Withdraws the presumed deaths of a living process, unless the task is quarantined. Returns whether any failure remains.
    pub(super) fn withdraw_deaths(&mut self, instance: u64) -> bool {
        if self.is_quarantined() {
            return true;
        }
        let before = self.deaths.len();
        self.deaths.retain(|death| (death.instance, death.evidence) != (instance, DeathEvidence::Presumed));
        self.deaths.len() == before || self.attempt_count() > 0
    }

    /// Returns the processes with a presumed death that counts.
    pub(super) fn presumed_dead(&self) -> impl Iterator<Item = u64> + '_ {
        self.deaths.iter().filter(|death| death.evidence == DeathEvidence::Presumed).map(|death| death.instance)
    }
}
