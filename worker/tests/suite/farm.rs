//! Tests with a real coordinator and real workers over loopback: the pixels depend only on the job.

use crate::common;

use std::collections::BTreeMap;
use std::future::pending;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use femc_coordinator::{ArtifactStorage, Config, Coordinator, Handle, LogStorage};
use femc_film::{Image, Tiling, exr, pixel_digest};
use femc_import::Bundle;
use femc_model::*;
use femc_pipeline::{Method, SceneSource, Settings, StopCondition};
use femc_proto::Client;
use femc_store::Store;
use femc_worker::Worker;
use tokio::task::JoinHandle;

/// A lamp over a floor in fog that thickens over three frames.
const SCENE: &str = "
camera main =
    origin 0 -3 1
    target 0 0 0.5
    fov 40
    film 48 32
time 0 1 2
vary medium.haze.sigma_s = 0 0.05 1 0.4
medium haze =
    sigma_s 0.05
mbox haze -1 -1 -1 1 1 1
m gray =
    c
    rd 0.6
m bright =
    c
    ed 2000
v a =
    p -2 -2 0
v b =
    p 2 -2 0
v c =
    p 2 2 0
v d =
    p -2 2 0
m gray
f a b c d
v e =
    p 0 0 1.2
m bright
sph e 0.2
";

fn settings(stop: StopCondition) -> Settings {
    Settings { stop, max_depth: 4, ..Settings::default() }
}

/// Returns the job and its bundle.
fn job(scene: &str, settings: &Settings) -> (JobSpec, Vec<u8>) {
    let bundle = Bundle(BTreeMap::from([("haze.mgf".into(), scene.as_bytes().to_vec())])).encode().unwrap();
    let grid = Grid { film: [48, 32], tile: 16 };
    let spec = JobSpec {
        name: "haze".into(),
        bundle: Digest::compute(&bundle),
        entry: "haze.mgf".into(),
        settings: serde_json::to_string(settings).unwrap(),
        frames: vec![1, 2, 3],
        grid,
        graph: common::graph(grid, settings),
        contents: vec![],
        priority: 50,
        owner: "me".into(),
        tags: vec![],
        notes: JobNotes::default(),
    };
    (spec, bundle)
}

async fn submit(client: &Client, (spec, bundle): (JobSpec, Vec<u8>)) -> JobId {
    client.put(bundle.into()).await.unwrap();
    client.submit(Some(spec.key().to_string()), spec).await.unwrap()
}

fn worker(farm: &Handle, threads: usize) -> JoinHandle<()> {
    let config = femc_worker::Config { threads, ..femc_worker::Config::new(farm.url()) };
    tokio::spawn(async { Worker::run(config, pending()).await.unwrap() })
}

/// Waits until the job's status is as wanted. Returns the last status, also if the job ends before.
async fn until(client: &Client, job: JobId, wanted: impl Fn(&JobStatus) -> bool) -> JobStatus {
    let mut watch = client.watch(job).await.unwrap();
    let mut last = None;
    while let Some(status) = watch.next().await.unwrap() {
        let is_wanted = wanted(&status);
        last = Some(status);
        if is_wanted {
            break;
        }
    }
    last.unwrap()
}

/// Returns the job of [`job`] with frames assembled from groups of `fan` tiles.
fn grouped(settings: &Settings, fan: u32) -> (JobSpec, Vec<u8>) {
    let (spec, bundle) = job(SCENE, settings);
    let tiling = Tiling::new(spec.grid.film[0], spec.grid.film[1], spec.grid.tile).unwrap();
    let graph = femc_pipeline::job_graph(&tiling, &settings.rounds(), NonZeroU32::new(fan).unwrap(), settings.method);
    (JobSpec { graph, ..spec }, bundle)
}

async fn image(client: &Client, frame: &FrameRecord) -> Vec<u8> {
    let Artifact { digest, bytes } = frame.image().expect("an image");
    client.get(&digest, bytes).await.unwrap().into()
}

