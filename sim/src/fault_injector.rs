//! Applies the planned faults of a world at their times.

use std::collections::BTreeMap;
use std::time::Duration;

use femc_model::{Digest, JobId};
use rand::RngExt as _;
use turmoil::Sim;

use crate::faults::{COORDINATORS, Fault, FaultPlan, WORKERS};
use crate::faulty_medium::{Damage, FaultyMedium, MediumFaults};
use crate::hosts::{LATENCY, coordinator_name, worker_name};
use crate::network::SWITCH;
use crate::shared::{CrashPoint, Shared};

/// Duration of a storm. Afterwards all faults of its plan are repaired.
const STORM_TIME: Duration = Duration::from_secs(32);

/// An action at a planned time.
#[derive(Debug, Clone, Copy)]
enum Action {
    Begin(Fault),
    End(Fault),
    /// Restart of a dead coordinator.
    StartCoordinator(usize),
    /// Restart of a dead worker.
    StartWorker(usize),
    RepairAll,
}

/// Planned actions, in order of time, then in order of planning.
#[derive(Debug, Default)]
pub(crate) struct FaultInjector {
    agenda: BTreeMap<(Duration, u64), Action>,
    planned: u64,
}

impl FaultInjector {
    /// Plans a storm that begins `now`: the faults of a plan, then peace.
    pub(crate) fn plan_storm(&mut self, now: Duration, plan: &FaultPlan, shared: &Shared) {
        {
            let mut state = shared.lock();
            (state.duplicated, state.delayed) = (plan.duplicated, plan.delayed);
            (state.misstated, state.foreign_leases) = (plan.misstated, plan.foreign_leases);
            let faults = || plan.faults.iter().map(|&(_, fault)| fault);
            state.charges.allow_for(faults());
            state.history.shared_stages.propagation_delay.allow_for(faults());
            state.queues.allow_for(faults());
        }
        plan.faults.iter().for_each(|&(at, fault)| self.plan_action(now + at, Action::Begin(fault)));
        self.plan_action(now + STORM_TIME, Action::RepairAll);
    }

    fn plan_action(&mut self, at: Duration, action: Action) {
        self.planned += 1;
        self.agenda.insert((at, self.planned), action);
    }

    /// Carries out all actions that are due.
    pub(crate) fn run_due(&mut self, sim: &mut Sim<'_>, shared: &Shared, medium: &FaultyMedium) {
        let now = sim.elapsed();
        let sprung = shared.lock().crashed.take();
        if let Some(host) = sprung {
            kill(sim, shared, coordinator_name(host), now);
            self.plan_action(now + Duration::from_secs(1), Action::StartCoordinator(host));
        }
        let struck = std::mem::take(&mut shared.lock().killed_workers);
        for host in struck {
            if kill(sim, shared, worker_name(host), now) {
                let mut state = shared.lock();
                state.count_fault("worker killed by a task");
                state.charges.allow_for_kill();
                self.plan_action(now + Duration::from_millis(700), Action::StartWorker(host));
            }
        }
        while let Some(entry) = self.agenda.first_entry().filter(|entry| entry.key().0 <= now) {
            let action = entry.remove();
            shared.lock().trace_event(now, &format!("{action:?}"));
            match action {
                Action::Begin(fault) => {
                    if let Some(end) = begin_fault(sim, fault, shared, medium, now) {
                        self.plan_action(now + end, Action::End(fault));
                    }
                }
                Action::End(fault) => end_fault(sim, fault, shared, medium),
                Action::StartCoordinator(host) => start_host(sim, coordinator_name(host)),
                Action::StartWorker(host) => start_host(sim, worker_name(host)),
                Action::RepairAll => repair_all(sim, shared, medium),
            }
        }
    }
}

