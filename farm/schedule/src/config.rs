//! Durations and limits of the scheduler.

use std::collections::BTreeMap;
use std::num::NonZeroU64;

/// Configuration of the scheduler. Durations are in milliseconds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Config {
    /// Duration of a lease after its last renewal.
    pub lease: u64,
    /// Interval of the workers' heartbeats; several fit into a lease.
    pub heartbeat: u64,
    /// A task without progress for this long is no longer renewed.
    pub stall: u64,
    /// Like `stall`, while a scene is prepared, which shows no progress.
    pub preparation_stall: u64,
    /// First rest of a worker after an infrastructure failure; it doubles with every further failure. It is also the first pause of
    /// a worker that is quarantined for a job while no other worker can take the job's tasks.
    pub back_off: u64,
    /// Maximum duration of this rest or pause.
    pub max_back_off: u64,
    /// After a restart with unfinished jobs, nothing is dispatched for this long. Workers that kept running reconnect with the
    /// tasks that they still work on, and these must not be given to others.
    pub regroup: u64,
    /// A worker on which three tasks of a job have failed in a row gets no task of that job for this long, then one task as a
    /// probe. The time doubles with every failed probe.
    pub quarantine: u64,
    /// Maximum duration of this quarantine.
    pub max_quarantine: u64,
    /// Number of tasks that a worker holds beyond its running ones: one that it can begin immediately, and one whose result is
    /// being uploaded and counts as held until it is durable.
    pub prefetch: u32,
    /// Milliseconds of work that may wait at a worker before a second task waits there, too.
    pub queue: u64,
    /// Milliseconds of work that may wait at a worker beyond `prefetch`, in at most [`Config::MAX_AHEAD`] tasks. Such a queue of
    /// short tasks hides the network's latency.
    pub ahead: u64,
    /// Intended duration of a lease, if a task can be divided.
    pub work_per_lease: u64,
    /// Minimum intended duration of a lease when there is not enough work for all workers.
    pub min_work_per_lease: u64,
    /// A task that takes longer than this, and more than twice as long as expected, may also be leased to a second, idle worker.
    pub late: u64,
    /// Units of work in a sample chunk: tasks are not divided below this size. It applies to jobs submitted from now on.
    pub chunk_size: NonZeroU64,
    /// A worker that disappeared during a task and has not come back for this long is presumed dead. The time is longer than a
    /// living worker needs to notice the broken connection and to reconnect.
    pub presume_dead_after: u64,
    /// A frame restarts when no worker of its engine build has been present for this long, and workers of other builds are.
    pub orphaned_after: u64,
    /// Size limit in bytes for shared jobs, finished or not, that no job needs any more and that are kept for future jobs. Each of
    /// them counts [`Config::SHARED_OVERHEAD`] in addition to its own bytes, so their number is limited, too.
    pub shared_bytes: u64,
    /// Ended jobs expire after this time; `None`: never.
    pub keep_ended: Option<u64>,
    /// Weights of owners in the fair share of time; the default weight is 1.
    pub weights: BTreeMap<String, u32>,
    /// Limits for the unfinished jobs of one owner.
    pub quota: Quota,
    /// Unix time in milliseconds at which the farm's clock would have been 0 if it had never stopped; `None`: unknown.
    pub clock_zero: Option<u64>,
}

/// Limits for the sums over one owner's jobs that have not ended. A job beyond a limit is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quota {
    /// Maximum number of jobs: 10 000.
    pub jobs: u64,
    /// Maximum number of frames, each of which needs memory once it has begun: 2^22.
    pub frames: u64,
    /// Maximum number of tasks in all frames and rounds: 2^32.
    pub tasks: u64,
}

impl Default for Quota {
    fn default() -> Self {
        Self { jobs: 10_000, frames: 1 << 22, tasks: 1 << 32 }
    }
}

impl Config {
    /// Maximum number of tasks that a worker holds beyond `prefetch`.
    pub const MAX_AHEAD: usize = 64;

    /// Bytes that each shared job counts in `shared_bytes` for its entry in the ledger.
    pub const SHARED_OVERHEAD: u64 = 64 << 10;

    /// Default number of pixel samples in a sample chunk: some tenths of a second of one processor, or seconds where light is hard
    /// to find.
    pub const CHUNK_SIZE: NonZeroU64 = NonZeroU64::new(1 << 15).unwrap();

    /// Number of heartbeats in a lease.
    const HEARTBEATS_PER_LEASE: u64 = 10;

    /// Returns the default configuration with leases of `lease` milliseconds and matching heartbeats.
    pub fn with_lease(lease: u64) -> Self {
        Self { lease, heartbeat: lease / Self::HEARTBEATS_PER_LEASE, ..Self::default() }
    }

    /// Returns an owner's weight.
    pub fn weight(&self, owner: &str) -> u32 {
        self.weights.get(owner).copied().unwrap_or(1)
    }
}

impl Default for Config {
    fn default() -> Self {
        Self {
            lease: 4_500,
            heartbeat: 500,
            stall: 120_000,
            preparation_stall: 900_000,
            back_off: 1_000,
            max_back_off: 60_000,
            regroup: 500,
            quarantine: 60_000,
            max_quarantine: 3_600_000,
            prefetch: 2,
            queue: 2_000,
            ahead: 200,
            work_per_lease: 8_000,
            min_work_per_lease: 1_500,
            late: 2_000,
            chunk_size: Self::CHUNK_SIZE,
            presume_dead_after: 15_000,
            orphaned_after: 60_000,
            shared_bytes: 16 << 30,
            keep_ended: None,
            weights: BTreeMap::new(),
            quota: Quota::default(),
            clock_zero: None,
        }
    }
}
