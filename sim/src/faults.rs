//! Faults of a world and their times. The seed decides them before the world begins.

use std::time::Duration;

use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};

pub use crate::faulty_medium::Damage;

/// A kind of fault that a farm may not survive yet. Worlds can leave it out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RiskyFault {
    /// Artifacts that are too short or too long, at rest or after a torn upload.
    Resized,
    /// Several uploads of one artifact at once.
    ConcurrentUploads,
    /// Tasks that kill their workers.
    WorkerKillers,
    /// Loss of the log, after which an empty one begins.
    LogLost,
    /// A full disk that must not terminate a coordinator.
    LogFull,
}

impl RiskyFault {
    /// Hardships that the farm does not survive.
    const DISABLED: &[Self] = &[];

    /// Checks whether worlds include the risky fault.
    pub(crate) fn is_enabled(self) -> bool {
        !Self::DISABLED.contains(&self)
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
    LoneWorkerFails(usize, Duration),
    /// Crash of the leading coordinator, with a later restart.
    CoordinatorDies(Duration),
    /// Crash of the coordinator in its n-th write from now on, before the batch is on the disk.
    DiesBeforeWrite(u32),
    /// Crash of the coordinator in its n-th write from now on, when half of the batch is on the disk.
    TornWrite(u32),
    /// Crash of the coordinator in its n-th write from now on, after the batch is on the disk and before any acknowledgement.
    DiesAfterWrite(u32),
    /// Change of the leader, while the previous leader continues as before.
    LeaderChanges,
    /// Loss of all messages between a worker and the switch.
    WorkerPartitioned(usize, Duration),
    /// Loss of all messages from a worker. The worker still receives messages.
    WorkerMute(usize, Duration),
    /// Loss of all messages between the coordinators and the switch.
    CoordinatorPartitioned(Duration),
    /// Freeze of a worker: messages from it and to it are delayed.
    WorkerFreezes(usize, Duration),
    /// Freeze of the coordinators: messages between them and the switch are delayed.
    CoordinatorFreezes(Duration),
    /// Slow network: latency up to the first duration, for the second duration.
    SlowNetwork(Duration, Duration),
    /// Full disk: this number of writes of the log fail.
    LogFull(u32),
    /// Full store: it accepts nothing new.
    StoreFull(Duration),
    /// Unavailable store: it answers with errors only.
    StoreUnavailable(Duration),
    /// Slow store: each operation takes up to the first duration longer, for the second duration.
    StoreSlow(Duration, Duration),
    /// Torn upload to the store, after a number of other uploads. The given thousandths of its bytes are kept.
    UploadTorn(u32, u64),
    /// Damage of an artifact that an unfinished frame needs.
    ArtifactDamaged(Damage),
    /// Damage of the scene of a job.
    SceneDamaged(Damage),
    /// Jump of the clock of a coordinator's machine by this number of milliseconds, forward or back.
    ClockJumps(usize, i64),
    /// Drift of the clock of a coordinator's machine: it is faster or slower by this number of thousandths.
    ClockDrifts(usize, i64),
    /// Loss of the log. The next coordinator begins an empty one.
    LogLost,
    /// Wrong bytes: one read of the store, after a number of other reads, returns bytes of another artifact.
    WrongRead(u32),
}

/// Planned faults of a world.
#[derive(Debug, Clone, Default)]
pub struct FaultPlan {
    /// Faults, each with the time at which it begins.
    pub faults: Vec<(Duration, Fault)>,
    /// Percentage of the workers' messages that arrive twice.
    pub duplicated: u32,
    /// Percentage of the workers' messages that arrive late.
    pub delayed: u32,
    /// Percentage of the workers' results that state a wrong size of an artifact.
    pub misstated: u32,
    /// Percentage of the workers' sessions that begin with a lease of another farm.
    pub foreign_leases: u32,
}

impl FaultPlan {
    /// Draws the plan of a seed: up to eight faults within the first 15 seconds, and in some worlds a loss of the log.
    pub fn from_seed(seed: u64) -> Self {
        let mut plan = Self::storm(seed);
        if seed % 11 == 4 && RiskyFault::LogLost.is_enabled() {
            let at = Duration::from_millis(2_000 + seed * 7_919 % 9_000);
            plan.faults.push((at, Fault::LogLost));
            plan.faults.sort_by_key(|&(at, _)| at);
        }
        plan.add_lone_failing_worker(seed);
        plan
    }

