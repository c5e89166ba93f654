//! Faults of a world and their times. The seed decides them before the world begins.

use std::time::Duration;

use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};

pub use crate::shelf::Harm;

/// A kind of fault that a farm may not survive yet. Worlds can leave it out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Hardship {
    /// Artifacts that are too short or too long, at rest or after a torn upload.
    Resized,
    /// Several uploads of one artifact at once.
    Senders,
    /// Tasks that kill their workers.
    Deadly,
    /// Loss of the log, after which an empty one begins.
    LogLost,
    /// A full disk that must not terminate a coordinator.
    FullLog,
}

impl Hardship {
    /// Hardships that the farm does not survive.
    const SPARED: &[Self] = &[];

    /// Checks whether worlds include the hardship.
    pub(crate) fn is_there(self) -> bool {
        !Self::SPARED.contains(&self)
    }
}

/// Number of workers of a world.
pub(crate) const WORKERS: usize = 3;
/// Number of coordinators of a world. One of them leads.
pub(crate) const COORDINATORS: usize = 2;

/// A fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// Crash of a worker, with a later restart.
    WorkerDies(usize, Duration),
    /// Crash of all workers but this one, on which every task fails. Later the others restart and this worker recovers.
    AloneAndSick(usize, Duration),
    /// Crash of the leading coordinator, with a later restart.
    CoordinatorDies(Duration),
    /// Crash of the coordinator in its n-th write from now on, before the batch is on the disk.
    DiesBeforeWrite(u32),
    /// Crash of the coordinator in its n-th write from now on, when half of the batch is on the disk.
    TornWrite(u32),
    /// Crash of the coordinator in its n-th write from now on, after the batch is on the disk and before any acknowledgement.
    DiesAfterWrite(u32),
    /// Change of the leader, while the previous leader continues as before.
    LeadChanges,
    /// Loss of all messages between a worker and the switch.
    WorkerCut(usize, Duration),
    /// Loss of all messages from a worker. The worker still receives messages.
    WorkerMute(usize, Duration),
    /// Loss of all messages between the coordinators and the switch.
    CoordinatorCut(Duration),
    /// Freeze of a worker: messages from it and to it are delayed.
    WorkerFreezes(usize, Duration),
    /// Freeze of the coordinators: messages between them and the switch are delayed.
    CoordinatorFreezes(Duration),
    /// Slow network: latency up to the first duration, for the second duration.
    Slow(Duration, Duration),
    /// Full disk: this number of writes of the log fail.
    LogFull(u32),
    /// Full store: it accepts nothing new.
    StoreFull(Duration),
    /// Unavailable store: it answers with errors only.
    StoreAway(Duration),
    /// Slow store: each operation takes up to the first duration longer, for the second duration.
    StoreSlow(Duration, Duration),
    /// Torn upload to the store, after a number of other uploads. The given thousandths of its bytes are kept.
    UploadTorn(u32, u64),
    /// Damage of an artifact that an unfinished frame needs.
    ArtifactHarmed(Harm),
    /// Damage of the scene of a job.
    SceneHarmed(Harm),
    /// Jump of the clock of a coordinator's machine by this number of milliseconds, forward or back.
    ClockJumps(usize, i64),
    /// Drift of the clock of a coordinator's machine: it is faster or slower by this number of thousandths.
    ClockDrifts(usize, i64),
    /// Loss of the log. The next coordinator begins an empty one.
    LogLost,
    /// Wrong bytes: one read of the store, after a number of other reads, returns bytes of another artifact.
    ReadsAnother(u32),
}

/// Planned faults of a world.
#[derive(Debug, Clone, Default)]
pub struct Planned {
    /// Faults, each with the time at which it begins.
    pub faults: Vec<(Duration, Fault)>,
    /// Percentage of the workers' messages that arrive twice.
    pub twice: u32,
    /// Percentage of the workers' messages that arrive late.
    pub late: u32,
    /// Percentage of the workers' results that state a wrong size of an artifact.
    pub misstated: u32,
    /// Percentage of the workers' sessions that begin with a lease of another farm.
    pub strays: u32,
}

impl Planned {
    /// Draws the plan of a seed: up to eight faults within the first 15 seconds, and in some worlds a loss of the log.
    pub fn of(seed: u64) -> Self {
        let mut plan = Self::storm(seed);
        if seed % 11 == 4 && Hardship::LogLost.is_there() {
            let at = Duration::from_millis(2_000 + seed * 7_919 % 9_000);
            plan.faults.push((at, Fault::LogLost));
            plan.faults.sort_by_key(|&(at, _)| at);
        }
        plan.add_sickness(seed);
        plan
    }

