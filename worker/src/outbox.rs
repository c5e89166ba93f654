//! Results that the coordinator has not acknowledged, on disk: a worker that is killed brings them along when it starts again.
//!
//! One file a result, written beside the work by a thread of its own, removed when the coordinator has answered:
//!
//! | bytes | what |
//! | --- | --- |
//! | 8 | `FEMCDONE` |
//! | 4 | format version, 4 |
//! | 32 | BLAKE3 of all that follows |
//! | 8 | length of the head |
//! | | the head, in postcard: build of the engine, assignment, job, result, what it took, log, lengths of the artefacts |
//! | | the artefacts |
//!
//! A file is written under another name, synced and renamed, so that it is there whole or not at all. What does not fit the
//! checksum all the same (a disk may lie) is reported and removed: the task is done again. A folder serves one worker at a
//! time. A result that the folder has no room for is kept in memory alone.

use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread::JoinHandle;

use bytes::Bytes;
use femc_model::{Assignment, Digest, Epoch, JobSpec, TaskKey, TaskResult, Usage};
use serde::{Deserialize, Serialize};

use crate::config::{IfTaken, OutboxConfig, WorkerError};
use crate::execute::Product;
use crate::table::Task;

const MAGIC: &[u8; 8] = b"FEMCDONE";
const VERSION: u32 = 4;
/// Bytes before the head.
const FRONT: usize = 8 + 4 + 32 + 8;
/// Folders that are tried when one is taken.
const FOLDERS: u32 = 1000;

/// A result of an earlier life.
#[derive(Debug)]
pub(crate) struct Restored {
    pub(crate) assignment: Assignment,
    pub(crate) spec: JobSpec,
    pub(crate) product: Product,
    /// What it took, without sending the result.
    pub(crate) usage: Option<Usage>,
    /// Seconds that it took, and the log's text.
    pub(crate) log: Option<(f64, String)>,
}

#[derive(Serialize, Deserialize)]
struct Head {
    engine: String,
    assignment: Assignment,
    spec: JobSpec,
    result: TaskResult,
    usage: Option<Usage>,
    log: Option<(f64, String)>,
    lengths: Vec<u64>,
}

/// Keeps results; clones share it. The default keeps nothing.
#[derive(Debug, Clone, Default)]
pub(crate) struct Outbox(Option<Arc<Desk>>);

#[derive(Debug)]
struct Desk {
    folder: PathBuf,
    orders: mpsc::Sender<Order>,
    clerk: Mutex<Option<JoinHandle<()>>>,
}

enum Order {
    Keep(Arc<Task>),
    Forget((TaskKey, Epoch)),
    Close,
}

impl Outbox {
    /// Opens the folder and reads what an earlier worker left there.
    pub(crate) fn open(config: &OutboxConfig) -> Result<(Self, Vec<Restored>), WorkerError> {
        let fault = |folder: &Path, error: io::Error| WorkerError::Outbox {
            folder: folder.to_owned(),
            message: error.to_string(),
        };
        let (folder, lock) = claim(config)?;
        let (files, restored) = read_all(&folder).map_err(|error| fault(&folder, error))?;
        if !restored.is_empty() {
            tracing::info!(results = restored.len(), folder = %folder.display(), "results of before are brought along");
        }
        let (orders, line) = mpsc::channel();
        let place = folder.clone();
        let mut clerk = Clerk { used: files.values().sum(), files, folder, limit: config.limit, _lock: lock };
        let clerk = std::thread::Builder::new()
            .name("outbox".into())
            .spawn(move || {
                for order in line {
                    match order {
                        Order::Keep(task) => clerk.keep(&task),
                        Order::Forget(key) => clerk.forget(&key),
                        Order::Close => break,
                    }
                }
            })
            .map_err(|error| WorkerError::Threads(error.to_string()))?;
        Ok((Self(Some(Arc::new(Desk { folder: place, orders, clerk: Mutex::new(Some(clerk)) }))), restored))
    }

    /// Its folder, which no other worker uses.
    pub(crate) fn folder(&self) -> Option<&Path> {
        self.0.as_ref().map(|desk| &*desk.folder)
    }

