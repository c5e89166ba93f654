//! One world from its first moment to its end.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use femc_coordinator::{Config, Coordinator, Time};
use femc_model::{Assignment, JobId, JobStatus, Work};
use femc_proto::{CallError, Client};
use femc_store::Store;
use femc_worker::{Hands, Pace, Worker};
use turmoil::Sim;

use crate::audit::{Violation, audit};
use crate::disk::{Log, Shelf};
use crate::faults::{COORDINATORS, Fault, Planned, WORKERS};
use crate::network::{dial, listen, url};
use crate::shared::{Shared, State, Trap};
use crate::stage::{self, CACHE, Stage};
use crate::switch;

/// From then on nothing goes wrong any more.
const PEACE: Duration = Duration::from_secs(32);
/// When the job must be done.
const END: Duration = Duration::from_secs(240);
/// Step of the simulated time.
const TICK: Duration = Duration::from_millis(5);

/// What came of a world.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// What must never be, and was.
    pub violations: Vec<Violation>,
    /// How often each kind of fault came about.
    pub fired: BTreeMap<&'static str, u32>,
    /// Simulated seconds.
    pub seconds: f64,
    /// Digest of all that was said and written: the same seed gives the same.
    pub trace: String,
    /// All that was said, one line each, if it was asked for.
    pub story: Vec<String>,
    /// Results that came after their lease, or twice, and changed nothing.
    pub stale: u64,
}

/// Lives through the world of this seed and plan. `tells`: keep the story.
pub fn run(seed: u64, plan: &Planned, tells: Tells) -> anyhow::Result<Outcome> {
    let stage = stage::pick(seed)?;
    line_up()?;
    let shared = Shared::new(seed, tells == Tells::Story);
    {
        let mut state = shared.lock();
        (state.twice, state.late) = (plan.twice, plan.late);
    }
    let shelf = Shelf::default();
    let store = Store::over("shelf", Arc::new(shelf.clone()));
    let mut sim = turmoil::Builder::new()
        .simulation_duration(END)
        .tick_duration(TICK)
        .min_message_latency(Duration::from_millis(1))
        .max_message_latency(Duration::from_millis(15))
        .tcp_capacity(1 << 16)
        .rng_seed(seed)
        .build();
    for host in 0..COORDINATORS {
        let (shared, store) = (shared.clone(), store.clone());
        sim.host(coordinator_name(host), move || coordinator(seed, host, stage, shared.clone(), store.clone()));
    }
    {
        let (shared, store) = (shared.clone(), store.clone());
        sim.host("switch", move || switch::serve(shared.clone(), store.clone()));
    }
    for host in 0..WORKERS {
        let shared = shared.clone();
        sim.host(worker_name(host), move || worker(seed, host, stage, shared.clone()));
    }
    sim.client("person", person(shared.clone(), stage));
    let broken = drive(&mut sim, plan, &shared, &shelf);
    let state = shared.lock();
    let mut violations = audit(stage, &state);
    violations.extend(broken.filter(|_| state.end.is_some()).map(Violation::World));
    let mut trace = state.trace.clone();
    for record in &state.disk.history {
        trace.update(record);
    }
    Ok(Outcome {
        violations,
        fired: state.fired.clone(),
        seconds: sim.elapsed().as_secs_f64(),
        trace: trace.finalize().to_hex().to_string(),
        story: state.story.clone().unwrap_or_default(),
        stale: state.end.as_ref().map_or(0, |(status, _)| status.stale_messages),
    })
}

/// Tokio numbers the tasks of a process and drops those of a crashed host in an order that follows from the numbers: begins
/// every world at a number of the same remainder. So worlds of one process do not live side by side.
fn line_up() -> std::io::Result<()> {
    const SHARDS: u64 = 64;
    let runtime = tokio::runtime::Builder::new_current_thread().build()?;
    runtime.block_on(async {
        loop {
            let number = tokio::spawn(async { tokio::task::id().to_string() }).await.ok();
            if number.and_then(|number| number.parse::<u64>().ok()).is_none_or(|number| number % SHARDS == 0) {
                return;
            }
        }
    });
    Ok(())
}

/// Whether a world's story is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tells {
    /// Only its outcome.
    Outcome,
    /// Every message.
    Story,
}

fn coordinator_name(host: usize) -> String {
    format!("c{host}")
}

fn worker_name(host: usize) -> String {
    format!("w{host}")
}

/// What is to be done at some time.
#[derive(Debug, Clone, Copy)]
enum Act {
    Begin(Fault),
    End(Fault),
    /// A dead coordinator is started again.
    Start(usize),
    Peace,
}

