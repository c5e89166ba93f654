//! Tests of a client with a real coordinator, without workers.

use bytes::Bytes;
use femc_coordinator::{ArtifactStorage, Config, Coordinator, CoordinatorError, Handle, LogStorage};
use femc_model::*;
use femc_proto::{CallError, Client};
use femc_store::Store;

fn spec() -> JobSpec {
    JobSpec {
        name: "fog".into(),
        bundle: Digest::compute(b"bundle"),
        entry: "fog.mgf".into(),
        settings: "{}".into(),
        frames: vec![1, 2],
        grid: Grid { film: [64, 64], tile: 16 },
        graph: testing::frame_graph(Grid { film: [64, 64], tile: 16 }.sizes(), &[16], 0),
        contents: vec![],
        priority: 50,
        owner: "me".into(),
        tags: vec![],
        notes: JobNotes::default(),
    }
}

/// Connects a client of the farm and uploads the scene of [`spec`].
async fn client(farm: &Handle) -> Client {
    let client = Client::connect(&farm.url()).await.unwrap();
    client.put(Bytes::from_static(b"bundle")).await.unwrap();
    client
}

fn refusal<T: std::fmt::Debug>(answer: Result<T, CallError>) -> Refusal {
    match answer {
        Err(CallError::Refused(refusal)) => refusal,
        other => panic!("not refused: {other:?}"),
    }
}

#[tokio::test]
async fn jobs_are_taken_listed_steered_and_watched_to_their_end() {
    let farm = Coordinator::start(Config::default()).await.unwrap();
    let client = client(&farm).await;
    let first = client.submit(Some("a".into()), spec()).await.unwrap();
    assert_eq!(client.submit(Some("a".into()), spec()).await.unwrap(), first);
    let second = client.submit(None, spec()).await.unwrap();
    let listed: Vec<JobId> = client.list().await.unwrap().iter().map(|status| status.job).collect();
    assert_eq!(listed, [first, second]);
    let status = client.status(first).await.unwrap();
    assert_eq!((status.state, status.waits), (JobState::Queued, vec![WaitReason::NoWorkers]));
    let mut watch = client.watch(first).await.unwrap();
    assert_eq!(watch.next().await.unwrap().unwrap().state, JobState::Queued);
    client.control(first, Control::Pause).await.unwrap();
    client.control(first, Control::Priority(80)).await.unwrap();
    client.control(first, Control::Cancel).await.unwrap();
    let mut last = None;
    while let Some(status) = watch.next().await.unwrap() {
        last = Some(status);
    }
    let last = last.unwrap();
    assert_eq!((last.state, last.priority), (JobState::Cancelled, 80), "the end is never missed");
    assert_eq!(client.frames(first).await.unwrap(), []);
    farm.stop().await.unwrap();
}

#[tokio::test]
async fn what_makes_no_sense_is_refused_by_variant() {
    let farm = Coordinator::start(Config::default()).await.unwrap();
    let client = client(&farm).await;
    let nobody = JobId(99);
    assert_eq!(refusal(client.status(nobody).await), Refusal::NoSuchJob { job: nobody });
    assert_eq!(refusal(client.frames(nobody).await), Refusal::NoSuchJob { job: nobody });
    assert_eq!(refusal(client.control(nobody, Control::Pause).await), Refusal::NoSuchJob { job: nobody });
    assert_eq!(refusal(client.watch(nobody).await), Refusal::NoSuchJob { job: nobody });
    let empty = JobSpec { frames: vec![], ..spec() };
    assert!(matches!(refusal(client.submit(None, empty).await), Refusal::Invalid { .. }));
    let id = client.submit(None, spec()).await.unwrap();
    client.control(id, Control::Cancel).await.unwrap();
    assert_eq!(refusal(client.control(id, Control::Pause).await), Refusal::Ended { job: id });
    assert!(matches!(refusal(client.control(id, Control::Priority(101)).await), Refusal::Invalid { .. }));
    farm.stop().await.unwrap();
}

