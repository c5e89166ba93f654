//! Download of scenes by workers.

use crate::common;

use std::collections::BTreeMap;
use std::future::pending;

use femc_coordinator::{Config, Coordinator, Handle};
use femc_import::Bundle;
use femc_model::*;
use femc_pipeline::{Settings, StopCondition};
use femc_proto::Client;
use femc_store::Store;
use femc_worker::{Cache, Parcel, PieceCache, Worker};
use tokio::task::JoinHandle;

const SCENE: &str = "
i lamp.mgf
camera main =
    origin 0 -3 1
    target 0 0 0.5
    fov 40
    film 16 16
";

const LAMP: &str = "
m bright =
    c
    ed 2000
v e =
    p 0 0 1.2
m bright
sph e 0.2
";

fn scene() -> Parcel {
    // This file is large enough to be a piece of its own.
    let mesh = "# a comment\n".repeat(40_000);
    let files = [("main.mgf", SCENE.to_owned()), ("lamp.mgf", LAMP.to_owned()), ("mesh.mgf", mesh)];
    let files = files.map(|(path, text)| (path.to_owned(), text.into_bytes()));
    Parcel::pack(&Bundle(BTreeMap::from(files))).unwrap()
}

fn spec(scene: &Parcel, spp: u32) -> JobSpec {
    let settings = Settings { stop: StopCondition::Spp(spp), max_depth: 2, ..Settings::default() };
    let grid = Grid { film: [16, 16], tile: 16 };
    JobSpec {
        name: "main".into(),
        bundle: scene.digest(),
        entry: "main.mgf".into(),
        settings: serde_json::to_string(&settings).unwrap(),
        frames: vec![1],
        grid,
        graph: common::graph(grid, &settings),
        contents: vec![],
        priority: 50,
        owner: "me".into(),
        tags: vec![],
        notes: JobNotes::default(),
    }
}

fn worker(farm: &Handle, pieces: &PieceCache) -> JoinHandle<()> {
    let cache = Cache::with_pieces(pieces.clone());
    let config = femc_worker::Config { threads: 1, cache, ..femc_worker::Config::new(farm.url()) };
    tokio::spawn(async { Worker::run(config, pending()).await.unwrap() })
}

async fn done(client: &Client, job: JobId) -> JobStatus {
    let mut watch = client.watch(job).await.unwrap();
    let mut last = None;
    while let Some(status) = watch.next().await.unwrap() {
        last = Some(status);
    }
    last.unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_second_job_of_a_scene_downloads_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let open = || PieceCache::in_folder(folder.path(), 1 << 20).unwrap();
    for (name, pieces, again) in [("memory", PieceCache::in_memory(1 << 20), None), ("folder", open(), Some(open))] {
        let farm = Coordinator::start(Config::default()).await.unwrap();
        let client = Client::connect(&farm.url()).await.unwrap();
        let scene = scene();
        client.put_all(&scene.artifacts()).await.unwrap();
        let first_worker = worker(&farm, &pieces);
        let first = client.submit(None, spec(&scene, 1)).await.unwrap();
        assert_eq!(done(&client, first).await.state, JobState::Done, "{name}");
        assert_eq!(pieces.fetched(), scene.size(), "{name}: all of it, once");
        // Different settings, so the scene is read again.
        let second = client.submit(None, spec(&scene, 2)).await.unwrap();
        assert_eq!(done(&client, second).await.state, JobState::Done, "{name}");
        assert_eq!(pieces.fetched(), scene.size(), "{name}: nothing more");
        first_worker.abort();
        if let Some(open) = again {
            let pieces = open();
            let other_worker = worker(&farm, &pieces);
            let third = client.submit(None, spec(&scene, 3)).await.unwrap();
            assert_eq!(done(&client, third).await.state, JobState::Done);
            assert_eq!(pieces.fetched(), 0, "a folder outlives its worker");
            other_worker.abort();
        }
        farm.stop().await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn scene_with_lost_piece_fails_job_by_name_and_can_be_resent() {
    let store = Store::in_memory();
    let farm = Coordinator::start_with(Config::default(), store.clone(), femc_queue::Memory::default()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let scene = scene();
    client.put_all(&scene.artifacts()).await.unwrap();
    let lost = Digest::compute(&scene.pieces[0]);
    let job = client.submit(None, spec(&scene, 1)).await.unwrap();
    store.remove(&lost).await.unwrap();
    let worker = worker(&farm, &PieceCache::in_memory(0));
    let status = done(&client, job).await;
    assert_eq!(status.state, JobState::Failed);
    let Some(Failure::LostInputs { digests, message }) = status.failure else { panic!("{status:?}") };
    assert!(digests.contains(&lost) && message.contains("submit it again"), "{message}");
    assert_eq!(client.put_all(&scene.artifacts()).await.unwrap(), scene.pieces[0].len() as u64);
    let job = client.submit(None, spec(&scene, 1)).await.unwrap();
    assert_eq!(done(&client, job).await.state, JobState::Done);
    worker.abort();
    farm.stop().await.unwrap();
}
