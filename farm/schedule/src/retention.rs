//! Removal of jobs: ended jobs expire, so that a farm that runs for years does not grow forever, and people can delete them.

use femc_model::{JobId, Refusal, Tick};

use crate::ledger::Job;
use crate::scheduler::Scheduler;
use crate::{Answer, Command, Fact};

impl Scheduler {
    /// Milliseconds between two checks of the ended jobs.
    const RETENTION_INTERVAL: u64 = 1_000;

    /// Removes expired jobs. Their artifacts stay in the store until the garbage collection: the client of a new submission may
    /// just have been told that they exist.
    pub(crate) fn remove_expired(&mut self, now: Tick, out: &mut Vec<Command>) {
        let Some(keep) = self.config.keep_ended else { return };
        if now < self.next_retention_check {
            return;
        }
        self.next_retention_check = now.after(Self::RETENTION_INTERVAL);
        let is_due = |job: &Job| job.has_ended() && job.ended.is_some_and(|ended| now.since(ended) >= keep);
        let due: Vec<JobId> = self.ledger.submitted_jobs().filter(|(_, job)| is_due(job)).map(|(id, _)| id).collect();
        for job in due {
            self.remove_job(job, now, out);
        }
    }

    /// Deletes a job that has ended.
    pub(crate) fn delete_job(&mut self, id: JobId, now: Tick, out: &mut Vec<Command>) -> Result<Answer, Refusal> {
        if !self.job(id)?.has_ended() {
            let message = format!("job {id} has not ended: cancel it first");
            return Err(Refusal::Invalid { field: "control".into(), message });
        }
        self.remove_job(id, now, out);
        Ok(Answer::Controlled(id))
    }

    fn remove_job(&mut self, job: JobId, now: Tick, out: &mut Vec<Command>) {
        self.revoke_all(job, out);
        self.record_fact(Fact::JobRemoved { job }, now, out);
        self.ready.remove(&job);
        self.joinable.remove(&job);
        self.order.remove(job);
        out.push(Command::JobChanged(job));
    }
}
