//! What comes to the coordinator: calls, each with a place for its answer.

use std::collections::BTreeSet;
use std::fs::File;

use femc_model::{
    AttemptRecord, Control, Crew, Cut, Digest, Drain, FrameParts, FrameRecord, FrameStatus, JobId, JobSpec, JobStatus,
    LogRecord, OwnerUsage, Refusal, TaskFilter, TaskPage, Tick, WorkerId, WorkerName,
};
use tokio::sync::{oneshot, watch};

/// What a job is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct JobShape {
    /// Specification of the job, as submitted.
    pub spec: Box<JobSpec>,
    /// How its tasks are cut.
    pub cut: Cut,
}

/// Some of a job's attempts.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AttemptPage {
    /// In the order in which they ended; see [`femc_model::Attempts`].
    pub attempts: Vec<AttemptRecord>,
    /// Where the next page begins; `None`: there is none.
    pub next: Option<u64>,
}

/// Where an answer goes.
pub type Reply<T> = oneshot::Sender<Result<T, Refusal>>;

/// What there is.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Listing {
    /// In order of submission.
    pub jobs: Vec<JobStatus>,
    /// What somebody should look after, for people.
    pub warnings: Vec<String>,
}

/// What has changed of the farm.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Changes {
    /// Jobs that may be otherwise than before: all that have not ended, and those to which something happened.
    pub jobs: Vec<JobStatus>,
    /// Every job that there is.
    pub there: BTreeSet<JobId>,
    /// The workers.
    pub workers: Crew,
    /// What somebody should look after, for people.
    pub warnings: Vec<String>,
}

/// How much a feed wants to hear.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum News {
    /// Every job.
    All,
    /// What happened since it was asked before.
    Changes,
}

/// What jobs refer to.
#[derive(Debug, Clone, Default)]
pub struct References {
    /// All that they name.
    pub artifacts: BTreeSet<Digest>,
    /// Their scenes, whose pieces are theirs, too.
    pub scenes: BTreeSet<Digest>,
}

/// The log at one moment.
#[derive(Debug)]
pub struct Backup {
    /// A copy of it, at its beginning.
    pub log: File,
    /// What its jobs refer to.
    pub references: References,
}

/// A request, to be answered in its own time.
/// - `S`: a worker's session, as its transport has it.
#[derive(Debug)]
pub enum Call<S> {
    /// Queue a job.
    Submit {
        /// A second submission with this key is the same job.
        key: Option<String>,
        /// The job.
        spec: Box<JobSpec>,
        /// Its number.
        reply: Reply<JobId>,
    },
    /// Every job.
    List {
        /// Status of all jobs.
        reply: Reply<Listing>,
    },
    /// What has changed since this was asked before, of which there is one who asks.
    Changes {
        /// How much is wanted.
        news: News,
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
    /// One job, as it changes.
    Watch {
        /// The job.
        job: JobId,
        /// Its status now and later; closed after its end.
        reply: Reply<watch::Receiver<JobStatus>>,
    },
    /// Steer a job.
    Control {
        /// The job.
        job: JobId,
        /// What is done to the job.
        control: Control,
        /// Sent when the control is durable.
        reply: Reply<()>,
    },
    /// What there is of a job's frames in work.
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
    /// What workers wrote down while they did the job's tasks.
    Logs {
        /// The job.
        job: JobId,
        /// Of attempts reported then or later.
        since: Tick,
        /// Records, oldest first.
        reply: Reply<Vec<LogRecord>>,
    },
    /// What a job is made of.
    Shape {
        /// The job.
        job: JobId,
        /// Specification of the job and its cut into tasks.
        reply: Reply<JobShape>,
    },
    /// A job frame by frame.
    FrameTable {
        /// The job.
        job: JobId,
        /// Ascending; the job's own stages first, if it has any.
        reply: Reply<Vec<FrameStatus>>,
    },
    /// A job task by task.
    Tasks {
        /// The job.
        job: JobId,
        /// Which of its tasks.
        filter: TaskFilter,
        /// The first of these that is told.
        from: u64,
        /// How many are told at most.
        count: usize,
        /// A window of these, and how many there are.
        reply: Reply<TaskPage>,
    },
    /// What the attempts at a job's tasks took.
    Attempts {
        /// The job.
        job: JobId,
        /// 0, or the `next` of the page before.
        from: u64,
        /// In the order in which they ended.
        reply: Reply<AttemptPage>,
    },
    /// The workers.
    Workers {
        /// Those that are there, and those that were.
        reply: Reply<Crew>,
    },
    /// What the owners' jobs used of the farm.
    Usage {
        /// By month, then by owner.
        reply: Reply<Vec<OwnerUsage>>,
    },
    /// Give workers no more tasks, or tasks again.
    Drain {
        /// Name of the worker.
        worker: WorkerName,
        /// Whether the drain begins or ends.
        drain: Drain,
        /// The sessions that it was done to, when it is durable.
        reply: Reply<Vec<WorkerId>>,
    },
    /// What all jobs refer to.
    References {
        /// Sent when all earlier calls are durable.
        reply: Reply<References>,
    },
    /// A copy of the log, and what it refers to.
    Backup {
        /// Sent when all earlier calls are durable.
        reply: Reply<Backup>,
    },
    /// An artifact that somebody wanted is not in the store, or was damaged and is removed.
    Lost {
        /// Digest of the artifact.
        digest: Digest,
        /// Sent when all that follows from the loss is durable.
        reply: Reply<()>,
    },
    /// A worker has come.
    Session(Box<S>),
}
