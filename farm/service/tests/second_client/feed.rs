//! Law of the feed: every listener knows the farm, with any other listeners.
//!
//! Each listener of a random schedule applies the events to its own small model, as `docs/http.md` says. The farm under the feed is
//! the same kind of model, so both sides are compared without the code of the feed.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use femc_model::{Intake, JobId, JobState, JobStatus, OfflineWorker, Refusal, WorkerId, WorkerList, WorkerStatus};
use femc_service::{Body, Call, ChangeScope, Changes, Farm, Gate, Http, Site};
use femc_store::Store;
use http::header::HeaderName;
use http_body_util::BodyExt as _;
use serde_json::Value;
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep, timeout};

use crate::common::{Random, job_status, open_gate, send, serve};

/// Interval between two queries of the feed.
const INTERVAL: Duration = Duration::from_secs(1);

/// Farm as users see it.
#[derive(Debug, Clone, Default, PartialEq)]
struct Model {
    /// Priority and state by the number of the job.
    jobs: BTreeMap<u64, (u64, String)>,
    /// Number of results by the number of the worker.
    workers: BTreeMap<u64, u64>,
    offline: Vec<String>,
    warnings: Vec<String>,
}

impl Model {
    /// Applies an event.
    fn apply(&mut self, kind: &str, data: &Value) {
        if kind == "snapshot" {
            *self = Self::default();
        }
        for job in list(data, "jobs") {
            self.jobs.insert(number(&job["job"]), Self::job(job));
        }
        for worker in list(data, "workers") {
            self.workers.insert(number(&worker["worker"]), number(&worker["completed"]));
        }
        if kind == "delta" {
            self.jobs.retain(|job, _| !list(data, "gone_jobs").iter().any(|gone| number(gone) == *job));
            self.workers.retain(|worker, _| !list(data, "gone_workers").iter().any(|gone| number(gone) == *worker));
        }
        if let Some(offline) = data["offline"].as_array() {
            self.offline = offline.iter().map(|worker| text(&worker["name"])).collect();
        }
        if let Some(warnings) = data["warnings"].as_array() {
            self.warnings = warnings.iter().map(text).collect();
        }
    }

    fn job(job: &Value) -> (u64, String) {
        (number(&job["priority"]), text(&job["state"]))
    }

    /// Returns the parts of a delta that say nothing new.
    fn repeated(&self, data: &Value) -> Vec<String> {
        let is_known_job = |job: &&Value| self.jobs.get(&number(&job["job"])) == Some(&Self::job(job));
        let is_known_worker =
            |worker: &&Value| self.workers.get(&number(&worker["worker"])) == Some(&number(&worker["completed"]));
        let mut repeated: Vec<String> = list(data, "jobs").iter().filter(is_known_job).map(Value::to_string).collect();
        repeated.extend(list(data, "workers").iter().filter(is_known_worker).map(Value::to_string));
        let gone_jobs = list(data, "gone_jobs").iter().filter(|job| !self.jobs.contains_key(&number(job)));
        repeated.extend(gone_jobs.map(|job| format!("job {job} is gone")));
        let gone = list(data, "gone_workers").iter().filter(|worker| !self.workers.contains_key(&number(worker)));
        repeated.extend(gone.map(|worker| format!("worker {worker} is gone")));
        let offline = data["offline"].as_array().map(|all| all.iter().map(|it| text(&it["name"])).collect::<Vec<_>>());
        repeated.extend(offline.filter(|it| *it == self.offline).map(|it| format!("offline {it:?}")));
        let warnings = data["warnings"].as_array().map(|all| all.iter().map(text).collect::<Vec<_>>());
        repeated.extend(warnings.filter(|it| *it == self.warnings).map(|it| format!("warnings {it:?}")));
        repeated
    }
}

fn list<'a>(data: &'a Value, field: &str) -> &'a [Value] {
    data[field].as_array().map_or(&[], Vec::as_slice)
}

fn number(value: &Value) -> u64 {
    value.as_u64().expect("a number")
}

fn text(value: &Value) -> String {
    value.as_str().expect("a text").to_owned()
}

/// State of a farm for its feed.
#[derive(Debug, Default)]
pub struct FarmState {
    now: Model,
    /// Jobs that changed since the previous query.
    touched: BTreeSet<u64>,
    is_refusing: bool,
    /// Time that each query takes.
    delay: Duration,
    queries: u64,
}

