//! Calls that change nothing, and their answers.

use std::collections::BTreeSet;

use femc_model::{
    Digest, FrameParts, FrameRecord, FrameStatus, JobId, JobStatus, LogRecord, OwnerUsage, Refusal, TaskFilter,
    TaskKey, TaskPage, Tick, WorkerId, WorkerList,
};
use femc_proto::{AttemptPage, Backup, ChangeScope, Changes, JobList, JobShape, References, Reply};
use femc_queue::{Queue, QueueError, Remedy};
use tokio::sync::watch;

use crate::actor::Actor;
use crate::attempts;
use crate::config::CoordinatorError;

/// A call whose answer changes nothing. It is answered when all earlier facts are durable.
#[derive(Debug)]
pub(crate) enum Query {
    List(Reply<JobList>),
    Changes(ChangeScope, Reply<Changes>),
    Status(JobId, Reply<JobStatus>),
    Watch(JobId, Reply<watch::Receiver<JobStatus>>),
    Parts(JobId, Reply<Vec<FrameParts>>),
    Producer(JobId, Digest, Reply<Option<TaskKey>>),
    Frames(JobId, Reply<Vec<FrameRecord>>),
    Logs(JobId, Tick, Reply<Vec<LogRecord>>),
    Shape(JobId, Reply<JobShape>),
    FrameTable(JobId, Reply<Vec<FrameStatus>>),
    Tasks(JobId, TaskFilter, u64, usize, Reply<TaskPage>),
    Attempts(JobId, u64, Reply<AttemptPage>),
    Workers(Reply<WorkerList>),
    Usage(Reply<Vec<OwnerUsage>>),
    Drained(Result<Vec<WorkerId>, Refusal>, Reply<Vec<WorkerId>>),
    Done(Reply<()>),
    References(Reply<References>),
    Backup(Reply<Backup>),
}

impl<Q: Queue> Actor<Q> {
    /// Answers the queries.
    pub(crate) async fn answer_queries(&mut self) -> Result<(), CoordinatorError> {
        let now = self.clock.now();
        // The send fails if the caller has disconnected. This is ignored.
        for question in std::mem::take(&mut self.queries) {
            match question {
                Query::List(reply) => {
                    let jobs = self.scheduler.jobs(now).into_iter();
                    let jobs = jobs.map(|status| self.targets.fill(&self.scheduler, status)).collect();
                    let warnings = self.disks.warnings();
                    drop(reply.send(Ok(JobList { jobs, warnings })));
                }
                Query::Changes(news, reply) => drop(reply.send(Ok(self.changes(news)))),
                Query::Status(job, reply) => {
                    drop(reply.send(self.targets.status(&self.scheduler, job, now)));
                }
                Query::Watch(job, reply) => drop(reply.send(self.watch(job))),
                Query::Parts(job, reply) => drop(reply.send(self.scheduler.partial_frames(job))),
                Query::Producer(job, digest, reply) => drop(reply.send(self.scheduler.producer(job, &digest))),
                Query::Frames(job, reply) => drop(reply.send(self.scheduler.frames(job))),
                Query::Logs(job, since, reply) => drop(reply.send(self.scheduler.logs(job, since))),
                Query::Shape(job, reply) => drop(reply.send(self.shape(job))),
                Query::FrameTable(job, reply) => drop(reply.send(self.scheduler.frame_table(job))),
                Query::Tasks(job, filter, from, count, reply) => {
                    drop(reply.send(self.scheduler.tasks(job, filter, from, count, now)));
                }
                Query::Attempts(job, from, reply) => {
                    let page = match self.queue.notes(job.0, from).await {
                        Ok(page) => Ok(attempts::decode_page(page)),
                        Err(error) if error.remedy() == Remedy::Reopen => return Err(error.into()),
                        // Notes are stored beside the log. The log works without them.
                        Err(error) => {
                            Err(Refusal::Unavailable { message: format!("cannot read the attempts: {error}") })
                        }
                    };
                    drop(reply.send(page));
                }
                Query::Drained(answer, reply) => drop(reply.send(answer)),
                Query::Done(reply) => drop(reply.send(Ok(()))),
                Query::Workers(reply) => drop(reply.send(Ok(self.all_workers()))),
                Query::Usage(reply) => drop(reply.send(Ok(self.scheduler.usage_by_owner()))),
                Query::References(reply) => drop(reply.send(Ok(self.references()))),
                Query::Backup(reply) => {
                    let copied = self.queue.copy().await;
                    let backup = copied.map(|log| Backup { log, references: self.references() });
                    drop(reply.send(backup.map_err(|error| backup_refusal(&error))));
                }
            }
        }
        Ok(())
    }

    /// Returns the changes for a feed.
    fn changes(&mut self, scope: ChangeScope) -> Changes {
        let now = self.clock.now();
        let touched = self.changed_since_feed.replace(BTreeSet::new()).filter(|_| scope == ChangeScope::Changes);
        let is_wanted = |job| touched.as_ref().is_none_or(|touched| touched.contains(&job));
        let (jobs, there) = self.scheduler.changed_jobs(is_wanted, now);
        let jobs = jobs.into_iter().map(|status| self.targets.fill(&self.scheduler, status)).collect();
        Changes { jobs, existing_jobs: there, workers: self.all_workers(), warnings: self.disks.warnings() }
    }

    pub(crate) fn references(&self) -> References {
        let ledger = self.scheduler.ledger();
        References { artifacts: ledger.references(), scenes: ledger.scenes() }
    }
}

/// Converts a failed copy of the log to a refusal. The log itself is unchanged.
fn backup_refusal(error: &QueueError) -> Refusal {
    match error {
        QueueError::NoCopy { .. } => Refusal::Invalid { field: "backup".into(), message: error.to_string() },
        error => Refusal::Unavailable { message: format!("cannot copy the log: {error}") },
    }
}
