//! What the scheduler is told, and what it asks for.

use femc_model::{
    Assignment, AttemptRecord, Control, Digest, Drain, Epoch, Failure, JobId, JobSpec, Month, Refusal, Registration,
    RevokeReason, TaskKey, TaskLog, TaskProgress, TaskResult, TaskUsage, Tick, WorkerId,
};

use crate::Fact;

/// Name of a request, so that its answer finds the way back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RequestId(pub u64);

/// Something happened.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// A job was submitted.
    Submitted {
        /// Number of the request, which the answer names.
        request: RequestId,
        /// A second submission with this key is the same job.
        key: Option<String>,
        /// The job.
        spec: Box<JobSpec>,
        /// Calendar date: Unix time in milliseconds; `None`: not known.
        date: Option<u64>,
    },
    /// A person steers a job.
    Controlled {
        /// Number of the request, which the answer names.
        request: RequestId,
        /// The job.
        job: JobId,
        /// What is done to the job.
        control: Control,
    },
    /// A worker's session began. The caller numbers sessions and never uses a number twice.
    Joined {
        /// The session.
        worker: WorkerId,
        /// Registration of the worker.
        registration: Registration,
    },
    /// A worker's session ended.
    Left {
        /// The session.
        worker: WorkerId,
    },
    /// A worker wants no more tasks.
    Draining {
        /// The session.
        worker: WorkerId,
    },
    /// A worker wants tasks again.
    Available {
        /// The session.
        worker: WorkerId,
    },
    /// An operator lets a worker have no more tasks, or tasks again.
    Drained {
        /// The session.
        worker: WorkerId,
        /// Whether the drain begins or ends.
        drain: Drain,
    },
    /// A worker says how far it is.
    Heartbeat {
        /// The session.
        worker: WorkerId,
        /// Its tasks.
        tasks: Vec<TaskProgress>,
    },
    /// What a worker wrote down during an attempt; comes before the attempt's outcome.
    Logged {
        /// The session.
        worker: WorkerId,
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
        /// The log; one that is stored is in the store.
        log: TaskLog,
    },
    /// What a lease took; comes before the attempt's outcome, or after the lease is over.
    Usage {
        /// The session.
        worker: WorkerId,
        /// Lease and its usage.
        usage: TaskUsage,
    },
    /// A worker has done a task; the artifacts are in the store.
    Completed {
        /// The session.
        worker: WorkerId,
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
        /// Result of the task.
        result: TaskResult,
    },
    /// A worker has done a task, and an artifact of its result is not in the store.
    ArtifactMissing {
        /// The session.
        worker: WorkerId,
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
        /// Digest of the artifact that is missing.
        artifact: Digest,
        /// Error of the store.
        message: String,
    },
    /// A worker has not done a task.
    Failed {
        /// The session.
        worker: WorkerId,
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
        /// Failure of the attempt.
        failure: Failure,
    },
    /// An artifact that somebody wanted is not in the store, or was damaged and is removed.
    Lost {
        /// Digest of the artifact.
        digest: Digest,
    },
    /// Everybody who is to be told of a job's end was told.
    Announced {
        /// The job.
        job: JobId,
        /// Time of the end.
        ended: Tick,
    },
    /// The calendar says that this is the month; usage is summed by month, and not at all before the first one is named.
    Month(Month),
    /// Time went by.
    Elapsed,
    /// The coordinator stood still for a while: heartbeats that renew leases, and registrations that bring leases along, may wait
    /// to be read.
    LoopStalled,
}

/// Something is to be done, in this order.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// Make this durable before any other command of the same call is executed.
    Record(Fact),
    /// Keep this with the job, as durable as the facts; nothing follows from it.
    Note(Box<AttemptRecord>),
    /// Tell a worker to do a task.
    Assign {
        /// The session.
        worker: WorkerId,
        /// The lease.
        assignment: Assignment,
    },
    /// Tell a worker to stop a task.
    Revoke {
        /// The session.
        worker: WorkerId,
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
        /// Reason for the revocation.
        reason: RevokeReason,
    },
    /// Tell a worker that its report counts.
    Accept {
        /// The session.
        worker: WorkerId,
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
    },
    /// Tell a worker that its report changed nothing.
    Refuse {
        /// The session.
        worker: WorkerId,
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
        /// Reason for the refusal.
        refusal: Refusal,
    },
    /// End the session of a worker that has begun another.
    Dismiss {
        /// The session.
        worker: WorkerId,
    },
    /// Answer a request.
    Answer {
        /// Number of the request.
        request: RequestId,
        /// The answer.
        answer: Result<Answer, Refusal>,
    },
    /// A job's status has changed.
    Changed(JobId),
    /// Something refers to these artifacts no longer: those to which nothing else does may go, see
    /// [`crate::Scheduler::unreferenced`].
    Discard(Vec<Digest>),
}

impl Command {
    /// Whether it says something to be kept, in the log or beside it: that comes before all others are executed.
    pub fn is_for_log(&self) -> bool {
        matches!(self, Self::Record(_) | Self::Note(_))
    }
}

/// What came of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// The job is in the queue, now or from before.
    Submitted(JobId),
    /// It was done to the job.
    Controlled(JobId),
}
