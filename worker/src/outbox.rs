//! Results that the coordinator has not acknowledged, on disk. A worker that was killed uploads them after its restart.
//!
//! Each result is one file. A separate thread writes it while the worker goes on, and removes it when the coordinator has answered:
//!
//! | bytes | content |
//! | --- | --- |
//! | 8 | `FEMCDONE` |
//! | 4 | format version, 6 |
//! | 32 | BLAKE3 of all that follows |
//! | 8 | length of the head |
//! | | the head, in postcard: build of the engine, assignment, job, result, usage, log, lengths of the artifacts |
//! | | the artifacts |
//!
//! A file is written under a temporary name, synced and renamed, so that it is either complete or absent. A file whose checksum is
//! wrong nevertheless (a disk may lie) is reported and removed, and its task is done again. A folder serves one worker at a time. A
//! result for which the folder has no room is kept in memory only.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs::{self, File, TryLockError};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use bytes::Bytes;
use femc_model::{Assignment, Digest, Epoch, JobSpec, ResourceUsage, TaskKey, TaskResult};
use serde::{Deserialize, Serialize};

use crate::config::{OutboxConfig, OutboxConflict, OutboxStorage, WorkerError};
use crate::execute::Product;
use crate::task_table::{Task, TaskTable};

const MAGIC: &[u8; 8] = b"FEMCDONE";
const VERSION: u32 = 6;
/// Bytes before the head.
const HEADER_BYTES: usize = 8 + 4 + 32 + 8;
/// Largest number of results that wait to be written.
const MAX_QUEUED: usize = 256;
/// Number of folders to try when folders are taken.
const FOLDERS: u32 = 1000;

/// A result from before the restart.
#[derive(Debug)]
pub(crate) struct RestoredResult {
    pub(crate) assignment: Assignment,
    pub(crate) spec: JobSpec,
    pub(crate) product: Product,
    /// Usage of the task, without the upload of the result.
    pub(crate) usage: Option<ResourceUsage>,
    /// Duration of the task in seconds, and the log's text.
    pub(crate) log: Option<(f64, String)>,
}

#[derive(Serialize, Deserialize)]
struct Head {
    engine: String,
    assignment: Assignment,
    spec: JobSpec,
    result: TaskResult,
    usage: Option<ResourceUsage>,
    log: Option<(f64, String)>,
    lengths: Vec<u64>,
}

/// Storage for unacknowledged results. Clones share it. The default stores nothing.
#[derive(Debug, Clone, Default)]
pub(crate) enum Outbox {
    #[default]
    Disabled,
    Folder(Arc<WriteQueue>),
    /// The memory, and the engine build that its results come from.
    Memory(MemoryOutbox, Arc<str>),
}

/// An outbox in memory, for simulations. Clones share it. Its results outlive the worker and are stored immediately.
#[derive(Debug, Clone, Default)]
pub struct MemoryOutbox(Arc<Mutex<BTreeMap<Key, Vec<u8>>>>);

impl MemoryOutbox {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<Key, Vec<u8>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Simulates damage: `change` may change the bytes of each result and returns whether to keep the result.
    pub fn damage(&self, mut change: impl FnMut(&mut Vec<u8>) -> bool) {
        self.lock().retain(|_, bytes| change(bytes));
    }

    fn read_all(&self, engine: &str) -> Vec<RestoredResult> {
        let mut restored = Vec::new();
        self.lock().retain(|_, bytes| {
            let result = decode(&Bytes::copy_from_slice(bytes), engine);
            let is_whole = result.is_some();
            restored.extend(result);
            is_whole
        });
        restored
    }

    fn store(&self, task: &Task, engine: &str) {
        let mut kept = self.lock();
        if let Some(Ok(product)) = task.outcome().filter(|_| !task.is_cancelled())
            && let Ok(bytes) = encode(task, product, engine)
        {
            kept.insert(task.key(), bytes);
        }
    }
}

