//! Tests of downloads of job results, over HTTP/1.1 on a real connection.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::sync::{Arc, Mutex};

use bytes::Bytes;
use femc_model::{
    Artifact, ChunkSize, Digest, FrameRecord, Graph, Grid, JobId, JobNotes, JobSpec, Output, Refusal, Role, Scope,
    StageKind, StageTemplate, TaskSizes,
};
use femc_service::{Call, ConnectedClient, Farm, Gate, Http, JobShape, Limits, Site, TransferSlots};
use femc_store::object_store::ObjectStoreExt as _;
use femc_store::{Store, artifact_path};
use femc_trust::{Authority, Holder, Tokens};
use hyper_util::rt::TokioIo;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;

const JOB: JobId = JobId(7);

/// A coordinator with one job. It records the artifacts that were reported lost.
struct TestServer {
    address: String,
    store: Store,
    lost: Arc<Mutex<Vec<Digest>>>,
    artifacts: BTreeMap<&'static str, (Artifact, Bytes)>,
}

/// An HTTP response.
struct TestResponse {
    status: u16,
    head: BTreeMap<String, String>,
    body: Vec<u8>,
}

impl TestResponse {
    fn header(&self, name: &str) -> &str {
        self.head.get(name).map_or("", String::as_str)
    }

    fn code(&self) -> String {
        let json: serde_json::Value = serde_json::from_slice(&self.body).expect("JSON");
        assert!(json["error"]["message"].is_string() && json["error"]["help"].is_string(), "{json}");
        json["error"]["code"].as_str().expect("a code").to_owned()
    }
}

/// Name of a job that has made nothing yet.
const UNFINISHED: &str = "unfinished";

fn spec(name: &str) -> JobSpec {
    let options =
        r#"{"stills":true,"sheet":"all frames.png","video":{"name":"drive.webm","rate":24.0},"painting":null}"#;
    let encode = StageTemplate::new(StageKind::EncodeClip, Scope::Job, TaskSizes::even(1, 1), &[Role::Clip])
        .with_options(options);
    let geometry = StageTemplate::new(StageKind::Geometry, Scope::Frame, TaskSizes::even(1, 1), &[Role::Geometry]);
    let solution = StageTemplate::new(StageKind::Solution, Scope::Frame, TaskSizes::even(1, 1), &[Role::Solution]);
    let learn = StageTemplate::new(StageKind::Learn, Scope::Frame, TaskSizes::even(1, 1), &[Role::Targets]);
    JobSpec {
        name: name.into(),
        bundle: Digest::compute(b"bundle"),
        entry: "fog.mgf".into(),
        settings: "{}".into(),
        frames: vec![3, 4],
        grid: Grid { film: [8, 8], tile: 8 },
        graph: Graph { stages: vec![encode, geometry, solution, learn] },
        contents: Vec::new(),
        priority: 50,
        owner: "me".into(),
        tags: Vec::new(),
        notes: JobNotes::default(),
    }
}

fn record(frame: u32, outputs: Vec<Output>) -> FrameRecord {
    FrameRecord {
        frame,
        outputs,
        spp: 4,
        relative_error: None,
        blocks: None,
        bad_samples: 0,
        busy_seconds: 1.0,
        seconds: 1.0,
        rounds: None,
        times: None,
    }
}

/// Answers calls to a farm with this job.
async fn serve_calls(
    mut inbox: mpsc::Receiver<Call<()>>,
    spec: JobSpec,
    records: Vec<FrameRecord>,
    lost: Arc<Mutex<Vec<Digest>>>,
) {
    while let Some(call) = inbox.recv().await {
        match call {
            Call::Shape { job: JOB, reply } => {
                drop(reply.send(Ok(JobShape { spec: Box::new(spec.clone()), chunk_size: ChunkSize::Whole })));
            }
            Call::Shape { job, reply } => drop(reply.send(Err(Refusal::NoSuchJob { job }))),
            Call::Frames { reply, .. } => drop(reply.send(Ok(records.clone()))),
            Call::Parts { reply, .. } => drop(reply.send(Ok(Vec::new()))),
            Call::ArtifactLost { digest, reply } => {
                lost.lock().expect("a list").push(digest);
                drop(reply.send(Ok(())));
            }
            other => panic!("nobody asks {other:?}"),
        }
    }
}

