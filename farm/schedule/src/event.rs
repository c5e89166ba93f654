//! Events that the scheduler receives, and commands that it returns.

use femc_model::{
    Assignment, AttemptRecord, Control, Digest, Drain, Epoch, Failure, JobId, JobSpec, Month, Refusal, Registration,
    RevokeReason, TaskKey, TaskLog, TaskProgress, TaskResult, TaskUsage, Tick, WorkerId,
};

use crate::Fact;

/// Number of a request, by which its answer is returned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RequestId(pub u64);

/// An event.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// A job was submitted.
    Submitted {
        /// Number of the request, for the answer.
        request: RequestId,
        /// Key of the submission; a second submission with this key returns the same job, or is refused if its results would differ.
        key: Option<String>,
        /// Specification of the job.
        spec: Box<JobSpec>,
        /// Calendar date: Unix time in milliseconds; `None`: unknown.
        date: Option<u64>,
    },
    /// A person controls a job.
    Controlled {
        /// Number of the request, for the answer.
        request: RequestId,
        /// The job.
        job: JobId,
        /// Action on the job.
        control: Control,
    },
    /// A worker's session began. The caller numbers sessions. It uses a number again only after the end of the session that had it:
    /// after [`Event::Left`] or [`Command::Dismiss`], and when no other command for that session is pending.
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
    /// A worker accepts no more tasks.
    Draining {
        /// The session.
        worker: WorkerId,
    },
    /// A worker accepts tasks again.
    Available {
        /// The session.
        worker: WorkerId,
    },
    /// An operator drains a worker, or ends its drain.
    Drained {
        /// The session.
        worker: WorkerId,
        /// Whether the drain begins or ends.
        drain: Drain,
    },
    /// A worker reports the progress of its tasks.
    Heartbeat {
        /// The session.
        worker: WorkerId,
        /// Progress of its tasks.
        tasks: Vec<TaskProgress>,
    },
    /// A worker reports the log of an attempt, before the attempt's outcome.
    Logged {
        /// The session.
        worker: WorkerId,
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
        /// The log; its text is inline or already in the store.
        log: TaskLog,
    },
    /// A worker reports the usage of a lease, before the attempt's outcome or after the lease is over.
    Usage {
        /// The session.
        worker: WorkerId,
        /// Lease and its usage.
        usage: TaskUsage,
    },
    /// A worker has completed a task; the artifacts are in the store.
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
    /// A worker has completed a task, but an artifact of its result is not in the store.
    ArtifactMissing {
        /// The session.
        worker: WorkerId,
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
        /// Digest of the missing artifact.
        artifact: Digest,
        /// Error of the store.
        message: String,
    },
    /// A worker has failed at a task.
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
    /// A requested artifact is not in the store, or was damaged and has been removed.
    ArtifactLost {
        /// Digest of the artifact.
        digest: Digest,
    },
    /// The end of a job was announced to all recipients.
    Announced {
        /// The job.
        job: JobId,
        /// Time of the end.
        ended: Tick,
    },
    /// The present month by the calendar. Usage is summed by month, and only after the first of these events.
    Month(Month),
    /// Time has passed.
    Elapsed,
    /// The coordinator was stalled for a while: heartbeats that renew leases, and registrations with held leases, may still be
    /// unread.
    CoordinatorStalled,
}

/// An action for the caller. Commands are executed in their order.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// Make this durable before any other command of the same call is executed.
    Record(Fact),
    /// Store this record with the job, as durably as the facts; no state depends on it.
    RecordAttempt(Box<AttemptRecord>),
    /// Assign a task to a worker.
    Assign {
        /// The session.
        worker: WorkerId,
        /// The lease.
        assignment: Assignment,
    },
    /// Revoke a worker's lease of a task.
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
    /// Acknowledge a worker's report, which counts.
    Accept {
        /// The session.
        worker: WorkerId,
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
    },
    /// Refuse a worker's report, which changed nothing.
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
    /// End the session of a worker that has begun another one.
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
    JobChanged(JobId),
    /// These artifacts have lost a reference. Those without any other reference may be removed: see
    /// [`crate::Scheduler::unreferenced`].
    Discard(Vec<Digest>),
}

impl Command {
    /// Checks whether the command stores something in or beside the log. Such commands are executed before all others.
    pub fn is_for_log(&self) -> bool {
        matches!(self, Self::Record(_) | Self::RecordAttempt(_))
    }

    /// Returns the session that the command is for.
    pub fn worker(&self) -> Option<WorkerId> {
        match self {
            Self::Assign { worker, .. }
            | Self::Revoke { worker, .. }
            | Self::Accept { worker, .. }
            | Self::Refuse { worker, .. }
            | Self::Dismiss { worker } => Some(*worker),
            Self::Record(_) | Self::RecordAttempt(_) | Self::Answer { .. } | Self::JobChanged(_) | Self::Discard(_) => {
                None
            }
        }
    }
}

/// Answer to a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// The job is in the queue, newly or from an earlier submission.
    Submitted(JobId),
    /// The action on the job is done.
    Controlled(JobId),
}
