//! A worker is free for other tasks within a second of a cancellation, whatever the cancelled task is doing.
//!
//! The tests check the order of events, which does not depend on the load of the machine: the other job finishes while the
//! cancelled task would still run. They print how long it took.

use crate::common;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::future::pending;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use femc_coordinator::{Config, Coordinator};
use femc_import::Bundle;
use femc_model::*;
use femc_pipeline::{Method, SceneSource, Settings, StopCondition};
use femc_proto::Client;
use femc_worker::{Metrics, Worker};

/// Time limit for an event that is immediate on an idle machine.
const TEST_TIMEOUT: Duration = Duration::from_secs(60);

/// Returns the number of abandoned threads, which still run a cancelled task.
fn abandoned_threads(metrics: &Metrics) -> u64 {
    let page = metrics.report().page;
    let line = page.lines().find_map(|line| line.strip_prefix("femc_worker_threads_left_behind "));
    line.expect("the number of threads").parse().unwrap()
}

/// Waits until no cancelled task runs any longer.
async fn all_ended(metrics: &Metrics) {
    let begun = Instant::now();
    while abandoned_threads(metrics) > 0 {
        assert!(begun.elapsed() < TEST_TIMEOUT, "the cancelled task runs on");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Returns the time from the cancellation to the end of a small job that waited behind the cancelled one.
async fn free_after_cancel(client: &Client, endless: JobId) -> Duration {
    let (spec, bundle) = common::job(1);
    client.put(bundle.into()).await.unwrap();
    let small = client.submit(None, spec).await.unwrap();
    let mut watch = client.watch(small).await.unwrap();
    let begun = Instant::now();
    client.control(endless, Control::Cancel).await.unwrap();
    let mut last = None;
    while let Some(status) = watch.next().await.unwrap() {
        last = Some(status);
    }
    assert_eq!(last.unwrap().state, JobState::Done);
    let free = begun.elapsed();
    assert!(free < TEST_TIMEOUT, "the other job waited for the cancelled one: {free:?}");
    free
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn cancelled_render_task_ends_even_within_a_pixel() {
    let farm = Coordinator::start(Config::default()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let config = femc_worker::Config { threads: 1, ..femc_worker::Config::new(farm.url()) };
    let metrics = config.metrics.clone();
    let worker = tokio::spawn(Worker::run(config, pending()));
    // One pixel of this job takes minutes.
    let (spec, bundle) = common::job(1 << 24);
    client.put(bundle.into()).await.unwrap();
    let endless = client.submit(None, JobSpec { priority: 60, ..spec }).await.unwrap();
    while client.status(endless).await.unwrap().samples_done == 0 {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let free = free_after_cancel(&client, endless).await;
    println!("rendering: free for another job, and that done, {free:?} after the cancellation");
    all_ended(&metrics).await;
    worker.abort();
    farm.stop().await.unwrap();
}

/// Returns a bundle with a scene of `triangles` triangles.
fn large(triangles: u32) -> Bundle {
    let mut text = String::from(
        "camera main =\n    origin 0 -3 1\n    target 0 0 0\n    fov 40\n    film 32 16\nm a =\n    ed 1\n",
    );
    for i in 0..triangles {
        let (x, y) = (f64::from(i % 1000) * 0.01, f64::from(i / 1000) * 0.01);
        for (name, dx, dy) in [("a", 0.0, 0.0), ("b", 0.01, 0.0), ("c", 0.0, 0.01)] {
            let z = (x * 31.0 + y * 17.0).sin() * 0.1;
            writeln!(text, "v {name} =\n    p {} {} {z}", x + dx, y + dy).unwrap();
        }
        text.push_str("f a b c\n");
    }
    Bundle(BTreeMap::from([("haze.mgf".into(), text.into_bytes())]))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn cancelled_worker_is_free_before_large_scene_is_prepared() {
    let settings = Settings { stop: StopCondition::Spp(1), ..Settings::default() };
    // Find a scene that takes more than three seconds to read and prepare on this machine with this build.
    let mut triangles = 20_000;
    let (bundle, alone) = loop {
        let bundle = large(triangles);
        let begun = Instant::now();
        let scene = Arc::new(femc_import::load_scene(&bundle, "haze.mgf").unwrap().scene);
        femc_pipeline::prepare_frame(&SceneSource::new(scene.clone()), &settings, 1, None).unwrap();
        if begun.elapsed() > Duration::from_secs(3) {
            break (bundle.encode().unwrap(), begun.elapsed());
        }
        triangles *= 2;
    };
    let farm = Coordinator::start(Config::default()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let config = femc_worker::Config { threads: 1, ..femc_worker::Config::new(farm.url()) };
    let metrics = config.metrics.clone();
    let worker = tokio::spawn(Worker::run(config, pending()));
    let spec = JobSpec {
        name: "large".into(),
        bundle: Digest::compute(&bundle),
        settings: serde_json::to_string(&settings).unwrap(),
        priority: 60,
        ..common::job(1).0
    };
    client.put(bundle.into()).await.unwrap();
    let heavy = client.submit(None, spec).await.unwrap();
    while client.status(heavy).await.unwrap().workers == 0 {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    tokio::time::sleep(Duration::from_millis(300)).await;
    let status = client.status(heavy).await.unwrap();
    assert_eq!((status.state, status.samples_done), (JobState::Running, 0), "it is being prepared: {status:?}");
    let free = free_after_cancel(&client, heavy).await;
    println!(
        "preparing ({triangles} triangles, {alone:?} alone): free, and another job done, {free:?} after the cancellation"
    );
    assert_eq!(abandoned_threads(&metrics), 1, "the scene is still being prepared when the other job is done");
    worker.abort();
    farm.stop().await.unwrap();
}

/// Returns a bundle with a scene of haze and `count` balls.
fn balls(count: u32) -> Bundle {
    let mut text = String::from(common::SCENE);
    text.push_str("m gray\n");
    for i in 0..count {
        let [x, y, z] = [i % 7, i / 7 % 7, i / 49].map(|k| f64::from(k) * 0.25 - 0.75);
        writeln!(text, "v ball =\n    p {x} {y} {}\nsph ball 0.1", z + 1.0).unwrap();
    }
    Bundle(BTreeMap::from([("haze.mgf".into(), text.into_bytes())]))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_first_pass_ends_when_it_is_cancelled() {
    let settings = Settings { stop: StopCondition::Spp(1), method: Method::Fem, ..Settings::default() };
    // Find a first pass that takes more than three minutes on this machine with this build: one with a 64th of its balls takes more
    // than three seconds.
    let mut count = 8;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let small_alone = loop {
        let bundle = balls(count);
        let source = SceneSource::new(Arc::new(femc_import::load_scene(&bundle, "haze.mgf").unwrap().scene));
        let world = femc_pipeline::prepare_world(&source, &settings, 1, None).unwrap();
        let begun = Instant::now();
        pool.install(|| femc_pipeline::solve_first_pass(&world, settings.method, &AtomicBool::new(false))).unwrap();
        if begun.elapsed() > Duration::from_secs(3) {
            break begun.elapsed();
        }
        count *= 2;
    };
    let bundle = balls(64 * count);
    let source = SceneSource::new(Arc::new(femc_import::load_scene(&bundle, "haze.mgf").unwrap().scene));
    let bundle = bundle.encode().unwrap();
    let farm = Coordinator::start(Config::default()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let config = femc_worker::Config { threads: 1, ..femc_worker::Config::new(farm.url()) };
    let metrics = config.metrics.clone();
    let worker = tokio::spawn(Worker::run(config, pending()));
    let (small, _) = common::job(1);
    let key =
        femc_pipeline::first_pass_key(&femc_pipeline::frame_key(&source, &settings, 1).unwrap(), settings.method, 1);
    let spec = JobSpec {
        name: "balls".into(),
        bundle: Digest::compute(&bundle),
        settings: serde_json::to_string(&settings).unwrap(),
        graph: common::graph(small.grid, &settings),
        contents: vec![(1, Digest::from_bytes(key))],
        priority: 60,
        ..small
    };
    client.put(bundle.into()).await.unwrap();
    let heavy = client.submit(None, spec).await.unwrap();
    tokio::time::sleep(Duration::from_millis(1000)).await;
    let status = client.status(heavy).await.unwrap();
    let is_waited_for = |wait: &WaitReason| matches!(wait, WaitReason::SharedStage { stage: StageKind::FirstPass, .. });
    assert!(status.waits.iter().any(is_waited_for), "it is being solved: {status:?}");
    let free = free_after_cancel(&client, heavy).await;
    println!(
        "solving ({} balls; a 64th of them alone: {small_alone:?}): free, and another job done, {free:?} after the cancellation",
        64 * count
    );
    all_ended(&metrics).await;
    worker.abort();
    farm.stop().await.unwrap();
}
