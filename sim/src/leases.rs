//! Who holds what, as seen on the way between coordinators and workers.

use std::collections::{BTreeMap, BTreeSet};

use femc_model::{Epoch, JobId, TaskKey};
use femc_schedule::Fact;

use crate::audit::Violation;

/// Number of a session that the switch has relayed.
pub(crate) type SessionNumber = u64;

/// Leases that were seen to be given out, brought along, and ended.
#[derive(Debug, Default)]
pub(crate) struct Leases {
    /// All that were given out.
    given: BTreeSet<(TaskKey, Epoch)>,
    /// Of each task's leases the latest: epochs grow with the log.
    latest: BTreeMap<TaskKey, Epoch>,
    /// Leases that a worker brought along, and the sessions in which nobody has taken them away again.
    brought: BTreeMap<(TaskKey, Epoch), BTreeSet<SessionNumber>>,
    /// Tasks that the log counts, under leases that nobody has brought along.
    counted: BTreeMap<TaskKey, Epoch>,
    sessions: SessionNumber,
}

impl Leases {
    /// A session begins, and these leases come with it.
    pub(crate) fn joined(&mut self, held: impl Iterator<Item = (TaskKey, Epoch)>) -> SessionNumber {
        self.sessions += 1;
        for lease in held {
            self.brought.entry(lease).or_default().insert(self.sessions);
        }
        self.sessions
    }

    /// A coordinator gives a lease out; what is wrong with that.
    pub(crate) fn assigned(&mut self, task: TaskKey, epoch: Epoch) -> Option<Violation> {
        self.given.insert((task, epoch));
        let latest = self.latest.entry(task).or_insert(epoch);
        *latest = epoch.max(*latest);
        self.superseded(task)
    }

    /// A coordinator ends a lease.
    pub(crate) fn revoked(&mut self, session: SessionNumber, task: TaskKey, epoch: Epoch) {
        if let Some(sessions) = self.brought.get_mut(&(task, epoch)) {
            sessions.remove(&session);
        }
    }

    /// Keeps nothing of this job and those before it: what the log counts of them from now on is wrong.
    pub(crate) fn forget_until(&mut self, job: JobId) {
        self.given.retain(|(task, _)| task.job > job);
        self.latest.retain(|task, _| task.job > job);
        self.brought.retain(|(task, _), _| task.job > job);
        self.counted.retain(|task, _| task.job > job);
    }

    /// What is wrong with a record that is being written now. A result may count only under a lease that holds: the task's
    /// latest, or one that a worker has brought along and that may have been adopted.
    pub(crate) fn judge(&mut self, fact: &Fact) -> Option<Violation> {
        let (task, epoch) = match fact {
            Fact::Rendered { task, epoch, .. } | Fact::Merged { task, epoch, .. } => (*task, *epoch),
            Fact::Lost { task } => {
                self.counted.remove(task);
                return None;
            }
            Fact::Restarted { job, frame } => {
                self.counted.retain(|task, _| (task.job, task.stage.frame) != (*job, *frame));
                return None;
            }
            _ => return None,
        };
        if !self.given.contains(&(task, epoch)) {
            return Some(Violation::Unleased { task, epoch });
        }
        if self.brought.get(&(task, epoch)).is_some_and(|sessions| !sessions.is_empty()) {
            return None;
        }
        self.counted.insert(task, epoch);
        self.superseded(task)
    }

    /// A task that counts is not given out again, whether the lease that came after its own is seen before or later.
    fn superseded(&self, task: TaskKey) -> Option<Violation> {
        let (epoch, later) = (*self.counted.get(&task)?, *self.latest.get(&task)?);
        (later > epoch).then_some(Violation::Superseded { task, epoch, later })
    }
}