fn drive(sim: &mut Sim<'_>, plan: &Planned, shared: &Shared, shelf: &Shelf) -> Option<String> {
    let mut agenda: BTreeMap<(Duration, usize), Act> = BTreeMap::new();
    let begin = plan.faults.iter().map(|&(at, fault)| (at, Act::Begin(fault)));
    for (number, (at, act)) in begin.chain([(PEACE, Act::Peace)]).enumerate() {
        agenda.insert((at, number), act);
    }
    loop {
        match sim.step() {
            Ok(true) => return None,
            Ok(false) => {}
            Err(error) => return Some(error.to_string()),
        }
        let now = sim.elapsed();
        let sprung = shared.lock().sprung.take();
        if let Some(host) = sprung {
            die(sim, shared, coordinator_name(host), now);
            agenda.insert((now + Duration::from_secs(1), usize::MAX - agenda.len()), Act::Start(host));
        }
        while let Some(entry) = agenda.first_entry().filter(|entry| entry.key().0 <= now) {
            let act = entry.remove();
            shared.lock().note(now, &format!("{act:?}"));
            match act {
                Act::Begin(fault) => {
                    if let Some(end) = begin_fault(sim, fault, shared, shelf, now) {
                        agenda.insert((now + end, usize::MAX - agenda.len()), Act::End(fault));
                    }
                }
                Act::End(fault) => end_fault(sim, fault, shared, shelf),
                Act::Start(host) => start(sim, coordinator_name(host)),
                Act::Peace => make_peace(sim, shared, shelf),
            }
        }
    }
}

