//! The scheduler's times and limits.

use std::collections::BTreeMap;
use std::num::NonZeroU64;

/// Times in milliseconds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Config {
    /// A lease ends so long after its last renewal.
    pub lease: u64,
    /// Workers are asked to send heartbeats so often; several fit into a lease.
    pub heartbeat: u64,
    /// A task that shows no progress for so long is not renewed any more.
    pub stall: u64,
    /// The same while a scene is prepared, which shows no progress.
    pub preparation_stall: u64,
    /// First rest of a worker after a failure of its surroundings; it doubles from failure to failure. Also the first pause of a
    /// worker that is quarantined for a job while no other can take the job's tasks.
    pub rest: u64,
    /// Longest such rest or pause.
    pub longest_rest: u64,
    /// After a restart with unfinished jobs nothing is dealt for so long: workers that have lived on come back with what they
    /// still work on, and that shall not be given to others.
    pub regroup: u64,
    /// A worker on which three tasks of a job have failed in a row gets no more of that job for so long, then one task as a
    /// probe; it doubles from probe to failed probe.
    pub quarantine: u64,
    /// Longest such time.
    pub longest_quarantine: u64,
    /// Tasks that a worker holds beyond those that it runs: one that it can begin at once, and one whose result is on its
    /// way and counts as held until it is durable.
    pub prefetch: u32,
    /// Milliseconds of work that may wait at a worker before a second task waits there, too.
    pub queue: u64,
    /// Milliseconds of work that may wait at a worker beyond `prefetch`, in at most [`Config::DEEPEST`] tasks: so many short tasks
    /// hide the network's latency.
    pub ahead: u64,
    /// A lease is meant to take so long, where a task can be cut.
    pub task: u64,
    /// And so long at least, where there is too little for everybody.
    pub least_task: u64,
    /// A task that takes longer than this, and twice as long as expected, may be given to a second worker that is idle.
    pub late: u64,
    /// Units of work of a task below which it is not cut; of jobs that are submitted from now on.
    pub grain: NonZeroU64,
    /// A worker that was gone in mid-task and has not come back for so long is taken for dead: longer than one that lives takes
    /// to notice and to try again.
    pub presumed: u64,
    /// A frame begins anew when no worker of its build of the engine has been there for so long, and others are.
    pub orphaned: u64,
    /// Most bytes of what is begun or done for contents that no job needs any more, and that is kept for jobs to come; each content
    /// counts [`Config::SHARED_OVERHEAD`] beside its own, so their number is bounded, too.
    pub shared_bytes: u64,
    /// A job that ended so long ago is forgotten; `None`: never.
    pub keep_ended: Option<u64>,
    /// Weights of owners in the fair share of time; who is not named has 1.
    pub weights: BTreeMap<String, u32>,
    /// What one owner may have waiting.
    pub quota: Quota,
    /// Unix time, in milliseconds, at which the farm's clock would have begun at 0, had it never stood still; `None`: not known.
    pub clock_zero: Option<u64>,
}

/// What the jobs of one owner that have not ended may add up to; a job beyond is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quota {
    /// Jobs: 10 000.
    pub jobs: u64,
    /// Their frames, which have memory each once they are begun: 2^22.
    pub frames: u64,
    /// Their tasks in all frames and rounds: 2^32.
    pub tasks: u64,
}

impl Default for Quota {
    fn default() -> Self {
        Self { jobs: 10_000, frames: 1 << 22, tasks: 1 << 32 }
    }
}

impl Config {
    /// Most tasks that a worker holds beyond `prefetch`.
    pub const DEEPEST: usize = 64;

    /// Bytes that each content counts in `shared_bytes` for what the ledger keeps of it.
    pub const SHARED_OVERHEAD: u64 = 64 << 10;

    /// Pixel samples of a grain: some tenths of a second of one processor, seconds where light is hard to find.
    pub const GRAIN: NonZeroU64 = NonZeroU64::new(1 << 15).unwrap();

    /// Heartbeats in a lease.
    const HEARTBEATS: u64 = 10;

    /// Leases of so many milliseconds and heartbeats to match.
    pub fn with_lease(lease: u64) -> Self {
        Self { lease, heartbeat: lease / Self::HEARTBEATS, ..Self::default() }
    }

    /// An owner's weight.
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
            rest: 1_000,
            longest_rest: 60_000,
            regroup: 500,
            quarantine: 60_000,
            longest_quarantine: 3_600_000,
            prefetch: 2,
            queue: 2_000,
            ahead: 200,
            task: 8_000,
            least_task: 1_500,
            late: 2_000,
            grain: Self::GRAIN,
            presumed: 15_000,
            orphaned: 60_000,
            shared_bytes: 16 << 30,
            keep_ended: None,
            weights: BTreeMap::new(),
            quota: Quota::default(),
            clock_zero: None,
        }
    }
}
