//! Tests of snapshots: a snapshot must equal the previous snapshot plus the records since.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bytes::Bytes;
use femc_coordinator::{Config, Coordinator, QueueError, TimeSource};
use femc_model::*;
use femc_proto::{Client, SessionReceiver, SessionSender};
use femc_queue::{Batch, LogContents, Memory, NotePage, Queue};
use femc_schedule::{Fact, Ledger};
use femc_store::Store;

/// An in-memory log that compares each snapshot with the content that it replaces.
#[derive(Debug, Clone, Default)]
struct ComparingLog {
    log: Memory,
    /// For each snapshot: the number of records that it replaces, and whether it is equal to them.
    snapshots: Arc<Mutex<Vec<(usize, Comparison)>>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Comparison {
    Equal,
    Different,
}

impl ComparingLog {
    fn snapshots(&self) -> Vec<(usize, Comparison)> {
        self.snapshots.lock().unwrap().clone()
    }

    /// Waits until everything received so far is in a snapshot.
    async fn wait_for_snapshot(&self) {
        let before = self.snapshots().len();
        while self.snapshots().len() < before + 2 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }
}

impl Queue for ComparingLog {
    async fn load(&mut self) -> Result<LogContents, QueueError> {
        self.log.load().await
    }

    async fn append(&mut self, batch: Batch<'_>) -> Result<(), QueueError> {
        self.log.append(batch).await
    }

    async fn snapshot(&mut self, state: &[u8]) -> Result<(), QueueError> {
        let LogContents { snapshot, records, .. } = self.log.load().await?;
        let mut ledger = snapshot.map(|state| Ledger::decode(&state).unwrap()).unwrap_or_default();
        for record in &records {
            let (now, fact) = Fact::decode(record).unwrap();
            ledger.apply(&fact, now);
        }
        let says = if Ledger::decode(state).unwrap() == ledger { Comparison::Equal } else { Comparison::Different };
        self.snapshots.lock().unwrap().push((records.len(), says));
        self.log.snapshot(state).await
    }

    async fn notes(&mut self, subject: u64, from: u64) -> Result<NotePage, QueueError> {
        self.log.notes(subject, from).await
    }
}

const TILE: &[u8] = b"the bytes of a tile";

fn spec() -> JobSpec {
    JobSpec {
        name: "fog".into(),
        bundle: Digest::compute(b"bundle"),
        entry: "fog.mgf".into(),
        settings: "{}".into(),
        frames: (1..=8).collect(),
        grid: Grid { film: [16, 8], tile: 8 },
        graph: testing::frame_graph(Grid { film: [16, 8], tile: 8 }.sizes(), &[16], 0),
        contents: vec![],
        priority: 50,
        owner: "me".into(),
        tags: vec![],
        notes: JobNotes::default(),
    }
}

async fn worker(client: &Client, instance: u64) -> (SessionSender, SessionReceiver) {
    let registration = Registration {
        name: format!("worker {instance}"),
        instance,
        engine: "test".into(),
        threads: 1,
        slots: 1,
        tags: vec![],
        held: vec![],
        death: None,
    };
    client.session(registration).await.unwrap()
}

async fn lease(incoming: &mut SessionReceiver) -> Assignment {
    loop {
        if let ToWorker::Assign(lease) = incoming.next().await.unwrap().expect("the session goes on") {
            return lease;
        }
    }
}

fn done(lease: &Assignment) -> FromWorker {
    let outputs = vec![Output { role: Role::Tile, artifact: Artifact::from_bytes(TILE) }];
    let result = TaskResult { outputs, units: 1024, ..TaskResult::default() };
    let log =
        TaskLog { outcome: AttemptOutcome::Done, seconds: 1.0, text: LogText::Stored(Artifact::from_bytes(TILE)) };
    FromWorker::Completed { task: lease.task, epoch: lease.epoch, result, log: Some(log), usage: None }
}

fn panicked(lease: &Assignment) -> FromWorker {
    let failure = Failure::Panicked { message: "oops".into() };
    FromWorker::Failed { task: lease.task, epoch: lease.epoch, failure, log: None, usage: None }
}

#[tokio::test]
async fn snapshot_equals_previous_snapshot_plus_later_records() {
    // Each tick makes a snapshot, also a tick that produces facts itself.
    let (log, clock) = (ComparingLog::default(), Arc::new(AtomicU64::new(0)));
    let shown = clock.clone();
    let config = Config {
        snapshot_interval: 0,
        time: TimeSource::from_fn(move || Duration::from_millis(shown.load(Ordering::SeqCst))),
        scheduler: femc_schedule::Config { keep_ended: Some(0), regroup: 0, ..femc_schedule::Config::default() },
        ..Config::default()
    };
    let passes = |milliseconds| clock.fetch_add(milliseconds, Ordering::SeqCst);
    let farm = Coordinator::start_with(config, Store::in_memory(), log.clone()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    client.put(Bytes::from_static(b"bundle")).await.unwrap();
    client.put(Bytes::from_static(TILE)).await.unwrap();

    let (first, second) = (client.submit(Some("fog".into()), spec()).await.unwrap(), spec());
    let second = client.submit(None, JobSpec { owner: "eve".into(), ..second }).await.unwrap();
    client.control(second, Control::Priority(10)).await.unwrap();
    let (out, mut incoming) = worker(&client, 1).await;
    let leased = lease(&mut incoming).await;
    log.wait_for_snapshot().await;
    out.send(done(&leased)).await;
    let leased = lease(&mut incoming).await;
    out.send(panicked(&leased)).await;
    log.wait_for_snapshot().await;
    client.control(first, Control::Pause).await.unwrap();
    client.drain(WorkerSelector::Name("worker 1".into()), Drain::Begin).await.unwrap();
    log.wait_for_snapshot().await;
    // The lease time that workers used is charged to the owner. Their leases end.
    let (_another, mut incoming) = worker(&client, 2).await;
    lease(&mut incoming).await;
    passes(6_000);
    log.wait_for_snapshot().await;
    client.control(first, Control::Resume).await.unwrap();
    client.control(first, Control::Cancel).await.unwrap();
    log.wait_for_snapshot().await;
    // The job expires in the tick that makes a snapshot.
    passes(2_000);
    log.wait_for_snapshot().await;
    let left: Vec<JobId> = client.listing().await.unwrap().jobs.iter().map(|status| status.job).collect();
    assert_eq!(left, [second]);
    farm.stop().await.unwrap();

    let snapshots = log.snapshots();
    assert!(snapshots.iter().all(|(_, says)| *says == Comparison::Equal), "{snapshots:?}");
    assert!(snapshots.iter().filter(|(records, _)| *records > 0).count() >= 6, "{snapshots:?}");
}
