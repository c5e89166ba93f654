//! Results that the coordinator has not acknowledged, on disk. A worker that was killed uploads them after its restart.
//!
//! Each result is one [file](file). A separate thread writes it while the worker goes on, and removes it when the coordinator has
//! answered. A file is written under a temporary name, synced and renamed, so that it is either complete or absent. A file whose
//! checksum is wrong nevertheless (a disk may lie) is reported and removed, and its task is done again. A [folder](folder) serves one
//! worker at a time. A result for which the folder has no room is kept in memory only.

mod file;
mod folder;
#[cfg(test)]
pub(crate) mod tests;

pub(crate) use file::{RestoredResult, decode};

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use bytes::Bytes;
use femc_model::{Epoch, TaskKey};

use crate::config::{OutboxConfig, OutboxStorage, WorkerError};
use crate::task_table::{Task, TaskTable};
use file::encode;
use folder::{ResultWriter, lock_folder, read_all};

/// Largest number of results that wait to be written.
const MAX_QUEUED: usize = 256;

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