    /// Writes a finished task's result, unless the coordinator answers before its turn comes.
    pub(crate) fn keep(&self, task: &Arc<Task>) {
        if matches!(task.outcome(), Some(Ok(_))) {
            self.order(Order::Keep(task.clone()));
        }
    }

    /// The coordinator has answered.
    pub(crate) fn forget(&self, key: (TaskKey, Epoch)) {
        self.order(Order::Forget(key));
    }

    /// Waits until all that was asked for is done.
    pub(crate) fn close(&self) {
        self.order(Order::Close);
        let Some(desk) = &self.0 else { return };
        let clerk = desk.clerk.lock().unwrap_or_else(PoisonError::into_inner).take();
        if clerk.is_some_and(|clerk| clerk.join().is_err()) {
            tracing::warn!("the outbox's thread panicked");
        }
    }

    fn order(&self, order: Order) {
        if let Some(desk) = &self.0 {
            // After the end nothing is kept.
            let _ = desk.orders.send(order);
        }
    }
}

/// The folder, or the next free one, and its lock, which ends with the process.
fn claim(config: &OutboxConfig) -> Result<(PathBuf, File), WorkerError> {
    for number in 1..=FOLDERS {
        let mut folder = config.folder.clone();
        if number > 1 {
            let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
            folder.set_file_name(format!("{name}-{number}"));
        }
        let fault = |message: String| WorkerError::Outbox { folder: folder.clone(), message };
        fs::create_dir_all(&folder).map_err(|error| fault(error.to_string()))?;
        let lock = File::create(folder.join("lock")).map_err(|error| fault(error.to_string()))?;
        match (lock.try_lock(), config.if_taken) {
            (Ok(()), _) => return Ok((folder, lock)),
            (Err(TryLockError::WouldBlock), IfTaken::NextFree) => {}
            (Err(TryLockError::WouldBlock), IfTaken::Fail) => return Err(fault("another worker uses it".into())),
            (Err(TryLockError::Error(error)), _) => return Err(fault(error.to_string())),
        }
    }
    Err(WorkerError::Outbox { folder: config.folder.clone(), message: "too many workers use it".into() })
}

type Files = BTreeMap<(TaskKey, Epoch), u64>;

/// All whole results, and the bytes of their files; removes everything else that is an outbox's.
fn read_all(folder: &Path) -> io::Result<(Files, Vec<Restored>)> {
    let (mut files, mut restored) = (Files::new(), Vec::new());
    let mut paths: Vec<PathBuf> = fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect::<io::Result<_>>()?;
    paths.sort();
    for path in paths {
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("new") => fs::remove_file(&path)?,
            Some("done") => {
                let bytes = fs::read(&path)?;
                let length = bytes.len() as u64;
                match decode(&bytes.into()) {
                    Some(result) => {
                        files.insert((result.assignment.task, result.assignment.epoch), length);
                        restored.push(result);
                    }
                    None => {
                        tracing::warn!(file = %path.display(), "a kept result is damaged, or another build's; its task is done again");
                        fs::remove_file(&path)?;
                    }
                }
            }
            _ => {}
        }
    }
    Ok((files, restored))
}

/// The front and the head; the artefacts follow.
fn encode(task: &Task, product: &Product) -> Result<Vec<u8>, postcard::Error> {
    let head = Head {
        engine: crate::engine().into(),
        assignment: task.assignment.clone(),
        spec: (*task.spec).clone(),
        result: product.result.clone(),
        usage: task.usage(),
        log: task.written_log().cloned(),
        lengths: product.artefacts.iter().map(|bytes| bytes.len() as u64).collect(),
    };
    let head = postcard::to_stdvec(&head)?;
    let mut body = (head.len() as u64).to_le_bytes().to_vec();
    body.extend(&head);
    product.artefacts.iter().for_each(|bytes| body.extend_from_slice(bytes));
    let mut file = MAGIC.to_vec();
    file.extend(VERSION.to_le_bytes());
    file.extend(Digest::of(&body).as_bytes());
    file.extend(body);
    Ok(file)
}