impl TestServer {
    /// Starts a coordinator.
    /// - `tokens`: accepted tokens. `None`: the farm does not authenticate.
    async fn start(name: &str, tokens: Option<Tokens>) -> Self {
        let store = Store::in_memory();
        let large: Vec<u8> = (0..9_000_001u32).map(|i| (i * 7 + i / 251) as u8).collect();
        let mut artifacts = BTreeMap::new();
        for (title, bytes) in [
            ("image", Bytes::from(large)),
            ("preview", Bytes::from_static(b"a preview")),
            ("layers", Bytes::from_static(b"layers")),
            ("geometry", Bytes::from_static(b"geometry")),
            ("solution", Bytes::from_static(b"solution")),
            ("targets", Bytes::from_static(b"{}")),
            ("readings", Bytes::from_static(b"{}")),
            ("still 3", Bytes::from_static(b"still of 3")),
            ("still 4", Bytes::from_static(b"still of 4")),
            ("clip", Bytes::from_static(b"\x1a\x45\xdf\xa3\x9fB\x86\x81\x01B\x82\x84webm and so on")),
            ("sheet", Bytes::from_static(b"a sheet")),
        ] {
            artifacts.insert(title, (store.put(bytes.clone()).await.expect("kept"), bytes));
        }
        let all = |outputs: &[(Role, &str)]| {
            outputs.iter().map(|&(role, title)| Output { role, artifact: artifacts[title].0 }).collect()
        };
        let whole = [(Role::Still, "still 3"), (Role::Still, "still 4"), (Role::Sheet, "sheet"), (Role::Clip, "clip")];
        let frame = [
            (Role::Image, "image"),
            (Role::Preview, "preview"),
            (Role::LayerImage, "layers"),
            (Role::Geometry, "geometry"),
            (Role::Solution, "solution"),
            (Role::Targets, "targets"),
            (Role::Readings, "readings"),
        ];
        let mut records = vec![record(0, all(&whole)), record(3, all(&frame))];
        if name == UNFINISHED {
            records.clear();
        }
        let (calls, inbox) = mpsc::channel::<Call<()>>(8);
        let lost = Arc::new(Mutex::new(Vec::new()));
        tokio::spawn(serve_calls(inbox, spec(name), records, lost.clone()));
        let gate = Gate::new(tokens.map(|tokens| (None, Some(tokens))), Limits::default(), None);
        let places = TransferSlots::new(gate.limits());
        let http = Http::new(Farm::new(calls), store.clone(), places, gate, Site::default(), false);
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("its address").to_string();
        tokio::spawn(async move {
            while let Ok((stream, peer)) = listener.accept().await {
                let reached = stream.local_addr().ok();
                let client =
                    ConnectedClient { address: Some(peer), local_address: reached, ..ConnectedClient::default() };
                let http = http.clone();
                let service = hyper::service::service_fn(move |request| {
                    let (http, visitor) = (http.clone(), client.clone());
                    async move { Ok::<_, Infallible>(http.serve(request, visitor).await) }
                });
                let server = hyper::server::conn::http1::Builder::new();
                tokio::spawn(server.serve_connection(TokioIo::new(stream), service));
            }
        });
        Self { address, store, lost, artifacts }
    }

    async fn request(&self, line: &str, head: &[&str]) -> TestResponse {
        let mut stream = TcpStream::connect(&self.address).await.expect("a connection");
        let head: String = head.iter().map(|line| format!("{line}\r\n")).collect();
        let request = format!("{line} HTTP/1.1\r\nHost: {}\r\n{head}Connection: close\r\n\r\n", self.address);
        stream.write_all(request.as_bytes()).await.expect("sent");
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).await.expect("an answer");
        let end = bytes.windows(4).position(|four| four == b"\r\n\r\n").expect("a head");
        let text = String::from_utf8_lossy(&bytes[..end]).into_owned();
        let status = text.split_whitespace().nth(1).and_then(|status| status.parse().ok()).expect("a status");
        let lines = text.lines().filter_map(|line| line.split_once(": "));
        let head = lines.map(|(name, value)| (name.to_ascii_lowercase(), value.to_owned())).collect();
        TestResponse { status, head, body: bytes[end + 4..].to_vec() }
    }

    async fn get(&self, path: &str, head: &[&str]) -> TestResponse {
        self.request(&format!("GET /api/v1/jobs/{path}"), head).await
    }

    fn bytes(&self, title: &str) -> &Bytes {
        &self.artifacts[title].1
    }

    fn digest(&self, title: &str) -> Digest {
        self.artifacts[title].0.digest
    }

    fn tag(&self, title: &str) -> String {
        format!("\"{}\"", self.digest(title))
    }

    fn lost(&self) -> Vec<Digest> {
        self.lost.lock().expect("a list").clone()
    }
}

