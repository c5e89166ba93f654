//! What goes wrong, and when: decided by the seed before the world begins.

use std::time::Duration;

use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};

pub use crate::shelf::Harm;

/// Something that a farm may not survive yet: then worlds go without it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Hardship {
    /// Artifacts that are shorter or longer than they should be, at rest or after a torn upload.
    Resized,
    /// Several who send one thing at once.
    Senders,
    /// Tasks that kill their workers.
    Deadly,
    /// A log that is lost, so that another one begins.
    LogLost,
    /// A full disk that may end no coordinator.
    FullLog,
}

impl Hardship {
    /// Those that the farm does not survive.
    const SPARED: &[Self] = &[];

    /// Whether worlds have it.
    pub(crate) fn is_there(self) -> bool {
        !Self::SPARED.contains(&self)
    }
}

/// Workers of a world.
pub(crate) const WORKERS: usize = 3;
/// Coordinators of a world; one leads.
pub(crate) const COORDINATORS: usize = 2;

/// Something that goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// A worker is killed, and started again later.
    WorkerDies(usize, Duration),
    /// All workers but this one are killed, and on this one every task fails. Later the others are started again, and it is well.
    AloneAndSick(usize, Duration),
    /// The leading coordinator is killed, and started again later.
    CoordinatorDies(Duration),
    /// The coordinator is killed in its n-th write from now on, before the batch is on the disk.
    DiesBeforeWrite(u32),
    /// The same when half of the batch is on the disk.
    TornWrite(u32),
    /// The same after the batch is on the disk, before anybody hears of it.
    DiesAfterWrite(u32),
    /// The other coordinator takes the lead, while the one before goes on as if nothing had happened.
    LeadChanges,
    /// What a worker and the switch send each other is lost.
    WorkerCut(usize, Duration),
    /// What the worker sends is lost; it still hears.
    WorkerMute(usize, Duration),
    /// What the coordinators and the switch send each other is lost.
    CoordinatorCut(Duration),
    /// A worker stands still; what it sent and what was sent to it comes later.
    WorkerFreezes(usize, Duration),
    /// The coordinators stand still.
    CoordinatorFreezes(Duration),
    /// Messages take up to so long.
    Slow(Duration, Duration),
    /// So many writes of the log find no room.
    LogFull(u32),
    /// Nothing new finds room in the store.
    StoreFull(Duration),
    /// The store does not answer but with errors.
    StoreAway(Duration),
    /// The store takes up to so long for everything.
    StoreSlow(Duration, Duration),
    /// Something that is put into the store after so many others is torn at so many thousandths, and what is there of it stays.
    UploadTorn(u32, u64),
    /// Something happens to an artifact that a frame in work needs.
    ArtifactHarmed(Harm),
    /// The same to a scene of a job.
    SceneHarmed(Harm),
    /// The clock of a coordinator's machine jumps by so many milliseconds, ahead or back.
    ClockJumps(usize, i64),
    /// It goes faster or slower from now on, by so many thousandths.
    ClockDrifts(usize, i64),
    /// The log is gone, and the next coordinator begins one that knows of nothing.
    LogLost,
    /// A read of the store, after so many others, gets bytes of another artifact.
    ReadsAnother(u32),
}

/// A world's faults.
#[derive(Debug, Clone, Default)]
pub struct Planned {
    /// With the time at which each begins.
    pub faults: Vec<(Duration, Fault)>,
    /// Percentage of the workers' messages that come twice.
    pub twice: u32,
    /// Percentage of the workers' messages that come late.
    pub late: u32,
    /// Percentage of the workers' results that state another size of an artifact than it has.
    pub misstated: u32,
    /// Percentage of the workers' sessions that begin with a lease of another farm.
    pub strays: u32,
}

impl Planned {
    /// The plan of a seed: up to eight faults within the first quarter of a minute, and in some worlds the log is lost.
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

    /// In every fifth world one worker is alone for a while, and sick. Drawn apart, so that the other worlds stay as they are.
    fn add_sickness(&mut self, seed: u64) {
        let mut rng = SmallRng::seed_from_u64(seed ^ 0x5eed_51c4);
        if rng.random_range(0..5) > 0 {
            return;
        }
        let [at, pause] = [500..6_000, 8_000..20_000].map(|range| Duration::from_millis(rng.random_range(range)));
        self.faults.push((at, Fault::AloneAndSick(rng.random_range(0..WORKERS), pause)));
        self.faults.sort_by_key(|&(at, _)| at);
    }

    /// The same for a world that goes on: its log is never lost.
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

    /// In every third world workers lie about sizes and bring leases of another farm, and the store lies about bytes. Drawn apart:
    /// the other worlds are as they would be without.
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
