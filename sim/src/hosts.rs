//! Hosts of a world: coordinators, one of which leads, the switch, and workers.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use femc_coordinator::{Config, Coordinator, CoordinatorError, Time};
use femc_model::{Assignment, StageKind, TaskKey};
use femc_queue::QueueError;
use femc_store::Store;
use femc_worker::{Fate, Hands, Journal, MemoryOutbox, OutboxPlace, Pace, Worker};
use rand::RngExt as _;
use turmoil::Sim;

use crate::audit::Violation;
use crate::disk::{Log, SNAPSHOT};
use crate::faults::{COORDINATORS, Hardship, WORKERS};
use crate::network::{SWITCH, dial, listen, url};
use crate::paces::{Paces, draw};
use crate::people::Curse;
use crate::shared::Shared;
use crate::shelf::Shelf;
use crate::stage::CACHE;
use crate::switch;
use crate::tasks::renders;

/// Longest latency of a message without faults.
pub(crate) const LATENCY: Duration = Duration::from_millis(15);

/// Creates a world with all its hosts. It advances in steps of `tick` and lasts at most until `end`. All coordinators use the
/// settings `scheduler`.
pub(crate) fn settle(
    seed: u64,
    [tick, end]: [Duration; 2],
    shared: &Shared,
    shelf: &Shelf,
    scheduler: &femc_schedule::Config,
) -> Sim<'static> {
    let paces = Paces::new(seed, scheduler.grain);
    shared.lock().queues.world = Some((paces, scheduler.clone()));
    let store = Store::over("shelf", Arc::new(shelf.clone()));
    let mut sim = turmoil::Builder::new()
        .simulation_duration(end)
        .tick_duration(tick)
        .min_message_latency(Duration::from_millis(1))
        .max_message_latency(LATENCY)
        .tcp_capacity(1 << 16)
        .rng_seed(seed)
        .build();
    for host in 0..COORDINATORS {
        let (shared, store, scheduler) = (shared.clone(), store.clone(), scheduler.clone());
        sim.host(coordinator_name(host), move || coordinator(host, shared.clone(), store.clone(), scheduler.clone()));
    }
    {
        let (shared, store) = (shared.clone(), store.clone());
        sim.host(SWITCH, move || switch::serve(shared.clone(), store.clone()));
    }
    for host in 0..WORKERS {
        let (shared, disk) = (shared.clone(), WorkerDisk::default());
        sim.host(worker_name(host), move || worker(seed, host, shared.clone(), paces, disk.clone()));
    }
    sim
}

/// Data that survives the process of a worker.
#[derive(Debug, Clone)]
struct WorkerDisk {
    journal: Journal,
    /// Results that are not acknowledged yet.
    memory: MemoryOutbox,
}

impl Default for WorkerDisk {
    fn default() -> Self {
        Self { journal: Journal::in_memory(), memory: MemoryOutbox::default() }
    }
}

impl WorkerDisk {
    /// Restarts the machine, which may lose or tear stored results.
    fn boots(&self, shared: &Shared) {
        let mut state = shared.lock();
        self.memory.harm(|result| {
            let what = match state.rng.random_range(0..8) {
                0 => "kept result lost",
                1 => "kept result torn",
                _ => "kept result survived a restart",
            };
            state.fired(what);
            if what == "kept result torn" {
                let length = state.rng.random_range(0..result.len());
                result.truncate(length);
            }
            what != "kept result lost"
        });
    }
}

/// Returns the number of connection ends that the simulated network keeps. Must be called from within the simulation.
pub(crate) fn ends() -> usize {
    let names = (0..COORDINATORS).map(coordinator_name).chain((0..WORKERS).map(worker_name)).chain([SWITCH.into()]);
    names.map(turmoil::established_tcp_stream_count_on).sum()
}

pub(crate) fn coordinator_name(host: usize) -> String {
    format!("c{host}")
}

pub(crate) fn worker_name(host: usize) -> String {
    format!("w{host}")
}

