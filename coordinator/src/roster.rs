//! Roster of the workers that the farm knows, connected or not, and its note beside the log.

use femc_model::{WorkerList, WorkerStatus};
use femc_queue::{Batch, Note, Queue};
use femc_schedule::SnapshotError;

use crate::actor::Actor;

/// Subject of the note with the roster of workers. Other subjects are job numbers, which begin with 1.
pub const ROSTER_SUBJECT: u64 = 0;

impl<Q: Queue> Actor<Q> {
    /// Returns the connected and the disconnected workers.
    pub(crate) fn all_workers(&self) -> WorkerList {
        let there = self.connected_workers();
        let offline = self.roster.offline(&there);
        WorkerList { connected: there, offline }
    }

    /// Returns the connected workers, with the counts of earlier sessions.
    fn connected_workers(&self) -> Vec<WorkerStatus> {
        let mut there = self.scheduler.workers(self.clock.now());
        self.roster.add_earlier(&mut there);
        there
    }

    /// Updates the roster from the connected workers. The next commit makes it durable.
    pub(crate) fn update_roster(&mut self) {
        let now = self.clock.now();
        // Without a date, the time of contact is not known.
        let Some(zero) = self.scheduler.config().clock_zero else { return };
        self.roster.observe(&self.connected_workers(), zero.saturating_add(now.0));
        self.is_roster_dirty = true;
    }

    pub(crate) fn roster_note(&self) -> Result<Note, SnapshotError> {
        Ok(Note { subject: ROSTER_SUBJECT, bytes: self.roster.encode()? })
    }

    /// Writes the final roster note, with the latest contacts.
    pub(crate) async fn save_roster(&mut self) {
        self.update_roster();
        let Ok(note) = self.roster_note() else { return };
        let batch = Batch { notes: &[note], forgotten: &[ROSTER_SUBJECT], ..Batch::default() };
        if let Err(error) = self.queue.append(batch).await {
            tracing::warn!(%error, "cannot save the last contacts of workers");
        }
    }
}
