//! Applies the planned faults of a world at their times.

use std::collections::BTreeMap;
use std::time::Duration;

use femc_model::{Digest, JobId};
use rand::RngExt as _;
use turmoil::Sim;

use crate::faults::{COORDINATORS, Fault, Planned, WORKERS};
use crate::hosts::{LATENCY, coordinator_name, worker_name};
use crate::network::SWITCH;
use crate::shared::{Shared, Trap};
use crate::shelf::{Harm, Shelf, Troubles};

/// Duration of a storm. Afterwards all faults of its plan are repaired.
const STORM: Duration = Duration::from_secs(32);

/// An action at a planned time.
#[derive(Debug, Clone, Copy)]
enum Act {
    Begin(Fault),
    End(Fault),
    /// Restart of a dead coordinator.
    Start(usize),
    /// Restart of a dead worker.
    Rise(usize),
    Peace,
}

/// Planned actions, in order of time, then in order of planning.
#[derive(Debug, Default)]
pub(crate) struct Weather {
    agenda: BTreeMap<(Duration, u64), Act>,
    planned: u64,
}

impl Weather {
    /// Plans a storm that begins `now`: the faults of a plan, then peace.
    pub(crate) fn storm(&mut self, now: Duration, plan: &Planned, shared: &Shared) {
        {
            let mut state = shared.lock();
            (state.twice, state.late) = (plan.twice, plan.late);
            (state.misstated, state.strays) = (plan.misstated, plan.strays);
            let faults = || plan.faults.iter().map(|&(_, fault)| fault);
            state.shares.expect(faults());
            state.chronicle.contents.patience.expect(faults());
            state.queues.expect(faults());
        }
        plan.faults.iter().for_each(|&(at, fault)| self.plan(now + at, Act::Begin(fault)));
        self.plan(now + STORM, Act::Peace);
    }

    fn plan(&mut self, at: Duration, act: Act) {
        self.planned += 1;
        self.agenda.insert((at, self.planned), act);
    }

    /// Carries out all actions that are due.
    pub(crate) fn pass(&mut self, sim: &mut Sim<'_>, shared: &Shared, shelf: &Shelf) {
        let now = sim.elapsed();
        let sprung = shared.lock().sprung.take();
        if let Some(host) = sprung {
            die(sim, shared, coordinator_name(host), now);
            self.plan(now + Duration::from_secs(1), Act::Start(host));
        }
        let struck = std::mem::take(&mut shared.lock().struck);
        for host in struck {
            if die(sim, shared, worker_name(host), now) {
                let mut state = shared.lock();
                state.fired("worker killed by a task");
                state.shares.strikes();
                self.plan(now + Duration::from_millis(700), Act::Rise(host));
            }
        }
        while let Some(entry) = self.agenda.first_entry().filter(|entry| entry.key().0 <= now) {
            let act = entry.remove();
            shared.lock().note(now, &format!("{act:?}"));
            match act {
                Act::Begin(fault) => {
                    if let Some(end) = begin_fault(sim, fault, shared, shelf, now) {
                        self.plan(now + end, Act::End(fault));
                    }
                }
                Act::End(fault) => end_fault(sim, fault, shared, shelf),
                Act::Start(host) => start(sim, coordinator_name(host)),
                Act::Rise(host) => start(sim, worker_name(host)),
                Act::Peace => make_peace(sim, shared, shelf),
            }
        }
    }
}

