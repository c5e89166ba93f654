//! Tests of the cache and of the threads that decode.

use std::collections::BTreeMap;
use std::path::PathBuf;

use femc_model::{Grid, Output, Stage, StageKind, TaskKey};
use tokio::sync::mpsc;

use super::*;
use crate::access::Limits;
use crate::light::{LightCallKind, LightFault};

/// Number of times that each source was opened.
static OPENED: Mutex<BTreeMap<String, u32>> = Mutex::new(BTreeMap::new());

fn times_opened(name: &str) -> u32 {
    OPENED.lock().unwrap().get(name).copied().unwrap_or(0)
}

/// Decoded light that repeats its source.
struct Echo {
    bytes: Vec<u8>,
    memory_bytes: usize,
}

impl LightData for Echo {
    fn memory_bytes(&self) -> usize {
        self.memory_bytes
    }

    fn answer(
        &self,
        _call: &LightCall,
        earlier: Option<&EarlierRows>,
        _is_cancelled: &AtomicBool,
    ) -> Result<LightAnswer, LightError> {
        // A row for each byte; the answer to a client that has rows is the tag of those.
        let identities = self.bytes.iter().map(|byte| [*byte; 16]).collect();
        let columns = earlier.map_or_else(|| self.bytes.clone(), |earlier| earlier.tag.clone().into_bytes());
        Ok(LightAnswer::Rows { columns, identities })
    }
}

/// Opens a source slowly. The name of a large one begins with `large`.
fn open(_tag: &str, sources: Vec<LightSource>) -> Result<Option<Arc<dyn LightData>>, LightFault> {
    let source = sources.into_iter().next().expect("a source");
    if let Some(part) = source.parts.iter().position(|part| part.as_ref() == b"bad") {
        return Err(LightFault { sources: vec![source.name], part: Some(part), message: "no light".into() });
    }
    *OPENED.lock().unwrap().entry(source.name.clone()).or_default() += 1;
    std::thread::sleep(Duration::from_millis(50));
    let memory_bytes = if source.name.starts_with("large") { 300 << 20 } else { 1 };
    Ok(Some(Arc::new(Echo { bytes: source.parts[0].to_vec(), memory_bytes })))
}

/// Views of files in a folder, with a farm that never answers.
struct Fixture {
    _folder: tempfile::TempDir,
    paths: Vec<PathBuf>,
    views: LightViews,
    farm: Farm<()>,
}

impl Fixture {
    fn new(names: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let paths: Vec<PathBuf> = names.iter().map(|name| folder.path().join(name)).collect();
        paths.iter().for_each(|path| std::fs::write(path, "first").unwrap());
        let file = |(name, path): (&&str, &PathBuf)| LightFile { name: (*name).to_owned(), path: path.clone() };
        let files = names.iter().zip(&paths).map(file).collect();
        let slots = TransferSlots::new(&Limits { transfers: 64, transfers_per_connection: 64, ..Limits::default() });
        let views = LightViews::new(Some(open), files, Store::in_memory(), slots);
        Self { _folder: folder, paths, views, farm: Farm::new(mpsc::channel(1).0) }
    }

    async fn ask(&self, file: usize) -> Vec<u8> {
        self.ask_since(file, None).await.1
    }

    /// Returns the tag and the bytes of an answer.
    async fn ask_since(&self, file: usize, since: Option<&str>) -> (String, Vec<u8>) {
        let call = LightCall { kind: LightCallKind::Schema, condition: None, bounds: None };
        let caller_key = CallerKey { name: None, connection: 1 };
        let question = LightQuestion { target: LightTarget::File(file), call, since: since.map(str::to_owned) };
        let answered = self.views.answer(&self.farm, question, None, caller_key).await.unwrap().unwrap();
        match answered.answer.unwrap().0 {
            LightAnswer::Json(bytes) | LightAnswer::Columns(bytes) | LightAnswer::Rows { columns: bytes, .. } => {
                (answered.tag, bytes)
            }
        }
    }
}

#[tokio::test]
async fn questions_at_once_open_the_data_once() {
    let fixture = Fixture::new(&["once"]);
    let answers = futures_util::future::join_all((0..20).map(|_| fixture.ask(0))).await;
    assert!(answers.iter().all(|bytes| bytes == b"first"));
    assert_eq!(times_opened("once"), 1);
}

#[tokio::test]
async fn data_is_opened_to_the_end_without_its_client() {
    let fixture = Fixture::new(&["left"]);
    assert!(tokio::time::timeout(Duration::from_millis(10), fixture.ask(0)).await.is_err(), "the client left");
    assert_eq!(fixture.ask(0).await, b"first");
    assert_eq!(times_opened("left"), 1);
}

#[tokio::test]
async fn a_changed_file_replaces_its_data() {
    let fixture = Fixture::new(&["changed"]);
    assert_eq!(fixture.ask(0).await, b"first");
    std::fs::write(&fixture.paths[0], "second").unwrap();
    assert_eq!(fixture.ask(0).await, b"second");
    assert_eq!((times_opened("changed"), fixture.views.cache.lock().unwrap().len()), (2, 1));
}