#[tokio::test]
async fn every_result_has_path_media_type_and_name_used_by_fetch() {
    let server = TestServer::start("drive", None).await;
    for (path, title, kind, name) in [
        ("7/frames/3/image.exr", "image", "image/x-exr", "drive.0003.exr"),
        ("7/frames/3/preview.png", "preview", "image/png", "drive.0003.preview.png"),
        ("7/frames/3/layers.exr", "layers", "image/x-exr", "drive.0003.layers.exr"),
        ("7/frames/3/geometry.glb", "geometry", "model/gltf-binary", "drive.0003.glb"),
        ("7/frames/3/readings.json", "readings", "application/json", "drive.0003.readings.json"),
        ("7/geometry?frame=3", "geometry", "model/gltf-binary", "drive.0003.glb"),
        ("7/geometry?frame=4", "geometry", "model/gltf-binary", "drive.0003.glb"),
        ("7/geometry", "geometry", "model/gltf-binary", "drive.0003.glb"),
        ("7/frames/3/solution.glb", "solution", "model/gltf-binary", "drive.0003.solution.glb"),
        ("7/solution?frame=4", "solution", "model/gltf-binary", "drive.0003.solution.glb"),
        ("7/frames/3/targets.json", "targets", "application/json", "drive.0003.targets.json"),
        ("7/targets?frame=4", "targets", "application/json", "drive.0003.targets.json"),
        ("7/frames/3/still.png", "still 3", "image/png", "drive.0003.png"),
        ("7/frames/4/still.png", "still 4", "image/png", "drive.0004.png"),
        ("7/clip", "clip", "video/webm", "drive.webm"),
        ("7/sheet.png", "sheet", "image/png", "all frames.png"),
    ] {
        let answer = server.get(path, &[]).await;
        assert_eq!((answer.status, answer.header("content-type")), (200, kind), "{path}");
        assert!(answer.body == *server.bytes(title), "{path}: its bytes");
        assert_eq!(answer.header("content-disposition"), format!("attachment; filename=\"{name}\""), "{path}");
        assert_eq!(answer.header("content-length"), answer.body.len().to_string(), "{path}");
        assert_eq!(answer.header("etag"), server.tag(title), "{path}");
        assert_eq!((answer.header("accept-ranges"), answer.header("cache-control")), ("bytes", "private, no-cache"));
        assert!(answer.header("content-security-policy").contains("media-src 'self'"));
        let head = server.request(&format!("HEAD /api/v1/jobs/{path}"), &[]).await;
        assert_eq!((head.status, head.body.len()), (200, 0), "{path}");
        assert_eq!(head.header("content-length"), answer.header("content-length"), "{path}");
        assert_eq!(head.header("content-type"), kind, "{path}");
        let tag = format!("If-None-Match: W/\"other\", {}", server.tag(title));
        let again = server.get(path, &[&tag]).await;
        assert_eq!((again.status, again.body.len(), again.header("etag")), (304, 0, answer.header("etag")), "{path}");
    }
    assert_eq!(server.lost(), []);
}

#[tokio::test]
async fn geometry_that_is_not_made_yet_is_an_empty_answer() {
    let server = TestServer::start(UNFINISHED, None).await;
    for path in ["7/geometry", "7/geometry?frame=3", "7/solution", "7/solution?frame=3", "7/targets"] {
        let answer = server.get(path, &[]).await;
        assert_eq!((answer.status, answer.body.len()), (204, 0), "{path}");
    }
    assert_eq!(server.get("7/geometry?frame=three", &[]).await.status, 400);
    assert_eq!(server.request("POST /api/v1/jobs/7/geometry", &[]).await.status, 405);
}

#[tokio::test]
async fn range_sends_only_its_bytes_and_past_end_refusal_has_length() {
    let server = TestServer::start("drive", None).await;
    let (path, bytes) = ("7/frames/3/image.exr", server.bytes("image").clone());
    // The last of these spans two blocks of the store.
    for (range, part) in
        [("0-", 0..9_000_001), ("0-0", 0..1), ("-5", 8_999_996..9_000_001), ("4194300-4194310", 4_194_300..4_194_311)]
    {
        let answer = server.get(path, &[&format!("Range: bytes={range}")]).await;
        assert_eq!(answer.status, 206, "{range}");
        assert!(answer.body == bytes[part.clone()], "{range}: its bytes");
        let due = format!("bytes {}-{}/9000001", part.start, part.end - 1);
        assert_eq!(answer.header("content-range"), due, "{range}");
    }
    let beyond = server.get(path, &["Range: bytes=9000001-"]).await;
    assert_eq!((beyond.status, beyond.header("content-range")), (416, "bytes */9000001"));
    assert_eq!(beyond.code(), "range");
    for range in ["bytes=0-1,5-6", "bytes=x", "frames=0-1"] {
        assert_eq!(server.get(path, &[&format!("Range: {range}")]).await.status, 200, "{range}");
    }
    let head = server.request(&format!("HEAD /api/v1/jobs/{path}"), &["Range: bytes=0-1"]).await;
    assert_eq!((head.status, head.header("content-length")), (200, "9000001"), "ranges are for GET alone");
    let current = format!("If-Range: {}", server.tag("image"));
    assert_eq!(server.get(path, &["Range: bytes=0-1", &current]).await.status, 206);
    assert_eq!(server.get(path, &["Range: bytes=0-1", "If-Range: \"other\""]).await.status, 200);
}

