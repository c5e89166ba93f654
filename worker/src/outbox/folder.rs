//! Folder of stored results, and the thread's part of the outbox that writes and removes its files.

use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::Key;
use super::file::{RestoredResult, decode, encode};
use crate::config::{OutboxConfig, OutboxConflict, WorkerError};
use crate::execute::Product;
use crate::task_table::Task;

/// Number of folders to try when folders are taken.
const FOLDERS: u32 = 1000;

/// Locks the folder, or the next free one. The lock ends with the process.
pub(super) fn lock_folder(config: &OutboxConfig) -> Result<(PathBuf, File), WorkerError> {
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

pub(super) type Files = BTreeMap<Key, u64>;

/// Reads all complete results and returns them with their file sizes. Removes damaged results, those of other builds, and temporary
/// files.
pub(super) fn read_all(folder: &Path, engine: &str) -> io::Result<(Files, Vec<RestoredResult>)> {
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

/// State of the writer thread.
pub(super) struct ResultWriter {
    pub(super) folder: PathBuf,
    pub(super) engine: Arc<str>,
    pub(super) limit: u64,
    pub(super) used: u64,
    pub(super) files: Files,
    pub(super) _lock: File,
}

impl ResultWriter {
    /// Writes the task's result; returns whether it is on disk.
    pub(super) fn store(&mut self, task: &Task) -> bool {
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

    pub(super) fn remove(&mut self, key: &Key) {
        let Some(bytes) = self.files.remove(key) else { return };
        match fs::remove_file(self.path(key)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                tracing::warn!(task = %key.0, %error, "cannot remove an acknowledged result from the outbox");
            }
            // A file that cannot be removed still counts as used.
            Ok(()) | Err(_) => self.used -= bytes,
        }
    }

    pub(super) fn path(&self, key: &Key) -> PathBuf {
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
pub(super) fn remove_leftover(path: &Path) -> u64 {
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