#[tokio::test]
async fn data_beyond_the_limit_is_dropped_the_oldest_use_first() {
    let fixture = Fixture::new(&["large-a", "large-b", "small"]);
    for file in [2, 0, 1] {
        fixture.ask(file).await;
    }
    assert_eq!(fixture.views.cache.lock().unwrap().len(), 1, "two large ones exceed the limit");
    fixture.ask(1).await;
    assert_eq!(times_opened("large-b"), 1, "the latest stays");
    fixture.ask(0).await;
    assert_eq!(times_opened("large-a"), 2);
}

#[tokio::test]
async fn answers_refer_to_known_rows_of_their_target() {
    let fixture = Fixture::new(&["growing", "other"]);
    let (first, bytes) = fixture.ask_since(0, Some("unknown")).await;
    assert_eq!(bytes, b"first", "an unknown tag changes nothing");
    std::fs::write(&fixture.paths[0], "second").unwrap();
    let (second, bytes) = fixture.ask_since(0, Some(&first)).await;
    assert_eq!(bytes, first.as_bytes());
    assert_ne!(first, second);
    assert_eq!(fixture.ask_since(1, Some(&first)).await.1, b"first", "rows of another target");
    *fixture.views.known_rows() = KnownRows::default();
    assert_eq!(fixture.ask_since(0, Some(&first)).await, (second, b"second".to_vec()), "after a restart");
}

/// Answers the calls of a farm with one job: frame 3 is in progress, and frame 4 is finished.
fn serve_farm(outputs: Vec<Output>, statistics: Artifact, known: Digest) -> Farm<()> {
    let (calls, mut inbox) = mpsc::channel::<Call<()>>(8);
    tokio::spawn(async move {
        while let Some(call) = inbox.recv().await {
            match call {
                Call::Frames { reply, .. } => {
                    let output = Output { role: Role::Statistics, artifact: statistics };
                    let record = FrameRecord {
                        frame: 4,
                        outputs: vec![output],
                        spp: 1,
                        relative_error: None,
                        blocks: None,
                        bad_samples: 0,
                        busy_seconds: 1.0,
                        seconds: 1.0,
                        rounds: None,
                        times: None,
                    };
                    drop(reply.send(Ok(vec![record])));
                }
                Call::Parts { reply, .. } => {
                    let grid = Grid { film: [8, 8], tile: 8 };
                    drop(reply.send(Ok(vec![FrameParts { frame: 3, grid, outputs: outputs.clone() }])));
                }
                Call::Producer { job, digest, reply } => {
                    let stage = Stage { frame: 3, round: 0, number: 1, kind: StageKind::Render };
                    let task = TaskKey { job, stage, index: 12 };
                    drop(reply.send(Ok((digest == known).then_some(task))));
                }
                Call::ArtifactLost { reply, .. } => drop(reply.send(Ok(()))),
                other => panic!("unexpected call {other:?}"),
            }
        }
    });
    Farm::new(calls)
}

#[tokio::test]
async fn damaged_statistics_are_named_by_frame_and_task() {
    let store = Store::in_memory();
    let good = store.put(Bytes::from_static(b"good")).await.unwrap();
    let bad = store.put(Bytes::from_static(b"bad")).await.unwrap();
    let slots = TransferSlots::new(&Limits { transfers: 4, transfers_per_connection: 4, ..Limits::default() });
    let views = LightViews::new(Some(open), Vec::new(), store.clone(), slots);
    let lost = Artifact { digest: Digest::compute(b"lost"), bytes: 4 };
    let outputs = [good, bad].map(|artifact| Output { role: Role::Paths, artifact });
    let ask = async |known: Digest, frame: u32| {
        let farm = serve_farm(outputs.to_vec(), lost, known);
        let call = LightCall { kind: LightCallKind::Schema, condition: None, bounds: None };
        let question = LightQuestion { target: LightTarget::Frames(JobId(7), vec![frame]), call, since: None };
        views.answer(&farm, question, None, CallerKey { name: None, connection: 1 }).await.unwrap_err()
    };
    let message = |error: LightViewError| match error {
        LightViewError::Unreadable { message } => message,
        other => panic!("{other:?}"),
    };
    let digest = bad.digest;
    let task = format!("frame 3, task 7/3.0/render.1/12 (artifact {digest}): no light");
    assert_eq!(message(ask(digest, 3).await), task);
    let part = format!("frame 3, part 2 of 2 (artifact {digest}): no light");
    assert_eq!(message(ask(good.digest, 3).await), part, "the task is not known any more");
    let error = ask(digest, 4).await;
    assert!(
        matches!(error, LightViewError::Lost { job: JobId(7), frame: 4, digest } if digest == lost.digest),
        "{error:?}"
    );
}
