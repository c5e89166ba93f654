//! What stands outside of all hosts: disks, the will of the seed, and what was seen.

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

/// A crash of the writing coordinator at a chosen write.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Trap {
    /// Before the batch is on the disk.
    Before,
    /// When half of the batch is on the disk.
    Within,
    /// After that, before anybody hears of it.
    After,
}

/// A machine's clock.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Wall {
    /// Milliseconds that it is ahead, or behind.
    pub(crate) ahead: i64,
    /// Thousandths that it is too fast, or too slow.
    pub(crate) drift: i64,
}

impl Wall {
    /// What it shows when so much time has gone by.
    pub(crate) fn shows(self, passed: Duration) -> Duration {
        // It does not begin at 0, so that it can go back.
        const FIRST: i64 = 3_600_000;
        let passed = passed.as_millis() as i64;
        Duration::from_millis((FIRST + passed + passed * self.drift / 1000 + self.ahead).max(0) as u64)
    }
}

/// Results, each with its lease.
pub(crate) type Reports = BTreeSet<(TaskKey, Epoch)>;

/// What everybody can see or must not lose.
#[derive(Debug)]
pub(crate) struct State {
    pub(crate) rng: SmallRng,
    pub(crate) disk: Disk,
    /// The coordinator that leads.
    pub(crate) leader: usize,
    /// Writes of the log until the trap springs.
    pub(crate) trap: Option<(u32, Trap)>,
    /// The coordinator in which the trap sprang.
    pub(crate) sprung: Option<usize>,
    /// The coordinators' clocks.
    pub(crate) clocks: [Wall; COORDINATORS],
    /// Of a hundred messages of workers, how many come twice, and how many come late.
    pub(crate) twice: u32,
    pub(crate) late: u32,
    /// Of a hundred results of workers, how many state another size of an artifact than it has.
    pub(crate) misstated: u32,
    /// Of a hundred sessions of workers, how many begin with a lease of another farm.
    pub(crate) strays: u32,
    /// Sizes of the artifacts of which another one was stated.
    pub(crate) sizes: BTreeMap<Digest, u64>,
    /// Leases as seen on the way.
    pub(crate) leases: Leases,
    /// What was wrong when it was written.
    pub(crate) wrong: Vec<Violation>,
    /// Results that were reported.
    pub(crate) reported: Reports,
    /// Results that were acknowledged.
    pub(crate) accepted: Reports,
    /// How often each kind of fault has really come about.
    pub(crate) fired: BTreeMap<&'static str, u32>,
    /// History by the log.
    pub(crate) chronicle: Chronicle,
    /// What people asked for and were answered.
    pub(crate) answers: Answers,
    /// What people did, and how jobs ended.
    pub(crate) counts: BTreeMap<&'static str, u64>,
    /// People who wait for their jobs.
    pub(crate) left: usize,
    /// Messages that changed nothing, of jobs that ended.
    pub(crate) stale: u64,
    /// What owners are charged.
    pub(crate) shares: Shares,
    /// What waits at workers.
    pub(crate) queues: Queues,
    /// A worker on which all tasks fail, while the others are dead.
    pub(crate) sick: Option<usize>,
    /// The process of each worker that was started last.
    pub(crate) lives: BTreeMap<usize, u64>,
    /// Workers that a task has just killed.
    pub(crate) struck: Vec<usize>,
    pub(crate) trace: blake3::Hasher,
    pub(crate) story: Option<Vec<String>>,
    pub(crate) boots: u64,
    /// Ends of connections that the simulated network keeps, also of attempts that were refused or given up.
    pub(crate) ends: usize,
    pub(crate) reach: Reach,
    /// What something happened to in the store.
    pub(crate) harmed: BTreeSet<Digest>,
    /// Frames of which an artifact was lost.
    pub(crate) robbed: BTreeSet<(JobId, u32)>,
}

/// One world's state; clones share it.
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

    /// A duration below `most`.
    pub(crate) fn pause(&self, most: Duration) -> Duration {
        Duration::from_micros(self.lock().rng.random_range(0..most.as_micros().max(1) as u64))
    }

    /// Writes down what happened.
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

    /// Somebody did this.
    pub(crate) fn did(&mut self, what: &'static str) {
        *self.counts.entry(what).or_default() += 1;
    }

    pub(crate) fn fired(&mut self, fault: &'static str) {
        *self.fired.entry(fault).or_default() += 1;
    }

    /// True for `percent` of a hundred.
    pub(crate) fn chance(&mut self, percent: u32) -> bool {
        self.rng.random_range(0..100) < percent
    }
}
