//! What goes wrong, and when: decided by the seed before the world begins.

use std::time::Duration;

use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};

/// Workers of a world.
pub(crate) const WORKERS: usize = 3;
/// Coordinators of a world; one leads.
pub(crate) const COORDINATORS: usize = 2;

/// Something that goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// A worker is killed, and started again later.
    WorkerDies(usize, Duration),
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
    /// Something that a frame in work needs is gone from the store.
    ArtefactLost,
    /// Bits of it flip.
    ArtefactDamaged,
    /// The coordinators' clocks jump ahead.
    ClockJumps(Duration),
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
}

impl Planned {
    /// The plan of a seed: up to eight faults within the first quarter of a minute.
    pub fn of(seed: u64) -> Self {
        let mut rng = SmallRng::seed_from_u64(seed ^ 0x5eed_f417);
        let count = rng.random_range(0..=8);
        let mut faults: Vec<(Duration, Fault)> =
            (0..count).map(|_| (Duration::from_millis(rng.random_range(100..15_000)), fault(&mut rng))).collect();
        faults.sort_by_key(|&(at, _)| at);
        let mut percent = |most: u32| if rng.random_range(0..2) == 0 { 0 } else { rng.random_range(0..most) };
        Self { faults, twice: percent(30), late: percent(20) }
    }
}

fn fault(rng: &mut SmallRng) -> Fault {
    let pause = Duration::from_millis(rng.random_range(50..12_000));
    let worker = rng.random_range(0..WORKERS);
    let few = rng.random_range(1..12);
    match rng.random_range(0..17) {
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
        14 => Fault::ArtefactLost,
        15 => Fault::ArtefactDamaged,
        _ => Fault::ClockJumps(pause),
    }
}