    /// Adds a lone worker on which all tasks fail, in every fifth world. A separate random sequence keeps the other worlds
    /// unchanged.
    fn add_lone_failing_worker(&mut self, seed: u64) {
        let mut rng = SmallRng::seed_from_u64(seed ^ 0x5eed_51c4);
        if rng.random_range(0..5) > 0 {
            return;
        }
        let [at, pause] = [500..6_000, 8_000..20_000].map(|range| Duration::from_millis(rng.random_range(range)));
        self.faults.push((at, Fault::LoneWorkerFails(rng.random_range(0..WORKERS), pause)));
        self.faults.sort_by_key(|&(at, _)| at);
    }

    /// Draws a plan for a world that lasts long: its log is never lost.
    pub(crate) fn storm(seed: u64) -> Self {
        let mut rng = SmallRng::seed_from_u64(seed ^ 0x5eed_f417);
        let count = rng.random_range(0..=8);
        let mut faults: Vec<(Duration, Fault)> =
            (0..count).map(|_| (Duration::from_millis(rng.random_range(100..15_000)), draw_fault(&mut rng))).collect();
        faults.sort_by_key(|&(at, _)| at);
        let mut percent = |most: u32| if rng.random_range(0..2) == 0 { 0 } else { rng.random_range(0..most) };
        let mut plan = Self { faults, duplicated: percent(30), delayed: percent(20), misstated: 0, foreign_leases: 0 };
        plan.add_wrong_data(seed);
        plan
    }

    /// Adds wrong data in every third world: workers misstate sizes and bring leases of another farm, and the store returns wrong
    /// bytes. A separate random sequence keeps the other worlds unchanged.
    fn add_wrong_data(&mut self, seed: u64) {
        let mut rng = SmallRng::seed_from_u64(seed ^ 0x5eed_11e5);
        if rng.random_range(0..3) > 0 {
            return;
        }
        self.misstated = rng.random_range(0..12);
        for _ in 0..rng.random_range(0..=3) {
            let at = Duration::from_millis(rng.random_range(100..15_000));
            self.faults.push((at, Fault::WrongRead(rng.random_range(0..30))));
        }
        self.foreign_leases = rng.random_range(0..80);
        self.faults.sort_by_key(|&(at, _)| at);
    }
}

fn draw_fault(rng: &mut SmallRng) -> Fault {
    let pause = Duration::from_millis(rng.random_range(50..12_000));
    let worker = rng.random_range(0..WORKERS);
    let few = rng.random_range(1..12);
    let thousandths = rng.random_range(0..1000);
    let resized = |harm| if RiskyFault::Resized.is_enabled() { harm } else { Damage::Lost };
    match rng.random_range(0..25) {
        0 => Fault::WorkerDies(worker, pause),
        1 => Fault::CoordinatorDies(pause),
        2 => Fault::DiesBeforeWrite(few),
        3 => Fault::DiesAfterWrite(few),
        4 => Fault::LeaderChanges,
        5 => Fault::WorkerPartitioned(worker, pause),
        6 => Fault::WorkerMute(worker, pause),
        7 => Fault::CoordinatorPartitioned(pause),
        8 => Fault::WorkerFreezes(worker, pause),
        9 => Fault::CoordinatorFreezes(pause),
        10 => Fault::SlowNetwork(pause / 8, pause),
        11 => Fault::LogFull(few.min(4)),
        12 => Fault::StoreFull(pause),
        13 => Fault::TornWrite(few),
        14 => Fault::ArtifactDamaged(Damage::Lost),
        15 => Fault::ArtifactDamaged(Damage::Flipped),
        16 => Fault::ArtifactDamaged(resized(Damage::Short(thousandths))),
        17 => Fault::ArtifactDamaged(resized(Damage::Long)),
        18 => Fault::ArtifactDamaged(Damage::Zeroed(thousandths)),
        19 if RiskyFault::Resized.is_enabled() => Fault::UploadTorn(8 * few, thousandths),
        20 => Fault::StoreUnavailable(pause / 2),
        21 => Fault::StoreSlow(pause / 16, pause),
        22 => Fault::SceneDamaged(if few % 2 == 0 { Damage::Lost } else { resized(Damage::Short(thousandths)) }),
        23 => Fault::ClockDrifts(worker % COORDINATORS, thousandths as i64 / 10 - 50),
        _ => {
            let jump = pause.as_millis() as i64;
            Fault::ClockJumps(worker % COORDINATORS, if few % 2 == 0 { jump } else { -jump })
        }
    }
}
