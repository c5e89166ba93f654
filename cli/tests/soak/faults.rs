//! Random faults, derived from a seed.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use crate::common::proxy::{Direction, Proxy};
use crate::farm::{Farm, WORKERS};

/// Random numbers from a seed: SplitMix64.
pub struct Rng(pub u64);

impl Rng {
    /// Returns a number below `most`.
    pub fn below(&mut self, most: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed ^ (mixed >> 31)) % most
    }

    /// Returns a duration from `least` to `most` milliseconds.
    fn random_duration(&mut self, least: u64, most: u64) -> Duration {
        Duration::from_millis(least + self.below(most - least))
    }
}

#[derive(Debug, Clone, Copy)]
enum Fault {
    WorkerKilled(usize),
    WorkerStopped(usize),
    CoordinatorKilled(usize),
    CoordinatorStopped(usize),
    LinkCut(usize),
    LinkFrozen(usize),
    LinkFrozenOneWay(usize, Direction),
}
use Fault::*;

impl Fault {
    fn random(draw: &mut Rng, coordinators: usize) -> Self {
        let worker = draw.below(WORKERS as u64) as usize;
        let coordinator = worker % coordinators;
        match draw.below(12) {
            0..3 => WorkerKilled(worker),
            3..5 => WorkerStopped(worker),
            5 => CoordinatorKilled(coordinator),
            6 => CoordinatorStopped(coordinator),
            7..9 => LinkCut(worker),
            9 => LinkFrozen(worker),
            10 => LinkFrozenOneWay(worker, Direction::Up),
            _ => LinkFrozenOneWay(worker, Direction::Down),
        }
    }

    fn name(self) -> &'static str {
        match self {
            WorkerKilled(_) => "worker killed",
            WorkerStopped(_) => "worker stopped",
            CoordinatorKilled(_) => "coordinator killed",
            CoordinatorStopped(_) => "coordinator stopped",
            LinkCut(_) => "link cut",
            LinkFrozen(_) => "link frozen",
            LinkFrozenOneWay(_, Direction::Up) => "link frozen upwards",
            LinkFrozenOneWay(_, Direction::Down) => "link frozen downwards",
        }
    }

    /// Begins the fault. Returns whether it took effect.
    fn begin(self, farm: &Farm) -> bool {
        match self {
            WorkerKilled(worker) => farm.workers[worker].kill(),
            WorkerStopped(worker) => farm.workers[worker].stop(),
            CoordinatorKilled(coordinator) => farm.coordinators[coordinator].kill(),
            CoordinatorStopped(coordinator) => farm.coordinators[coordinator].stop(),
            LinkCut(worker) => always(|| farm.proxies[worker].iter().for_each(Proxy::cut)),
            LinkFrozen(worker) => always(|| farm.proxies[worker].iter().for_each(Proxy::freeze)),
            LinkFrozenOneWay(worker, way) => {
                always(|| farm.proxies[worker].iter().for_each(|proxy| proxy.freeze_direction(way)))
            }
        }
    }

    fn end(self, farm: &Farm) {
        match self {
            WorkerKilled(worker) => farm.workers[worker].start(&farm.dir),
            WorkerStopped(worker) => farm.workers[worker].resume(),
            CoordinatorKilled(coordinator) => farm.coordinators[coordinator].start(&farm.dir),
            CoordinatorStopped(coordinator) => farm.coordinators[coordinator].resume(),
            LinkCut(_) => {}
            LinkFrozen(worker) | LinkFrozenOneWay(worker, _) => farm.proxies[worker].iter().for_each(Proxy::thaw),
        }
    }
}

fn always(action: impl FnOnce()) -> bool {
    action();
    true
}

/// Produces faults until `end`, each for some seconds and often several at the same time, then repairs everything. Returns the
/// number of faults by kind.
pub fn inject_faults(farm: &Farm, seed: u64, end: Instant) -> BTreeMap<&'static str, u64> {
    let mut rng = Rng(seed);
    let (mut fired, mut under_way) = (BTreeMap::new(), Vec::<(Instant, Fault)>::new());
    let mut next = Instant::now() + rng.random_duration(1_000, 4_000);
    while Instant::now() < end {
        let now = Instant::now();
        let (over, rest) = under_way.into_iter().partition(|&(until, _)| until <= now);
        under_way = rest;
        Vec::into_iter(over).for_each(|(_, fault): (Instant, Fault)| fault.end(farm));
        if now >= next {
            let (fault, lasts) = (Fault::random(&mut rng, farm.coordinators.len()), rng.random_duration(100, 6_000));
            let is_new = under_way.iter().all(|&(_, other)| other.name() != fault.name());
            if is_new && fault.begin(farm) {
                *fired.entry(fault.name()).or_insert(0) += 1;
                under_way.push((now + lasts, fault));
            }
            next = now + rng.random_duration(500, 4_000);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    under_way.into_iter().for_each(|(_, fault)| fault.end(farm));
    farm.heal();
    fired
}
