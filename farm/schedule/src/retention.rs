//! Jobs that ended long ago are forgotten, so that a farm that runs for years does not grow for ever; and those that a person
//! deletes.

use femc_model::{JobId, Refusal, Tick};

use crate::ledger::Job;
use crate::scheduler::Scheduler;
use crate::{Answer, Command, Fact};

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
            self.forget(job, now, out);
        }
    }

    /// Deletes a job that has ended.
    pub(crate) fn delete(&mut self, id: JobId, now: Tick, out: &mut Vec<Command>) -> Result<Answer, Refusal> {
        if !self.job(id)?.has_ended() {
            let message = format!("job {id} has not ended: cancel it first");
            return Err(Refusal::Invalid { field: "control".into(), message });
        }
        self.forget(id, now, out);
        Ok(Answer::Controlled(id))
    }

    fn forget(&mut self, job: JobId, now: Tick, out: &mut Vec<Command>) {
        self.revoke_all(job, out);
        self.record(Fact::Forgotten { job }, now, out);
        self.ready.remove(&job);
        self.joinable.remove(&job);
        self.order.remove(job);
        out.push(Command::Changed(job));
    }
}
