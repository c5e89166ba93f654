//! State outside of all hosts: disks, decisions of the seed, and observations.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use femc_model::{Digest, Epoch, JobId, TaskKey};
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};

use crate::audit::Violation;
use crate::chronicle::Chronicle;
use crate::disk::Disk;
use crate::faults::COORDINATORS;
use crate::leases::Leases;
use crate::network::Reach;
use crate::promises::Answers;
use crate::queues::Queues;
use crate::shares::Shares;

/// Crash of the writing coordinator at a chosen write.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Trap {
    /// Before the batch is on the disk.
    Before,
    /// When half of the batch is on the disk.
    Within,
    /// After the batch is on the disk, before any acknowledgement.
    After,
}

/// Clock of a machine.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Wall {
    /// Milliseconds that the clock is ahead; negative if it is behind.
    pub(crate) ahead: i64,
    /// Thousandths that the clock is too fast; negative if it is too slow.
    pub(crate) drift: i64,
}

impl Wall {
    /// Returns the displayed time after `passed`.
    pub(crate) fn shows(self, passed: Duration) -> Duration {
        // The clock does not begin at 0, so that it can jump back.
        const FIRST: i64 = 3_600_000;
        let passed = passed.as_millis() as i64;
        Duration::from_millis((FIRST + passed + passed * self.drift / 1000 + self.ahead).max(0) as u64)
    }
}

/// Results, each identified by its lease.
pub(crate) type Reports = BTreeSet<(TaskKey, Epoch)>;

/// State of a world that all hosts share or that outlives them.
#[derive(Debug)]
pub(crate) struct State {
    pub(crate) rng: SmallRng,
    pub(crate) disk: Disk,
    /// Number of the leading coordinator.
    pub(crate) leader: usize,
    /// Number of writes of the log until the planned crash.
    pub(crate) trap: Option<(u32, Trap)>,
    /// Coordinator that the planned crash has hit.
    pub(crate) sprung: Option<usize>,
    /// The coordinators' clocks.
    pub(crate) clocks: [Wall; COORDINATORS],
    /// Percentages of the workers' messages that arrive twice, and that arrive late.
    pub(crate) twice: u32,
    pub(crate) late: u32,
    /// Percentage of the workers' results that state a wrong size of an artifact.
    pub(crate) misstated: u32,
    /// Percentage of the workers' sessions that begin with a lease of another farm.
    pub(crate) strays: u32,
    /// Real sizes of the artifacts whose size was misstated.
    pub(crate) sizes: BTreeMap<Digest, u64>,
    /// Leases as observed between coordinators and workers.
    pub(crate) leases: Leases,
    /// Violations so far.
    pub(crate) wrong: Vec<Violation>,
    /// Results that workers reported.
    pub(crate) reported: Reports,
    /// Results that a coordinator acknowledged.
    pub(crate) accepted: Reports,
    /// Number of times that each kind of fault took effect.
    pub(crate) fired: BTreeMap<&'static str, u32>,
    /// History according to the log.
    pub(crate) chronicle: Chronicle,
    /// Requests of people and the answers to them.
    pub(crate) answers: Answers,
    /// Counts of actions of people and of ends of jobs.
    pub(crate) counts: BTreeMap<&'static str, u64>,
    /// Number of people who wait for their jobs.
    pub(crate) left: usize,
    /// Number of messages about ended jobs that changed nothing.
    pub(crate) stale: u64,
    /// Charges of owners.
    pub(crate) shares: Shares,
    /// Queues of workers.
    pub(crate) queues: Queues,
    /// Worker on which all tasks fail while the others are dead.
    pub(crate) sick: Option<usize>,
    /// Latest process of each worker.
    pub(crate) lives: BTreeMap<usize, u64>,
    /// Workers that a task has just killed.
    pub(crate) struck: Vec<usize>,
    pub(crate) trace: blake3::Hasher,
    pub(crate) story: Option<Vec<String>>,
    pub(crate) boots: u64,
    /// Connection ends that the simulated network keeps, including refused and abandoned attempts.
    pub(crate) ends: usize,
    pub(crate) reach: Reach,
    /// Artifacts that were damaged in the store.
    pub(crate) harmed: BTreeSet<Digest>,
    /// Frames of which an artifact was damaged.
    pub(crate) robbed: BTreeSet<(JobId, u32)>,
}

/// Handle of a world's state. Clones share the state.
#[derive(Debug, Clone)]
pub(crate) struct Shared(Arc<Mutex<State>>);

impl Shared {
    pub(crate) fn new(seed: u64, tells: bool) -> Self {
        Self(Arc::new(Mutex::new(State {
            rng: SmallRng::seed_from_u64(seed),
            disk: Disk::default(),
            leader: 0,
            trap: None,
            sprung: None,
            clocks: [Wall::default(); COORDINATORS],
            twice: 0,
            late: 0,
            misstated: 0,
            strays: 0,
            sizes: BTreeMap::new(),
            leases: Leases::default(),
            wrong: Vec::new(),
            reported: BTreeSet::new(),
            accepted: BTreeSet::new(),
            fired: BTreeMap::new(),
            chronicle: Chronicle::default(),
            answers: Answers::default(),
            counts: BTreeMap::new(),
            left: 0,
            stale: 0,
            shares: Shares::default(),
            queues: Queues::default(),
            sick: None,
            lives: BTreeMap::new(),
            struck: Vec::new(),
            trace: blake3::Hasher::new(),
            story: tells.then(Vec::new),
            boots: 0,
            ends: 0,
            reach: Reach::default(),
            harmed: BTreeSet::new(),
            robbed: BTreeSet::new(),
        })))
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Draws a duration below `most`.
    pub(crate) fn pause(&self, most: Duration) -> Duration {
        Duration::from_micros(self.lock().rng.random_range(0..most.as_micros().max(1) as u64))
    }

    /// Adds an event to the trace.
    pub(crate) fn note(&self, what: impl FnOnce() -> String) {
        let now = turmoil::sim_elapsed().unwrap_or_default();
        self.lock().note(now, &what());
    }
}

impl State {
    pub(crate) fn note(&mut self, now: Duration, what: &str) {
        let line = format!("{:9.3} {what}", now.as_secs_f64());
        self.trace.update(line.as_bytes());
        if let Some(story) = &mut self.story {
            story.push(line);
        }
    }

    /// Counts an action.
    pub(crate) fn did(&mut self, what: &'static str) {
        *self.counts.entry(what).or_default() += 1;
    }

    pub(crate) fn fired(&mut self, fault: &'static str) {
        *self.fired.entry(fault).or_default() += 1;
    }

    /// Returns true with a probability of `percent`.
    pub(crate) fn chance(&mut self, percent: u32) -> bool {
        self.rng.random_range(0..100) < percent
    }
}
