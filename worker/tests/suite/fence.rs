//! A worker stops relying on its leases before the coordinator can have granted them to others.

use std::future::pending;
use std::time::Duration;

use crate::common;
use crate::common::{LinkState, Net, job, simulated};
use femc_coordinator::{Config, Coordinator};
use femc_model::*;
use femc_proto::{Call, Client, Server, Session};
use femc_queue::Memory;
use femc_store::Store;
use femc_worker::Worker;
use tokio::sync::{mpsc, watch};
use tokio::time::{Instant, timeout};

/// Lease duration of the scripted coordinator, milliseconds.
const LEASE: u64 = 1600;
const HEARTBEAT: u64 = 100;

/// Waits for the next session that the worker opens.
async fn session(calls: &mut mpsc::Receiver<Call>) -> Session {
    match calls.recv().await {
        Some(Call::Session(session)) => *session,
        other => panic!("no session: {other:?}"),
    }
}

fn left(assignment: &Assignment, left: u64) -> Vec<LeaseStatus> {
    vec![LeaseStatus { task: assignment.task, epoch: assignment.epoch, remaining: left }]
}

#[tokio::test(start_paused = true)]
async fn worker_of_silent_coordinator_reports_only_with_renewed_lease() {
    let (spec, bundle) = job(4);
    let store = Store::in_memory();
    store.put(bundle.into()).await.unwrap();
    let ((net, connections), (send, mut calls)) = (Net::new(), mpsc::channel(16));
    tokio::spawn(Server::new(send, store).serve(connections, pending()));
    let config = simulated("w", net.open(), Duration::from_millis(4000));
    tokio::spawn(Worker::run(config, pending()));

    // The coordinator answers for half a second, then stops.
    let mut first = session(&mut calls).await;
    let stage = Stage { frame: 1, round: 0, number: 0, kind: StageKind::Render };
    let task = TaskKey { job: JobId(7), stage, index: 0 };
    let epoch = Epoch::new(3, 1);
    let (inputs, taken, more) = (vec![], StepsTaken::default(), NextRound::Impossible);
    let work = TaskSpec {
        item: 0,
        steps: 0..4,
        inputs,
        hints: Vec::new(),
        steps_taken: taken,
        next_round: more,
        elapsed: 0,
        busy_seconds: 0.0,
    };
    let assignment = Assignment { task, epoch, lease: LEASE, copy_of: None, spec: work };
    let welcome = ToWorker::Welcome { worker: WorkerId(1), heartbeat: HEARTBEAT, lease: LEASE };
    first.out.send(welcome.clone()).await.unwrap();
    first.out.send(ToWorker::Job { job: JobId(7), spec: Box::new(spec.clone()) }).await.unwrap();
    first.out.send(ToWorker::Assign(assignment.clone())).await.unwrap();
    let (begun, mut answered, mut heartbeats) = (Instant::now(), Instant::now(), 0);
    while let Some(message) = first.messages.next().await {
        let FromWorker::Heartbeat { number, tasks, .. } = message.unwrap() else { panic!("only heartbeats") };
        heartbeats += 1;
        // The worker may have sent the first heartbeat before the task arrived.
        if number > 1 && answered.elapsed() < Duration::from_millis(LEASE - 2 * HEARTBEAT) {
            assert_eq!(tasks.len(), 1, "the lease is sure to hold");
        }
        if begun.elapsed() < Duration::from_millis(500) {
            answered = Instant::now();
            first
                .out
                .send(ToWorker::Renewed { heartbeat: number, leases: left(&assignment, LEASE), intake: Intake::Open })
                .await
                .unwrap();
        }
    }
    let silent = answered.elapsed();
    println!("{heartbeats} heartbeats; the session ended {silent:?} after the last answer");
    assert!(heartbeats > 10, "it went on while the lease was sure to hold");
    assert!(silent < Duration::from_millis(LEASE), "it ended before the lease did: {silent:?}");

    // The worker reconnects with the lease and finishes the task. It does not report it, because the coordinator has not said that
    // the lease holds.
    let mut second = session(&mut calls).await;
    assert_eq!(second.registration.held, [HeldLease { task, epoch, steps: 0..4, job: spec.key() }]);
    second.out.send(welcome).await.unwrap();
    let mut last = 0;
    while begun.elapsed() < Duration::from_millis(5000) {
        let message = second.messages.next().await.unwrap().unwrap();
        let FromWorker::Heartbeat { number, tasks, .. } = message else {
            panic!("reported without a lease: {message:?}")
        };
        assert_eq!(tasks, [], "it is not claimed either");
        last = number;
        second.out.send(ToWorker::Renewed { heartbeat: number, leases: vec![], intake: Intake::Open }).await.unwrap();
    }
    second
        .out
        .send(ToWorker::Renewed { heartbeat: last, leases: left(&assignment, LEASE), intake: Intake::Open })
        .await
        .unwrap();
    let next = second.messages.next().await.unwrap().unwrap();
    assert!(matches!(next, FromWorker::Heartbeat { .. }), "an answer that was heard before says nothing: {next:?}");
    let FromWorker::Heartbeat { number, .. } = next else { return };
    second
        .out
        .send(ToWorker::Renewed { heartbeat: number, leases: left(&assignment, LEASE), intake: Intake::Open })
        .await
        .unwrap();
    let reported = async {
        loop {
            match second.messages.next().await.unwrap().unwrap() {
                FromWorker::Heartbeat { .. } => {}
                FromWorker::Completed { task, epoch, .. } => return (task, epoch),
                other => panic!("{other:?}"),
            }
        }
    };
    assert_eq!(timeout(Duration::from_secs(1), reported).await.unwrap(), (task, epoch), "now it is");
}

