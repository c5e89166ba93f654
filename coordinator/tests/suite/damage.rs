//! Tests of damaged artifacts in the store, and of concurrent uploads.

use std::collections::VecDeque;
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use crate::common::{Cut, Proxy};
use bytes::Bytes;
use femc_coordinator::{ArtifactStorage, Config, Coordinator, Handle};
use femc_model::*;
use femc_proto::{CallError, Client, SessionReceiver, SessionSender};
use tokio::io::AsyncReadExt as _;
use tokio::net::{TcpListener, TcpStream};

const MB: u64 = 1_000_000;

async fn farm() -> (tempfile::TempDir, Handle, Client) {
    let folder = tempfile::tempdir().unwrap();
    let config = Config { artifacts: ArtifactStorage::Folder(folder.path().join("artifacts")), ..Config::default() };
    let farm = Coordinator::start(config).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    (folder, farm, client)
}

/// Makes bytes without repetitions.
fn noise(size: u64) -> Bytes {
    let mut state = size;
    let word = |_| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 32).to_le_bytes()
    };
    (0..size / 8).flat_map(word).collect()
}

/// Returns the path of an artifact's file.
fn file(folder: &Path, digest: &Digest) -> PathBuf {
    let name = digest.to_string();
    folder.join("artifacts").join(&name[..2]).join(&name[2..])
}

/// Returns damaged versions of a file: truncated, empty, with a flipped bit, with bytes appended.
fn damaged_variants(whole: &[u8]) -> Vec<Vec<u8>> {
    let mut flipped = whole.to_vec();
    flipped[whole.len() / 2] ^= 1;
    vec![whole[..whole.len() - 1].to_vec(), vec![], flipped, [whole, b"rubbish"].concat()]
}

fn spec(bundle: Digest) -> JobSpec {
    JobSpec {
        name: "fog".into(),
        bundle,
        entry: "fog.mgf".into(),
        settings: "{}".into(),
        frames: vec![1, 2],
        grid: Grid { film: [8, 8], tile: 8 },
        graph: testing::frame_graph(Grid { film: [8, 8], tile: 8 }.sizes(), &[16], 0),
        contents: vec![],
        priority: 50,
        owner: "me".into(),
        tags: vec![],
        notes: JobNotes::default(),
    }
}

/// A worker that the test controls.
struct TestWorker {
    client: Client,
    out: SessionSender,
    incoming: SessionReceiver,
    /// Artifact reported as the image of every frame; `None`: the one that the worker makes.
    image: Option<Artifact>,
    /// Assignments received while the worker waited for another message.
    waiting: VecDeque<Assignment>,
}

impl TestWorker {
    async fn join(url: &str) -> Self {
        let client = Client::connect(url).await.unwrap();
        let registration = Registration {
            name: "worker".into(),
            instance: 1,
            engine: "e".into(),
            threads: 1,
            slots: 1,
            tags: vec![],
            held: vec![],
            death: None,
        };
        let (out, incoming) = client.session(registration).await.unwrap();
        Self { client, out, incoming, image: None, waiting: VecDeque::new() }
    }

    async fn assigned(&mut self) -> Assignment {
        if let Some(assignment) = self.waiting.pop_front() {
            return assignment;
        }
        loop {
            if let ToWorker::Assign(assignment) = self.incoming.next().await.unwrap().expect("the session goes on") {
                return assignment;
            }
        }
    }

    /// Reports a result. Returns whether it was accepted.
    async fn report(&mut self, held: &Assignment, result: TaskResult) -> bool {
        let (task, epoch) = (held.task, held.epoch);
        self.send_and_wait(epoch, FromWorker::Completed { task, epoch, result, log: None, usage: None }).await
    }