const REFUSAL: &str = "the log is full";

impl FarmState {
    /// Answers a query with as little as the documentation of [`Changes`] permits.
    fn changes(&mut self, scope: ChangeScope) -> Result<Changes, Refusal> {
        self.queries += 1;
        if self.is_refusing {
            return Err(Refusal::Unavailable { message: REFUSAL.into() });
        }
        let touched = std::mem::take(&mut self.touched);
        let is_wanted =
            |number: u64, state: &str| scope == ChangeScope::All || state != "done" || touched.contains(&number);
        let jobs = self.now.jobs.iter().filter(|(number, (_, state))| is_wanted(**number, state));
        let status = |(number, (priority, state)): (&u64, &(u64, String))| -> JobStatus {
            let state = if state == "done" { JobState::Done } else { JobState::Running };
            job_status(JobId(*number), u8::try_from(*priority).expect("a priority"), state)
        };
        // A silence below 3 s is no change.
        let silent = self.queries * 700 % 2900;
        let connected = self.now.workers.iter().map(|(number, completed)| worker(*number, *completed, silent));
        let offline = self.now.offline.iter().map(|name| OfflineWorker {
            name: name.clone(),
            threads: 1,
            tags: Vec::new(),
            engine: String::new(),
            last_contact: 1500,
        });
        Ok(Changes {
            jobs: jobs.map(status).collect(),
            existing_jobs: self.now.jobs.keys().map(|number| JobId(*number)).collect(),
            workers: WorkerList { connected: connected.collect(), offline: offline.collect() },
            warnings: self.now.warnings.clone(),
        })
    }

    /// Changes something that users see.
    pub fn change(&mut self, random: &mut Random) {
        let number = 1 + random.below(6) as u64;
        match random.below(8) {
            0 => {
                self.now.jobs.remove(&number);
            }
            1..=3 => {
                let state = *random.pick(&["running", "done"]);
                self.now.jobs.insert(number, (random.below(3) as u64, state.to_owned()));
                self.touched.insert(number);
            }
            4 => {
                self.now.workers.remove(&number);
            }
            5 => *self.now.workers.entry(number).or_default() += 1,
            6 => {
                let names = ["w1", "w2", "w3"][random.below(4).min(2)..].iter();
                self.now.offline = names.map(ToString::to_string).collect();
            }
            _ => self.now.warnings = vec!["the disk is nearly full".to_owned(); random.below(3)],
        }
    }
}

fn worker(number: u64, completed: u64, silent: u64) -> WorkerStatus {
    WorkerStatus {
        worker: WorkerId(number),
        name: format!("w{number}"),
        threads: 1,
        tags: Vec::new(),
        tasks: Vec::new(),
        silent,
        completed,
        failed: 0,
        intake: Intake::Open,
        engine: String::new(),
    }
}

/// Starts a coordinator of a farm.
pub fn start(state: &Arc<Mutex<FarmState>>, gate: Gate) -> Http<()> {
    let (calls, mut inbox) = mpsc::channel(8);
    let state = state.clone();
    tokio::spawn(async move {
        while let Some(call) = inbox.recv().await {
            let Call::Changes { scope, reply } = call else { panic!("unexpected call {call:?}") };
            let delay = state.lock().unwrap().delay;
            if !delay.is_zero() {
                sleep(delay).await;
            }
            let answer = state.lock().unwrap().changes(scope);
            drop(reply.send(answer));
        }
    });
    serve(Farm::new(calls), Store::in_memory(), gate, Site::default())
}

/// Knowledge of a client, which it keeps while it is disconnected.
#[derive(Debug, Clone, Default)]
struct Memory {
    /// Id of the last event; empty: none.
    id: String,
    /// Start of the coordinator that sent the event.
    start: u32,
    known: Model,
}

/// A connected client.
struct Listener {
    body: Body,
    memory: Memory,
    /// Start of the coordinator.
    start: u32,
    /// Whether the first event must be a snapshot. Later events are deltas.
    wants_snapshot: bool,
}

/// Place of the id in a request.
#[derive(Debug, Clone, Copy)]
enum IdPlace {
    Query,
    Header,
}

