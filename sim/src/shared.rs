//! State outside of all hosts: disks, decisions of the seed, and observations.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use femc_model::{Digest, Epoch, JobId, TaskKey};
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};

use crate::audit::Violation;
use crate::charges::ChargeAudit;
use crate::disk::Disk;
use crate::faults::COORDINATORS;
use crate::history::History;
use crate::leases::Leases;
use crate::network::Reachability;
use crate::queues::WorkerQueues;
use crate::requests::RequestHistory;

/// Crash of the writing coordinator at a chosen write.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CrashPoint {
    /// Before the batch is on the disk.
    Before,
    /// When half of the batch is on the disk.
    Within,
    /// After the batch is on the disk, before any acknowledgement.
    After,
}

/// Clock of a machine.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct MachineClock {
    /// Milliseconds that the clock is ahead; negative if it is behind.
    pub(crate) ahead: i64,
    /// Thousandths that the clock is too fast; negative if it is too slow.
    pub(crate) drift: i64,
}

impl MachineClock {
    /// Returns the displayed time after `passed`.
    pub(crate) fn read(self, passed: Duration) -> Duration {
        // The clock does not begin at 0, so that it can jump back.
        const FIRST: i64 = 3_600_000;
        let passed = passed.as_millis() as i64;
        Duration::from_millis((FIRST + passed + passed * self.drift / 1000 + self.ahead).max(0) as u64)
    }
}

/// Results, each identified by its lease.
pub(crate) type ResultSet = BTreeSet<(TaskKey, Epoch)>;

/// State of a world that all hosts share or that outlives them.
#[derive(Debug)]
pub(crate) struct State {
    pub(crate) rng: SmallRng,
    pub(crate) disk: Disk,
    /// Number of the leading coordinator.
    pub(crate) leader: usize,
    /// Number of writes of the log until the planned crash.
    pub(crate) planned_crash: Option<(u32, CrashPoint)>,
    /// Coordinator that the planned crash has hit.
    pub(crate) crashed: Option<usize>,
    /// The coordinators' clocks.
    pub(crate) clocks: [MachineClock; COORDINATORS],
    /// Percentages of the workers' messages that arrive twice, and that arrive late.
    pub(crate) duplicated: u32,
    pub(crate) delayed: u32,
    /// Percentage of the workers' results that state a wrong size of an artifact.
    pub(crate) misstated: u32,
    /// Percentage of the workers' sessions that begin with a lease of another farm.
    pub(crate) foreign_leases: u32,
    /// Real sizes of the artifacts whose size was misstated.
    pub(crate) sizes: BTreeMap<Digest, u64>,
    /// Leases as observed between coordinators and workers.
    pub(crate) leases: Leases,
    /// Violations so far.
    pub(crate) violations: Vec<Violation>,
    /// Results that workers reported.
    pub(crate) reported: ResultSet,
    /// Results that a coordinator acknowledged.
    pub(crate) accepted: ResultSet,
    /// Number of times that each kind of fault took effect.
    pub(crate) fired: BTreeMap<&'static str, u32>,
    /// History according to the log.
    pub(crate) history: History,
    /// Requests of people and the answers to them.
    pub(crate) requests: RequestHistory,
    /// Counts of actions of people and of ends of jobs.
    pub(crate) counts: BTreeMap<&'static str, u64>,
    /// Number of people who wait for their jobs.
    pub(crate) waiting_people: usize,
    /// Number of messages about ended jobs that changed nothing.
    pub(crate) stale: u64,
    /// Charges of owners.
    pub(crate) charges: ChargeAudit,
    /// Queues of workers.
    pub(crate) queues: WorkerQueues,
    /// Worker on which all tasks fail while the others are dead.
    pub(crate) failing_worker: Option<usize>,
    /// Latest process of each worker.
    pub(crate) processes: BTreeMap<usize, u64>,
    /// Workers that a task has just killed.
    pub(crate) killed_workers: Vec<usize>,
    pub(crate) trace: blake3::Hasher,
    pub(crate) story: Option<Vec<String>>,
    pub(crate) boots: u64,
    /// Connection ends that the simulated network keeps, including refused and abandoned attempts.
    pub(crate) connection_ends: usize,
    pub(crate) reachability: Reachability,
    /// Artifacts that were damaged in the store.
    pub(crate) damaged: BTreeSet<Digest>,
    /// Frames of which an artifact was damaged.
    pub(crate) damaged_frames: BTreeSet<(JobId, u32)>,
}

/// Handle of a world's state. Clones share the state.
#[derive(Debug, Clone)]
pub(crate) struct Shared(Arc<Mutex<State>>);

impl Shared {
    pub(crate) fn new(seed: u64, keeps_story: bool) -> Self {
        Self(Arc::new(Mutex::new(State {
            rng: SmallRng::seed_from_u64(seed),
            disk: Disk::default(),
            leader: 0,
            planned_crash: None,
            crashed: None,
            clocks: [MachineClock::default(); COORDINATORS],
            duplicated: 0,
            delayed: 0,
            misstated: 0,
            foreign_leases: 0,
            sizes: BTreeMap::new(),
            leases: Leases::default(),
            violations: Vec::new(),
            reported: BTreeSet::new(),
            accepted: BTreeSet::new(),
            fired: BTreeMap::new(),
            history: History::default(),
            requests: RequestHistory::default(),
            counts: BTreeMap::new(),
            waiting_people: 0,
            stale: 0,
            charges: ChargeAudit::default(),
            queues: WorkerQueues::default(),
            failing_worker: None,
            processes: BTreeMap::new(),
            killed_workers: Vec::new(),
            trace: blake3::Hasher::new(),
            story: keeps_story.then(Vec::new),
            boots: 0,
            connection_ends: 0,
            reachability: Reachability::default(),
            damaged: BTreeSet::new(),
            damaged_frames: BTreeSet::new(),
        })))
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Draws a duration below `most`.
    pub(crate) fn draw_duration(&self, most: Duration) -> Duration {
        Duration::from_micros(self.lock().rng.random_range(0..most.as_micros().max(1) as u64))
    }

    /// Adds an event to the trace.
    pub(crate) fn trace(&self, event: impl FnOnce() -> String) {
        let now = turmoil::sim_elapsed().unwrap_or_default();
        self.lock().trace_event(now, &event());
    }
}

impl State {
    pub(crate) fn trace_event(&mut self, now: Duration, event: &str) {
        let line = format!("{:9.3} {event}", now.as_secs_f64());
        self.trace.update(line.as_bytes());
        if let Some(story) = &mut self.story {
            story.push(line);
        }
    }

    /// Counts an action.
    pub(crate) fn count_action(&mut self, action: &'static str) {
        *self.counts.entry(action).or_default() += 1;
    }

    pub(crate) fn count_fault(&mut self, fault: &'static str) {
        *self.fired.entry(fault).or_default() += 1;
    }

    /// Returns true with a probability of `percent`.
    pub(crate) fn draw_bool(&mut self, percent: u32) -> bool {
        self.rng.random_range(0..100) < percent
    }
}