#[tokio::test]
async fn a_name_of_any_characters_stays_within_its_header() {
    let server = TestServer::start("Nachtfahrt \"№ 3\"; filename=x.exe", None).await;
    let answer = server.get("7/frames/3/preview.png", &[]).await;
    assert_eq!(
        answer.header("content-disposition"),
        "attachment; filename=\"Nachtfahrt __ 3_; filename=x.exe.0003.preview.png\"; \
         filename*=UTF-8''Nachtfahrt%20%22%E2%84%96%203%22%3B%20filename%3Dx.exe.0003.preview.png"
    );
}

#[tokio::test]
async fn unmade_result_is_not_found_and_damaged_or_lost_one_is_remade() {
    let server = TestServer::start("drive", None).await;
    for path in ["7/frames/4/image.exr", "7/frames/3/painted.png", "7/frames/0/still.png", "7/frames/9/still.png"] {
        let answer = server.get(path, &[]).await;
        assert_eq!((answer.status, answer.code().as_str()), (404, "not_found"), "{path}");
    }
    assert_eq!(server.get("8/clip", &[]).await.status, 404, "another job");
    assert_eq!(server.request("POST /api/v1/jobs/7/clip", &[]).await.header("allow"), "GET, HEAD");
    assert_eq!(server.lost(), []);
    let objects = server.store.objects();
    let mut other = server.bytes("image").to_vec();
    other[5_000_000] ^= 1;
    objects.put(&artifact_path(&server.digest("image")), other.into()).await.expect("damaged");
    let answer = server.get("7/frames/3/image.exr", &[]).await;
    assert_eq!((answer.status, answer.code().as_str()), (404, "lost"));
    assert!(answer.header("content-disposition").is_empty(), "an error is not kept as an image");
    assert_eq!(server.lost(), [server.digest("image")]);
    // Nothing has read the clip since it was stored.
    objects.delete(&artifact_path(&server.digest("clip"))).await.expect("removed");
    let answer = server.get("7/clip", &["Range: bytes=3-"]).await;
    assert_eq!((answer.status, answer.code().as_str()), (404, "lost"));
    assert_eq!(server.request("HEAD /api/v1/jobs/7/clip", &[]).await.status, 404);
    assert!(server.lost().contains(&server.digest("clip")));
}

#[tokio::test]
async fn viewers_may_download_and_workers_and_strangers_may_not() {
    let folder = tempfile::tempdir().expect("a folder");
    let authority = Authority::init(folder.path(), "farm").expect("an authority");
    let ann = Holder::User { name: "ann".into(), role: femc_trust::Role::Viewer };
    let viewer = authority.issue_token(ann, 1).expect("a token").token().secret();
    let worker = authority.issue_token(Holder::Worker { name: "w".into() }, 1).expect("a token").token().secret();
    let tokens = Tokens::open(authority.tokens_path()).expect("a list");
    let server = TestServer::start("drive", Some(tokens)).await;
    let (_, port) = server.address.rsplit_once(':').expect("a port");
    let cookie = format!("Cookie: femc-{port}={viewer}");
    for path in ["7/frames/3/image.exr", "7/clip", "7/sheet.png"] {
        for (header, status) in [
            ("Accept: */*".to_owned(), 401),
            (format!("Authorization: Bearer {worker}"), 403),
            (format!("Authorization: Bearer {viewer}"), 200),
            (cookie.clone(), 200),
            (format!("Cookie: femc={viewer}"), 401),
        ] {
            assert_eq!(server.get(path, &[&header]).await.status, status, "{path}");
        }
        let foreign = server.get(path, &[&cookie, "Sec-Fetch-Site: cross-site"]).await;
        assert_eq!((foreign.status, foreign.code().as_str()), (403, "cross_site"), "{path}");
    }
}
