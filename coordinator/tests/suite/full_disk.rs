//! Tests of a full disk: the coordinator waits with its state, acknowledges nothing, and resumes.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use bytes::Bytes;
use femc_coordinator::{
    ArtifactStorage, Config, Coordinator, CoordinatorError, Handle, Leadership, LogStorage, Metrics, QueueError,
};
use femc_metrics::Health;
use femc_model::*;
use femc_proto::{CallError, Client, SessionReceiver, SessionSender};
use femc_queue::{Batch, LogContents, Memory, NotePage, Queue};
use femc_schedule::{Fact, Ledger};
use femc_store::Store;

/// An in-memory log on a medium that may be full.
#[derive(Debug, Clone, Default)]
struct LimitedLog {
    log: Memory,
    is_full: Arc<AtomicBool>,
    /// Whether there is never space for a snapshot.
    has_no_snapshots: bool,
    refused: Arc<AtomicUsize>,
}

impl LimitedLog {
    fn set_full(&self, is_full: bool) {
        self.is_full.store(is_full, Ordering::SeqCst);
    }

    fn admits(&self) -> Result<(), QueueError> {
        if self.is_full.load(Ordering::SeqCst) { self.refuse() } else { Ok(()) }
    }

    fn refuse(&self) -> Result<(), QueueError> {
        self.refused.fetch_add(1, Ordering::SeqCst);
        Err(QueueError::OutOfSpace { place: "the test".into(), message: "disk full".into() })
    }

    /// Waits until this many more writes were refused.
    async fn wait_for_refusals(&self, more: usize) {
        let from = self.refused.load(Ordering::SeqCst);
        while self.refused.load(Ordering::SeqCst) < from + more {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }

    /// Returns the ledger of a coordinator that would start now.
    async fn ledger(&self) -> Ledger {
        let LogContents { snapshot, records, .. } = self.log.clone().load().await.unwrap();
        let mut ledger = snapshot.map(|state| Ledger::decode(&state).unwrap()).unwrap_or_default();
        for record in records {
            let (now, fact) = Fact::decode(&record).unwrap();
            ledger.apply(&fact, now);
        }
        ledger
    }
}

impl Queue for LimitedLog {
    async fn load(&mut self) -> Result<LogContents, QueueError> {
        self.log.load().await
    }

    async fn append(&mut self, batch: Batch<'_>) -> Result<(), QueueError> {
        self.admits()?;
        self.log.append(batch).await
    }

    async fn snapshot(&mut self, state: &[u8]) -> Result<(), QueueError> {
        if self.has_no_snapshots {
            return self.refuse();
        }
        self.admits()?;
        self.log.snapshot(state).await
    }

