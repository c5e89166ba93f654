//! What has happened for good: the entries of the log.

use femc_model::{
    Control, Cut, Digest, Drain, Epoch, Failure, JobId, JobSpec, LogRecord, OwnerUsage, TaskKey, TaskResult, Tick,
};
use serde::{Deserialize, Serialize};

use crate::Casualty;

/// What an owner has used, and where that puts him.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Used {
    /// Milliseconds of workers that his leases have held.
    pub held: u64,
    /// Place in the order of service, as in weighted fair queueing: the lowest goes first. Grows with the time used, the slower
    /// the greater the owner's weight is at the time, and to that of the others when he comes back after an absence.
    pub virtual_time: u64,
}

/// A change of the [`Ledger`](crate::Ledger).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Fact {
    /// A coordinator has begun; leases of the ones before are void.
    Opened {
        /// Greater than any before.
        incarnation: u32,
    },
    /// A job was taken.
    Submitted {
        /// Its number.
        job: JobId,
        /// A second submission with this key is the same job.
        key: Option<String>,
        /// Specification of the job, as submitted.
        spec: Box<JobSpec>,
        /// How finely its tasks are cut.
        cut: Cut,
        /// Calendar date: Unix time in milliseconds; `None`: not known.
        #[serde(deserialize_with = "femc_model::since_version_10")]
        date: Option<u64>,
        /// Whether its ends are announced; earlier versions of the log announce none.
        #[serde(deserialize_with = "femc_model::since_version_11")]
        announces: bool,
    },
    /// The stages of a content are begun, for all jobs that need them, by one build of the engine.
    Shared {
        /// Its number: [`JobId::shared`].
        job: JobId,
        /// Of the content.
        key: Digest,
        /// The build.
        engine: String,
        /// What to do: the job that needed it first, of one frame.
        spec: Box<JobSpec>,
        /// How finely its tasks are cut.
        cut: Cut,
    },
    /// A task was done, or some of its grains; what its result decides follows from it.
    Done {
        /// Which; its index is the first of the lease's grains.
        task: TaskKey,
        /// End of the lease's grains.
        end: u32,
        /// Of the lease that did it.
        epoch: Epoch,
        /// When that lease was granted.
        leased: Tick,
        /// Result of the task.
        result: Box<TaskResult>,
    },
    /// A task used up one attempt.
    Failed {
        /// The task.
        task: TaskKey,
        /// Leases of it that were granted before are over: what comes of them counts no more.
        until: Epoch,
        /// Failure of the attempt.
        failure: Failure,
    },
    /// Outputs of a task that others need are gone: it is to be done again, and what it reads, where that is gone, too.
    Lost {
        /// The task that had made it.
        task: TaskKey,
    },
    /// A result of a finished frame is gone, or its build of the engine: the frame begins anew.
    Restarted {
        /// The job.
        job: JobId,
        /// Frame number; [`Stage::OF_JOB`](femc_model::Stage::OF_JOB): the job's own stages.
        frame: u32,
    },
    /// The job cannot succeed.
    Doomed {
        /// The job.
        job: JobId,
        /// Failure that ends the job.
        failure: Failure,
    },
    /// A person steered the job.
    Controlled {
        /// The job.
        job: JobId,
        /// What is done to the job.
        control: Control,
    },
    /// An operator let a worker have no more tasks, or tasks again.
    Drained {
        /// The worker's process.
        instance: u64,
        /// Whether the drain begins or ends.
        drain: Drain,
    },
    /// A worker wrote something down during an attempt.
    Logged(Box<LogRecord>),
    /// A job that had ended was forgotten, with its key and its logs.
    Forgotten {
        /// The job.
        job: JobId,
    },
    /// The first result of a frame is about to count: it and all others come from one build of the engine. Until the frame is
    /// finished, or begins anew.
    Built {
        /// The job.
        job: JobId,
        /// Frame number.
        frame: u32,
        /// Build of the engine.
        engine: String,
    },
    /// A worker died while it computed a task.
    Died {
        /// The task.
        task: TaskKey,
        /// End of the lease's grains, which begin with the task's key.
        end: u32,
        /// Who, and how one knows.
        casualty: Casualty,
    },
    /// A process of which deaths were presumed has come back.
    Lives {
        /// The worker's process.
        instance: u64,
    },
    /// What owners have used, of those of whom it has changed.
    Used {
        /// By owner.
        owners: Vec<(String, Used)>,
    },
    /// Owners' usage of a month, as it is now, of those of whom it has changed.
    Metered {
        /// Each replaces the usage of its owner and month.
        usage: Vec<OwnerUsage>,
    },
    /// Everybody who is to be told of a job's end was told.
    Announced {
        /// The job.
        job: JobId,
        /// Time of the end; where the job has ended once more since, that end is not announced.
        ended: Tick,
    },
}