/// What [`encode`] of this build wrote; `None` for anything else.
pub(crate) fn decode(file: &Bytes) -> Option<Restored> {
    let front = file.get(..FRONT)?;
    let is_ours = front[..8] == *MAGIC && front[8..12] == VERSION.to_le_bytes();
    if !is_ours || Digest::of(&file[44..]).as_bytes()[..] != front[12..44] {
        return None;
    }
    let length = usize::try_from(u64::from_le_bytes(front[44..].try_into().ok()?)).ok()?;
    let end = FRONT.checked_add(length)?;
    let Head { engine, assignment, spec, result, usage, log, lengths } =
        postcard::from_bytes(file.get(FRONT..end)?).ok()?;
    if engine != crate::engine() {
        return None;
    }
    let (mut at, mut artefacts) = (end, Vec::new());
    for length in lengths {
        let end = at.checked_add(usize::try_from(length).ok()?)?;
        file.get(at..end)?;
        artefacts.push(file.slice(at..end));
        at = end;
    }
    (at == file.len()).then_some(Restored { assignment, spec, product: Product { result, artefacts }, usage, log })
}

/// Does the writing.
struct Clerk {
    folder: PathBuf,
    limit: u64,
    used: u64,
    files: Files,
    _lock: File,
}

impl Clerk {
    fn keep(&mut self, task: &Task) {
        let (key, Some(Ok(product))) = (task.key(), task.outcome()) else { return };
        // Answered already.
        if task.is_cancelled() || self.files.contains_key(&key) {
            return;
        }
        let bytes: u64 = product.artefacts.iter().map(|bytes| bytes.len() as u64).sum();
        if self.used + bytes > self.limit {
            tracing::warn!(task = %key.0, limit = self.limit, "the outbox is full: a result is in memory alone");
            return;
        }
        match self.write(task, product) {
            Ok(bytes) => {
                self.used += bytes;
                self.files.insert(key, bytes);
            }
            Err(error) => {
                tracing::warn!(task = %key.0, folder = %self.folder.display(), %error, "a result is in memory alone");
            }
        }
    }

    fn write(&self, task: &Task, product: &Product) -> io::Result<u64> {
        let bytes = encode(task, product).map_err(io::Error::other)?;
        let path = self.path(&task.key());
        let new = path.with_extension("new");
        let mut file = File::create(&new)?;
        file.write_all(&bytes)?;
        file.sync_all()?;
        fs::rename(&new, &path)?;
        sync_folder(&self.folder)?;
        Ok(bytes.len() as u64)
    }

    fn forget(&mut self, key: &(TaskKey, Epoch)) {
        let Some(bytes) = self.files.remove(key) else { return };
        self.used -= bytes;
        if let Err(error) = fs::remove_file(self.path(key)) {
            tracing::warn!(task = %key.0, %error, "an acknowledged result stays in the outbox");
        }
    }

    fn path(&self, (task, epoch): &(TaskKey, Epoch)) -> PathBuf {
        self.folder.join(format!("{}.{}.done", task.to_string().replace('/', "-"), epoch.0))
    }
}

