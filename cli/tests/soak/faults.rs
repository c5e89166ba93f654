//! Random faults, derived from a seed.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use crate::common::proxy::{Proxy, Way};
use crate::farm::{Farm, WORKERS};

/// Random numbers from a seed: SplitMix64.
pub struct Draw(pub u64);

impl Draw {
    /// Returns a number below `most`.
    pub fn below(&mut self, most: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed ^ (mixed >> 31)) % most
    }

    /// Returns a duration from `least` to `most` milliseconds.
    fn pause(&mut self, least: u64, most: u64) -> Duration {
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
    LinkFrozenOneWay(usize, Way),
}
use Fault::*;

impl Fault {
    fn draw(draw: &mut Draw, coordinators: usize) -> Self {
        let worker = draw.below(WORKERS as u64) as usize;
        let coordinator = worker % coordinators;
        match draw.below(12) {
            0..3 => WorkerKilled(worker),
            3..5 => WorkerStopped(worker),
            5 => CoordinatorKilled(coordinator),
            6 => CoordinatorStopped(coordinator),
            7..9 => LinkCut(worker),
            9 => LinkFrozen(worker),
            10 => LinkFrozenOneWay(worker, Way::Up),
            _ => LinkFrozenOneWay(worker, Way::Down),
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
            LinkFrozenOneWay(_, Way::Up) => "link frozen upwards",
            LinkFrozenOneWay(_, Way::Down) => "link frozen downwards",
        }
    }

    /// Begins the fault. Returns whether it took effect.
    fn begin(self, farm: &Farm) -> bool {
        match self {
            WorkerKilled(worker) => farm.workers[worker].kill(),
            WorkerStopped(worker) => farm.workers[worker].stop(),
            CoordinatorKilled(coordinator) => farm.coordinators[coordinator].kill(),
            CoordinatorStopped(coordinator) => farm.coordinators[coordinator].stop(),
            LinkCut(worker) => does(|| farm.ways[worker].iter().for_each(Proxy::cut)),
            LinkFrozen(worker) => does(|| farm.ways[worker].iter().for_each(Proxy::freeze)),
            LinkFrozenOneWay(worker, way) => does(|| farm.ways[worker].iter().for_each(|proxy| proxy.freeze_way(way))),
        }
    }

    fn end(self, farm: &Farm) {
        match self {
            WorkerKilled(worker) => farm.workers[worker].start(&farm.place),
            WorkerStopped(worker) => farm.workers[worker].go_on(),
            CoordinatorKilled(coordinator) => farm.coordinators[coordinator].start(&farm.place),
            CoordinatorStopped(coordinator) => farm.coordinators[coordinator].go_on(),
            LinkCut(_) => {}
            LinkFrozen(worker) | LinkFrozenOneWay(worker, _) => farm.ways[worker].iter().for_each(Proxy::thaw),
        }
    }
}

fn does(what: impl FnOnce()) -> bool {
    what();
    true
}

/// Produces faults until `end`, each for some seconds and often several at the same time, then repairs everything. Returns the
/// number of faults by kind.
pub fn storm(farm: &Farm, seed: u64, end: Instant) -> BTreeMap<&'static str, u64> {
    let mut draw = Draw(seed);
    let (mut fired, mut under_way) = (BTreeMap::new(), Vec::<(Instant, Fault)>::new());
    let mut next = Instant::now() + draw.pause(1_000, 4_000);
    while Instant::now() < end {
        let now = Instant::now();
        let (over, rest) = under_way.into_iter().partition(|&(until, _)| until <= now);
        under_way = rest;
        Vec::into_iter(over).for_each(|(_, fault): (Instant, Fault)| fault.end(farm));
        if now >= next {
            let (fault, lasts) = (Fault::draw(&mut draw, farm.coordinators.len()), draw.pause(100, 6_000));
            let is_new = under_way.iter().all(|&(_, other)| other.name() != fault.name());
            if is_new && fault.begin(farm) {
                *fired.entry(fault.name()).or_insert(0) += 1;
                under_way.push((now + lasts, fault));
            }
            next = now + draw.pause(500, 4_000);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    under_way.into_iter().for_each(|(_, fault)| fault.end(farm));
    farm.heal();
    fired
}
