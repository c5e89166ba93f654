//! Working hours of a worker: at their end it finishes the running task and gives back the rest.

use std::future::pending;
use std::time::Duration;

use crate::common;
use crate::common::{Net, job, job_of, simulated};
use femc_coordinator::{Config, Coordinator};
use femc_model::*;
use femc_proto::Client;
use femc_queue::Memory;
use femc_store::Store;
use femc_worker::{Availability, Worker, WorkingHours};
use tokio::time::Instant;

#[tokio::test(start_paused = true)]
async fn off_duty_worker_finishes_task_and_begins_none_until_on_duty() {
    let (net, connections) = Net::new();
    let config = Config { time: common::time(), ..Config::default() };
    let farm = Coordinator::start_on_stream(connections, config, Store::in_memory(), Memory::default()).await.unwrap();
    let client = Client::connect_with(&net.open(), "http://farm:7878").await.unwrap();
    // Eight tiles of a second each. The worker is off duty from the third second to the tenth.
    let (spec, bundle) = job_of(4, 8);
    client.put(bundle.into()).await.unwrap();
    let id = client.submit(None, spec).await.unwrap();
    let begun = Instant::now();
    let working_hours = WorkingHours::from_fn(move || {
        if (3..10).contains(&begun.elapsed().as_secs()) { Availability::Off } else { Availability::Available }
    });
    let config = femc_worker::Config { working_hours, ..simulated("w", net.open(), Duration::from_millis(1000)) };
    tokio::spawn(Worker::run(config, pending()));
    let at = async |seconds: u64| {
        tokio::time::sleep_until(begun + Duration::from_millis(seconds * 1000 + 800)).await;
        client.workers().await.unwrap().remove(0)
    };
    let before = at(2).await;
    assert!(before.completed >= 1 && before.tasks.len() > 1 && before.intake == Intake::Open, "{before:?}");
    let after = at(4).await;
    assert_eq!((after.tasks.len(), after.intake), (0, Intake::Off), "it holds nothing: {after:?}");
    assert!(after.completed > before.completed, "what it was at is done");
    let later = at(9).await;
    assert_eq!((later.completed, later.failed), (after.completed, 0));
    assert_eq!(client.status(id).await.unwrap().waits, [WaitReason::WorkersDraining { workers: 1 }]);
    let again = at(12).await;
    assert!(again.completed > later.completed && again.intake == Intake::Open, "{again:?}");
    let mut watch = client.watch(id).await.unwrap();
    let mut last = None;
    while let Some(status) = watch.next().await.unwrap() {
        last = Some(status);
    }
    assert_eq!(last.unwrap().state, JobState::Done);
    farm.stop().await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_worker_that_starts_outside_its_hours_does_nothing() {
    let (net, connections) = Net::new();
    let config = Config { time: common::time(), ..Config::default() };
    let farm = Coordinator::start_on_stream(connections, config, Store::in_memory(), Memory::default()).await.unwrap();
    let client = Client::connect_with(&net.open(), "http://farm:7878").await.unwrap();
    let (spec, bundle) = job(4);
    client.put(bundle.into()).await.unwrap();
    let id = client.submit(None, spec).await.unwrap();
    let working_hours = WorkingHours::from_fn(|| Availability::Off);
    let config = femc_worker::Config { working_hours, ..simulated("w", net.open(), Duration::from_millis(100)) };
    tokio::spawn(Worker::run(config, pending()));
    tokio::time::sleep(Duration::from_secs(20)).await;
    let status = client.status(id).await.unwrap();
    assert_eq!((status.state, status.samples_done), (JobState::Queued, 0), "{status:?}");
    assert_eq!((client.workers().await.unwrap()[0].intake, status.quarantined), (Intake::Off, vec![]));
    farm.stop().await.unwrap();
}