async fn pixels(client: &Client, job: JobId) -> Vec<String> {
    let mut digests = Vec::new();
    for frame in client.frames(job).await.unwrap() {
        let image: Image = exr::decode(std::io::Cursor::new(image(client, &frame).await)).unwrap().image;
        digests.push(format!("{:?}", pixel_digest(&image)));
    }
    digests
}

/// Returns the frames as one worker with one thread renders them.
async fn reference(stop: StopCondition) -> Vec<String> {
    let farm = Coordinator::start(Config::default()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let id = submit(&client, job(SCENE, &settings(stop))).await;
    let one = worker(&farm, 1);
    let status = until(&client, id, |_| false).await;
    assert_eq!((status.state, status.frames_done, status.bad_samples), (JobState::Done, 3, 0), "{status:?}");
    let pixels = pixels(&client, id).await;
    assert_eq!(pixels.len(), 3);
    assert_ne!(pixels[0], pixels[2], "the fog thickens");
    one.abort();
    farm.stop().await.unwrap();
    pixels
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn three_workers_of_which_one_vanishes_render_the_pixels_of_one() {
    let expected = reference(StopCondition::Spp(32)).await;
    let farm = Coordinator::start(Config::default()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let id = submit(&client, job(SCENE, &settings(StopCondition::Spp(32)))).await;
    let lost = worker(&farm, 2);
    let others = [worker(&farm, 1), worker(&farm, 2)];
    until(&client, id, |status| status.samples_done > 0).await;
    lost.abort();
    let status = until(&client, id, |_| false).await;
    assert_eq!(status.state, JobState::Done, "{status:?}");
    assert_eq!(pixels(&client, id).await, expected);
    others.iter().for_each(JoinHandle::abort);
    farm.stop().await.unwrap();
}

/// Returns each frame's file without what differs from run to run, and its record without seconds.
async fn contents(client: &Client, job: JobId) -> Vec<(String, FrameRecord)> {
    let mut contents = Vec::new();
    for frame in client.frames(job).await.unwrap() {
        let layers = exr_layers(&image(client, &frame).await);
        let outputs = frame.outputs.iter().copied().filter(|output| output.role != Role::Image).collect();
        contents.push((layers, FrameRecord { outputs, busy_seconds: 0.0, seconds: 0.0, ..frame }));
    }
    contents
}

/// Returns a digest of all channels, and the attributes without the seconds.
fn exr_layers(bytes: &[u8]) -> String {
    use ::exr::prelude::*;
    let image = read().no_deep_data().largest_resolution_level().all_channels().all_layers().all_attributes();
    let image = image.from_buffered(std::io::Cursor::new(bytes)).unwrap();
    let attributes = exr::decode(std::io::Cursor::new(bytes)).unwrap().attributes;
    let attributes: BTreeMap<_, _> = attributes.into_iter().filter(|(name, _)| !name.contains("seconds")).collect();
    let channels = format!("{:?}", image.layer_data[0].channel_data);
    format!("{} {attributes:?}", Digest::compute(channels.as_bytes()))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn frame_of_groups_equals_frame_of_tiles_over_several_rounds() {
    // This error is never reached, so all rounds run.
    for stop in [StopCondition::Spp(8), StopCondition::Error(0.05)] {
        let mut all = Vec::new();
        for fan in [256, 1, 4] {
            let farm = Coordinator::start(Config::default()).await.unwrap();
            let client = Client::connect(&farm.url()).await.unwrap();
            let id = submit(&client, grouped(&settings(stop), fan)).await;
            let workers = [worker(&farm, 1), worker(&farm, 1)];
            let status = until(&client, id, |_| false).await;
            assert_eq!(status.state, JobState::Done, "{status:?}");
            all.push(contents(&client, id).await);
            workers.iter().for_each(JoinHandle::abort);
            farm.stop().await.unwrap();
        }
        let is_bounded = matches!(stop, StopCondition::Spp(_));
        assert!(is_bounded || all[0].iter().any(|(_, frame)| frame.spp > settings(stop).rounds()[0]), "several rounds");
        assert_eq!(all[0].len(), 3);
        assert_eq!((&all[1], &all[2]), (&all[0], &all[0]));
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_coordinator_that_comes_back_goes_on_where_it_was() {
    let expected = reference(StopCondition::Spp(32)).await;
    let folder = tempfile::tempdir().unwrap();
    let config = Config {
        log: LogStorage::Sqlite(folder.path().join("log.sqlite")),
        artifacts: ArtifactStorage::Folder(folder.path().join("artifacts")),
        ..Config::default()
    };
    let farm = Coordinator::start(config.clone()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let id = submit(&client, job(SCENE, &settings(StopCondition::Spp(32)))).await;
    let first = worker(&farm, 1);
    let tiles = |status: &JobStatus| status.frames_done * 6 + status.active.iter().map(|f| f.tiles_done).sum::<u32>();
    let before = until(&client, id, |status| tiles(status) >= 3).await;
    first.abort();
    farm.stop().await.unwrap();

    let farm = Coordinator::start(config).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    assert_eq!(submit(&client, job(SCENE, &settings(StopCondition::Spp(32)))).await, id, "the same job");
    let after = client.status(id).await.unwrap();
    assert!(tiles(&after) >= tiles(&before), "what was done is done: {after:?}");
    let second = worker(&farm, 2);
    assert_eq!(until(&client, id, |_| false).await.state, JobState::Done);
    assert_eq!(pixels(&client, id).await, expected);
    second.abort();
    farm.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_frame_goes_on_round_by_round_until_its_error_is_reached() {
    let farm = Coordinator::start(Config::default()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let id = submit(&client, job(SCENE, &settings(StopCondition::Error(0.03)))).await;
    let workers = [worker(&farm, 1), worker(&farm, 1)];
    let status = until(&client, id, |_| false).await;
    assert_eq!(status.state, JobState::Done, "{status:?}");
    let frames = client.frames(id).await.unwrap();
    // The decision uses a conservative bound from one half of the samples. The reported error is an estimate from both halves.
    assert!(frames.iter().all(|frame| frame.relative_error.unwrap() <= 1.2 * 0.03), "{frames:?}");
    assert!(frames.iter().any(|frame| frame.spp > 16), "more than one round: {frames:?}");
    workers.iter().for_each(JoinHandle::abort);
    farm.stop().await.unwrap();
}

/// A glowing wall in the left half of the picture, without noise; fog behind it, with noise.
const HALVES: &str = "
v k =
    p -4 -1.2 -3
v l =
    p 0 -1.2 -3
v o =
    p 0 -1.2 4
v q =
    p -4 -1.2 4
m bright
f k l o q
";

/// Returns the colors and sample counts of a frame's pixels, by tile.
fn tiles(bytes: &[u8]) -> Vec<Vec<([f32; 3], u32)>> {
    use ::exr::prelude::*;
    let file = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer().all_attributes();
    let file = file.from_buffered(std::io::Cursor::new(bytes)).unwrap();
    let samples = file.layer_data.channel_data.list.iter().find(|channel| channel.name.eq("samples.Y")).unwrap();
    let FlatSamples::U32(samples) = &samples.sample_data else { panic!("whole numbers") };
    let image = exr::decode(std::io::Cursor::new(bytes)).unwrap().image;
    let pixel = |(x, y): (u32, u32)| {
        let at = (y * 48 + x) as usize;
        (image.pixels[at], samples[at])
    };
    Tiling::new(48, 32, 16).unwrap().rects().map(|rect| rect.pixels().map(pixel).collect()).collect()
}

/// Returns the samples per pixel of each tile of the first frame, from the records of its attempts.
async fn drawn(client: &Client, job: JobId) -> Vec<u32> {
    let (shape, attempts) = client.attempts(job).await.unwrap();
    let (number, template) = shape.spec.graph.main_stage().unwrap();
    let mut counts = vec![0; 6];
    for record in attempts.iter().filter(|record| record.ending == LeaseEnding::Done) {
        let TaskKey { stage, index, .. } = record.task;
        if (stage.frame, stage.number) == (1, number) {
            let tile = Chunks::new(template, stage.round, None, shape.chunk_size).task(index);
            counts[tile as usize] += (record.samples / 256) as u32;
        }
    }
    counts
}

/// Returns the job of the two halves in three rounds, in groups of `fan` tiles.
fn halves(stop: StopCondition, fan: u32) -> (JobSpec, Vec<u8>) {
    let settings = settings(stop);
    let (spec, bundle) = job(&format!("{SCENE}{HALVES}"), &settings);
    let rounds = if let StopCondition::Spp(spp) = stop { vec![spp] } else { vec![16, 32, 64] };
    let graph = femc_pipeline::job_graph(
        &Tiling::new(48, 32, 16).unwrap(),
        &rounds,
        NonZeroU32::new(fan).unwrap(),
        settings.method,
    );
    (JobSpec { graph, frames: vec![1, 3], ..spec }, bundle)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn calm_tiles_get_fewer_samples_and_any_split_gives_same_frame() {
    let stop = StopCondition::Error(0.012);
    let mut all = Vec::new();
    // One worker; three workers, of which one vanishes at the end of a round; sample chunks of few samples, in groups of two tiles.
    for (workers, fan, grain) in [(1, 256, 1_u64 << 15), (3, 256, 1 << 15), (3, 2, 1 << 9)] {
        let mut config = Config::default();
        config.scheduler.chunk_size = grain.try_into().unwrap();
        let farm = Coordinator::start(config).await.unwrap();
        let client = Client::connect(&farm.url()).await.unwrap();
        let id = submit(&client, halves(stop, fan)).await;
        let workers: Vec<JoinHandle<()>> = (0..workers).map(|_| worker(&farm, 1)).collect();
        if let [lost, _, ..] = &workers[..] {
            until(&client, id, |status| status.samples_done > 48 * 32 * 16).await;
            lost.abort();
        }
        let status = until(&client, id, |_| false).await;
        assert_eq!((status.state, status.frames_done), (JobState::Done, 2), "{status:?}");
        all.push(contents(&client, id).await);
        let frame = &client.frames(id).await.unwrap()[0];
        let found = tiles(&image(&client, frame).await);
        let counts: Vec<u32> = found.iter().map(|tile| tile[0].1).collect();
        let drawn = drawn(&client, id).await;
        let is_held = |tile: usize| drawn[tile] != counts[tile];
        assert!((0..6).all(|tile| drawn[tile] >= counts[tile]), "the statistics know each task's tile");
        if all.len() == 1 {
            assert!(found.iter().zip(&counts).all(|(tile, count)| tile.iter().all(|pixel| pixel.1 == *count)));
            // Tiles with only the wall, and the others. A tile at the wall's edge may be of either kind.
            assert_eq!((counts[0], counts[3], counts[2], counts[5]), (16, 16, 64, 64), "{counts:?}");
            assert_eq!(u64::from(frame.spp), counts.iter().map(|&count| u64::from(count)).sum::<u64>() / 6);
            // Each tile equals the tile of a frame in which all tiles have that many samples.
            for spp in [16, 64] {
                let even = submit(&client, halves(StopCondition::Spp(spp), fan)).await;
                until(&client, even, |_| false).await;
                let even = tiles(&image(&client, &client.frames(even).await.unwrap()[0]).await);
                let same = (0..6).filter(|&tile| counts[tile] == spp && !is_held(tile));
                same.for_each(|tile| assert!(found[tile] == even[tile], "tile {tile} of {spp} samples"));
            }
        }
        workers.iter().for_each(JoinHandle::abort);
        farm.stop().await.unwrap();
    }
    assert_eq!((&all[1], &all[2]), (&all[0], &all[0]));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn tiles_that_the_store_has_lost_are_rendered_again() {
    let expected = reference(StopCondition::Spp(32)).await;
    let store = Store::in_memory();
    let farm = Coordinator::start_with(Config::default(), store.clone(), femc_queue::Memory::default()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let (spec, bundle) = job(SCENE, &settings(StopCondition::Spp(32)));
    let keep = spec.bundle;
    let id = submit(&client, (spec, bundle)).await;
    let first = worker(&farm, 1);
    until(&client, id, |status| status.active.iter().any(|frame| frame.tiles_done >= 2)).await;
    first.abort();
    until(&client, id, |status| status.workers == 0).await;
    for artifact in store.list().await.unwrap() {
        if artifact.digest != keep && !client.frames(id).await.unwrap().iter().any(|f| f.image() == Some(artifact)) {
            store.remove(&artifact.digest).await.unwrap();
        }
    }
    let second = worker(&farm, 2);
    let status = until(&client, id, |_| false).await;
    assert_eq!(status.state, JobState::Done, "{status:?}");
    assert_eq!(pixels(&client, id).await, expected);
    second.abort();
    farm.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_broken_scene_fails_its_job_and_the_next_job_is_done() {
    let farm = Coordinator::start(Config::default()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let workers = [worker(&farm, 1)];
    let broken = submit(&client, job("f nobody knows\n", &settings(StopCondition::Spp(4)))).await;
    let status = until(&client, broken, |_| false).await;
    assert_eq!(status.state, JobState::Failed);
    let Some(Failure::Scene { message }) = status.failure else { panic!("{status:?}") };
    assert!(message.contains("haze.mgf:1"), "{message}");
    let sound = submit(&client, job(SCENE, &settings(StopCondition::Spp(4)))).await;
    assert_eq!(until(&client, sound, |_| false).await.state, JobState::Done);
    workers.iter().for_each(JoinHandle::abort);
    farm.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn cancelled_job_frees_worker_and_stopped_worker_returns_tasks() {
    let farm = Coordinator::start(Config::default()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let endless = submit(&client, job(SCENE, &settings(StopCondition::Spp(1 << 24)))).await;
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let config = femc_worker::Config { threads: 1, ..femc_worker::Config::new(farm.url()) };
    let first = tokio::spawn(Worker::run(config, async { drop(stopped.await) }));
    until(&client, endless, |status| status.samples_done > 0).await;
    client.control(endless, Control::Cancel).await.unwrap();
    let sound = submit(&client, job(SCENE, &settings(StopCondition::Spp(4)))).await;
    assert_eq!(until(&client, sound, |_| false).await.state, JobState::Done);
    client.control(endless, Control::Retry).await.unwrap();
    until(&client, endless, |status| status.samples_done > 0).await;
    stop.send(()).unwrap();
    first.await.unwrap().unwrap();
    let status = client.status(endless).await.unwrap();
    assert_eq!((status.workers, status.state), (0, JobState::Queued), "{status:?}");
    assert_eq!(client.workers().await.unwrap(), []);
    farm.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn worker_waits_for_coordinator_and_impatient_one_gives_up() {
    let farm = Coordinator::start(Config::default()).await.unwrap();
    let address = farm.address();
    farm.stop().await.unwrap();
    let url = format!("http://{address}");
    let impatient = femc_worker::Config {
        threads: 1,
        reconnect_limit: Some(Duration::from_millis(1)),
        ..femc_worker::Config::new(url.clone())
    };
    let error = Worker::run(impatient, pending()).await.unwrap_err();
    assert!(error.to_string().contains("cannot be reached"), "{error}");
    let patient = femc_worker::Config { threads: 1, ..femc_worker::Config::new(url) };
    let patient = tokio::spawn(Worker::run(patient, pending()));
    let farm = Coordinator::start(Config { listen: address, ..Config::default() }).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let id = submit(&client, job(SCENE, &settings(StopCondition::Spp(4)))).await;
    assert_eq!(until(&client, id, |_| false).await.state, JobState::Done);
    patient.abort();
    farm.stop().await.unwrap();
}

/// Returns the job without fog and with a first pass. The floor, and therefore the world, differs in each frame.
fn with_first_pass() -> (JobSpec, Vec<u8>) {
    let settings = Settings { stop: StopCondition::Spp(64), method: Method::Fem, ..Settings::default() };
    let scene = SCENE.replace("vary medium.haze.sigma_s = 0 0.05 1 0.4", "vary material.gray.rd = 0 0.1 1 0.8");
    let scene = scene.replace("mbox haze -1 -1 -1 1 1 1\n", "").replace("sigma_s 0.05", "sigma_s 0");
    let (spec, bundle) = job(&scene, &settings);
    let files = Bundle::decode(&bundle, 1 << 20).unwrap();
    let source = SceneSource::new(Arc::new(femc_import::load_scene(&files, &spec.entry).unwrap().scene));
    let content = |&frame: &u32| {
        let frame_key = femc_pipeline::frame_key(&source, &settings, frame).unwrap();
        (frame, Digest::from_bytes(femc_pipeline::first_pass_key(&frame_key, settings.method, 1)))
    };
    (JobSpec { contents: spec.frames.iter().map(content).collect(), ..spec }, bundle)
}

/// Returns the files below a folder that hold the light of a first pass.
fn fields(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let is_field = |path: &PathBuf| std::fs::read(path).is_ok_and(|bytes| bytes.starts_with(b"FEMCFELD"));
    entries.flat_map(|path| if path.is_dir() { fields(&path) } else { vec![path] }).filter(is_field).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn lost_first_pass_light_is_found_again_with_same_pixels() {
    let mut all = Vec::new();
    for is_lost in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let artifacts = folder.path().join("artifacts");
        let config = Config { artifacts: ArtifactStorage::Folder(artifacts.clone()), ..Config::default() };
        let farm = Coordinator::start(config).await.unwrap();
        let client = Client::connect(&farm.url()).await.unwrap();
        let id = submit(&client, with_first_pass()).await;
        let first = worker(&farm, 1);
        if is_lost {
            while fields(&artifacts).is_empty() {
                tokio::time::sleep(Duration::from_millis(2)).await;
            }
            first.abort();
            assert_ne!(client.status(id).await.unwrap().state, JobState::Done);
            fields(&artifacts).iter().for_each(|field| std::fs::remove_file(field).unwrap());
        }
        let second = worker(&farm, 2);
        let status = until(&client, id, |_| false).await;
        assert_eq!((status.state, status.frames_done), (JobState::Done, 3), "{status:?}");
        all.push(pixels(&client, id).await);
        [first, second].iter().for_each(JoinHandle::abort);
        farm.stop().await.unwrap();
    }
    assert_eq!(all[0], all[1]);
    assert_ne!(all[0][0], all[0][2], "each frame has its own world's light");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn first_pass_with_foreign_key_or_missing_one_fails_job() {
    let farm = Coordinator::start(Config::default()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let one = worker(&farm, 1);
    let (spec, bundle) = with_first_pass();
    let foreign = JobSpec { contents: vec![(3, Digest::compute(b"another world"))], ..spec.clone() };
    let graph = common::graph(spec.grid, &settings(StopCondition::Spp(64)));
    let without = JobSpec { graph, contents: vec![], ..spec };
    for (spec, said) in [(foreign, "does not match its key"), (without, "it must have a first-pass stage")] {
        let id = submit(&client, (spec, bundle.clone())).await;
        let status = until(&client, id, |_| false).await;
        assert_eq!(status.state, JobState::Failed, "{status:?}");
        assert!(format!("{status:?}").contains(said), "{status:?}");
    }
    one.abort();
    farm.stop().await.unwrap();
}