/// Makes a rename durable, where the system can.
fn sync_folder(folder: &Path) -> io::Result<()> {
    if cfg!(unix) { File::open(folder)?.sync_all() } else { Ok(()) }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::sync::Arc;

    use femc_model::{Artefact, Grid, JobId, Stage, StageKind, TileResult, Work};
    use femc_proto::Client;

    use super::*;
    use crate::meter::Meter;

    fn spec() -> JobSpec {
        JobSpec {
            name: "fog".into(),
            bundle: Digest::of(b"bundle"),
            entry: "fog.mgf".into(),
            settings: "{}".into(),
            frames: vec![1],
            grid: Grid { film: [16, 16], tile: 16 },
            rounds: vec![4],
            priority: 50,
            owner: "me".into(),
            tags: vec![],
        }
    }

    /// A finished task, with a client that is never asked anything.
    pub(crate) async fn task(index: u32, bytes: &'static [u8]) -> Arc<Task> {
        let stage = Stage { frame: 1, round: 0, kind: StageKind::Render };
        let task = TaskKey { job: JobId(3), stage, index };
        let work = Work::Render { tile: index, samples: 0..4 };
        let assignment = Assignment { task, epoch: Epoch(9), lease: 5000, copy_of: None, work };
        let dial = femc_proto::Dial::by(|_, _| {
            let (near, far) = tokio::io::duplex(1 << 16);
            // Nobody answers, and nobody hangs up.
            std::mem::forget(far);
            Box::pin(async { Ok(femc_proto::Link::new(near)) })
        });
        let client = Client::connect_by(&dial, "http://nobody:1").await.unwrap();
        let task = Task::new(assignment, Arc::new(spec()), client, &Meter::none());
        let result = TileResult { tile: Artefact::of(bytes), samples: 4, bad_samples: 0, seconds: 0.5 };
        task.begin();
        task.write_log(0.5, "done".into());
        task.settle(Ok(Product { result: TaskResult::Tile(result), artefacts: vec![Bytes::from_static(bytes)] }));
        Arc::new(task)
    }

    fn config(folder: &Path) -> OutboxConfig {
        OutboxConfig { folder: folder.join("box"), limit: 10_000, if_taken: IfTaken::Fail }
    }

    fn indices(restored: &[Restored]) -> Vec<(u32, &[u8])> {
        restored.iter().map(|r| (r.assignment.task.index, &r.product.artefacts[0][..])).collect()
    }

    #[tokio::test]
    async fn what_is_not_acknowledged_is_there_after_a_new_start_and_what_is_is_not() {
        let place = tempfile::tempdir().unwrap();
        let (outbox, restored) = Outbox::open(&config(place.path())).unwrap();
        assert!(restored.is_empty());
        let (first, second) = (task(1, b"first").await, task(2, b"second").await);
        outbox.keep(&first);
        outbox.keep(&second);
        outbox.forget(first.key());
        outbox.close();
        let (outbox, restored) = Outbox::open(&config(place.path())).unwrap();
        assert_eq!(indices(&restored), [(2, &b"second"[..])]);
        assert_eq!((&restored[0].spec, &restored[0].assignment), (&*second.spec, &second.assignment));
        assert_eq!(
            (restored[0].usage.map(|usage| usage.wall), &restored[0].log),
            (Some(0.5), &Some((0.5, "done".into())))
        );
        outbox.forget(second.key());
        outbox.close();
        assert!(Outbox::open(&config(place.path())).unwrap().1.is_empty());
    }

    #[tokio::test]
    async fn a_torn_or_changed_file_is_left_out_and_removed_and_the_others_are_read() {
        let place = tempfile::tempdir().unwrap();
        let (outbox, _) = Outbox::open(&config(place.path())).unwrap();
        for index in 1..=3 {
            outbox.keep(&task(index, b"tile").await);
        }
        outbox.close();
        let folder = place.path().join("box");
        let file = |index: u32| folder.join(format!("3-1.0-render-{index}.9.done"));
        let whole = fs::read(file(1)).unwrap();
        for end in 0..whole.len() {
            assert!(decode(&whole[..end].to_vec().into()).is_none(), "cut at {end}");
        }
        let mut changed = whole.clone();
        changed[whole.len() - 1] ^= 1;
        fs::write(file(1), changed).unwrap();
        fs::write(file(3), &whole[..whole.len() / 2]).unwrap();
        fs::write(folder.join("half.new"), b"half").unwrap();
        let (_, restored) = Outbox::open(&config(place.path())).unwrap();
        assert_eq!(indices(&restored), [(2, &b"tile"[..])]);
        assert!(!file(1).exists() && !file(3).exists() && file(2).exists() && !folder.join("half.new").exists());
    }

    #[tokio::test]
    async fn a_folder_serves_one_worker_and_holds_no_more_than_its_limit() {
        let place = tempfile::tempdir().unwrap();
        let small = OutboxConfig { limit: 1000, ..config(place.path()) };
        let (outbox, _) = Outbox::open(&small).unwrap();
        let taken = Outbox::open(&small).unwrap_err();
        assert!(taken.to_string().contains("another worker"), "{taken}");
        let next = OutboxConfig { if_taken: IfTaken::NextFree, ..small.clone() };
        let (second, _) = Outbox::open(&next).unwrap();
        assert!(place.path().join("box-2").is_dir());
        static LARGE: [u8; 600] = [7; 600];
        outbox.keep(&task(1, &LARGE).await);
        outbox.keep(&task(2, &LARGE).await);
        outbox.close();
        second.close();
        let (_, restored) = Outbox::open(&small).unwrap();
        assert_eq!(indices(&restored), [(1, &LARGE[..])]);
    }
}
