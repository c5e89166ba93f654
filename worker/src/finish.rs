//! What becomes of a task that is done: it is kept, and the session is told.

use std::sync::Arc;

use femc_model::{Epoch, TaskKey};
use tokio::sync::mpsc::UnboundedSender;

use crate::outbox::Outbox;
use crate::table::{Outcome, Task};

/// Takes in what came of tasks.
#[derive(Debug, Clone)]
pub(crate) struct Finish {
    /// Hears of every task that is done.
    pub(crate) told: UnboundedSender<(TaskKey, Epoch)>,
    pub(crate) outbox: Outbox,
}

impl Finish {
    pub(crate) fn done(&self, task: &Arc<Task>, outcome: Outcome) {
        task.settle(outcome);
        if !task.is_cancelled() {
            self.outbox.keep(task);
        }
        // Without a listener the worker is ending.
        let _ = self.told.send(task.key());
    }
}
