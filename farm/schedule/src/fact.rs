//! Facts: permanent changes, the entries of the log.

use femc_model::{
    ChunkSize, Control, Digest, Drain, Epoch, Failure, JobId, JobSpec, LogRecord, OwnerUsage, TaskKey, TaskResult, Tick,
};
use serde::{Deserialize, Serialize};

use crate::WorkerDeath;

/// Time that an owner has used, and the resulting place in the order of service.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct UsedTime {
    /// Milliseconds of worker time that the owner was charged.
    pub charged: u64,
    /// Place in the order of service, as in weighted fair queueing: the lowest is served first. It grows with the used time,
    /// divided by the owner's weight at that time. When an owner returns after an absence, it rises to the level of the others.
    pub virtual_time: u64,
}

/// A change of the [`Ledger`](crate::Ledger).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Fact {
    /// A coordinator has started; all leases of earlier ones are void.
    CoordinatorStarted {
        /// Incarnation of the coordinator, greater than all before.
        incarnation: u32,
    },
    /// A job was accepted.
    Submitted {
        /// Number of the job.
        job: JobId,
        /// Key of the submission; a second submission with this key returns the same job, or is refused if its results would differ.
        key: Option<String>,
        /// Specification of the job, as submitted.
        spec: Box<JobSpec>,
        /// Granularity at which its tasks are divided.
        chunk_size: ChunkSize,
        /// Calendar date: Unix time in milliseconds; `None`: unknown.
        #[serde(deserialize_with = "femc_model::since_version_10")]
        date: Option<u64>,
        /// Whether its ends are announced; never for jobs from earlier versions of the log.
        #[serde(deserialize_with = "femc_model::since_version_11")]
        announces: bool,
    },
    /// A shared job has begun: one build of the engine does the stages of a content for all jobs that need them.
    SharedJobBegun {
        /// Number of the shared job: [`JobId::shared`].
        job: JobId,
        /// Key of the content.
        key: Digest,
        /// Build of the engine.
        engine: String,
        /// Specification: that of the first job that needs it, with one frame.
        spec: Box<JobSpec>,
        /// Granularity at which its tasks are divided.
        chunk_size: ChunkSize,
    },
    /// A task or some of its sample chunks are done; the decision in the result takes effect.
    Done {
        /// The task; its index is the first sample chunk of the lease.
        task: TaskKey,
        /// End of the lease's sample chunks.
        end: u32,
        /// Epoch of the lease.
        epoch: Epoch,
        /// Time at which the lease was granted.
        leased: Tick,
        /// Result of the task.
        result: Box<TaskResult>,
    },
    /// A task used up one attempt.
    Failed {
        /// The task.
        task: TaskKey,
        /// Earlier leases of the task are over: their outcomes no longer count.
        until: Epoch,
        /// Failure of the attempt.
        failure: Failure,
    },
    /// Outputs of a task that others need are lost. The task must run again, and so must the producers of its inputs that are lost.
    OutputsLost {
        /// The task that made the outputs.
        task: TaskKey,
    },
    /// A result of a finished frame is lost, or its build of the engine is gone: the frame restarts.
    Restarted {
        /// The job.
        job: JobId,
        /// Frame number; [`Stage::JOB_FRAME`](femc_model::Stage::JOB_FRAME): the job's own stages.
        frame: u32,
    },
    /// The job cannot succeed.
    JobFailed {
        /// The job.
        job: JobId,
        /// Failure that ends the job.
        failure: Failure,
    },
    /// A person controlled the job.
    Controlled {
        /// The job.
        job: JobId,
        /// Action on the job.
        control: Control,
    },
    /// An operator drained a worker, or ended its drain.
    Drained {
        /// Process of the worker.
        instance: u64,
        /// Whether the drain begins or ends.
        drain: Drain,
    },
    /// The log of an attempt is in the store.
    Logged(Box<LogRecord>),
    /// An ended job was removed, with its key and its logs.
    JobRemoved {
        /// The job.
        job: JobId,
    },
    /// The first result of a frame is about to count: all its results come from this build of the engine, until the frame is
    /// finished or restarts.
    BuildAssigned {
        /// The job.
        job: JobId,
        /// Frame number.
        frame: u32,
        /// Build of the engine.
        engine: String,
    },
    /// A worker died while it computed a task.
    WorkerDied {
        /// The task.
        task: TaskKey,
        /// End of the lease's sample chunks, which begin with the task's index.
        end: u32,
        /// Worker that died, and the evidence.
        death: WorkerDeath,
    },
    /// A process that was presumed dead has come back.
    WorkerReturned {
        /// Process of the worker.
        instance: u64,
    },
    /// The used time of some owners has changed.
    TimeCharged {
        /// Used time by owner.
        owners: Vec<(String, UsedTime)>,
    },
    /// The usage of some owners in a month has changed.
    Metered {
        /// New usage; each entry replaces the usage of its owner and month.
        usage: Vec<OwnerUsage>,
    },
    /// The end of a job was announced to all recipients.
    Announced {
        /// The job.
        job: JobId,
        /// Time of the end. If the job has ended again since, the new end is not yet announced.
        ended: Tick,
    },
}

impl Fact {
    /// Returns the task that a change of its job's progress is about.
    pub(crate) fn task(&self) -> Option<&TaskKey> {
        match self {
            Self::Done { task, .. }
            | Self::Failed { task, .. }
            | Self::OutputsLost { task }
            | Self::WorkerDied { task, .. } => Some(task),
            _ => None,
        }
    }

    /// Returns the same task, to change it.
    pub(crate) fn task_mut(&mut self) -> Option<&mut TaskKey> {
        match self {
            Self::Done { task, .. }
            | Self::Failed { task, .. }
            | Self::OutputsLost { task }
            | Self::WorkerDied { task, .. } => Some(task),
            _ => None,
        }
    }
}
