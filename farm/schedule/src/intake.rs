//! Intake of workers: whether they accept tasks themselves, and whether an operator has drained them.

use femc_model::{Drain, Intake, Tick, WorkerId, WorkerSelector};

use crate::scheduler::Scheduler;
use crate::{Command, Fact};

impl Scheduler {
    /// Sets whether a worker accepts tasks.
    pub(crate) fn set_wanted_intake(&mut self, worker: WorkerId, wish: Intake) {
        if let Some(known) = self.table.workers.get_mut(&worker) {
            known.wanted_intake = wish;
        }
        self.update_intake(worker);
    }

    /// Drains a worker or ends its drain. This holds for the worker's process, across sessions and restarts of the coordinator.
    pub(crate) fn set_drained(&mut self, worker: WorkerId, drain: Drain, now: Tick, out: &mut Vec<Command>) {
        let Some(instance) = self.table.instance(worker) else { return };
        if self.ledger.side.is_drained(instance) != (drain == Drain::Begin) {
            self.record_fact(Fact::Drained { instance, drain }, now, out);
        }
        self.update_intake(worker);
    }

    /// Updates a worker's intake; a drain by an operator has precedence.
    pub(crate) fn update_intake(&mut self, worker: WorkerId) {
        if let Some(known) = self.table.workers.get_mut(&worker) {
            let is_drained = self.ledger.side.is_drained(known.registration.instance);
            known.intake = if is_drained { Intake::Drained } else { known.wanted_intake };
        }
    }

    /// Returns the sessions with this number or name, in order of joining.
    pub fn select_workers(&self, selector: &WorkerSelector) -> Vec<WorkerId> {
        match selector {
            WorkerSelector::Number(worker) => {
                self.table.workers.keys().filter(|known| *known == worker).copied().collect()
            }
            WorkerSelector::Name(name) => {
                let workers = self.table.workers.iter();
                workers.filter(|(_, known)| known.registration.name == *name).map(|(&worker, _)| worker).collect()
            }
        }
    }
}
