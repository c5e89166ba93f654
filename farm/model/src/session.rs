//! Messages of a worker's session with the coordinator.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::{
    Assignment, Digest, Epoch, Failure, Intake, JobId, JobSpec, Refusal, ResourceUsage, TaskKey, TaskLog, TaskResult,
    WorkerId,
};

/// Registration of a worker.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Registration {
    /// Name for display, such as the machine's name.
    pub name: String,
    /// Random number, constant for the life of the worker's process. A second session with the same number replaces the first.
    pub instance: u64,
    /// Build of the engine. One build renders all frames of a job.
    pub engine: String,
    /// Number of render threads.
    pub threads: u32,
    /// Number of tasks that run in parallel. The coordinator leases at least one more task, and several more if tasks are short, so
    /// that the next task is there when one is done.
    pub slots: u32,
    /// Tags that the worker offers.
    pub tags: Vec<String>,
    /// Leases of an earlier session that the worker still works on, or whose results it still has.
    pub held: Vec<HeldLease>,
    /// Death of an earlier process of this worker, if it died. It is reported once.
    pub death: Option<Death>,
}

/// Report that a worker's process died while it computed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Death {
    /// [`Registration::instance`] of the process that died.
    pub instance: u64,
    /// Leases that the process computed, from the worker's journal.
    pub computing: Vec<HeldLease>,
}

impl Death {
    /// Maximum number of tasks that a process computes at a time.
    pub const MAX_TASKS: usize = 64;
}

/// Lease that a worker holds from an earlier session.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeldLease {
    /// The task.
    pub task: TaskKey,
    /// Epoch of the lease.
    pub epoch: Epoch,
    /// Steps that the lease covers: [`TaskSpec::steps`](crate::TaskSpec::steps).
    pub steps: Range<u32>,
    /// [`JobSpec::key`] of the job. It prevents confusion with a job of the same number from another farm.
    pub job: Digest,
}

/// Phase of a task on its worker, in the order of execution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Phase {
    /// Fetched ahead, not started.
    Waiting,
    /// Fetching inputs, and reading and preparing the scene.
    Preparing,
    /// Computing the result.
    Working,
    /// Sending the result to the store.
    Uploading,
}

/// Progress of a task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskProgress {
    /// The task.
    pub task: TaskKey,
    /// Epoch of the lease.
    pub epoch: Epoch,
    /// Phase of the attempt.
    pub phase: Phase,
    /// Units of work done, such as pixel samples. For a task that joins, the number of inputs read. Never decreases.
    pub units: u64,
}

/// A valid lease and its remaining time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeaseStatus {
    /// The task.
    pub task: TaskKey,
    /// Epoch of the lease.
    pub epoch: Epoch,
    /// Milliseconds until the lease expires, unless it is renewed.
    pub remaining: u64,
}

/// Resources that a lease used.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TaskUsage {
    /// The task.
    pub task: TaskKey,
    /// Epoch of the lease.
    pub epoch: Epoch,
    /// Resources used.
    pub usage: ResourceUsage,
}

/// Message from a worker to the coordinator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum FromWorker {
    /// The first message of a session.
    Register(Registration),
    /// Signals that the worker is alive, and reports the progress of its tasks.
    Heartbeat {
        /// Number of the heartbeat in this session, from 1. The answer repeats it.
        number: u64,
        /// Tasks whose leases are valid, as far as the worker knows.
        tasks: Vec<TaskProgress>,
        /// Resources used by leases that were revoked since the previous heartbeat.
        usage: Vec<TaskUsage>,
    },
    /// The result is in the store.
    Completed {
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
        /// Result of the task.
        result: TaskResult,
        /// Log of the attempt.
        log: Option<TaskLog>,
        /// Resources used.
        usage: Option<ResourceUsage>,
    },
    /// The task failed.
    Failed {
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
        /// Failure of the attempt.
        failure: Failure,
        /// Log of the attempt.
        log: Option<TaskLog>,
        /// Resources used.
        usage: Option<ResourceUsage>,
    },
    /// The worker wants no more tasks: it is leaving or off duty.
    Draining,
    /// The worker accepts tasks again.
    Available,
}

/// Reason why a lease is revoked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum RevokeReason {
    /// The job was cancelled or has failed.
    JobEnded,
    /// The lease expired.
    Expired,
    /// Another worker finished the task.
    Done,
}

/// Message from the coordinator to a worker.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum ToWorker {
    /// The worker is registered.
    Welcome {
        /// Number of the worker.
        worker: WorkerId,
        /// Milliseconds between heartbeats.
        heartbeat: u64,
        /// Milliseconds for which a lease is valid after a heartbeat.
        lease: u64,
    },
    /// Answer to a heartbeat. An assignment that arrives after it was made after the heartbeat was sent.
    Renewed {
        /// Number of the heartbeat.
        heartbeat: u64,
        /// All leases of this session, with their remaining time when the answer was sent.
        leases: Vec<LeaseStatus>,
        /// Intake that the coordinator grants. A drained worker gives back the tasks that it has not started.
        intake: Intake,
    },
    /// Specification of a job. It is sent before the first assignment of the job.
    Job {
        /// The job.
        job: JobId,
        /// Specification of the job, as submitted.
        spec: Box<JobSpec>,
    },
    /// Assigns a task.
    Assign(Assignment),
    /// Stops a task. No answer is expected.
    Revoke {
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
        /// Reason for the revocation.
        reason: RevokeReason,
    },
    /// The completion is durable.
    Accepted {
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
    },
    /// The completion or failure changed nothing.
    Refused {
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
        /// Reason for the refusal.
        refusal: Refusal,
    },
    /// The coordinator stops. The worker reconnects later.
    Goodbye,
}