/// Counts of what the schedules contain.
#[derive(Debug, Default)]
struct Counts {
    snapshots: u32,
    deltas: u32,
    large_deltas: u32,
    resumed: u32,
    handovers: u32,
}

impl Listener {
    /// Connects with this id, in the query of the URL or in the header.
    async fn arrive(http: &Http<()>, id: &str, memory: Memory, place: IdPlace) -> Self {
        let header = (HeaderName::from_static("last-event-id"), id);
        let (line, headers) = match place {
            IdPlace::Query => (format!("GET /api/v1/feed?since={id}"), &[][..]),
            IdPlace::Header if id.is_empty() => ("GET /api/v1/feed".to_owned(), &[][..]),
            IdPlace::Header => ("GET /api/v1/feed".to_owned(), &[header][..]),
        };
        let response = send(http, &line, headers).await;
        assert_eq!(response.status(), 200);
        Self { body: response.into_body(), memory, start: 0, wants_snapshot: true }
    }

    /// Waits for an event this long and applies it. Returns whether there was one. Keep-alives are no events.
    async fn read(&mut self, patience: Duration, counts: &mut Counts) -> bool {
        let until = Instant::now() + patience;
        let (kind, id, data) = loop {
            let Ok(frame) = timeout(until - Instant::now(), self.body.frame()).await else { return false };
            let bytes = frame.expect("the feed goes on").expect("no error").into_data().expect("data");
            let event = std::str::from_utf8(&bytes).expect("text");
            if event.starts_with(':') {
                continue;
            }
            let field = |name: &str| event.lines().find_map(|line| line.strip_prefix(name)).unwrap_or_default();
            let data: Value = serde_json::from_str(field("data: ")).expect("JSON");
            break (field("event: ").to_owned(), field("id: ").to_owned(), data);
        };
        assert_eq!(data["seq"], id.as_str());
        let due = if self.wants_snapshot { "snapshot" } else { "delta" };
        assert_eq!(kind, due, "{id} after {}", self.memory.id);
        if kind == "delta" {
            let [before, after] = [&self.memory.id, &id].map(|id| id.split_once('-').expect("a start and a number"));
            assert_eq!(before.0, after.0, "a delta is of the start that the client knows");
            let [before, after] = [before.1, after.1].map(|number| number.parse::<u64>().expect("a number"));
            assert!(before < after, "{after} after {before}");
            if after == before + 1 {
                assert_eq!(self.memory.known.repeated(&data), [""; 0], "the client knows this already");
            } else {
                counts.large_deltas += 1;
            }
            let lists =
                ["jobs", "gone_jobs", "workers", "gone_workers"].iter().any(|field| !list(&data, field).is_empty());
            assert!(lists || !data["offline"].is_null() || !data["warnings"].is_null(), "an empty delta: {data}");
            counts.deltas += 1;
        } else {
            counts.snapshots += 1;
        }
        self.memory.known.apply(&kind, &data);
        (self.memory.id, self.memory.start, self.wants_snapshot) = (id, self.start, false);
        true
    }
}

/// A random schedule of listeners and changes.
struct Schedule {
    random: Random,
    state: Arc<Mutex<FarmState>>,
    http: Http<()>,
    listeners: Vec<Listener>,
    /// Disconnected clients.
    away: Vec<Memory>,
    /// Number of the coordinator's start.
    start: u32,
    changed_at: Instant,
    counts: Counts,
}

impl Schedule {
    fn new(seed: u64) -> Self {
        let mut random = Random(seed);
        let delay = Duration::from_millis(*random.pick(&[0, 0, 300]));
        let state = Arc::new(Mutex::new(FarmState { delay, ..FarmState::default() }));
        (0..random.below(12)).for_each(|_| state.lock().unwrap().change(&mut random));
        let http = start(&state, open_gate());
        let (listeners, away, changed_at) = (Vec::new(), Vec::new(), Instant::now());
        Self { random, state, http, listeners, away, start: 0, changed_at, counts: Counts::default() }
    }

    /// Longest time from a change of the farm until the feed has it.
    fn bound(&self) -> Duration {
        INTERVAL + 2 * self.state.lock().unwrap().delay
    }