    async fn notes(&mut self, subject: u64, from: u64) -> Result<NotePage, QueueError> {
        self.log.notes(subject, from).await
    }
}

const RESULT: &[u8] = b"a tile that nobody looks at";

fn spec() -> JobSpec {
    JobSpec {
        name: "fog".into(),
        bundle: Digest::compute(b"bundle"),
        entry: "fog.mgf".into(),
        settings: "{}".into(),
        frames: vec![1],
        grid: Grid { film: [64, 64], tile: 8 },
        graph: testing::frame_graph(Grid { film: [64, 64], tile: 8 }.sizes(), &[16], 0),
        contents: vec![],
        priority: 50,
        owner: "me".into(),
        tags: vec![],
        notes: JobNotes::default(),
    }
}

async fn farm(log: &LimitedLog, config: Config) -> (Handle, Client) {
    let farm = Coordinator::start_with(config, Store::in_memory(), log.clone()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    client.put(Bytes::from_static(b"bundle")).await.unwrap();
    client.put(Bytes::from_static(RESULT)).await.unwrap();
    (farm, client)
}

async fn worker(client: &Client) -> (SessionSender, SessionReceiver) {
    let registration = Registration {
        name: "one".into(),
        instance: 7,
        engine: "test".into(),
        threads: 1,
        slots: 1,
        tags: vec![],
        held: vec![],
        death: None,
    };
    client.session(registration).await.unwrap()
}

fn done(lease: &Assignment) -> FromWorker {
    let outputs = vec![Output { role: Role::Tile, artifact: Artifact::from_bytes(RESULT) }];
    let (task, epoch) = (lease.task, lease.epoch);
    let result = TaskResult { outputs, units: 1024, ..TaskResult::default() };
    FromWorker::Completed { task, epoch, result, log: None, usage: None }
}

async fn next<T>(incoming: &mut SessionReceiver, wanted: impl Fn(ToWorker) -> Option<T>) -> T {
    loop {
        if let Some(found) = wanted(incoming.next().await.unwrap().expect("the session goes on")) {
            return found;
        }
    }
}

fn refusal<T: std::fmt::Debug>(answer: Result<T, CallError>) -> Refusal {
    match answer {
        Err(CallError::Refused(refusal)) => refusal,
        other => panic!("not refused: {other:?}"),
    }
}

#[tokio::test]
async fn full_log_acknowledges_nothing_and_resumes_when_there_is_room() {
    let (log, metrics) = (LimitedLog::default(), Metrics::default());
    let (farm, client) = farm(&log, Config { metrics: metrics.clone(), ..Config::default() }).await;
    let job = client.submit(None, spec()).await.unwrap();
    let (out, mut incoming) = worker(&client).await;
    let assigned = |message| if let ToWorker::Assign(lease) = message { Some(lease) } else { None };
    let lease = next(&mut incoming, assigned).await;

    log.set_full(true);
    out.send(done(&lease)).await;
    log.wait_for_refusals(1).await;
    // New requests while the disk is full, and the heartbeat of a worker.
    assert!(matches!(refusal(client.submit(None, spec()).await), Refusal::NoRoom { .. }));
    let Refusal::Unavailable { message } = refusal(client.listing().await) else { panic!("another refusal") };
    assert!(message.contains("no room for the log in the test"), "{message}");
    assert!(matches!(refusal(client.control(job, Control::Pause).await), Refusal::Unavailable { .. }));
    let report = metrics.report(&Leadership::Leader).await;
    assert!(matches!(report.health, Health::Waiting { message } if message.contains("no room")));
    assert!(report.page.contains("femc_log_waits_for_room 1"));
    for number in 1..=3 {
        out.send(FromWorker::Heartbeat { number, tasks: vec![], usage: vec![] }).await;
        let answered = |message| match message {
            ToWorker::Renewed { heartbeat, .. } => Some(heartbeat),
            ToWorker::Accepted { .. } => panic!("told before it was durable"),
            _ => None,
        };
        assert_eq!(next(&mut incoming, answered).await, number, "its session goes on");
    }
    log.wait_for_refusals(2).await;
    assert_eq!(log.ledger().await.references().len(), 1, "the scene alone");

    log.set_full(false);
    let accepted = |message| if let ToWorker::Accepted { task, .. } = message { Some(task) } else { None };
    assert_eq!(next(&mut incoming, accepted).await, lease.task);
    assert_eq!(log.ledger().await.references().len(), 2, "and the tile, once");
    assert_eq!(client.listing().await.unwrap().jobs[0].job, job);
    client.submit(None, spec()).await.unwrap();
    assert_eq!(metrics.report(&Leadership::Leader).await.health, Health::Ready);
    farm.stop().await.unwrap();
}

#[tokio::test]
async fn command_refused_by_a_full_log_runs_when_there_is_room() {
    let log = LimitedLog::default();
    let (farm, client) = farm(&log, Config::default()).await;
    let job = client.submit(None, spec()).await.unwrap();
    log.set_full(true);
    // The first request that must be written. Later requests are refused.
    let Refusal::Unavailable { message } = refusal(client.control(job, Control::Pause).await) else {
        panic!("another refusal")
    };
    assert!(
        message.contains("no room for the log in the test") && message.contains("as soon as there is space"),
        "{message}"
    );
    log.wait_for_refusals(2).await;
    log.set_full(false);
    let paused = async {
        while !client.listing().await.is_ok_and(|farm| farm.jobs[0].state == JobState::Paused) {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(60), paused).await.expect("what was asked for is done");
    log.set_full(true);
    let key = || Some("once".to_owned());
    assert!(matches!(refusal(client.submit(key(), spec()).await), Refusal::Unavailable { .. }));
    log.wait_for_refusals(1).await;
    log.set_full(false);
    let submitted = async {
        loop {
            match client.submit(key(), spec()).await {
                Ok(job) => return job,
                Err(_) => tokio::time::sleep(Duration::from_millis(20)).await,
            }
        }
    };
    let second = tokio::time::timeout(Duration::from_secs(60), submitted).await.expect("it is taken");
    let jobs: Vec<JobId> = client.listing().await.unwrap().jobs.iter().map(|job| job.job).collect();
    assert_eq!(jobs, [job, second], "once");
    farm.stop().await.unwrap();
}

#[tokio::test]
async fn reports_during_a_full_log_are_accepted_when_there_is_room() {
    let log = LimitedLog::default();
    let (farm, client) = farm(&log, Config::default()).await;
    client.submit(None, spec()).await.unwrap();
    let (out, mut incoming) = worker(&client).await;
    let assigned = |message| if let ToWorker::Assign(lease) = message { Some(lease) } else { None };
    let (first, second) = (next(&mut incoming, assigned).await, next(&mut incoming, assigned).await);
    log.set_full(true);
    out.send(done(&first)).await;
    log.wait_for_refusals(1).await;
    out.send(done(&second)).await;
    log.wait_for_refusals(2).await;
    log.set_full(false);
    let accepted = |message| if let ToWorker::Accepted { task, .. } = message { Some(task) } else { None };
    let both = [next(&mut incoming, accepted).await, next(&mut incoming, accepted).await];
    assert_eq!(both, [first.task, second.task]);
    farm.stop().await.unwrap();
}

#[tokio::test]
async fn snapshot_without_room_is_skipped_and_a_stop_says_why_it_ends() {
    let log = LimitedLog { has_no_snapshots: true, ..LimitedLog::default() };
    let (farm, client) = farm(&log, Config { snapshot_interval: 1, ..Config::default() }).await;
    while log.refused.load(Ordering::SeqCst) == 0 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    client.submit(None, spec()).await.unwrap();
    assert_eq!(log.ledger().await.references().len(), 1, "records are still taken");
    log.set_full(true);
    let paused = tokio::spawn({
        let client = client.clone();
        async move { client.control(JobId(1), Control::Pause).await }
    });
    log.wait_for_refusals(1).await;
    let ended = farm.stop().await.unwrap_err();
    assert!(matches!(ended, CoordinatorError::Queue(QueueError::OutOfSpace { .. })), "{ended}");
    assert!(paused.await.unwrap().is_err(), "it was never told");
}

#[tokio::test]
async fn low_disk_space_warns_first_then_refuses_only_new_jobs() {
    let folder = tempfile::tempdir().unwrap();
    let free = femc_metrics::free_disk_bytes(folder.path()).unwrap();
    let config = |keep_free| Config {
        log: LogStorage::Sqlite(folder.path().join("log.sqlite")),
        artifacts: ArtifactStorage::Folder(folder.path().join("artifacts")),
        keep_free,
        ..Config::default()
    };
    for (keep_free, warnings, is_taken) in [(0, 0, true), (free / 2, 2, true), (2 * free, 2, false)] {
        let config = config(keep_free);
        let metrics = config.metrics.clone();
        let farm = Coordinator::start(config).await.unwrap();
        let client = Client::connect(&farm.url()).await.unwrap();
        client.put(Bytes::from_static(b"bundle")).await.unwrap();
        let before = client.listing().await.unwrap();
        assert_eq!(before.warnings.len(), warnings, "{:?}", before.warnings);
        let report = metrics.report(&Leadership::Leader).await;
        assert!(report.page.contains("femc_disk_free_bytes{holds=\"log\"}"), "{}", report.page);
        assert!(report.page.contains("femc_disk_free_bytes{holds=\"artifacts\"}"));
        match client.submit(None, spec()).await {
            Ok(job) => {
                assert!(is_taken);
                assert_eq!(report.health, Health::Ready);
                client.control(job, Control::Pause).await.unwrap();
            }
            Err(CallError::Refused(no @ Refusal::NoRoom { .. })) => {
                assert!(!is_taken && no.to_string().contains("femc gc"), "{no}");
                assert!(matches!(report.health, Health::Degraded { .. }));
                client.control(before.jobs[0].job, Control::Cancel).await.unwrap();
            }
            other => panic!("{other:?}"),
        }
        farm.stop().await.unwrap();
    }
}
