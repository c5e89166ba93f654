//! Handles finished tasks: stores the result and the log, and notifies the session.

use std::fmt::Write as _;
use std::sync::Arc;

use femc_fault::{Point, pass_point};
use femc_model::{Epoch, LogDestination, LogText, TaskKey};
use tokio::sync::mpsc::UnboundedSender;

use crate::outbox::Outbox;
use crate::task_table::{Outcome, Task};

/// Receiver of the tasks' outcomes.
#[derive(Debug, Clone)]
pub(crate) struct OutcomeHandler {
    /// Channel that notifies the session of every finished task.
    pub(crate) done: UnboundedSender<(TaskKey, Epoch)>,
    pub(crate) outbox: Outbox,
    /// The worker's name, for logs.
    pub(crate) worker: Arc<str>,
}

impl OutcomeHandler {
    pub(crate) fn handle(&self, task: &Arc<Task>, outcome: Outcome) {
        pass_point(Point::WorkerAfterTask);
        task.account.end();
        if !task.is_cancelled() {
            self.close_log(task, &outcome);
        }
        task.set_outcome(outcome);
        if !task.is_cancelled() {
            self.outbox.store(task);
        }
        // A closed channel means that the worker is ending.
        let _ = self.done.send(task.key());
    }

    /// Closes the task's log. A log that travels with the report is short; other logs go to the store.
    fn close_log(&self, task: &Task, outcome: &Outcome) {
        let Some(seconds) = task.log.seconds() else { return };
        let limit = match task.log_destination(Some(outcome)) {
            LogDestination::Report => LogText::MAX_INLINE,
            LogDestination::Store => LogText::MAX_STORED,
        };
        task.set_final_log(seconds, task.log.render(&self.header(task, outcome, seconds), limit));
    }

    fn header(&self, task: &Task, outcome: &Outcome, seconds: f64) -> String {
        let (key, epoch) = task.key();
        let mut header = format!("task {key}, epoch {}\nworker {}, engine {}\n", epoch.0, self.worker, crate::engine());
        // Writing to a string cannot fail.
        let _ = match outcome {
            Ok(_) => write!(header, "done in {seconds:.3} s"),
            Err(failure) => write!(header, "failed after {seconds:.3} s: {failure}"),
        };
        let units = task.units.load(std::sync::atomic::Ordering::Relaxed);
        let _ = write!(header, "; {units} {}", task.properties().unit);
        if let Some(peak) = task.account.peak() {
            let _ = write!(header, "; peak memory of this process {} MiB", peak.div_ceil(1 << 20));
        }
        header.push('\n');
        header
    }
}
