//! Calls to the coordinator. Each has a channel for its answer.

use std::collections::BTreeSet;
use std::fs::File;

use femc_model::{
    AttemptRecord, ChunkSize, Control, Digest, Drain, FrameParts, FrameRecord, FrameStatus, JobId, JobSpec, JobStatus,
    LogRecord, OwnerUsage, Refusal, TaskFilter, TaskKey, TaskPage, Tick, WorkerId, WorkerList, WorkerSelector,
};
use tokio::sync::{oneshot, watch};

/// Specification of a job, and its division into chunks.
#[derive(Debug, Clone, PartialEq)]
pub struct JobShape {
    /// Specification of the job, as submitted.
    pub spec: Box<JobSpec>,
    /// Division of its tasks into chunks.
    pub chunk_size: ChunkSize,
}

/// A page of a job's attempts.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AttemptPage {
    /// Attempts in the order in which they ended; see [`femc_model::Attempts`].
    pub attempts: Vec<AttemptRecord>,
    /// Start of the next page; `None`: this is the last page.
    pub next: Option<u64>,
}

/// Channel for an answer.
pub type Reply<T> = oneshot::Sender<Result<T, Refusal>>;

/// All jobs, with warnings.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JobList {
    /// Jobs in order of submission.
    pub jobs: Vec<JobStatus>,
    /// Warnings for users about conditions that need attention.
    pub warnings: Vec<String>,
}

/// Changes of the farm.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Changes {
    /// Jobs that may have changed: all unfinished jobs, and those with an event.
    pub jobs: Vec<JobStatus>,
    /// All existing jobs.
    pub existing_jobs: BTreeSet<JobId>,
    /// The workers.
    pub workers: WorkerList,
    /// Warnings for users about conditions that need attention.
    pub warnings: Vec<String>,
}

/// Amount of data that a feed wants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChangeScope {
    /// Every job.
    All,
    /// Changes since the previous request.
    Changes,
}

/// Artifacts that jobs refer to.
#[derive(Debug, Clone, Default)]
pub struct References {
    /// All artifacts that the jobs name.
    pub artifacts: BTreeSet<Digest>,
    /// Scenes of the jobs. The pieces of a scene are referenced, too.
    pub scenes: BTreeSet<Digest>,
}

/// Snapshot of the log.
#[derive(Debug)]
pub struct Backup {
    /// Copy of the log, positioned at its start.
    pub log: File,
    /// Artifacts that its jobs refer to.
    pub references: References,
}

/// A call to the coordinator, answered asynchronously.
/// - `S`: type of a worker's session in its transport.
#[derive(Debug)]
pub enum Call<S> {
    /// Queue a job.
    Submit {
        /// Idempotency key: a second submission with this key returns the same job, or is refused if its results would differ.
        key: Option<String>,
        /// The job.
        spec: Box<JobSpec>,
        /// Number of the job.
        reply: Reply<JobId>,
    },
    /// Every job.
    List {
        /// Status of all jobs.
        reply: Reply<JobList>,
    },
    /// Changes since the previous call. There is only one caller of this.
    Changes {
        /// Amount of data wanted.
        scope: ChangeScope,
        /// Jobs and workers at this moment.
        reply: Reply<Changes>,
    },
    /// One job.
    Status {
        /// The job.
        job: JobId,
        /// Status of the job at this moment.
        reply: Reply<JobStatus>,
    },
    /// Updates of one job.
    Watch {
        /// The job.
        job: JobId,
        /// Current and later status. Closed after the job ends.
        reply: Reply<watch::Receiver<JobStatus>>,
    },
    /// Control a job.
    Control {
        /// The job.
        job: JobId,
        /// Action on the job.
        control: Control,
        /// Sent when the control is durable.
        reply: Reply<()>,
    },
    /// Available outputs of unfinished frames of a job.
    Parts {
        /// The job.
        job: JobId,
        /// Answer, in ascending order of frames.
        reply: Reply<Vec<FrameParts>>,
    },
    /// The finished frames of a job.
    Frames {
        /// The job.
        job: JobId,
        /// Answer, in ascending order of frames.
        reply: Reply<Vec<FrameRecord>>,
    },
    /// Logs of the attempts at a job's tasks.
    Logs {
        /// The job.
        job: JobId,
        /// Earliest report time of the attempts.
        since: Tick,
        /// Records, oldest first.
        reply: Reply<Vec<LogRecord>>,
    },
    /// Specification of a job, and its division into chunks.
    Shape {
        /// The job.
        job: JobId,
        /// Specification of the job and its division into chunks.
        reply: Reply<JobShape>,
    },
    /// Table of a job's frames.
    FrameTable {
        /// The job.
        job: JobId,
        /// Frames in ascending order. The job's own stages come first, if it has any.
        reply: Reply<Vec<FrameStatus>>,
    },
    /// Table of a job's tasks.
    Tasks {
        /// The job.
        job: JobId,
        /// Filter of the tasks.
        filter: TaskFilter,
        /// Index of the first returned task.
        from: u64,
        /// Maximum number of returned tasks.
        count: usize,
        /// Page of tasks, and the total number.
        reply: Reply<TaskPage>,
    },
    /// Resource usage of the attempts at a job's tasks.
    Attempts {
        /// The job.
        job: JobId,
        /// 0, or the `next` of the previous page.
        from: u64,
        /// Attempts in the order in which they ended.
        reply: Reply<AttemptPage>,
    },
    /// The workers.
    Workers {
        /// Connected and disconnected workers.
        reply: Reply<WorkerList>,
    },
    /// Farm usage of the owners' jobs.
    Usage {
        /// Usage, ordered by month, then by owner.
        reply: Reply<Vec<OwnerUsage>>,
    },
    /// Drain workers, or end the drain.
    Drain {
        /// Name of the worker.
        worker: WorkerSelector,
        /// Whether the drain starts or ends.
        drain: Drain,
        /// Affected sessions. Sent when the change is durable.
        reply: Reply<Vec<WorkerId>>,
    },
    /// Artifacts that all jobs refer to.
    References {
        /// Sent when all earlier calls are durable.
        reply: Reply<References>,
    },
    /// Copy of the log, and the artifacts that it refers to.
    Backup {
        /// Sent when all earlier calls are durable.
        reply: Reply<Backup>,
    },
    /// An artifact is missing from the store, or was damaged and has been removed.
    ArtifactLost {
        /// Digest of the artifact.
        digest: Digest,
        /// Sent when all consequences of the loss are durable.
        reply: Reply<()>,
    },
    /// Find the task of a frame in progress that made an artifact.
    Producer {
        /// The job.
        job: JobId,
        /// Digest of the artifact.
        digest: Digest,
        /// The task. `None`: no frame in progress has such an output now.
        reply: Reply<Option<TaskKey>>,
    },
    /// A worker has connected.
    Session(Box<S>),
}