/// Runs a coordinator: it stands by until it leads, and stands by again after it loses the lead.
async fn coordinator(host: usize, shared: Shared, store: Store, scheduler: femc_schedule::Config) -> turmoil::Result {
    loop {
        while shared.lock().leader != host {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        let log = Log::lead(&shared, host);
        let started = tokio::time::Instant::now();
        let clock = shared.clone();
        let time = move || clock.lock().clocks[host].shows(started.elapsed());
        let scheduler = femc_schedule::Config { clock_zero: Some(0), ..scheduler.clone() };
        let config = Config { scheduler, snapshot: SNAPSHOT, time: Time::by(time), ..Config::default() };
        shared.note(|| format!("c{host} leads"));
        let failed = async {
            match Coordinator::on(listen(&shared, &coordinator_name(host)).await, config, store.clone(), log).await {
                Ok(mut handle) => (handle.failed().await, true),
                Err(error) => (error, false),
            }
        };
        // A deposed leader notices at its next write. If it has nothing to write, it notices after a while.
        let dethroned = async {
            while shared.lock().leader == host {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
            tokio::time::sleep(shared.pause(Duration::from_secs(10))).await;
        };
        tokio::select! {
            biased;
            (error, has_led) = failed => {
                shared.note(|| format!("c{host} fails: {error}"));
                // A leader must wait until the disk has space.
                if has_led && is_full(&error) && Hardship::FullLog.is_there() {
                    shared.lock().wrong.push(Violation::Ended { message: error.to_string() });
                }
            }
            () = dethroned => shared.note(|| format!("c{host} no longer leads")),
        }
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
}

fn is_full(error: &CoordinatorError) -> bool {
    matches!(error, CoordinatorError::Queue(QueueError::Medium(error)) if error.kind() == io::ErrorKind::StorageFull)
}

async fn worker(seed: u64, host: usize, shared: Shared, paces: Paces, disk: WorkerDisk) -> turmoil::Result {
    disk.boots(&shared);
    let boot = {
        let mut state = shared.lock();
        state.boots += 1;
        let boot = state.boots;
        state.lives.insert(host, boot);
        boot
    };
    let fates = shared.clone();
    let config = femc_worker::Config {
        name: worker_name(host),
        threads: 1,
        cache: CACHE.clone(),
        instance: boot,
        journal: disk.journal,
        outbox: Some(OutboxPlace::Memory(disk.memory)),
        engine: build(seed, boot).into(),
        dial: dial(&shared, &worker_name(host)),
        hands: Hands::Simulated(Pace::fated(move |assignment| {
            let time = {
                let mut state = fates.lock();
                state.queues.note_begun(assignment.task, assignment.epoch);
                paces.time(assignment, state.chronicle.spec(assignment.task.job))
            };
            (time, fate(seed, host, &fates, assignment))
        })),
        ..femc_worker::Config::new(url(SWITCH))
    };
    Ok(Worker::run(config, std::future::pending()).await?)
}

/// Returns the engine build of a worker process. In every fourth world the farm is upgraded while it works: workers that restart
/// after a crash have another build.
fn build(seed: u64, boot: u64) -> &'static str {
    if seed.is_multiple_of(4) && boot > WORKERS as u64 { "new" } else { "old" }
}

/// Decides the fate of a task according to the curse of its job.
fn fate(seed: u64, host: usize, shared: &Shared, assignment: &Assignment) -> Fate {
    /// Percentage of failing tasks in a job in which some fail.
    const OFTEN: u64 = 12;
    /// Percentage for the first task of shared stages, high enough that the task is sometimes quarantined.
    const OFTEN_SHARED: u64 = 60;
    let TaskKey { job, stage, .. } = assignment.task;
    if shared.lock().sick == Some(host) {
        return Fate::Panics;
    }
    let (curse, first) = match shared.lock().chronicle.spec(job) {
        Some(spec) => (Curse::of(spec), spec.frames.first().copied()),
        None => return Fate::Done,
    };
    let is_the_one = first == Some(stage.frame)
        && assignment.task.index == 0
        && (renders(assignment) || stage.kind == StageKind::Drill);
    let is_first = job.is_shared() && (stage.round, stage.number, assignment.task.index) == (0, 0, 0);
    let often = if is_first { OFTEN_SHARED } else { OFTEN };
    let is_unlucky = || draw(&format!("{seed} fate {} {}", assignment.task, assignment.epoch.0)) * 100 / 65_536 < often;
    match curse {
        Curse::Nothing => Fate::Done,
        Curse::NowAndThen if is_unlucky() => Fate::Panics,
        Curse::Always if is_the_one => Fate::Panics,
        Curse::Deadly if is_the_one => {
            let shared = shared.clone();
            Fate::Kills(Arc::new(move || shared.lock().struck.push(host)))
        }
        Curse::NowAndThen | Curse::Always | Curse::Deadly => Fate::Done,
    }
}