#[tokio::test(start_paused = true)]
async fn partitioned_worker_costs_nothing_and_rejoins_afterwards() {
    let (net, connections) = Net::new();
    let config = Config { time: common::time(), ..Config::default() };
    let store = Store::in_memory();
    let farm = Coordinator::start_on_stream(connections, config, store, Memory::default()).await.unwrap();
    let client = Client::connect_with(&net.open(), "http://farm:7878").await.unwrap();
    let (spec, bundle) = job(4);
    client.put(bundle.into()).await.unwrap();
    let (state, is_open) = watch::channel(LinkState::Open);
    let cut_off = simulated("cut off", net.dial(is_open), Duration::from_millis(3000));
    tokio::spawn(Worker::run(cut_off, pending()));
    while client.workers().await.unwrap().is_empty() {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let id = client.submit(None, spec.clone()).await.unwrap();
    let mut watch = client.watch(id).await.unwrap();
    while watch.next().await.unwrap().unwrap().samples_done == 0 {}
    assert_eq!(client.workers().await.unwrap()[0].tasks.len(), 2, "it holds all that there is");

    state.send(LinkState::Frozen).unwrap();
    tokio::spawn(Worker::run(simulated("other", net.open(), Duration::from_millis(3000)), pending()));
    let mut last = None;
    while let Some(status) = watch.next().await.unwrap() {
        last = Some(status);
    }
    let status = last.unwrap();
    assert_eq!((status.state, status.samples_done), (JobState::Done, spec.grid.pixels() * 4), "{status:?}");
    let completed = |name: &'static str, workers: &[WorkerStatus]| {
        workers.iter().filter(|worker| worker.name == name).map(|worker| worker.completed).sum::<u64>()
    };
    assert_eq!(completed("other", &client.workers().await.unwrap()), 3, "two tiles and the image");

    // The isolated worker has finished both tiles meanwhile, but they are no longer needed.
    state.send(LinkState::Open).unwrap();
    let again = async {
        loop {
            tokio::time::sleep(Duration::from_millis(100)).await;
            let workers = client.workers().await.unwrap();
            let back: Vec<_> =
                workers.iter().filter(|worker| worker.name == "cut off" && worker.silent < 1000).cloned().collect();
            if let [back] = &back[..] {
                return back.clone();
            }
        }
    };
    let back = timeout(Duration::from_secs(60), again).await.unwrap();
    assert_eq!((back.tasks.len(), back.completed, back.failed), (0, 0, 0), "{back:?}");
    let more = client.submit(None, JobSpec { priority: 60, ..spec }).await.unwrap();
    let mut watch = client.watch(more).await.unwrap();
    let mut last = None;
    while let Some(status) = watch.next().await.unwrap() {
        last = Some(status);
    }
    assert_eq!(last.unwrap().state, JobState::Done);
    assert!(completed("cut off", &client.workers().await.unwrap()) > 0, "it works again");
    farm.stop().await.unwrap();
}