    /// Sends a message about a lease. Returns whether it was accepted.
    async fn send_and_wait(&mut self, epoch: Epoch, message: FromWorker) -> bool {
        self.out.send(message).await;
        loop {
            match self.incoming.next().await.unwrap().expect("the session goes on") {
                ToWorker::Accepted { epoch: of, .. } if of == epoch => return true,
                ToWorker::Revoke { epoch: of, reason: RevokeReason::Expired, .. } if of == epoch => panic!("no answer"),
                ToWorker::Refused { epoch: of, .. } | ToWorker::Revoke { epoch: of, .. } if of == epoch => {
                    return false;
                }
                ToWorker::Assign(assignment) => self.waiting.push_back(assignment),
                _ => {}
            }
        }
    }

    /// Runs tasks until the job is done. The images are the bytes `Image 1` and `Image 2`, unless `image` is set.
    async fn work(&mut self, id: JobId) {
        while self.client.status(id).await.unwrap().state != JobState::Done {
            let held = self.assigned().await;
            let result = self.result(&held).await;
            assert!(self.report(&held, result).await);
        }
    }

    async fn result(&self, held: &Assignment) -> TaskResult {
        let bytes = format!("{:?} {}", held.task.stage.kind, held.task.stage.frame);
        let artifact = self.client.put(Bytes::from(bytes)).await.unwrap();
        made(held, if held.task.stage.kind == StageKind::Image { self.image.unwrap_or(artifact) } else { artifact })
    }
}

/// Makes the result of a worker that has made this artifact for a task.
fn made(held: &Assignment, artifact: Artifact) -> TaskResult {
    let of = |role| TaskResult { outputs: vec![Output { role, artifact }], seconds: 0.1, ..TaskResult::default() };
    match held.task.stage.kind {
        StageKind::Render => TaskResult { units: held.spec.steps.len() as u64 * 64, ..of(Role::Tile) },
        _ => TaskResult { decision: Some(Decision::Done), ..of(Role::Image) },
    }
}

/// Way in which an artifact gets into the store.
#[derive(Debug, Clone, Copy)]
enum ArtifactOrigin {
    /// Uploaded through the coordinator.
    Uploaded,
    /// Left by an earlier run of the coordinator. The present one has not checked it yet.
    LeftOver,
}

impl ArtifactOrigin {
    const BOTH: [Self; 2] = [Self::Uploaded, Self::LeftOver];

    /// Puts a new artifact into the store, a different one on each call.
    async fn plant(self, folder: &Path, client: &Client, number: &mut u64) -> (Bytes, Artifact) {
        *number += 1;
        let bytes = Bytes::from(format!("artifact {number}"));
        let artifact = Artifact::from_bytes(&bytes);
        match self {
            Self::Uploaded => drop(client.put(bytes.clone()).await.unwrap()),
            Self::LeftOver => {
                let file = file(folder, &artifact.digest);
                std::fs::create_dir_all(file.parent().unwrap()).unwrap();
                std::fs::write(file, &bytes).unwrap();
            }
        }
        (bytes, artifact)
    }
}