#[derive(Debug)]
pub(crate) struct WriteQueue {
    folder: PathBuf,
    pending: Mutex<PendingWrites>,
    /// Signaled when the line gets an entry or is closed.
    wakeup: Condvar,
    writer: Mutex<Option<JoinHandle<()>>>,
}

/// A lease; each result belongs to one.
type Key = (TaskKey, Epoch);

/// Queue of the writer thread. It is bounded, and answered results leave it.
#[derive(Debug, Default)]
struct PendingWrites {
    /// Results that wait to be written, oldest first.
    to_write: VecDeque<Arc<Task>>,
    /// Results that are on disk or being written.
    on_disk: BTreeSet<Key>,
    /// Results to remove from disk, because the coordinator has answered.
    to_remove: VecDeque<Key>,
    closed: bool,
}

/// Next action of the writer.
enum WriterAction {
    Write(Arc<Task>),
    Remove(Key),
}

impl PendingWrites {
    /// Takes the next action. Removals come first, because they make room.
    fn next(&mut self) -> Option<WriterAction> {
        if let Some(key) = self.to_remove.pop_front() {
            return Some(WriterAction::Remove(key));
        }
        let task = self.to_write.pop_front()?;
        self.on_disk.insert(task.key());
        Some(WriterAction::Write(task))
    }
}

