//! Jobs that ended long ago are forgotten, so that a farm that runs for years does not grow for ever.

use femc_model::{JobId, Tick};

use crate::ledger::Job;
use crate::scheduler::Scheduler;
use crate::{Command, Fact};

impl Scheduler {
    /// Milliseconds between two looks at the jobs that have ended.
    const LOOK: u64 = 1_000;

    /// Forgets the jobs that ended longer ago than they are to be kept. What they named stays in the store, for the collection
    /// of garbage: a submission may have been told a moment ago that it is there.
    pub(crate) fn forget_ended(&mut self, now: Tick, out: &mut Vec<Command>) {
        let Some(keep) = self.config.keep_ended else { return };
        if now < self.looks_from {
            return;
        }
        self.looks_from = now.after(Self::LOOK);
        let is_due = |job: &Job| job.has_ended() && job.ended.is_some_and(|ended| now.since(ended) >= keep);
        let due: Vec<JobId> = self.ledger.of_people().filter(|(_, job)| is_due(job)).map(|(id, _)| id).collect();
        for job in due {
            self.revoke_all(job, out);
            self.record(Fact::Forgotten { job }, now, out);
            self.ready.remove(&job);
            self.joinable.remove(&job);
            self.order.remove(job);
            out.push(Command::Changed(job));
        }
    }
}