    /// Adds a lone worker on which all tasks fail, in every fifth world. A separate random sequence keeps the other worlds
    /// unchanged.
    fn add_sickness(&mut self, seed: u64) {
        let mut rng = SmallRng::seed_from_u64(seed ^ 0x5eed_51c4);
        if rng.random_range(0..5) > 0 {
            return;
        }
        let [at, pause] = [500..6_000, 8_000..20_000].map(|range| Duration::from_millis(rng.random_range(range)));
        self.faults.push((at, Fault::AloneAndSick(rng.random_range(0..WORKERS), pause)));
        self.faults.sort_by_key(|&(at, _)| at);
    }

    /// Draws a plan for a world that lasts long: its log is never lost.
    pub(crate) fn storm(seed: u64) -> Self {
        let mut rng = SmallRng::seed_from_u64(seed ^ 0x5eed_f417);
        let count = rng.random_range(0..=8);
        let mut faults: Vec<(Duration, Fault)> =
            (0..count).map(|_| (Duration::from_millis(rng.random_range(100..15_000)), fault(&mut rng))).collect();
        faults.sort_by_key(|&(at, _)| at);
        let mut percent = |most: u32| if rng.random_range(0..2) == 0 { 0 } else { rng.random_range(0..most) };
        let mut plan = Self { faults, twice: percent(30), late: percent(20), misstated: 0, strays: 0 };
        plan.add_lies(seed);
        plan
    }

    /// Adds wrong data in every third world: workers misstate sizes and bring leases of another farm, and the store returns wrong
    /// bytes. A separate random sequence keeps the other worlds unchanged.
    fn add_lies(&mut self, seed: u64) {
        let mut rng = SmallRng::seed_from_u64(seed ^ 0x5eed_11e5);
        if rng.random_range(0..3) > 0 {
            return;
        }
        self.misstated = rng.random_range(0..12);
        for _ in 0..rng.random_range(0..=3) {
            let at = Duration::from_millis(rng.random_range(100..15_000));
            self.faults.push((at, Fault::ReadsAnother(rng.random_range(0..30))));
        }
        self.strays = rng.random_range(0..80);
        self.faults.sort_by_key(|&(at, _)| at);
    }
}

fn fault(rng: &mut SmallRng) -> Fault {
    let pause = Duration::from_millis(rng.random_range(50..12_000));
    let worker = rng.random_range(0..WORKERS);
    let few = rng.random_range(1..12);
    let thousandths = rng.random_range(0..1000);
    let resized = |harm| if Hardship::Resized.is_there() { harm } else { Harm::Lost };
    match rng.random_range(0..25) {
        0 => Fault::WorkerDies(worker, pause),
        1 => Fault::CoordinatorDies(pause),
        2 => Fault::DiesBeforeWrite(few),
        3 => Fault::DiesAfterWrite(few),
        4 => Fault::LeadChanges,
        5 => Fault::WorkerCut(worker, pause),
        6 => Fault::WorkerMute(worker, pause),
        7 => Fault::CoordinatorCut(pause),
        8 => Fault::WorkerFreezes(worker, pause),
        9 => Fault::CoordinatorFreezes(pause),
        10 => Fault::Slow(pause / 8, pause),
        11 => Fault::LogFull(few.min(4)),
        12 => Fault::StoreFull(pause),
        13 => Fault::TornWrite(few),
        14 => Fault::ArtifactHarmed(Harm::Lost),
        15 => Fault::ArtifactHarmed(Harm::Flipped),
        16 => Fault::ArtifactHarmed(resized(Harm::Short(thousandths))),
        17 => Fault::ArtifactHarmed(resized(Harm::Long)),
        18 => Fault::ArtifactHarmed(Harm::Zeroed(thousandths)),
        19 if Hardship::Resized.is_there() => Fault::UploadTorn(8 * few, thousandths),
        20 => Fault::StoreAway(pause / 2),
        21 => Fault::StoreSlow(pause / 16, pause),
        22 => Fault::SceneHarmed(if few % 2 == 0 { Harm::Lost } else { resized(Harm::Short(thousandths)) }),
        23 => Fault::ClockDrifts(worker % COORDINATORS, thousandths as i64 / 10 - 50),
        _ => {
            let jump = pause.as_millis() as i64;
            Fault::ClockJumps(worker % COORDINATORS, if few % 2 == 0 { jump } else { -jump })
        }
    }
}