/// Returns sizes that differ from the size of the artifact.
fn other_sizes(bytes: u64) -> [u64; 5] {
    [0, 1, bytes - 1, bytes + 1, bytes + (1 << 40)]
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn result_with_a_wrong_artifact_size_is_rejected() {
    for origin in ArtifactOrigin::BOTH {
        let (folder, farm, client) = farm().await;
        let bundle = client.put(Bytes::from_static(b"bundle")).await.unwrap();
        let id = client.submit(None, spec(bundle.digest)).await.unwrap();
        let (mut number, mut refused) = (0, 0);
        while client.status(id).await.unwrap().state != JobState::Done {
            for case in [0, 2, 3] {
                let (bytes, artifact) = origin.plant(folder.path(), &client, &mut number).await;
                let other = Artifact { bytes: other_sizes(artifact.bytes)[case], ..artifact };
                // A worker gets no tasks for a while after a refused report, so each report comes from another worker.
                let mut worker = TestWorker::join(&farm.url()).await;
                let held = worker.assigned().await;
                assert!(!worker.report(&held, made(&held, other)).await, "{origin:?}: {} of {other:?}", held.task);
                assert_eq!(client.get_exactly(&artifact).await.unwrap(), bytes, "the artifact stays");
                refused += 1;
            }
            let (_, artifact) = origin.plant(folder.path(), &client, &mut number).await;
            let mut worker = TestWorker::join(&farm.url()).await;
            let mut held = worker.assigned().await;
            if held.task.stage.kind == StageKind::Image {
                // A second output with a wrong size makes the report invalid, although the first one is right.
                let (_, preview) = origin.plant(folder.path(), &client, &mut number).await;
                let mut both = made(&held, artifact);
                both.outputs.push(Output { role: Role::Preview, artifact: Artifact { bytes: 1, ..preview } });
                assert!(!worker.report(&held, both).await, "{origin:?}: {}", held.task);
                (worker, refused) = (TestWorker::join(&farm.url()).await, refused + 1);
                held = worker.assigned().await;
            }
            assert!(worker.report(&held, made(&held, artifact)).await, "{origin:?}: {} with its own size", held.task);
        }
        assert_eq!(refused, 4 * 3 + 2);
        farm.stop().await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn result_with_a_damaged_or_lost_artifact_is_rejected() {
    let (folder, farm, client) = farm().await;
    let bundle = client.put(Bytes::from_static(b"bundle")).await.unwrap();
    client.submit(None, spec(bundle.digest)).await.unwrap();
    let mut number = 0;
    for case in 0..5 {
        let (bytes, artifact) = ArtifactOrigin::LeftOver.plant(folder.path(), &client, &mut number).await;
        let at = file(folder.path(), &artifact.digest);
        match damaged_variants(&bytes).get(case) {
            Some(damaged) => std::fs::write(at, damaged).unwrap(),
            None => std::fs::remove_file(at).unwrap(),
        }
        let mut worker = TestWorker::join(&farm.url()).await;
        let held = worker.assigned().await;
        assert!(!worker.report(&held, made(&held, artifact)).await, "harm {case}");
        assert_eq!(client.missing(&[artifact.digest]).await.unwrap(), [artifact.digest]);
    }
    farm.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_log_of_another_size_than_its_report_says_did_not_arrive() {
    for origin in ArtifactOrigin::BOTH {
        let (folder, farm, client) = farm().await;
        let bundle = client.put(Bytes::from_static(b"bundle")).await.unwrap();
        let id = client.submit(None, spec(bundle.digest)).await.unwrap();
        let mut worker = TestWorker::join(&farm.url()).await;
        let (mut number, mut expected) = (0, Vec::new());
        for other in [Some(3), None, Some(0), Some(2)] {
            let (_, log) = origin.plant(folder.path(), &client, &mut number).await;
            let held = worker.assigned().await;
            let (task, epoch, result) = (held.task, held.epoch, worker.result(&held).await);
            let text =
                LogText::Stored(other.map_or(log, |case| Artifact { bytes: other_sizes(log.bytes)[case], ..log }));
            let told = Some(TaskLog { outcome: AttemptOutcome::Done, seconds: 0.25, text });
            let report = FromWorker::Completed { task, epoch, result, log: told, usage: None };
            assert!(worker.send_and_wait(epoch, report).await, "it is no reason to do the task again");
            let lost = LogText::Inline("the coordinator did not receive the log".into());
            expected.push((epoch, if other.is_some() { lost } else { LogText::Stored(log) }));
        }
        let mut kept = client.logs(id, Tick(0)).await.unwrap();
        kept.sort_by_key(|record| record.epoch);
        expected.sort_by_key(|(epoch, _)| *epoch);
        assert_eq!(kept.into_iter().map(|it| (it.epoch, it.log.text)).collect::<Vec<_>>(), expected, "{origin:?}");
        farm.stop().await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn fetch_with_a_wrong_size_is_refused_and_the_artifact_stays() {
    let (_folder, farm, client) = farm().await;
    let bundle = client.put(Bytes::from_static(b"bundle")).await.unwrap();
    let whole = noise(2 * MB);
    let image = client.put(whole.clone()).await.unwrap();
    let id = client.submit(None, spec(bundle.digest)).await.unwrap();
    let mut worker = TestWorker::join(&farm.url()).await;
    worker.image = Some(image);
    worker.work(id).await;
    let proxy = Proxy::start(farm.address(), &[]).await;
    let through = Client::connect(&proxy.url).await.unwrap();
    for bytes in other_sizes(image.bytes) {
        let heard = through.get_exactly(&Artifact { bytes, ..image }).await;
        let is_refused =
            matches!(&heard, Err(CallError::Refused(Refusal::DigestMismatch { digest })) if *digest == image.digest);
        assert!(
            is_refused,
            "the artifact was asked for with the wrong size of {bytes} bytes, and the answer was {heard:?}"
        );
    }
    assert!(proxy.traffic.down() < MB / 10, "{} bytes came", proxy.traffic.down());
    let status = client.status(id).await.unwrap();
    assert_eq!((status.state, status.frames_done), (JobState::Done, 2), "no frame is lost");
    assert_eq!(through.get_exactly(&image).await.unwrap(), whole);
    farm.stop().await.unwrap();
}

/// Starts a proxy to `server` that alters the bytes of [`marked`] in both directions.
async fn corrupting_proxy(server: SocketAddr) -> String {
    async fn pass(mut from: impl tokio::io::AsyncRead + Unpin, mut to: impl tokio::io::AsyncWrite + Unpin) {
        let mut buffer = vec![0; 1 << 16];
        while let Ok(read @ 1..) = from.read(&mut buffer).await {
            let (mut run, bytes) = (0, &mut buffer[..read]);
            for byte in bytes.iter_mut() {
                run = if *byte == MARK { run + 1 } else { 0 };
                *byte ^= u8::from(run == 16);
            }
            if tokio::io::AsyncWriteExt::write_all(&mut to, bytes).await.is_err() {
                return;
            }
        }
    }
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    tokio::spawn(async move {
        while let Ok((client, _)) = listener.accept().await {
            let (from_client, to_client) = client.into_split();
            let (from_server, to_server) = TcpStream::connect(server).await.unwrap().into_split();
            tokio::spawn(pass(from_client, to_server));
            tokio::spawn(pass(from_server, to_client));
        }
    });
    url
}

/// Byte that is repeated more often in artifacts of [`marked`] than in any message. The proxy recognizes artifacts by it.
const MARK: u8 = 0xa5;

fn marked(size: usize) -> Bytes {
    vec![MARK; size].into()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn bytes_that_a_link_has_changed_are_refused_on_either_side() {
    let (_folder, farm, direct) = farm().await;
    let far = Client::connect(&corrupting_proxy(farm.address()).await).await.unwrap();
    let is_mismatch =
        |outcome: &Result<(), CallError>| matches!(outcome, Err(CallError::Refused(Refusal::DigestMismatch { .. })));
    for size in [100, 3_000_000] {
        let (whole, artifact) = (marked(size), Artifact::from_bytes(&marked(size)));
        let put = far.put(whole.clone()).await.map(drop);
        assert!(is_mismatch(&put), "{put:?}");
        assert_eq!(direct.missing(&[artifact.digest]).await.unwrap(), [artifact.digest], "nothing is kept");
        direct.put(whole.clone()).await.unwrap();
        for got in [far.get(&artifact.digest, 1 << 30).await, far.get_exactly(&artifact).await] {
            let got = got.map(drop);
            assert!(is_mismatch(&got), "{got:?}");
        }
        assert_eq!(direct.get_exactly(&artifact).await.unwrap(), whole, "the store's bytes are sound");
    }
    farm.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_report_is_answered_and_its_log_is_kept() {
    let (_folder, farm, client) = farm().await;
    let bundle = client.put(Bytes::from_static(b"bundle")).await.unwrap();
    let id = client.submit(None, JobSpec { frames: vec![1, 2, 3], ..spec(bundle.digest) }).await.unwrap();
    let stored = client.put(Bytes::from_static(b"a long log")).await.unwrap();
    let mut reported = Vec::new();
    for case in 0..3 {
        // A worker gets no tasks for a while after a failure of its surroundings, so each report comes from another worker.
        let mut worker = TestWorker::join(&farm.url()).await;
        let held = worker.assigned().await;
        let (task, epoch) = (held.task, held.epoch);
        let (result, absent) = (worker.result(&held).await, Artifact::from_bytes(b"never uploaded"));
        let outputs = vec![Output { role: Role::Tile, artifact: absent }];
        let tile = TaskResult { outputs, units: 16 * 64, ..TaskResult::default() };
        let failure = Failure::Panicked { message: "oops".into() };
        let log = |attempt, text| Some(TaskLog { outcome: attempt, seconds: 0.25, text });
        let [inline, stored] = [LogText::Inline(format!("log {case}")), LogText::Stored(stored)];
        let (message, counts) = match case {
            0 => {
                let log = log(AttemptOutcome::Done, inline);
                (FromWorker::Completed { task, epoch, result, log, usage: None }, true)
            }
            1 => {
                let (result, log) = (tile, log(AttemptOutcome::Done, inline));
                (FromWorker::Completed { task, epoch, result, log, usage: None }, false)
            }
            _ => (
                FromWorker::Failed { task, epoch, failure, log: log(AttemptOutcome::Failed, stored), usage: None },
                true,
            ),
        };
        let (FromWorker::Completed { log, .. } | FromWorker::Failed { log, .. }) = &message else { unreachable!() };
        reported.push((epoch, log.clone().unwrap()));
        assert_eq!(worker.send_and_wait(epoch, message).await, counts, "report {case}");
    }
    let mut kept = client.logs(id, Tick(0)).await.unwrap();
    kept.sort_by_key(|record| record.epoch);
    assert_eq!(kept.into_iter().map(|record| (record.epoch, record.log)).collect::<Vec<_>>(), reported);
    farm.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_truncated_artifact_is_wanted_again_by_whoever_offers_it() {
    let (folder, farm, client) = farm().await;
    for whole in [Bytes::from_static(b"a tile of some bytes"), noise(9 * MB)] {
        let artifact = client.put(whole.clone()).await.unwrap();
        for damaged in damaged_variants(&whole) {
            std::fs::write(file(folder.path(), &artifact.digest), &damaged).unwrap();
            assert_eq!(client.put(whole.clone()).await.unwrap(), artifact);
            assert_eq!(client.get_exactly(&artifact).await.unwrap(), whole, "of {} bytes", damaged.len());

            std::fs::write(file(folder.path(), &artifact.digest), &damaged).unwrap();
            let heard = client.get_exactly(&artifact).await;
            let is_refused = matches!(
                heard,
                Err(CallError::Refused(Refusal::NoSuchArtifact { .. } | Refusal::DigestMismatch { .. }))
            );
            assert!(is_refused, "of {} bytes: {heard:?}", damaged.len());
            assert_eq!(client.missing(&[artifact.digest]).await.unwrap(), [artifact.digest], "it is removed");
            client.put(whole.clone()).await.unwrap();
        }
    }
    farm.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_truncated_result_does_not_block_its_job() {
    let (folder, farm, client) = farm().await;
    let bundle = client.put(Bytes::from_static(b"bundle")).await.unwrap();
    let id = client.submit(None, spec(bundle.digest)).await.unwrap();
    // Placed before any coordinator has seen it, like an artifact that was uploaded in an earlier run and truncated since.
    let tile = Digest::compute(b"Render 1");
    std::fs::create_dir_all(file(folder.path(), &tile).parent().unwrap()).unwrap();
    std::fs::write(file(folder.path(), &tile), b"Ren").unwrap();
    let mut worker = TestWorker::join(&farm.url()).await;
    worker.work(id).await;
    assert_eq!(client.frames(id).await.unwrap().len(), 2);
    farm.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn truncated_scene_is_sent_again_before_its_job_is_accepted() {
    let (folder, farm, client) = farm().await;
    let pieces: Vec<Bytes> = (0..3).map(|i| Bytes::from(format!("piece {i} of a scene"))).collect();
    let named = pieces.iter().map(|bytes| BundlePiece { artifact: Artifact::from_bytes(bytes), unpacked: 9 }).collect();
    let manifest = Bytes::from(Manifest { pieces: named, ..Manifest::default() }.encode().unwrap());
    let scene: Vec<Bytes> = pieces.iter().chain([&manifest]).cloned().collect();
    client.put_all(&scene).await.unwrap();
    for part in &scene {
        std::fs::write(file(folder.path(), &Digest::compute(part)), &part[..part.len() - 3]).unwrap();
        let refused = client.submit(None, spec(Digest::compute(&manifest))).await;
        assert!(matches!(refused, Err(CallError::Refused(Refusal::MissingArtifacts { count: 1, .. }))), "{refused:?}");
        assert_eq!(client.put_all(&scene).await.unwrap(), part.len() as u64, "just what is damaged");
        client.submit(None, spec(Digest::compute(&manifest))).await.unwrap();
    }
    farm.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn fetch_detects_a_damaged_image_and_its_frame_is_rerendered() {
    let (folder, farm, client) = farm().await;
    let bundle = client.put(Bytes::from_static(b"bundle")).await.unwrap();
    let id = client.submit(None, spec(bundle.digest)).await.unwrap();
    let mut worker = TestWorker::join(&farm.url()).await;
    worker.work(id).await;
    let before = client.frames(id).await.unwrap();
    let image = before[1].image().unwrap();
    let whole = client.get_exactly(&image).await.unwrap();
    for damaged in damaged_variants(&whole).into_iter().map(Some).chain([None]) {
        let at = file(folder.path(), &image.digest);
        match damaged {
            Some(damaged) => std::fs::write(at, damaged).unwrap(),
            None => std::fs::remove_file(at).unwrap(),
        }
        assert!(client.get_exactly(&image).await.is_err());
        let status = client.status(id).await.unwrap();
        assert_eq!((status.state, status.frames_done), (JobState::Running, 1), "told before the answer comes");
        assert!(status.waits.contains(&WaitReason::ImageLost { frame: 2 }), "{:?}", status.waits);
        assert_eq!(client.frames(id).await.unwrap(), before[..1]);
        worker.work(id).await;
        assert_eq!(client.frames(id).await.unwrap()[1].image(), Some(image));
        assert_eq!(client.get_exactly(&image).await.unwrap(), whole);
    }
    farm.stop().await.unwrap();
}

/// Starts a proxy to `server` that holds back the data from the server after this many bytes, signals that, and continues on
/// request.
async fn pausing_proxy(
    bytes: usize,
    server: SocketAddr,
) -> (String, tokio::sync::oneshot::Receiver<()>, tokio::sync::oneshot::Sender<()>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let ((say, said), (go_on, may_go_on)) = (tokio::sync::oneshot::channel(), tokio::sync::oneshot::channel());
    tokio::spawn(async move {
        let (mut from_client, mut to_client) = listener.accept().await.unwrap().0.into_split();
        let (mut from_server, mut to_server) = TcpStream::connect(server).await.unwrap().into_split();
        tokio::spawn(async move { tokio::io::copy(&mut from_client, &mut to_server).await });
        tokio::io::copy(&mut (&mut from_server).take(bytes as u64), &mut to_client).await.unwrap();
        say.send(()).unwrap();
        may_go_on.await.unwrap();
        let _ = tokio::io::copy(&mut from_server, &mut to_client).await;
    });
    (url, said, go_on)
}

/// Flips a byte of a file. A second call restores it.
fn flip(file: &Path) {
    let mut file = std::fs::OpenOptions::new().read(true).write(true).open(file).unwrap();
    let mut byte = [0];
    file.read_exact(&mut byte).unwrap();
    file.seek(SeekFrom::Start(0)).unwrap();
    file.write_all(&[byte[0] ^ 1]).unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn transient_read_error_of_a_sound_image_rerenders_no_frame() {
    let (folder, farm, client) = farm().await;
    let bundle = client.put(Bytes::from_static(b"bundle")).await.unwrap();
    let whole = noise(40 * MB);
    let image = client.put(whole.clone()).await.unwrap();
    let id = client.submit(None, spec(bundle.digest)).await.unwrap();
    let mut worker = TestWorker::join(&farm.url()).await;
    worker.image = Some(image);
    worker.work(id).await;
    let file = file(folder.path(), &image.digest);
    flip(&file);
    // More data than fits in the buffers between both ends is still unread when the byte is restored.
    let (url, held, go_on) = pausing_proxy(1 << 20, farm.address()).await;
    let slow = Client::connect(&url).await.unwrap();
    let fetch = tokio::spawn(async move { slow.get_exactly(&image).await });
    held.await.unwrap();
    flip(&file);
    go_on.send(()).unwrap();
    let heard = fetch.await.unwrap();
    assert!(matches!(heard, Err(CallError::Refused(Refusal::DigestMismatch { .. }))), "{heard:?}");
    let status = client.status(id).await.unwrap();
    assert_eq!((status.state, status.frames_done), (JobState::Done, 2), "the store has it");
    assert_eq!(client.get_exactly(&image).await.unwrap(), whole);
    farm.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_retry_of_a_job_that_is_done_looks_at_its_images() {
    let (folder, farm, client) = farm().await;
    let bundle = client.put(Bytes::from_static(b"bundle")).await.unwrap();
    let id = client.submit(None, spec(bundle.digest)).await.unwrap();
    let mut worker = TestWorker::join(&farm.url()).await;
    worker.work(id).await;
    let all_is_well = client.control(id, Control::Retry).await;
    assert!(matches!(all_is_well, Err(CallError::Refused(Refusal::Ended { .. }))), "{all_is_well:?}");
    let image = client.frames(id).await.unwrap()[0].image().unwrap();
    std::fs::write(file(folder.path(), &image.digest), b"half").unwrap();
    client.control(id, Control::Retry).await.unwrap();
    let status = client.status(id).await.unwrap();
    assert_eq!((status.state, status.frames_done), (JobState::Running, 1));
    worker.work(id).await;
    assert_eq!(client.get_exactly(&image).await.unwrap().len() as u64, image.bytes);
    farm.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn all_who_send_the_same_at_once_succeed_and_some_may_die() {
    let (_folder, farm, client) = farm().await;
    let bytes = noise(24 * MB);
    let artifact = Artifact::from_bytes(&bytes);
    let mut senders = Vec::new();
    for number in 0..6u64 {
        // Every second upload loses its connection on the way, and one client disconnects for good.
        let cuts = if number % 2 == 0 { vec![Cut::Up((3 + 2 * number) * MB)] } else { vec![] };
        let proxy = Proxy::start(farm.address(), &cuts).await;
        let sender = Client::connect(&proxy.url).await.unwrap();
        let bytes = bytes.clone();
        let sending = tokio::spawn(async move {
            let put = sender.put(bytes).await;
            (put, proxy.traffic.up())
        });
        senders.push(sending);
    }
    senders.remove(0).abort();
    let mut sent = 0;
    for sender in senders {
        let (put, up) = sender.await.unwrap();
        assert_eq!(put.unwrap(), artifact);
        sent += up;
    }
    println!("{sent} bytes were sent for {}", bytes.len());
    assert_eq!(client.get_exactly(&artifact).await.unwrap(), bytes);
    farm.stop().await.unwrap();
}