impl WriteQueue {
    fn pending(&self) -> MutexGuard<'_, PendingWrites> {
        // A panic within the few lines under this lock leaves the state consistent.
        self.pending.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for the next action. Returns `None` when the line is closed and empty.
    fn next(&self) -> Option<WriterAction> {
        let mut line = self.pending();
        loop {
            if let Some(order) = line.next() {
                return Some(order);
            }
            if line.closed {
                return None;
            }
            line = self.wakeup.wait(line).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl Outbox {
    /// Opens the outbox and reads the results that an earlier worker left there.
    /// - `engine`: this worker's engine build; results of other builds are dropped.
    pub(crate) async fn open(storage: OutboxStorage, engine: &str) -> Result<(Self, Vec<RestoredResult>), WorkerError> {
        let engine: Arc<str> = engine.into();
        match storage {
            OutboxStorage::Folder(config) => tokio::task::spawn_blocking(move || Self::open_folder(&config, engine))
                .await
                .map_err(|error| WorkerError::Threads(error.to_string()))?,
            OutboxStorage::Memory(memory) => {
                let restored = memory.read_all(&engine);
                Ok((Self::Memory(memory, engine), restored))
            }
        }
    }

    fn open_folder(config: &OutboxConfig, engine: Arc<str>) -> Result<(Self, Vec<RestoredResult>), WorkerError> {
        let fault = |folder: &Path, error: io::Error| WorkerError::Outbox {
            folder: folder.to_owned(),
            message: error.to_string(),
        };
        let (folder, lock) = lock_folder(config)?;
        let (files, restored) = read_all(&folder, &engine).map_err(|error| fault(&folder, error))?;
        if !restored.is_empty() {
            tracing::info!(results = restored.len(), folder = %folder.display(), "restored undelivered results of an earlier run");
        }
        let line = PendingWrites { on_disk: files.keys().copied().collect(), ..PendingWrites::default() };
        let place = folder.clone();
        let queue = Arc::new(WriteQueue {
            folder: place,
            pending: Mutex::new(line),
            wakeup: Condvar::new(),
            writer: Mutex::default(),
        });
        let mut writer =
            ResultWriter { used: files.values().sum(), files, folder, engine, limit: config.limit, _lock: lock };
        let orders = queue.clone();
        let thread = std::thread::Builder::new()
            .name("outbox".into())
            .spawn(move || {
                while let Some(order) = orders.next() {
                    match order {
                        WriterAction::Write(task) => {
                            if !writer.store(&task) {
                                orders.pending().on_disk.remove(&task.key());
                            }
                        }
                        WriterAction::Remove(key) => writer.remove(&key),
                    }
                }
            })
            .map_err(|error| WorkerError::Threads(error.to_string()))?;
        *queue.writer.lock().unwrap_or_else(PoisonError::into_inner) = Some(thread);
        Ok((Self::Folder(queue), restored))
    }

    /// Returns the outbox's folder, which no other worker uses.
    pub(crate) fn folder(&self) -> Option<&Path> {
        match self {
            Self::Folder(queue) => Some(&queue.folder),
            Self::Disabled | Self::Memory(..) => None,
        }
    }

    /// Queues a finished task's result for writing. If the coordinator answers before its turn, the result is not written.
    pub(crate) fn store(&self, task: &Arc<Task>) {
        let queue = match self {
            Self::Folder(queue) => queue,
            Self::Memory(memory, engine) => return memory.store(task, engine),
            Self::Disabled => return,
        };
        let mut line = queue.pending();
        // Check under the lock: an answer that arrives after this check finds the task in the line.
        if !matches!(task.outcome(), Some(Ok(_))) || task.is_cancelled() || line.closed {
            return;
        }
        if line.to_write.len() >= MAX_QUEUED {
            tracing::warn!(task = %task.assignment.task, "the outbox writes too slowly: a result is in memory only");
            return;
        }
        line.to_write.push_back(task.clone());
        queue.wakeup.notify_one();
    }

    /// Drops the task and its stored result, because the coordinator has answered or the lease is over. The task is dropped first,
    /// so that nothing stores its result afterwards.
    pub(crate) fn remove_answered(&self, table: &TaskTable, key: &Key) -> Option<Arc<Task>> {
        let task = table.remove(key);
        match self {
            Self::Folder(queue) => {
                let mut line = queue.pending();
                line.to_write.retain(|task| task.key() != *key);
                if line.on_disk.remove(key) {
                    line.to_remove.push_back(*key);
                    queue.wakeup.notify_one();
                }
            }
            Self::Memory(memory, _) => drop(memory.lock().remove(key)),
            Self::Disabled => {}
        }
        task
    }

    /// Waits until the writer has emptied its queue.
    pub(crate) fn close(&self) {
        let Self::Folder(queue) = self else { return };
        queue.pending().closed = true;
        queue.wakeup.notify_one();
        let writer = queue.writer.lock().unwrap_or_else(PoisonError::into_inner).take();
        if writer.is_some_and(|writer| writer.join().is_err()) {
            tracing::warn!("the outbox's thread panicked");
        }
    }
}

/// Locks the folder, or the next free one. The lock ends with the process.
fn lock_folder(config: &OutboxConfig) -> Result<(PathBuf, File), WorkerError> {
    for number in 1..=FOLDERS {
        let mut folder = config.folder.clone();
        if number > 1 {
            let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
            folder.set_file_name(format!("{name}-{number}"));
        }
        let fault = |message: String| WorkerError::Outbox { folder: folder.clone(), message };
        fs::create_dir_all(&folder).map_err(|error| fault(error.to_string()))?;
        let lock = File::create(folder.join("lock")).map_err(|error| fault(error.to_string()))?;
        match (lock.try_lock(), config.on_conflict) {
            (Ok(()), _) => return Ok((folder, lock)),
            (Err(TryLockError::WouldBlock), OutboxConflict::NextFree) => {}
            (Err(TryLockError::WouldBlock), OutboxConflict::Fail) => {
                return Err(fault("another worker uses this folder".into()));
            }
            (Err(TryLockError::Error(error)), _) => return Err(fault(error.to_string())),
        }
    }
    Err(WorkerError::Outbox { folder: config.folder.clone(), message: "too many workers use this folder".into() })
}

type Files = BTreeMap<Key, u64>;

/// Reads all complete results and returns them with their file sizes. Removes damaged results, those of other builds, and temporary
/// files.
fn read_all(folder: &Path, engine: &str) -> io::Result<(Files, Vec<RestoredResult>)> {
    let (mut files, mut restored) = (Files::new(), Vec::new());
    let mut paths: Vec<PathBuf> = fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect::<io::Result<_>>()?;
    paths.sort();
    for path in paths {
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("new") => fs::remove_file(&path)?,
            Some("done") => {
                let bytes = match fs::read(&path) {
                    Ok(bytes) => bytes,
                    Err(error) => {
                        tracing::warn!(file = %path.display(), %error, "cannot read a stored result; its task will be repeated");
                        continue;
                    }
                };
                let length = bytes.len() as u64;
                match decode(&bytes.into(), engine) {
                    Some(result) => {
                        let key = (result.assignment.task, result.assignment.epoch);
                        let place = folder.join(file_name(&key));
                        // Earlier versions named tasks differently.
                        if place != path {
                            fs::rename(&path, place)?;
                        }
                        files.insert(key, length);
                        restored.push(result);
                    }
                    None => {
                        tracing::warn!(file = %path.display(), "a stored result is damaged or from another build; its task will be repeated");
                        fs::remove_file(&path)?;
                    }
                }
            }
            _ => {}
        }
    }
    Ok((files, restored))
}

/// Encodes a result as a whole file: the front, the head and the artifacts.
fn encode(task: &Task, product: &Product, engine: &str) -> Result<Vec<u8>, postcard::Error> {
    let head = Head {
        engine: engine.into(),
        assignment: task.assignment.clone(),
        spec: (*task.spec).clone(),
        result: product.result.clone(),
        usage: task.usage(),
        log: task.final_log().cloned(),
        lengths: product.artifacts.iter().map(|bytes| bytes.len() as u64).collect(),
    };
    let head = postcard::to_stdvec(&head)?;
    let mut body = (head.len() as u64).to_le_bytes().to_vec();
    body.extend(&head);
    product.artifacts.iter().for_each(|bytes| body.extend_from_slice(bytes));
    let mut file = MAGIC.to_vec();
    file.extend(VERSION.to_le_bytes());
    file.extend(Digest::compute(&body).as_bytes());
    file.extend(body);
    Ok(file)
}

/// Decodes a file of [`encode`] from the same engine build; `None` for anything else.
pub(crate) fn decode(file: &Bytes, engine: &str) -> Option<RestoredResult> {
    let front = file.get(..HEADER_BYTES)?;
    let is_ours = front[..8] == *MAGIC && front[8..12] == VERSION.to_le_bytes();
    if !is_ours || Digest::compute(&file[44..]).as_bytes()[..] != front[12..44] {
        return None;
    }
    let length = usize::try_from(u64::from_le_bytes(front[44..].try_into().ok()?)).ok()?;
    let end = HEADER_BYTES.checked_add(length)?;
    let Head { engine: of, assignment, spec, result, usage, log, lengths } =
        postcard::from_bytes(file.get(HEADER_BYTES..end)?).ok()?;
    if of != engine {
        return None;
    }
    let (mut at, mut artifacts) = (end, Vec::new());
    for length in lengths {
        let end = at.checked_add(usize::try_from(length).ok()?)?;
        file.get(at..end)?;
        artifacts.push(file.slice(at..end));
        at = end;
    }
    (at == file.len()).then_some(RestoredResult {
        assignment,
        spec,
        product: Product { result, artifacts },
        usage,
        log,
    })
}

/// State of the writer thread.
struct ResultWriter {
    folder: PathBuf,
    engine: Arc<str>,
    limit: u64,
    used: u64,
    files: Files,
    _lock: File,
}

impl ResultWriter {
    /// Writes the task's result; returns whether it is on disk.
    fn store(&mut self, task: &Task) -> bool {
        let (key, Some(Ok(product))) = (task.key(), task.outcome()) else { return false };
        if self.files.contains_key(&key) {
            return true;
        }
        // The coordinator has answered already.
        if task.is_cancelled() {
            return false;
        }
        match self.write(task, product) {
            Ok(bytes) => {
                self.used += bytes;
                self.files.insert(key, bytes);
                true
            }
            Err(error) => {
                tracing::warn!(task = %key.0, folder = %self.folder.display(), %error, "cannot write a result to the outbox; it is in memory only");
                false
            }
        }
    }

    /// Writes a file and returns its size. After a failure, it removes the remains; remains that cannot be removed count as used.
    fn write(&mut self, task: &Task, product: &Product) -> io::Result<u64> {
        let room = self.limit.saturating_sub(self.used);
        let full =
            || io::Error::new(io::ErrorKind::StorageFull, format!("the outbox is full (limit: {} bytes)", self.limit));
        // Check before all artifacts are copied.
        if product.artifacts.iter().map(|bytes| bytes.len() as u64).sum::<u64>() > room {
            return Err(full());
        }
        let bytes = encode(task, product, &self.engine).map_err(io::Error::other)?;
        if bytes.len() as u64 > room {
            return Err(full());
        }
        let path = self.path(&task.key());
        let new = path.with_extension("new");
        let written =
            write(&new, &bytes).and_then(|()| fs::rename(&new, &path)).and_then(|()| sync_folder(&self.folder));
        if let Err(error) = written {
            self.used += [new, path].iter().map(|path| remove_leftover(path)).sum::<u64>();
            return Err(error);
        }
        Ok(bytes.len() as u64)
    }

    fn remove(&mut self, key: &Key) {
        let Some(bytes) = self.files.remove(key) else { return };
        match fs::remove_file(self.path(key)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                tracing::warn!(task = %key.0, %error, "cannot remove an acknowledged result from the outbox");
            }
            // A file that cannot be removed still counts as used.
            Ok(()) | Err(_) => self.used -= bytes,
        }
    }

    fn path(&self, key: &Key) -> PathBuf {
        self.folder.join(file_name(key))
    }
}

fn file_name((task, epoch): &Key) -> String {
    format!("{}.{}.done", task.to_string().replace('/', "-"), epoch.0)
}

fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

/// Removes a useless file; returns its size if it cannot be removed, else 0.
fn remove_leftover(path: &Path) -> u64 {
    match fs::symlink_metadata(path) {
        Ok(data) if data.is_file() => fs::remove_file(path).map_or(data.len(), |()| 0),
        // There is no file, or it is not one of the outbox's.
        Ok(_) | Err(_) => 0,
    }
}

/// Makes a rename durable, where the system can.
fn sync_folder(folder: &Path) -> io::Result<()> {
    if cfg!(unix) { File::open(folder)?.sync_all() } else { Ok(()) }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::sync::Arc;

    use femc_model::{
        Artifact, Graph, Grid, JobId, JobNotes, NextRound, Output, Role, Stage, StageKind, StepsTaken, TaskSpec,
    };
    use femc_proto::Client;

    use super::*;
    use crate::meter::Meter;

    fn spec() -> JobSpec {
        JobSpec {
            name: "fog".into(),
            bundle: Digest::compute(b"bundle"),
            entry: "fog.mgf".into(),
            settings: "{}".into(),
            frames: vec![1],
            grid: Grid { film: [16, 16], tile: 16 },
            graph: Graph::default(),
            contents: vec![],
            priority: 50,
            owner: "me".into(),
            tags: vec![],
            notes: JobNotes::default(),
        }
    }

    /// Returns a finished task whose client is never used.
    pub(crate) async fn task(index: u32, bytes: &'static [u8]) -> Arc<Task> {
        let stage = Stage { frame: 1, round: 0, number: 0, kind: StageKind::Render };
        let task = TaskKey { job: JobId(3), stage, index };
        let (inputs, taken, more) = (Vec::new(), StepsTaken::default(), NextRound::Impossible);
        let work = TaskSpec {
            item: index,
            steps: 0..4,
            inputs,
            hints: Vec::new(),
            steps_taken: taken,
            next_round: more,
            elapsed: 0,
            busy_seconds: 0.0,
        };
        let assignment = Assignment { task, epoch: Epoch(9), lease: 5000, copy_of: None, spec: work };
        let dial = femc_proto::Dialer::from_fn(|_, _| {
            let (near, far) = tokio::io::duplex(1 << 16);
            // The other end never answers and never closes the connection.
            std::mem::forget(far);
            Box::pin(async { Ok(femc_proto::ByteStream::new(near)) })
        });
        let client = Client::connect_with(&dial, "http://nobody:1").await.unwrap();
        let task = Task::new(assignment, Arc::new(spec()), client, &Meter::without_clock());
        let output = Output { role: Role::Tile, artifact: Artifact::from_bytes(bytes) };
        let result = TaskResult { outputs: vec![output], units: 4, seconds: 0.5, ..TaskResult::default() };
        task.begin();
        task.set_final_log(0.5, "done".into());
        task.set_outcome(Ok(Product { result, artifacts: vec![Bytes::from_static(bytes)] }));
        Arc::new(task)
    }

    fn open(config: &OutboxConfig) -> Result<(Outbox, Vec<RestoredResult>), WorkerError> {
        Outbox::open_folder(config, crate::engine().into())
    }

    fn config(folder: &Path) -> OutboxConfig {
        OutboxConfig { folder: folder.join("box"), limit: 10_000, on_conflict: OutboxConflict::Fail }
    }

    fn indices(restored: &[RestoredResult]) -> Vec<(u32, &[u8])> {
        restored.iter().map(|r| (r.assignment.task.index, &r.product.artifacts[0][..])).collect()
    }

    #[tokio::test]
    async fn only_unacknowledged_results_survive_restart() {
        let place = tempfile::tempdir().unwrap();
        let (outbox, restored) = open(&config(place.path())).unwrap();
        assert!(restored.is_empty());
        let (first, second) = (task(1, b"first").await, task(2, b"second").await);
        outbox.store(&first);
        outbox.store(&second);
        outbox.remove_answered(&TaskTable::default(), &first.key());
        outbox.close();
        let (outbox, restored) = open(&config(place.path())).unwrap();
        assert_eq!(indices(&restored), [(2, &b"second"[..])]);
        assert_eq!((&restored[0].spec, &restored[0].assignment), (&*second.spec, &second.assignment));
        assert_eq!(
            (restored[0].usage.map(|usage| usage.wall), &restored[0].log),
            (Some(0.5), &Some((0.5, "done".into())))
        );
        outbox.remove_answered(&TaskTable::default(), &second.key());
        outbox.close();
        assert!(open(&config(place.path())).unwrap().1.is_empty());
    }

    #[tokio::test]
    async fn torn_or_changed_file_is_removed_and_others_are_read() {
        let place = tempfile::tempdir().unwrap();
        let (outbox, _) = open(&config(place.path())).unwrap();
        for index in 1..=3 {
            outbox.store(&task(index, b"tile").await);
        }
        outbox.close();
        let folder = place.path().join("box");
        let file = |index: u32| folder.join(format!("3-1.0-render.0-{index}.9.done"));
        let whole = fs::read(file(1)).unwrap();
        for end in 0..whole.len() {
            assert!(decode(&whole[..end].to_vec().into(), crate::engine()).is_none(), "cut at {end}");
        }
        let mut changed = whole.clone();
        changed[whole.len() - 1] ^= 1;
        fs::write(file(1), changed).unwrap();
        fs::write(file(3), &whole[..whole.len() / 2]).unwrap();
        fs::write(folder.join("half.new"), b"half").unwrap();
        let (_, restored) = open(&config(place.path())).unwrap();
        assert_eq!(indices(&restored), [(2, &b"tile"[..])]);
        assert!(!file(1).exists() && !file(3).exists() && file(2).exists() && !folder.join("half.new").exists());
    }

    #[tokio::test]
    async fn a_folder_serves_one_worker_and_holds_no_more_than_its_limit() {
        let place = tempfile::tempdir().unwrap();
        let small = OutboxConfig { limit: 1000, ..config(place.path()) };
        let (outbox, _) = open(&small).unwrap();
        let taken = open(&small).unwrap_err();
        assert!(taken.to_string().contains("another worker"), "{taken}");
        let next = OutboxConfig { on_conflict: OutboxConflict::NextFree, ..small.clone() };
        let (second, _) = open(&next).unwrap();
        assert!(place.path().join("box-2").is_dir());
        static LARGE: [u8; 600] = [7; 600];
        outbox.store(&task(1, &LARGE).await);
        outbox.store(&task(2, &LARGE).await);
        outbox.close();
        second.close();
        let (_, restored) = open(&small).unwrap();
        assert_eq!(indices(&restored), [(1, &LARGE[..])]);
    }

    #[tokio::test]
    async fn old_named_result_is_read_and_removed_when_acknowledged() {
        let place = tempfile::tempdir().unwrap();
        let (outbox, _) = open(&config(place.path())).unwrap();
        let kept = task(1, b"tile").await;
        outbox.store(&kept);
        outbox.close();
        let folder = place.path().join("box");
        fs::rename(folder.join("3-1.0-render.0-1.9.done"), folder.join("3-1.0-render-1.9.done")).unwrap();
        let (outbox, restored) = open(&config(place.path())).unwrap();
        assert_eq!(indices(&restored), [(1, &b"tile"[..])]);
        outbox.remove_answered(&TaskTable::default(), &kept.key());
        outbox.close();
        assert_eq!(files(place.path()), ["lock"]);
    }

    fn files(folder: &Path) -> Vec<String> {
        let names = fs::read_dir(folder.join("box")).unwrap().map(|entry| entry.unwrap().file_name());
        let mut names: Vec<String> = names.map(|name| name.into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[tokio::test]
    async fn what_cannot_be_written_to_its_end_leaves_nothing_behind() {
        let place = tempfile::tempdir().unwrap();
        let (outbox, _) = open(&config(place.path())).unwrap();
        // A folder blocks the first result's path, so that its rename fails as on a full disk.
        let taken = "3-1.0-render.0-1.9.done";
        fs::create_dir(place.path().join("box").join(taken)).unwrap();
        outbox.store(&task(1, b"first").await);
        outbox.store(&task(2, b"second").await);
        outbox.close();
        assert_eq!(files(place.path()), [taken, "3-1.0-render.0-2.9.done", "lock"]);
        let (_, restored) = open(&config(place.path())).unwrap();
        assert_eq!(indices(&restored), [(2, &b"second"[..])], "what cannot be read stops nobody");
    }

    #[tokio::test]
    async fn the_limit_counts_whole_files() {
        let place = tempfile::tempdir().unwrap();
        let first = task(1, b"first").await;
        let Some(Ok(product)) = first.outcome() else { panic!("it is done") };
        let size = encode(&first, product, crate::engine()).unwrap().len() as u64;
        let config = OutboxConfig { limit: 2 * size, ..config(place.path()) };
        let (outbox, _) = open(&config).unwrap();
        for index in 1..=3 {
            outbox.store(&task(index, b"first").await);
        }
        outbox.close();
        assert_eq!(files(place.path()).len(), 2 + 1, "two results and the lock");
    }

    #[tokio::test]
    async fn unremovable_result_still_takes_room_and_removed_one_does_not() {
        let place = tempfile::tempdir().unwrap();
        let lock = File::create(place.path().join("lock")).unwrap();
        let folder = place.path().to_owned();
        let mut writer = ResultWriter {
            folder,
            engine: crate::engine().into(),
            limit: 1 << 20,
            used: 0,
            files: Files::new(),
            _lock: lock,
        };
        let tasks = [task(1, b"first").await, task(2, b"second").await];
        assert!(tasks.iter().all(|task| writer.store(task)));
        let sizes = tasks.each_ref().map(|task| fs::metadata(writer.path(&task.key())).unwrap().len());
        assert_eq!(writer.used, sizes.iter().sum::<u64>());
        // A folder cannot be removed as a file.
        let stuck = writer.path(&tasks[0].key());
        fs::remove_file(&stuck).unwrap();
        fs::create_dir(&stuck).unwrap();
        writer.remove(&tasks[0].key());
        assert_eq!(writer.used, sizes.iter().sum::<u64>());
        writer.remove(&tasks[1].key());
        assert_eq!(writer.used, sizes[0]);
        // The remains of a failed write count only if they cannot be removed.
        let left = place.path().join("left.new");
        fs::write(&left, [0; 100]).unwrap();
        assert_eq!((remove_leftover(&left), left.exists(), remove_leftover(&left)), (0, false, 0));
    }

    #[tokio::test]
    async fn who_is_answered_leaves_the_line_and_the_line_ends() {
        let place = tempfile::tempdir().unwrap();
        let (outbox, _) = open(&config(place.path())).unwrap();
        let Outbox::Folder(queue) = outbox.clone() else { panic!("a folder") };
        let tasks = [task(1, b"first").await, task(2, b"second").await];
        // Simulate a slow disk: the writer has the first result and is still writing.
        let mut line = PendingWrites::default();
        tasks.iter().for_each(|task| line.to_write.push_back(task.clone()));
        assert!(matches!(line.next(), Some(WriterAction::Write(task)) if task.key() == tasks[0].key()));
        *queue.pending() = line;
        for task in &tasks {
            outbox.remove_answered(&TaskTable::default(), &task.key());
        }
        {
            let line = queue.pending();
            assert!(line.to_write.is_empty(), "what was answered is not written any more");
            // The first result is on disk. The second is too if the writer took it before its answer arrived.
            assert!(
                line.on_disk.is_empty() && line.to_remove.len() <= tasks.len(),
                "what may be on the disk goes: {line:?}"
            );
        }
        let many = task(3, b"third").await;
        queue.pending().to_write = std::iter::repeat_n(many.clone(), MAX_QUEUED).collect();
        outbox.store(&many);
        assert!(queue.pending().to_write.len() <= MAX_QUEUED);
        outbox.remove_answered(&TaskTable::default(), &many.key());
        outbox.close();
    }

    #[tokio::test]
    async fn answer_during_handover_of_result_leaves_no_file() {
        let place = tempfile::tempdir().unwrap();
        let (outbox, _) = open(&config(place.path())).unwrap();
        let (table, first) = (Arc::new(TaskTable::default()), task(1, b"first").await);
        table.insert_finished(first.clone());
        let Outbox::Folder(queue) = outbox.clone() else { panic!("a folder") };
        let answering = {
            // While the line is locked, the answer is blocked just before it.
            let _line = queue.pending();
            let answering = std::thread::spawn({
                let (outbox, table, key) = (outbox.clone(), table.clone(), first.key());
                move || outbox.remove_answered(&table, &key).is_some()
            });
            for _ in 0..1000 {
                if first.is_cancelled() {
                    break;
                }
                std::thread::sleep(std::time::Duration::from_millis(10));
            }
            assert!(first.is_cancelled(), "who looks now, and keeps it, keeps it for ever");
            answering
        };
        assert!(answering.join().unwrap());
        outbox.store(&first);
        outbox.close();
        assert_eq!(files(place.path()), ["lock"]);
    }
}