/// Lets it begin; how long it lasts, if it ends by itself.
fn begin_fault(sim: &mut Sim<'_>, fault: Fault, shared: &Shared, shelf: &Shelf, now: Duration) -> Option<Duration> {
    let fired = |what| shared.lock().fired(what);
    match fault {
        Fault::WorkerDies(host, pause) => {
            die(sim, shared, worker_name(host), now).then(|| fired("worker died"));
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
        Fault::LeadChanges => {
            let mut state = shared.lock();
            state.leader = (state.leader + 1) % COORDINATORS;
            state.fired("lead changed");
            None
        }
        Fault::WorkerCut(host, pause) => {
            sim.partition(worker_name(host), "switch");
            fired("worker cut off");
            Some(pause)
        }
        Fault::WorkerMute(host, pause) => {
            sim.partition_oneway(worker_name(host), "switch");
            fired("worker mute");
            Some(pause)
        }
        Fault::CoordinatorCut(pause) => {
            (0..COORDINATORS).for_each(|host| sim.partition(coordinator_name(host), "switch"));
            fired("coordinator cut off");
            Some(pause)
        }
        Fault::WorkerFreezes(host, pause) => {
            sim.hold(worker_name(host), "switch");
            fired("worker frozen");
            Some(pause)
        }
        Fault::CoordinatorFreezes(pause) => {
            (0..COORDINATORS).for_each(|host| sim.hold(coordinator_name(host), "switch"));
            fired("coordinator frozen");
            Some(pause)
        }
        Fault::Slow(most, pause) => {
            sim.set_max_message_latency(most);
            fired("slow network");
            Some(pause)
        }
        Fault::LogFull(writes) => {
            shared.lock().disk.full = writes;
            None
        }
        Fault::StoreFull(pause) => {
            shelf.fill(true);
            fired("store full");
            Some(pause)
        }
        Fault::ClockJumps(jump) => {
            shared.lock().ahead += jump;
            fired("clock jumped");
            None
        }
    }
}

fn end_fault(sim: &mut Sim<'_>, fault: Fault, shared: &Shared, shelf: &Shelf) {
    match fault {
        Fault::WorkerDies(host, _) => start(sim, worker_name(host)),
        Fault::CoordinatorDies(_) => (0..COORDINATORS).for_each(|host| start(sim, coordinator_name(host))),
        Fault::WorkerCut(host, _) => sim.repair(worker_name(host), "switch"),
        Fault::WorkerMute(host, _) => sim.repair_oneway(worker_name(host), "switch"),
        Fault::CoordinatorCut(_) => (0..COORDINATORS).for_each(|host| sim.repair(coordinator_name(host), "switch")),
        Fault::WorkerFreezes(host, _) => sim.release(worker_name(host), "switch"),
        Fault::CoordinatorFreezes(_) => {
            (0..COORDINATORS).for_each(|host| sim.release(coordinator_name(host), "switch"));
        }
        Fault::Slow(..) => sim.set_max_message_latency(Duration::from_millis(15)),
        Fault::StoreFull(_) => shelf.fill(false),
        Fault::LogFull(_) => shared.lock().disk.full = 0,
        Fault::DiesBeforeWrite(_) | Fault::DiesAfterWrite(_) | Fault::LeadChanges | Fault::ClockJumps(_) => {}
    }
}

/// Whatever is broken is mended, and whoever is dead lives.
fn make_peace(sim: &mut Sim<'_>, shared: &Shared, shelf: &Shelf) {
    let hosts = (0..COORDINATORS).map(coordinator_name).chain((0..WORKERS).map(worker_name));
    for host in hosts {
        sim.release(host.as_str(), "switch");
        sim.repair(host.as_str(), "switch");
        start(sim, host);
    }
    sim.set_max_message_latency(Duration::from_millis(15));
    shelf.fill(false);
    let mut state = shared.lock();
    (state.trap, state.disk.full, state.twice, state.late) = (None, 0, 0, 0);
}

/// Kills a process; `false` if it was dead.
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

/// A coordinator: stands by until it leads, and again when it leads no more.
async fn coordinator(seed: u64, host: usize, stage: &'static Stage, shared: Shared, store: Store) -> turmoil::Result {
    loop {
        while shared.lock().leader != host {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        let log = Log::lead(&shared, host);
        let started = tokio::time::Instant::now();
        let clock = shared.clone();
        let config = Config {
            snapshot: 25,
            scheduler: femc_schedule::Config { group: stage::group(seed), ..stage.schedule.clone() },
            time: Time::by(move || started.elapsed() + clock.lock().ahead),
            ..Config::default()
        };
        shared.note(|| format!("c{host} leads"));
        let failed = async {
            match Coordinator::on(listen().await, config, store.clone(), log).await {
                Ok(mut handle) => handle.failed().await,
                Err(error) => error,
            }
        };
        // One that leads no more finds out at its next write; one that has nothing to write, after a while.
        let dethroned = async {
            while shared.lock().leader == host {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
            tokio::time::sleep(shared.pause(Duration::from_secs(10))).await;
        };
        tokio::select! {
            biased;
            error = failed => shared.note(|| format!("c{host} fails: {error}")),
            () = dethroned => shared.note(|| format!("c{host} leads no more")),
        }
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
}

async fn worker(seed: u64, host: usize, stage: &'static Stage, shared: Shared) -> turmoil::Result {
    let boot = {
        let mut state = shared.lock();
        state.boots += 1;
        state.boots
    };
    let config = femc_worker::Config {
        name: worker_name(host),
        threads: 1,
        cache: CACHE.clone(),
        instance: boot,
        dial: dial(),
        hands: Hands::Simulated(Pace::by(move |assignment| pace(seed, stage, assignment))),
        ..femc_worker::Config::new(url("switch"))
    };
    Ok(Worker::run(config, std::future::pending()).await?)
}

/// From a fifth of a second to three seconds; where tiles are cut, from a twentieth to a half a sample.
fn pace(seed: u64, stage: &Stage, assignment: &Assignment) -> Duration {
    let name = format!("{seed} {} {}", assignment.task, assignment.epoch.0);
    let hash = blake3::hash(name.as_bytes());
    let draw = u64::from(u16::from_le_bytes([hash.as_bytes()[0], hash.as_bytes()[1]]));
    let between = |least: u64, most: u64| Duration::from_millis(least + draw * (most - least) / 65_536);
    match &assignment.work {
        Work::Render { samples, .. } if stage.is_cut() => between(50, 500) * samples.len() as u32,
        Work::Render { .. } => between(200, 3_000),
        Work::Gather { .. } | Work::Merge { .. } => between(200, 1_000),
    }
}

/// Submits the job, waits for its end, fetches its frames; never gives up.
async fn person(shared: Shared, stage: &'static Stage) -> turmoil::Result {
    let job = insist(&shared, async |client: Client| {
        client.put(stage.bundle.clone()).await?;
        client.submit(Some("haze".into()), stage.spec.clone()).await
    })
    .await;
    let status = loop {
        let status = insist(&shared, async |client: Client| client.status(job).await).await;
        if status.state.has_ended() {
            break status;
        }
        tokio::time::sleep(Duration::from_millis(400)).await;
    };
    let pixels = insist(&shared, async |client: Client| frames(&client, job).await).await;
    let pixels = pixels.into_iter().map(stage::pixels).collect::<anyhow::Result<_>>()?;
    let end: (JobStatus, Vec<String>) = (status, pixels);
    let mut state: std::sync::MutexGuard<'_, State> = shared.lock();
    state.end = Some(end);
    Ok(())
}

async fn frames(client: &Client, job: JobId) -> Result<Vec<bytes::Bytes>, CallError> {
    let mut files = Vec::new();
    for frame in client.frames(job).await? {
        files.push(client.get(&frame.image.digest, frame.image.bytes).await?);
    }
    Ok(files)
}

/// Asks the coordinator that leads until it answers.
async fn insist<T>(shared: &Shared, ask: impl AsyncFn(Client) -> Result<T, CallError>) -> T {
    loop {
        let leader = url(&coordinator_name(shared.lock().leader));
        let answer = tokio::time::timeout(Duration::from_secs(5), async {
            let client = Client::connect_by(&dial(), &leader).await?;
            ask(client).await
        });
        match answer.await {
            Ok(Ok(answer)) => return answer,
            Ok(Err(error)) => shared.note(|| format!("person: {error}")),
            Err(_) => shared.note(|| "person: no answer".into()),
        }
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
}