#[tokio::test]
async fn artifacts_go_up_and_come_down_whole_or_not_at_all() {
    let store = Store::in_memory().with_limit(5_000_000);
    let queue = femc_queue::Memory::default();
    let farm = Coordinator::start_with(Config::default(), store, queue).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let bytes: Bytes = (0..4_500_001u32).map(|i| (i ^ (i >> 9)) as u8).collect();
    let digest = Digest::compute(&bytes);
    assert_eq!(refusal(client.get(&digest, u64::MAX).await), Refusal::NoSuchArtifact { digest });
    assert_eq!(client.missing(&[digest]).await.unwrap(), [digest]);
    assert_eq!(client.put(bytes.clone()).await.unwrap(), Artifact { digest, bytes: 4_500_001 });
    assert_eq!(client.missing(&[digest]).await.unwrap(), []);
    assert_eq!(client.put(bytes.clone()).await.unwrap().digest, digest, "a second time sends nothing");
    assert_eq!(client.get(&digest, 4_500_001).await.unwrap(), bytes);
    assert!(matches!(refusal(client.get(&digest, 4_500_000).await), Refusal::ArtifactTooLarge { .. }));
    let most = Refusal::ArtifactTooLarge { limit: 5_000_000 };
    assert_eq!(refusal(client.put(vec![7; 5_000_001].into()).await), most);
    let empty = client.put(Bytes::new()).await.unwrap();
    assert_eq!(client.get(&empty.digest, 0).await.unwrap(), Bytes::new());
    farm.stop().await.unwrap();
}

#[tokio::test]
async fn job_with_an_incomplete_scene_is_refused_with_missing_digests() {
    let store = Store::in_memory();
    let farm = Coordinator::start_with(Config::default(), store.clone(), femc_queue::Memory::default()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let of = |bytes: &[u8]| BundlePiece { artifact: Artifact::from_bytes(bytes), unpacked: 9 };
    let manifest = Manifest { pieces: vec![of(b"one"), of(b"two"), of(b"three")], ..Manifest::default() };
    let bytes = Bytes::from(manifest.encode().unwrap());
    let job = JobSpec { bundle: Digest::compute(&bytes), ..spec() };
    let lacks = |digests: Vec<Digest>| Refusal::MissingArtifacts { count: digests.len() as u64, digests };
    let [one, two, three] = [b"one".as_slice(), b"two", b"three"].map(Digest::compute);
    assert_eq!(refusal(client.submit(None, job.clone()).await), lacks(vec![job.bundle]));
    client.put(bytes).await.unwrap();
    client.put(Bytes::from_static(b"two")).await.unwrap();
    let refused = refusal(client.submit(None, job.clone()).await);
    assert_eq!(refused, lacks(vec![one, three]));
    assert!(refused.to_string().contains(&one.to_string()), "{refused}");
    assert_eq!(client.list().await.unwrap(), [], "nothing was queued");
    let all = [b"one".as_slice(), b"two", b"three", b"one"].map(Bytes::copy_from_slice);
    assert_eq!(client.put_all(&all).await.unwrap(), 8, "only what is missing, and once");
    let id = client.submit(None, job.clone()).await.unwrap();
    store.remove(&two).await.unwrap();
    assert_eq!(refusal(client.submit(None, job).await), lacks(vec![two]));
    assert_eq!(client.list().await.unwrap()[0].job, id);
    let damaged = client.put(Bytes::from_static(b"femcmnft and rubbish")).await.unwrap().digest;
    let job = JobSpec { bundle: damaged, ..spec() };
    assert!(matches!(refusal(client.submit(None, job).await), Refusal::Invalid { field, .. } if field == "bundle"));
    farm.stop().await.unwrap();
}

#[tokio::test]
async fn a_stopped_coordinator_cannot_be_reached_and_its_log_is_free() {
    let folder = tempfile::tempdir().unwrap();
    let config = Config {
        log: LogStorage::Sqlite(folder.path().join("log.sqlite")),
        artifacts: ArtifactStorage::Folder(folder.path().join("artifacts")),
        ..Config::default()
    };
    let farm = Coordinator::start(config.clone()).await.unwrap();
    let client = client(&farm).await;
    let id = client.submit(None, spec()).await.unwrap();
    let second = Coordinator::start(config.clone()).await.map(|_| ()).unwrap_err();
    assert!(matches!(second, CoordinatorError::Queue(femc_queue::QueueError::InUse { .. })), "{second}");
    let url = farm.url();
    farm.stop().await.unwrap();
    assert!(!folder.path().join("log.sqlite-wal").exists(), "a copy of the one file is complete");
    assert!(matches!(client.list().await, Err(CallError::Unreachable { .. })));
    assert!(matches!(Client::connect(&url).await, Err(CallError::Unreachable { .. })));
    assert!(matches!(
        Client::connect("no address").await,
        Err(CallError::Address { .. } | CallError::Unreachable { .. })
    ));
    let farm = Coordinator::start(config).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    assert_eq!(client.list().await.unwrap()[0].job, id);
    farm.stop().await.unwrap();
}

#[tokio::test]
async fn an_address_that_others_can_reach_is_refused_unless_asked_for() {
    let config = Config { listen: "0.0.0.0:0".parse().unwrap(), ..Config::default() };
    let error = Coordinator::start(config).await.map(|_| ()).unwrap_err();
    assert!(matches!(error, CoordinatorError::Exposed { .. }), "{error}");
}
