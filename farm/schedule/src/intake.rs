//! Who gets more tasks: what workers want for themselves, and what an operator says.

use femc_model::{Drain, Intake, Tick, WorkerId, WorkerName};

use crate::scheduler::Scheduler;
use crate::{Command, Fact};

impl Scheduler {
    /// A worker wants tasks, or none.
    pub(crate) fn wish(&mut self, worker: WorkerId, wish: Intake) {
        if let Some(known) = self.table.workers.get_mut(&worker) {
            known.wish = wish;
        }
        self.note_intake(worker);
    }

    /// An operator's word; it holds for the worker's process, over sessions and the coordinator's restarts.
    pub(crate) fn drained(&mut self, worker: WorkerId, drain: Drain, now: Tick, out: &mut Vec<Command>) {
        let Some(instance) = self.table.instance(worker) else { return };
        if self.ledger.side.is_drained(instance) != (drain == Drain::Begin) {
            self.record(Fact::Drained { instance, drain }, now, out);
        }
        self.note_intake(worker);
    }

    /// The operator's word goes first.
    pub(crate) fn note_intake(&mut self, worker: WorkerId) {
        if let Some(known) = self.table.workers.get_mut(&worker) {
            let is_drained = self.ledger.side.is_drained(known.registration.instance);
            known.intake = if is_drained { Intake::Drained } else { known.wish };
        }
    }

    /// The sessions that people mean by this, in order of joining.
    pub fn named(&self, name: &WorkerName) -> Vec<WorkerId> {
        match name {
            WorkerName::Number(worker) => self.table.workers.keys().filter(|known| *known == worker).copied().collect(),
            WorkerName::Name(name) => {
                let workers = self.table.workers.iter();
                workers.filter(|(_, known)| known.registration.name == *name).map(|(&worker, _)| worker).collect()
            }
        }
    }
}