/// Begins a fault. Returns its duration, if it has an end.
fn begin_fault(
    sim: &mut Sim<'_>,
    fault: Fault,
    shared: &Shared,
    medium: &FaultyMedium,
    now: Duration,
) -> Option<Duration> {
    let fired = |what, pause: Option<Duration>| {
        shared.lock().count_fault(what);
        pause
    };
    let plan_crash = |writes, point| {
        shared.lock().planned_crash = Some((writes, point));
        None
    };
    match fault {
        Fault::WorkerDies(host, pause) => {
            kill(sim, shared, worker_name(host), now).then(|| fired("worker died", None));
            Some(pause)
        }
        Fault::LoneWorkerFails(host, pause) => {
            for other in (0..WORKERS).filter(|&other| other != host) {
                kill(sim, shared, worker_name(other), now);
            }
            shared.lock().failing_worker = Some(host);
            fired("lone worker sick", Some(pause))
        }
        Fault::CoordinatorDies(pause) => {
            let leader = shared.lock().leader;
            kill(sim, shared, coordinator_name(leader), now).then(|| fired("coordinator died", None));
            Some(pause)
        }
        Fault::DiesBeforeWrite(writes) => plan_crash(writes, CrashPoint::Before),
        Fault::DiesAfterWrite(writes) => plan_crash(writes, CrashPoint::After),
        Fault::TornWrite(writes) => plan_crash(writes, CrashPoint::Within),
        Fault::ArtifactDamaged(harm) => {
            let robbed = draw_artifact(shared).is_some_and(|artifact| damage_artifact(shared, medium, &artifact, harm));
            robbed.then(|| fired(harm.name(), None));
            None
        }
        Fault::LeaderChanges => {
            let mut state = shared.lock();
            state.leader = (state.leader + 1) % COORDINATORS;
            state.count_fault("lead changed");
            None
        }
        Fault::WorkerPartitioned(host, pause) => {
            disconnect(sim, shared, worker_name(host));
            fired("worker cut off", Some(pause))
        }
        Fault::WorkerMute(host, pause) => {
            sim.partition_oneway(worker_name(host), SWITCH);
            shared.lock().reachability.disconnect(worker_name(host));
            fired("worker mute", Some(pause))
        }
        Fault::CoordinatorPartitioned(pause) => {
            (0..COORDINATORS).for_each(|host| disconnect(sim, shared, coordinator_name(host)));
            fired("coordinator cut off", Some(pause))
        }
        Fault::WorkerFreezes(host, pause) => {
            sim.hold(worker_name(host), SWITCH);
            fired("worker frozen", Some(pause))
        }
        Fault::CoordinatorFreezes(pause) => {
            (0..COORDINATORS).for_each(|host| sim.hold(coordinator_name(host), SWITCH));
            fired("coordinator frozen", Some(pause))
        }
        Fault::SlowNetwork(most, pause) => {
            sim.set_max_message_latency(most);
            fired("slow network", Some(pause))
        }
        Fault::SceneDamaged(harm) => {
            let scene = shared.lock().disk.ledger().ok().and_then(|ledger| ledger.scenes().first().copied());
            scene.is_some_and(|scene| damage_artifact(shared, medium, &scene, harm)).then(|| fired("scene lost", None));
            None
        }
        Fault::LogFull(writes) => {
            shared.lock().disk.failing_writes = writes;
            None
        }
        Fault::StoreFull(pause) => {
            medium.change_faults(|troubles| troubles.full = true);
            fired("store full", Some(pause))
        }
        Fault::StoreUnavailable(pause) => {
            medium.change_faults(|troubles| troubles.unavailable = true);
            fired("store away", Some(pause))
        }
        Fault::StoreSlow(most, pause) => {
            medium.change_faults(|troubles| troubles.delay = most);
            fired("store slow", Some(pause))
        }
        Fault::UploadTorn(others, thousandths) => {
            medium.change_faults(|troubles| troubles.torn_upload = Some((others, thousandths)));
            None
        }
        Fault::WrongRead(others) => {
            medium.change_faults(|troubles| troubles.wrong_read = Some(others));
            None
        }
        Fault::ClockJumps(host, jump) => {
            shared.lock().clocks[host].ahead += jump;
            fired(if jump > 0 { "clock jumped ahead" } else { "clock jumped back" }, None)
        }
        Fault::ClockDrifts(host, drift) => {
            shared.lock().clocks[host].drift = drift;
            fired("clock drifts", None)
        }
        Fault::LogLost => {
            for host in 0..COORDINATORS {
                kill(sim, shared, coordinator_name(host), now);
            }
            shared.lock().lose_log();
            fired("log lost", Some(Duration::from_secs(1)))
        }
    }
}