/// Begins a fault. Returns its duration, if it has an end.
fn begin_fault(sim: &mut Sim<'_>, fault: Fault, shared: &Shared, shelf: &Shelf, now: Duration) -> Option<Duration> {
    let fired = |what| shared.lock().fired(what);
    match fault {
        Fault::WorkerDies(host, pause) => {
            die(sim, shared, worker_name(host), now).then(|| fired("worker died"));
            Some(pause)
        }
        Fault::AloneAndSick(host, pause) => {
            for other in (0..WORKERS).filter(|&other| other != host) {
                die(sim, shared, worker_name(other), now);
            }
            shared.lock().sick = Some(host);
            fired("lone worker sick");
            Some(pause)
        }
        Fault::CoordinatorDies(pause) => {
            let leader = shared.lock().leader;
            die(sim, shared, coordinator_name(leader), now).then(|| fired("coordinator died"));
            Some(pause)
        }
        Fault::DiesBeforeWrite(writes) => {
            shared.lock().trap = Some((writes, Trap::Before));
            None
        }
        Fault::DiesAfterWrite(writes) => {
            shared.lock().trap = Some((writes, Trap::After));
            None
        }
        Fault::TornWrite(writes) => {
            shared.lock().trap = Some((writes, Trap::Within));
            None
        }
        Fault::ArtifactHarmed(harm) => {
            let robbed = pick(shared).is_some_and(|artifact| harms(shared, shelf, &artifact, harm));
            robbed.then(|| fired(harm.name()));
            None
        }
        Fault::LeadChanges => {
            let mut state = shared.lock();
            state.leader = (state.leader + 1) % COORDINATORS;
            state.fired("lead changed");
            None
        }
        Fault::WorkerCut(host, pause) => {
            cut(sim, shared, worker_name(host));
            fired("worker cut off");
            Some(pause)
        }
        Fault::WorkerMute(host, pause) => {
            sim.partition_oneway(worker_name(host), SWITCH);
            shared.lock().reach.cut(worker_name(host));
            fired("worker mute");
            Some(pause)
        }
        Fault::CoordinatorCut(pause) => {
            (0..COORDINATORS).for_each(|host| cut(sim, shared, coordinator_name(host)));
            fired("coordinator cut off");
            Some(pause)
        }
        Fault::WorkerFreezes(host, pause) => {
            sim.hold(worker_name(host), SWITCH);
            fired("worker frozen");
            Some(pause)
        }
        Fault::CoordinatorFreezes(pause) => {
            (0..COORDINATORS).for_each(|host| sim.hold(coordinator_name(host), SWITCH));
            fired("coordinator frozen");
            Some(pause)
        }
        Fault::Slow(most, pause) => {
            sim.set_max_message_latency(most);
            fired("slow network");
            Some(pause)
        }
        Fault::SceneHarmed(harm) => {
            let scene = shared.lock().disk.ledger().ok().and_then(|ledger| ledger.scenes().first().copied());
            scene.is_some_and(|scene| harms(shared, shelf, &scene, harm)).then(|| fired("scene lost"));
            None
        }
        Fault::LogFull(writes) => {
            shared.lock().disk.full = writes;
            None
        }
        Fault::StoreFull(pause) => {
            shelf.trouble(|troubles| troubles.full = true);
            fired("store full");
            Some(pause)
        }
        Fault::StoreAway(pause) => {
            shelf.trouble(|troubles| troubles.away = true);
            fired("store away");
            Some(pause)
        }
        Fault::StoreSlow(most, pause) => {
            shelf.trouble(|troubles| troubles.slow = most);
            fired("store slow");
            Some(pause)
        }
        Fault::UploadTorn(others, thousandths) => {
            shelf.trouble(|troubles| troubles.tears = Some((others, thousandths)));
            None
        }
        Fault::ReadsAnother(others) => {
            shelf.trouble(|troubles| troubles.swaps = Some(others));
            None
        }
        Fault::ClockJumps(host, jump) => {
            shared.lock().clocks[host].ahead += jump;
            fired(if jump > 0 { "clock jumped ahead" } else { "clock jumped back" });
            None
        }
        Fault::ClockDrifts(host, drift) => {
            shared.lock().clocks[host].drift = drift;
            fired("clock drifts");
            None
        }
        Fault::LogLost => {
            for host in 0..COORDINATORS {
                die(sim, shared, coordinator_name(host), now);
            }
            shared.lock().lose_log();
            fired("log lost");
            Some(Duration::from_secs(1))
        }
    }
}