    async fn arrive(&mut self) {
        let mut memory = Memory::default();
        let mut id = String::new();
        match self.random.below(4) {
            0 => id = (*self.random.pick(&["7-1", "-", "x", "0", "18eb8561cfbd92e0-41"])).to_owned(),
            1 | 2 if !self.away.is_empty() => {
                let place = self.random.below(self.away.len());
                memory = self.away.swap_remove(place);
                id.clone_from(&memory.id);
                self.counts.resumed += 1;
            }
            _ => {}
        }
        let is_known = !id.is_empty() && id == memory.id && memory.start == self.start;
        let place = *self.random.pick(&[IdPlace::Query, IdPlace::Header]);
        let mut listener = Listener::arrive(&self.http, &id, memory, place).await;
        (listener.start, listener.wants_snapshot) = (self.start, !is_known);
        if listener.wants_snapshot && self.random.below(3) > 0 {
            let wait = self.state.lock().unwrap().delay + Duration::from_millis(1);
            assert!(listener.read(wait, &mut self.counts).await, "a new listener gets a snapshot at once");
            let state = self.state.lock().unwrap();
            if !state.is_refusing && self.changed_at.elapsed() > INTERVAL + 3 * state.delay {
                assert_eq!(listener.memory.known, state.now, "the snapshot of a silent farm");
            }
        }
        self.listeners.push(listener);
    }

    fn leave(&mut self) {
        if !self.listeners.is_empty() {
            let place = self.random.below(self.listeners.len());
            self.away.push(self.listeners.swap_remove(place).memory);
        }
    }

    async fn step(&mut self) {
        match self.random.below(16) {
            0..=2 => self.arrive().await,
            3 | 4 => self.leave(),
            5 => {
                // The last listener leaves just before another arrives.
                self.away.extend(self.listeners.drain(..).map(|listener| listener.memory));
                sleep(Duration::from_millis(*self.random.pick(&[0, 0, 1, 400, 999, 1000, 1001, 2100]))).await;
                self.counts.handovers += 1;
                self.arrive().await;
            }
            6 | 7 if !self.listeners.is_empty() => {
                let place = self.random.below(self.listeners.len());
                self.listeners[place].read(Duration::from_millis(1), &mut self.counts).await;
            }
            8..=10 => {
                self.state.lock().unwrap().change(&mut self.random);
                self.changed_at = Instant::now();
            }
            11 if self.random.below(4) == 0 => {
                let mut state = self.state.lock().unwrap();
                state.is_refusing = !state.is_refusing;
                self.changed_at = Instant::now();
            }
            12 if self.random.below(6) == 0 => {
                // Another start of the coordinator: every id becomes invalid.
                self.away.extend(self.listeners.drain(..).map(|listener| listener.memory));
                self.http = start(&self.state, open_gate());
                self.start += 1;
            }
            _ => {
                let pause = *self.random.pick(&[0, 1, 100, 500, 999, 1000, 1001, 1500, 5000]);
                sleep(Duration::from_millis(pause)).await;
            }
        }
    }

    /// Checks that all listeners know the farm after two query intervals, and that a silent farm has no news.
    async fn settle(&mut self) {
        self.state.lock().unwrap().is_refusing = false;
        sleep(2 * self.bound()).await;
        let now = self.state.lock().unwrap().now.clone();
        for listener in &mut self.listeners {
            let mut events = 0;
            while listener.read(Duration::from_millis(1), &mut self.counts).await {
                events += 1;
            }
            assert!(events <= 1, "{events} events were queued for a slow listener");
            assert_eq!(listener.memory.known, now, "the listener knows the farm");
        }
        for listener in &mut self.listeners {
            assert!(!listener.read(3 * INTERVAL, &mut self.counts).await, "a silent farm has no news");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn every_listener_knows_the_farm_beside_any_others() {
    let mut counts = [0; 5];
    for seed in 0..400 {
        eprintln!("seed {seed}");
        let mut schedule = Schedule::new(seed);
        for step in 0..60 {
            schedule.step().await;
            if step % 20 == 19 {
                schedule.settle().await;
            }
        }
        let Counts { snapshots, deltas, large_deltas, resumed, handovers } = schedule.counts;
        let own = [snapshots, deltas, large_deltas, resumed, handovers];
        counts.iter_mut().zip(own).for_each(|(sum, own)| *sum += own);
    }
    assert!(counts.iter().all(|&count| count > 200), "the schedules contain everything: {counts:?}");
}