fn end_fault(sim: &mut Sim<'_>, fault: Fault, shared: &Shared, medium: &FaultyMedium) {
    match fault {
        Fault::WorkerDies(host, _) => start_host(sim, worker_name(host)),
        Fault::LoneWorkerFails(..) => {
            shared.lock().failing_worker = None;
            (0..WORKERS).for_each(|host| start_host(sim, worker_name(host)));
        }
        Fault::CoordinatorDies(_) | Fault::LogLost => {
            (0..COORDINATORS).for_each(|host| start_host(sim, coordinator_name(host)));
        }
        Fault::WorkerPartitioned(host, _) | Fault::WorkerMute(host, _) => reconnect(sim, shared, &worker_name(host)),
        Fault::CoordinatorPartitioned(_) => {
            (0..COORDINATORS).for_each(|host| reconnect(sim, shared, &coordinator_name(host)));
        }
        Fault::WorkerFreezes(host, _) => sim.release(worker_name(host), SWITCH),
        Fault::CoordinatorFreezes(_) => {
            (0..COORDINATORS).for_each(|host| sim.release(coordinator_name(host), SWITCH));
        }
        Fault::SlowNetwork(..) => sim.set_max_message_latency(LATENCY),
        Fault::StoreFull(_) => medium.change_faults(|troubles| troubles.full = false),
        Fault::StoreUnavailable(_) => medium.change_faults(|troubles| troubles.unavailable = false),
        Fault::StoreSlow(..) => medium.change_faults(|troubles| troubles.delay = Duration::ZERO),
        Fault::LogFull(_) => shared.lock().disk.failing_writes = 0,
        Fault::DiesBeforeWrite(_)
        | Fault::TornWrite(_)
        | Fault::DiesAfterWrite(_)
        | Fault::LeaderChanges
        | Fault::UploadTorn(..)
        | Fault::WrongRead(_)
        | Fault::ArtifactDamaged(_)
        | Fault::SceneDamaged(_)
        | Fault::ClockJumps(..)
        | Fault::ClockDrifts(..) => {}
    }
}

/// Repairs all faults and restarts dead hosts.
fn repair_all(sim: &mut Sim<'_>, shared: &Shared, medium: &FaultyMedium) {
    let hosts = (0..COORDINATORS).map(coordinator_name).chain((0..WORKERS).map(worker_name));
    for host in hosts {
        sim.release(host.as_str(), SWITCH);
        reconnect(sim, shared, &host);
        start_host(sim, host);
    }
    sim.set_max_message_latency(LATENCY);
    medium.change_faults(|troubles| *troubles = MediumFaults::default());
    let mut state = shared.lock();
    state.clocks.iter_mut().for_each(|clock| clock.drift = 0);
    (state.planned_crash, state.disk.failing_writes, state.failing_worker) = (None, 0, None);
    (state.duplicated, state.delayed, state.misstated, state.foreign_leases) = (0, 0, 0, 0);
}

/// Draws an artifact of an unfinished frame, or of shared stages, if any exists. Each frame is chosen only once: a task with a
/// missing input counts as failed, and a job rightly fails after three failures.
fn draw_artifact(shared: &Shared) -> Option<Digest> {
    let mut state = shared.lock();
    let shared = state.history.shared_inputs();
    let needed: Vec<(JobId, u32, Digest)> = state.disk.ledger().ok()?.inputs().chain(shared).collect();
    let needed: Vec<_> =
        needed.into_iter().filter(|(job, frame, _)| !state.damaged_frames.contains(&(*job, *frame))).collect();
    if needed.is_empty() {
        return None;
    }
    let (job, frame, artifact) = needed[state.rng.random_range(0..needed.len())];
    state.damaged_frames.insert((job, frame));
    Some(artifact)
}

/// Damages an artifact. Returns `false` if it does not exist.
fn damage_artifact(shared: &Shared, medium: &FaultyMedium, artifact: &Digest, harm: Damage) -> bool {
    shared.lock().damaged.insert(*artifact);
    medium.damage(artifact, harm)
}

/// Disconnects a host from the switch.
fn disconnect(sim: &mut Sim<'_>, shared: &Shared, host: String) {
    sim.partition(host.as_str(), SWITCH);
    shared.lock().reachability.disconnect(host);
}

fn reconnect(sim: &mut Sim<'_>, shared: &Shared, host: &str) {
    sim.repair(host, SWITCH);
    shared.lock().reachability.reconnect(host);
}

/// Kills a process. Returns `false` if it was dead.
fn kill(sim: &mut Sim<'_>, shared: &Shared, host: String, now: Duration) -> bool {
    let lives = sim.is_host_running(host.as_str());
    if lives {
        shared.lock().trace_event(now, &format!("{host} dies"));
        sim.crash(host);
    }
    lives
}

fn start_host(sim: &mut Sim<'_>, host: String) {
    if !sim.is_host_running(host.as_str()) {
        sim.bounce(host);
    }
}
