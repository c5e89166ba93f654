//! The words of a worker's session with the coordinator.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::{
    Assignment, Digest, Epoch, Failure, Intake, JobId, JobSpec, Refusal, TaskKey, TaskLog, TaskResult, Usage, WorkerId,
};

/// How a worker introduces itself.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Registration {
    /// Name for people, such as the machine's.
    pub name: String,
    /// Random, the same for the life of the worker's process: a second session replaces the first.
    pub instance: u64,
    /// Build of the engine; the frames of a job are rendered by one build only.
    pub engine: String,
    /// Threads that render.
    pub threads: u32,
    /// Tasks that run side by side. At least one more is leased, and more of short tasks, so that the next is there when one is done.
    pub slots: u32,
    /// Tags that the worker offers.
    pub tags: Vec<String>,
    /// Leases of an earlier session that it still works on, or whose results it still has.
    pub held: Vec<HeldLease>,
    /// How an earlier process of this worker ended, if it died; told once.
    pub died: Option<Death>,
}

/// A worker's process died while it computed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Death {
    /// [`Registration::instance`] of that process.
    pub instance: u64,
    /// What it computed, by the worker's own journal.
    pub computing: Vec<HeldLease>,
}

impl Death {
    /// Most tasks that a process computes at a time.
    pub const MOST: usize = 64;
}

/// A lease that a worker brings along from an earlier session.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeldLease {
    /// The task.
    pub task: TaskKey,
    /// Epoch of the lease.
    pub epoch: Epoch,
    /// The steps that it covers: [`Work::steps`](crate::Work::steps).
    pub steps: Range<u32>,
    /// [`JobSpec::key`] of the job, so that the task of another farm's job of the same number is not taken for this one.
    pub job: Digest,
}

/// What the worker is doing for a task; ascending in the order of execution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Phase {
    /// Fetched ahead, not begun.
    Waiting,
    /// Fetching inputs, reading and preparing the scene.
    Preparing,
    /// Computing the result.
    Working,
    /// Sending the result to the store.
    Uploading,
}

/// How far a task is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskProgress {
    /// The task.
    pub task: TaskKey,
    /// Epoch of the lease.
    pub epoch: Epoch,
    /// Phase of the attempt.
    pub phase: Phase,
    /// Units of work done, such as pixel samples; of a task that joins, inputs that are in. Only grows.
    pub units: u64,
}

/// A lease that holds, and for how long.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeaseLeft {
    /// The task.
    pub task: TaskKey,
    /// Epoch of the lease.
    pub epoch: Epoch,
    /// Milliseconds until it ends, unless it is renewed.
    pub left: u64,
}

/// What went into a lease.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TaskUsage {
    /// The task.
    pub task: TaskKey,
    /// Epoch of the lease.
    pub epoch: Epoch,
    /// Usage of the lease.
    pub usage: Usage,
}

/// From a worker to the coordinator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum FromWorker {
    /// The first message of a session.
    Register(Registration),
    /// I am here, and so far are my tasks.
    Heartbeat {
        /// Of this session, from 1; the answer names it.
        number: u64,
        /// The tasks whose leases hold, as far as the worker knows.
        tasks: Vec<TaskProgress>,
        /// What went into leases that were taken back since the heartbeat before.
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
        /// Usage of the lease.
        usage: Option<Usage>,
    },
    /// The task is not done.
    Failed {
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
        /// Failure of the attempt.
        failure: Failure,
        /// Log of the attempt.
        log: Option<TaskLog>,
        /// Usage of the lease.
        usage: Option<Usage>,
    },
    /// Give me no more tasks: I am leaving, or off duty.
    Draining,
    /// I take tasks again.
    Available,
}

/// Why a lease is taken back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum RevokeReason {
    /// The job was cancelled or has failed.
    JobEnded,
    /// The lease ran out.
    Expired,
    /// Another worker has done the task.
    Done,
}

/// From the coordinator to a worker.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum ToWorker {
    /// Registered.
    Welcome {
        /// Name of this session.
        worker: WorkerId,
        /// Milliseconds between heartbeats.
        heartbeat: u64,
        /// Milliseconds for which a lease holds after a heartbeat.
        lease: u64,
    },
    /// The answer to a heartbeat. An assignment that comes after it was made after the heartbeat was sent.
    Renewed {
        /// The heartbeat's number.
        heartbeat: u64,
        /// All leases of this session, with the time left when this was said.
        leases: Vec<LeaseLeft>,
        /// Intake that the coordinator grants: a worker that is drained gives back what it has not begun.
        intake: Intake,
    },
    /// What a job is; comes before the first assignment of it.
    Job {
        /// The job.
        job: JobId,
        /// Specification of the job, as submitted.
        spec: Box<JobSpec>,
    },
    /// Do this.
    Assign(Assignment),
    /// Stop this; no answer is expected.
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
    /// The coordinator stops; come again later.
    Goodbye,
}
