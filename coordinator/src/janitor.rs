//! Removal of artifacts that no job names any more: tiles that were reduced, and sums of earlier rounds.
//!
//! An artifact is removed some time after its release, and only if nothing names it then. The reason: the same bytes may have been
//! uploaded again with the same digest, and a worker that finds them in the store does not send them twice. If an artifact is
//! removed although it is needed, the task that misses it has it recreated.
//!
//! The list is in memory. `femc gc` finds what a restart leaves behind, and what killed clients or workers uploaded in vain.

use std::collections::VecDeque;

use femc_model::{Digest, Tick};
use femc_queue::Queue;
use femc_schedule::Command;

use crate::actor::Actor;
use crate::config::CoordinatorError;
use crate::full_log::ActorInputs;

/// Released artifacts that wait for their removal.
#[derive(Debug, Default)]
pub(crate) struct Janitor {
    released: VecDeque<(Tick, Vec<Digest>)>,
    last_sweep: Tick,
}

impl Janitor {
    /// Milliseconds between release and removal.
    const REMOVAL_DELAY: u64 = 30_000;
    /// Milliseconds between two removals. Each of them inspects everything that the jobs name.
    const SWEEP_INTERVAL: u64 = 2_000;

    pub(crate) fn push(&mut self, now: Tick, digests: Vec<Digest>) {
        self.released.push_back((now, digests));
    }

    /// Returns whether the released artifacts should be inspected now.
    fn is_due(&self, now: Tick) -> bool {
        now.since(self.last_sweep) >= Self::SWEEP_INTERVAL
    }

    fn take_due(&mut self, now: Tick) -> Vec<Digest> {
        let mut due = Vec::new();
        self.last_sweep = now;
        while self.released.front().is_some_and(|(released, _)| now.since(*released) >= Self::REMOVAL_DELAY) {
            due.extend(self.released.pop_front().map(|(_, digests)| digests).unwrap_or_default());
        }
        due
    }
}

impl<Q: Queue> Actor<Q> {
    /// Removes artifacts that are due. The scheduler's facts are made durable first: until then the log still names artifacts that
    /// the scheduler has released, and a coordinator that reads the log after a crash would need them.
    pub(crate) async fn sweep(
        &mut self,
        commands: &mut Vec<Command>,
        inputs: &mut ActorInputs,
    ) -> Result<(), CoordinatorError> {
        if !self.janitor.is_due(self.clock.now()) {
            return Ok(());
        }
        self.commit(commands, inputs).await?;
        let due = self.scheduler.unreferenced(self.janitor.take_due(self.clock.now()));
        if due.is_empty() {
            return Ok(());
        }
        let store = self.store.clone();
        tokio::spawn(async move {
            for digest in due {
                if let Err(error) = store.remove(&digest).await {
                    tracing::warn!(%digest, %error, "cannot delete an artifact that no job needs");
                }
            }
        });
        Ok(())
    }
}