fn end_fault(sim: &mut Sim<'_>, fault: Fault, shared: &Shared, shelf: &Shelf) {
    match fault {
        Fault::WorkerDies(host, _) => start(sim, worker_name(host)),
        Fault::AloneAndSick(..) => {
            shared.lock().sick = None;
            (0..WORKERS).for_each(|host| start(sim, worker_name(host)));
        }
        Fault::CoordinatorDies(_) | Fault::LogLost => {
            (0..COORDINATORS).for_each(|host| start(sim, coordinator_name(host)));
        }
        Fault::WorkerCut(host, _) | Fault::WorkerMute(host, _) => mend(sim, shared, &worker_name(host)),
        Fault::CoordinatorCut(_) => (0..COORDINATORS).for_each(|host| mend(sim, shared, &coordinator_name(host))),
        Fault::WorkerFreezes(host, _) => sim.release(worker_name(host), SWITCH),
        Fault::CoordinatorFreezes(_) => {
            (0..COORDINATORS).for_each(|host| sim.release(coordinator_name(host), SWITCH));
        }
        Fault::Slow(..) => sim.set_max_message_latency(LATENCY),
        Fault::StoreFull(_) => shelf.trouble(|troubles| troubles.full = false),
        Fault::StoreAway(_) => shelf.trouble(|troubles| troubles.away = false),
        Fault::StoreSlow(..) => shelf.trouble(|troubles| troubles.slow = Duration::ZERO),
        Fault::LogFull(_) => shared.lock().disk.full = 0,
        Fault::DiesBeforeWrite(_)
        | Fault::TornWrite(_)
        | Fault::DiesAfterWrite(_)
        | Fault::LeadChanges
        | Fault::UploadTorn(..)
        | Fault::ReadsAnother(_)
        | Fault::ArtifactHarmed(_)
        | Fault::SceneHarmed(_)
        | Fault::ClockJumps(..)
        | Fault::ClockDrifts(..) => {}
    }
}

/// Repairs all faults and restarts dead hosts.
fn make_peace(sim: &mut Sim<'_>, shared: &Shared, shelf: &Shelf) {
    let hosts = (0..COORDINATORS).map(coordinator_name).chain((0..WORKERS).map(worker_name));
    for host in hosts {
        sim.release(host.as_str(), SWITCH);
        mend(sim, shared, &host);
        start(sim, host);
    }
    sim.set_max_message_latency(LATENCY);
    shelf.trouble(|troubles| *troubles = Troubles::default());
    let mut state = shared.lock();
    state.clocks.iter_mut().for_each(|clock| clock.drift = 0);
    (state.trap, state.disk.full, state.sick) = (None, 0, None);
    (state.twice, state.late, state.misstated, state.strays) = (0, 0, 0, 0);
}

/// Draws an artifact of an unfinished frame, or of shared stages, if any exists. Each frame is chosen only once: a task with a
/// missing input counts as failed, and a job rightly fails after three failures.
fn pick(shared: &Shared) -> Option<Digest> {
    let mut state = shared.lock();
    let shared = state.chronicle.shared_inputs();
    let needed: Vec<(JobId, u32, Digest)> = state.disk.ledger().ok()?.inputs().chain(shared).collect();
    let needed: Vec<_> = needed.into_iter().filter(|(job, frame, _)| !state.robbed.contains(&(*job, *frame))).collect();
    if needed.is_empty() {
        return None;
    }
    let (job, frame, artifact) = needed[state.rng.random_range(0..needed.len())];
    state.robbed.insert((job, frame));
    Some(artifact)
}

/// Damages an artifact. Returns `false` if it does not exist.
fn harms(shared: &Shared, shelf: &Shelf, artifact: &Digest, harm: Harm) -> bool {
    shared.lock().harmed.insert(*artifact);
    shelf.harm(artifact, harm)
}

/// Disconnects a host from the switch.
fn cut(sim: &mut Sim<'_>, shared: &Shared, host: String) {
    sim.partition(host.as_str(), SWITCH);
    shared.lock().reach.cut(host);
}

fn mend(sim: &mut Sim<'_>, shared: &Shared, host: &str) {
    sim.repair(host, SWITCH);
    shared.lock().reach.mend(host);
}

/// Kills a process. Returns `false` if it was dead.
fn die(sim: &mut Sim<'_>, shared: &Shared, host: String, now: Duration) -> bool {
    let lives = sim.is_host_running(host.as_str());
    if lives {
        shared.lock().note(now, &format!("{host} dies"));
        sim.crash(host);
    }
    lives
}

fn start(sim: &mut Sim<'_>, host: String) {
    if !sim.is_host_running(host.as_str()) {
        sim.bounce(host);
    }
}
