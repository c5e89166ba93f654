//! Tests of `femc gc`: artifacts that it removes, and artifacts that it must keep.

use std::path::Path;
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use femc_coordinator::{ArtifactStorage, Config, Coordinator, Handle};
use femc_model::*;
use femc_proto::{ArtifactTotals, CallError, Client, CollectMode};
use femc_store::Store;

const HOUR: Duration = Duration::from_secs(3600);

struct TestFarm {
    folder: tempfile::TempDir,
    farm: Handle,
    client: Client,
    /// Store of the farm, accessed without the coordinator.
    store: Store,
}

impl TestFarm {
    async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let config = Config { artifacts: ArtifactStorage::Folder(folder.path().to_owned()), ..Config::default() };
        let farm = Coordinator::start(config).await.unwrap();
        let client = Client::connect(&farm.url()).await.unwrap();
        let store = Store::open_folder(folder.path()).unwrap();
        Self { folder, farm, client, store }
    }

    /// Makes all artifacts in the store two hours old.
    fn age(&self) {
        age(self.folder.path());
    }

    /// Stores bytes without the coordinator.
    async fn put_stray(&self, bytes: &[u8]) -> Artifact {
        self.store.put(Bytes::copy_from_slice(bytes)).await.unwrap()
    }
}

fn age(folder: &Path) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            age(&path);
        } else if let Ok(file) = std::fs::File::options().write(true).open(&path) {
            file.set_modified(SystemTime::now() - 2 * HOUR).unwrap();
        }
    }
}

/// Returns the pieces of a scene, followed by the manifest that names them.
fn scene(name: &str) -> Vec<Bytes> {
    let mut pieces: Vec<Bytes> = (0..5).map(|i| Bytes::from(format!("{name}, piece {i}"))).collect();
    let named = pieces.iter().map(|bytes| BundlePiece { artifact: Artifact::from_bytes(bytes), unpacked: 9 }).collect();
    let manifest = Manifest { pieces: named, ..Manifest::default() };
    pieces.push(manifest.encode().unwrap().into());
    pieces
}

fn digests(artifacts: &[Bytes]) -> Vec<Digest> {
    artifacts.iter().map(|bytes| Digest::compute(bytes)).collect()
}

fn job(scene: &[Bytes]) -> JobSpec {
    JobSpec {
        name: "fog".into(),
        bundle: Digest::compute(scene.last().unwrap()),
        entry: "fog.mgf".into(),
        settings: "{}".into(),
        frames: vec![1],
        grid: Grid { film: [64, 64], tile: 16 },
        graph: testing::frame_graph(Grid { film: [64, 64], tile: 16 }.sizes(), &[16], 0),
        contents: vec![],
        priority: 50,
        owner: "me".into(),
        tags: vec![],
        notes: JobNotes::default(),
    }
}

#[tokio::test]
async fn what_no_job_refers_to_goes_and_a_dry_run_says_so_before() {
    let farm = TestFarm::start().await;
    let scene = scene("a scene");
    farm.client.put_all(&scene).await.unwrap();
    let id = farm.client.submit(None, job(&scene)).await.unwrap();
    farm.client.control(id, Control::Cancel).await.unwrap();
    let stray = [farm.put_stray(b"of a client that was killed").await, farm.put_stray(b"of no job").await];
    farm.age();
    let young = farm.put_stray(b"just now").await;
    let bytes = stray.iter().map(|artifact| artifact.bytes).sum();
    let garbage = ArtifactTotals { artifacts: 2, bytes };
    let steps = [
        (CollectMode::DryRun, garbage, 9),
        (CollectMode::Remove, garbage, 7),
        (CollectMode::Remove, ArtifactTotals::default(), 7),
    ];
    for (mode, garbage, left) in steps {
        let found = farm.client.collect(mode, HOUR).await.unwrap();
        assert_eq!(found.referenced.artifacts, 6, "also of a job that has ended");
        assert_eq!(found.young, ArtifactTotals { artifacts: 1, bytes: young.bytes });
        assert_eq!(found.garbage, garbage);
        assert_eq!(found.names.len() as u64, garbage.artifacts);
        assert!(found.names.iter().all(|artifact| stray.contains(artifact)), "{found:?}");
        assert_eq!(farm.store.list().await.unwrap().len(), left);
    }
    assert_eq!(farm.store.missing(&digests(&scene)).await.unwrap(), []);
    assert!(farm.store.has(&young.digest).await.unwrap());
    let hasty = farm.client.collect(CollectMode::Remove, Duration::from_secs(1)).await.unwrap_err();
    assert!(matches!(hasty, CallError::Refused(Refusal::Invalid { ref field, .. }) if field == "grace"), "{hasty}");
    farm.farm.stop().await.unwrap();
}

#[tokio::test]
async fn artifacts_promised_to_a_submission_survive_collection() {
    let farm = TestFarm::start().await;
    let (asked, unasked) = (scene("told"), scene("untold"));
    for bytes in asked.iter().chain(&unasked) {
        farm.put_stray(bytes).await;
    }
    farm.age();
    assert_eq!(farm.client.missing(&digests(&asked)).await.unwrap(), []);
    let found = farm.client.collect(CollectMode::Remove, HOUR).await.unwrap();
    assert_eq!((found.young.artifacts, found.garbage.artifacts), (6, 6));
    farm.client.submit(None, job(&asked)).await.unwrap();
    let refused = farm.client.submit(None, job(&unasked)).await.unwrap_err();
    assert!(matches!(refused, CallError::Refused(Refusal::MissingArtifacts { .. })), "{refused}");
    let found = farm.client.collect(CollectMode::Remove, HOUR).await.unwrap();
    assert_eq!((found.referenced.artifacts, found.garbage.artifacts), (6, 0));
    farm.farm.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn accepted_jobs_lose_no_artifact_to_concurrent_collections() {
    let farm = TestFarm::start().await;
    let scenes: Vec<Vec<Bytes>> = (0..40).map(|i| scene(&format!("scene {i}"))).collect();
    let collector = tokio::spawn({
        let client = farm.client.clone();
        async move {
            let mut garbage = 0;
            loop {
                garbage += client.collect(CollectMode::Remove, HOUR).await.unwrap().garbage.artifacts;
                if client.list().await.unwrap().len() == 40 {
                    return garbage;
                }
            }
        }
    });
    for scene in &scenes {
        // Old leftovers of an earlier attempt: a submission finds them, and a collection would remove them.
        for bytes in scene {
            farm.put_stray(bytes).await;
        }
        farm.put_stray(format!("beside {:?}", scene[0]).as_bytes()).await;
        farm.age();
        farm.client.put_all(scene).await.unwrap();
        farm.client.submit(None, job(scene)).await.expect("what was told is there");
    }
    let meanwhile = collector.await.unwrap();
    println!("{meanwhile} artifacts went meanwhile");
    farm.age();
    let found = farm.client.collect(CollectMode::Remove, HOUR).await.unwrap();
    assert_eq!(found.referenced.artifacts, 40 * 6);
    assert!(meanwhile > 0 && meanwhile + found.garbage.artifacts >= 40, "{meanwhile}, {found:?}");
    for scene in &scenes {
        assert_eq!(farm.store.missing(&digests(scene)).await.unwrap(), []);
    }
    farm.farm.stop().await.unwrap();
}
