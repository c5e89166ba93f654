//! Hosts of a world: coordinators, one of which leads, the switch, and workers.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use femc_coordinator::{Config, Coordinator, CoordinatorError, TimeSource};
use femc_model::{Assignment, StageKind, TaskKey};
use femc_queue::QueueError;
use femc_store::Store;
use femc_worker::{Executor, Journal, MemoryOutbox, OutboxStorage, SimulatedOutcome, TaskSimulation, Worker};
use rand::RngExt as _;
use turmoil::Sim;

use crate::audit::Violation;
use crate::disk::{Log, SNAPSHOT_RECORDS};
use crate::faults::{COORDINATORS, RiskyFault, WORKERS};
use crate::faulty_medium::FaultyMedium;
use crate::network::{SWITCH, dialer, listen, url};
use crate::people::InjectedFailure;
use crate::shared::Shared;
use crate::switch;
use crate::task_durations::{TaskDurations, draw_16_bits};
use crate::tasks::is_rendering;
use crate::test_jobs::CACHE;

/// Longest latency of a message without faults.
pub(crate) const LATENCY: Duration = Duration::from_millis(15);

/// Creates a world with all its hosts. It advances in steps of `tick` and lasts at most until `end`. All coordinators use the
/// settings `scheduler`.
pub(crate) fn build_sim(
    seed: u64,
    [tick, end]: [Duration; 2],
    shared: &Shared,
    medium: &FaultyMedium,
    scheduler: &femc_schedule::Config,
) -> Sim<'static> {
    let durations = TaskDurations::new(seed, scheduler.chunk_size);
    shared.lock().queues.settings = Some((durations, scheduler.clone()));
    let store = Store::from_object_store("shelf", Arc::new(medium.clone()));
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
        sim.host(worker_name(host), move || worker(seed, host, shared.clone(), durations, disk.clone()));
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
    fn restart(&self, shared: &Shared) {
        let mut state = shared.lock();
        self.memory.damage(|result| {
            let what = match state.rng.random_range(0..8) {
                0 => "kept result lost",
                1 => "kept result torn",
                _ => "kept result survived a restart",
            };
            state.count_fault(what);
            if what == "kept result torn" {
                let length = state.rng.random_range(0..result.len());
                result.truncate(length);
            }
            what != "kept result lost"
        });
    }
}

/// Returns the number of connection ends that the simulated network keeps. Must be called from within the simulation.
pub(crate) fn connection_ends() -> usize {
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
        let log = Log::take_lead(&shared, host);
        let started = tokio::time::Instant::now();
        let clock = shared.clone();
        let time = move || clock.lock().clocks[host].read(started.elapsed());
        let scheduler = femc_schedule::Config { clock_zero: Some(0), ..scheduler.clone() };
        let config = Config {
            scheduler,
            snapshot_interval: SNAPSHOT_RECORDS,
            time: TimeSource::from_fn(time),
            ..Config::default()
        };
        shared.trace(|| format!("c{host} leads"));
        let failed = async {
            match Coordinator::start_on_stream(
                listen(&shared, &coordinator_name(host)).await,
                config,
                store.clone(),
                log,
            )
            .await
            {
                Ok(mut handle) => (handle.failed().await, true),
                Err(error) => (error, false),
            }
        };
        // A deposed leader notices at its next write. If it has nothing to write, it notices after a while.
        let dethroned = async {
            while shared.lock().leader == host {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
            tokio::time::sleep(shared.draw_duration(Duration::from_secs(10))).await;
        };
        tokio::select! {
            biased;
            (error, has_led) = failed => {
                shared.trace(|| format!("c{host} fails: {error}"));
                // A leader must wait until the disk has space.
                if has_led && is_disk_full(&error) && RiskyFault::LogFull.is_enabled() {
                    shared.lock().violations.push(Violation::CoordinatorTerminated { message: error.to_string() });
                }
            }
            () = dethroned => shared.trace(|| format!("c{host} no longer leads")),
        }
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
}

fn is_disk_full(error: &CoordinatorError) -> bool {
    matches!(error, CoordinatorError::Queue(QueueError::Io(error)) if error.kind() == io::ErrorKind::StorageFull)
}

async fn worker(seed: u64, host: usize, shared: Shared, durations: TaskDurations, disk: WorkerDisk) -> turmoil::Result {
    disk.restart(&shared);
    let boot = {
        let mut state = shared.lock();
        state.boots += 1;
        let boot = state.boots;
        state.processes.insert(host, boot);
        boot
    };
    let fates = shared.clone();
    let config = femc_worker::Config {
        name: worker_name(host),
        threads: 1,
        cache: CACHE.clone(),
        instance: boot,
        journal: disk.journal,
        outbox: Some(OutboxStorage::Memory(disk.memory)),
        engine: build(seed, boot).into(),
        dial: dialer(&shared, &worker_name(host)),
        executor: Executor::Simulated(TaskSimulation::from_outcomes(move |assignment| {
            let time = {
                let mut state = fates.lock();
                state.queues.observe_start(assignment.task, assignment.epoch);
                durations.duration(assignment, state.history.spec(assignment.task.job))
            };
            (time, draw_outcome(seed, host, &fates, assignment))
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

/// Draws the outcome of a task according to the injected failure of its job.
fn draw_outcome(seed: u64, host: usize, shared: &Shared, assignment: &Assignment) -> SimulatedOutcome {
    /// Percentage of failing tasks in a job in which some fail.
    const FAILURE_PERCENT: u64 = 12;
    /// Percentage for the first task of shared stages, high enough that the task is sometimes quarantined.
    const SHARED_FAILURE_PERCENT: u64 = 60;
    let TaskKey { job, stage, .. } = assignment.task;
    if shared.lock().failing_worker == Some(host) {
        return SimulatedOutcome::Panic;
    }
    let (injected, first) = match shared.lock().history.spec(job) {
        Some(spec) => (InjectedFailure::from_spec(spec), spec.frames.first().copied()),
        None => return SimulatedOutcome::Done,
    };
    let is_the_one = first == Some(stage.frame)
        && assignment.task.index == 0
        && (is_rendering(assignment) || stage.kind == StageKind::Drill);
    let is_first = job.is_shared() && (stage.round, stage.number, assignment.task.index) == (0, 0, 0);
    let percent = if is_first { SHARED_FAILURE_PERCENT } else { FAILURE_PERCENT };
    let is_unlucky =
        || draw_16_bits(&format!("{seed} fate {} {}", assignment.task, assignment.epoch.0)) * 100 / 65_536 < percent;
    match injected {
        InjectedFailure::Nothing => SimulatedOutcome::Done,
        InjectedFailure::RandomPanics if is_unlucky() => SimulatedOutcome::Panic,
        InjectedFailure::RepeatedPanic if is_the_one => SimulatedOutcome::Panic,
        InjectedFailure::KillsWorker if is_the_one => {
            let shared = shared.clone();
            SimulatedOutcome::KillProcess(Arc::new(move || shared.lock().killed_workers.push(host)))
        }
        InjectedFailure::RandomPanics | InjectedFailure::RepeatedPanic | InjectedFailure::KillsWorker => {
            SimulatedOutcome::Done
        }
    }
}
