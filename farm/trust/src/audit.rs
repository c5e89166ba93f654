//! Audit log of all actions on a farm, performed or refused: the caller, the caller's address, the call, and the outcome.
//!
//! The log is a file to which lines of JSON are appended, one for each action. A line is handed to the operating system before the
//! caller receives the answer, so it outlives the process. It reaches the disk within 0.2 s. Repeated refusals of the same action
//! become one line per second with a count, so that a client that retries all the time does not displace other entries. The file is
//! rotated at 64 MiB, and the latest seven rotated files are kept. The log contains no secrets: certificates and tokens are
//! represented by their digests.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::Serialize;
use time::OffsetDateTime;

use crate::TrustError;

/// An action, performed or refused.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct AuditEvent {
    /// Role and name of the caller; `anybody` if callers are not authenticated.
    pub who: String,
    /// Digest of the certificate or token that identified the caller.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
    /// Address of the caller.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from: Option<String>,
    /// Name of the call, like `Jobs/Submit`.
    pub call: String,
    /// Number of the job.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub job: Option<u64>,
    /// Arguments of the call.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub what: Option<String>,
    /// `ok`, or the code of the refusal.
    pub outcome: String,
    /// Reason for the refusal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

#[derive(Serialize)]
struct Line<'a> {
    /// Time in UTC.
    time: String,
    #[serde(flatten)]
    event: &'a AuditEvent,
    /// Number of repetitions since the previous line with the same event.
    #[serde(skip_serializing_if = "Option::is_none")]
    times: Option<u64>,
}

/// An audit log. Clones write to the same log, which is closed when the last clone is dropped.
#[derive(Debug, Clone)]
pub struct Audit(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    audit_file: Arc<Mutex<AuditFile>>,
    /// Sender that is dropped at the end to stop the thread that syncs the file.
    stop: Option<Sender<()>>,
    sync_thread: Option<JoinHandle<()>>,
}

impl Audit {
    /// Size in bytes at which a file is rotated.
    pub const MAX_FILE_BYTES: u64 = 64 << 20;
    /// Number of rotated files that are kept.
    const ROTATED_FILES: usize = 7;
    /// Time between two syncs to the disk.
    const SYNC_INTERVAL: Duration = Duration::from_millis(200);

    /// Opens the log at `path`, or creates it.
    pub fn open(path: &Path) -> Result<Self, TrustError> {
        Self::with_max_bytes(path, Self::MAX_FILE_BYTES)
    }

    fn with_max_bytes(path: &Path, max_bytes: u64) -> Result<Self, TrustError> {
        let book = Arc::new(Mutex::new(AuditFile::open(path, max_bytes).map_err(TrustError::file(path))?));
        let (open, closed) = channel();
        let keeper = std::thread::Builder::new().name("audit".into()).spawn({
            let book = book.clone();
            move || sync_loop(&book, &closed)
        });
        let keeper = Some(keeper.map_err(TrustError::file(path))?);
        Ok(Self(Arc::new(Shared { audit_file: book, stop: Some(open), sync_thread: keeper })))
    }

    /// Returns the latest `count` lines, newest first. Lines that cannot be parsed are left out.
    pub fn latest(&self, count: usize) -> Result<Vec<serde_json::Value>, TrustError> {
        let path = lock(&self.0.audit_file).path.clone();
        let mut found = Vec::new();
        for number in 0..=Self::ROTATED_FILES {
            let path = if number == 0 { path.clone() } else { rotated_path(&path, number) };
            match File::open(&path).and_then(|file| last_lines(file, count - found.len())) {
                Ok(lines) => found.extend(lines),
                Err(error) if error.kind() == std::io::ErrorKind::NotFound && number > 0 => break,
                Err(error) => return Err(TrustError::file(&path)(error)),
            }
            if found.len() >= count {
                break;
            }
        }
        Ok(found)
    }

    /// Records an action that was performed, or that failed for another reason than a refusal.
    pub fn record(&self, event: &AuditEvent) {
        lock(&self.0.audit_file).write(event, None);
    }

    /// Records a refusal: the first one immediately, repetitions as a count once a second.
    pub fn record_refusal(&self, event: AuditEvent) {
        let mut book = lock(&self.0.audit_file);
        if let Some(times) = book.repeats.get_mut(&event) {
            *times += 1;
        } else if book.repeats.len() < AuditFile::MAX_DISTINCT {
            book.write(&event, None);
            book.repeats.insert(event, 0);
        } else {
            book.overflow += 1;
        }
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        self.stop = None;
        if let Some(keeper) = self.sync_thread.take() {
            // A panic of this thread has already been logged.
            let _ = keeper.join();
        }
    }
}

fn lock(audit_file: &Mutex<AuditFile>) -> MutexGuard<'_, AuditFile> {
    // A panic under this lock leaves at worst a half-written line.
    audit_file.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Syncs written lines to the disk until the log is closed.
fn sync_loop(audit_file: &Mutex<AuditFile>, closed: &Receiver<()>) {
    let mut turns = 0;
    loop {
        let is_over = closed.recv_timeout(Audit::SYNC_INTERVAL) != Err(RecvTimeoutError::Timeout);
        turns += 1;
        let file = {
            let mut book = lock(audit_file);
            if is_over || turns % 5 == 0 {
                book.write_repeats();
            }
            std::mem::take(&mut book.is_dirty).then(|| book.file.try_clone())
        };
        // The lock is released before the sync, so that writers do not wait for the disk.
        if let Some(Err(error)) = file.map(|file| file.and_then(|file| file.sync_data())) {
            tracing::error!(%error, "cannot sync the audit record to the disk");
        }
        if is_over {
            return;
        }
    }
}

#[derive(Debug)]
struct AuditFile {
    path: PathBuf,
    file: File,
    bytes: u64,
    max_bytes: u64,
    is_dirty: bool,
    /// Refusals of this second, with the number of repetitions after the first.
    repeats: BTreeMap<AuditEvent, u64>,
    /// Number of refusals beyond [`AuditFile::MAX_DISTINCT`] different ones.
    overflow: u64,
}

impl AuditFile {
    /// Maximum number of different refusals that are counted separately within a second.
    const MAX_DISTINCT: usize = 256;

    fn open(path: &Path, max_bytes: u64) -> std::io::Result<Self> {
        let file = append_to(path)?;
        let bytes = file.metadata()?.len();
        Ok(Self { path: path.into(), file, bytes, max_bytes, is_dirty: false, repeats: BTreeMap::new(), overflow: 0 })
    }

    fn write(&mut self, event: &AuditEvent, times: Option<u64>) {
        if let Err(error) = self.try_write(event, times) {
            // The action has already happened, so it must at least appear in this log.
            tracing::error!(%error, ?event, "cannot write the audit record");
        }
    }

    fn try_write(&mut self, event: &AuditEvent, times: Option<u64>) -> std::io::Result<()> {
        let mut line = serde_json::to_vec(&Line { time: now(), event, times })?;
        line.push(b'\n');
        if self.bytes > 0 && self.bytes + line.len() as u64 > self.max_bytes {
            self.rotate()?;
        }
        self.file.write_all(&line)?;
        self.bytes += line.len() as u64;
        self.is_dirty = true;
        Ok(())
    }

    /// Rotates the files: `audit.jsonl` becomes `audit.jsonl.1`, `.1` becomes `.2`, and the oldest is removed.
    fn rotate(&mut self) -> std::io::Result<()> {
        self.file.sync_data()?;
        let aside = |number| rotated_path(&self.path, number);
        for number in (1..Audit::ROTATED_FILES).rev() {
            match std::fs::rename(aside(number), aside(number + 1)) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error),
                Ok(()) | Err(_) => {}
            }
        }
        std::fs::rename(&self.path, aside(1))?;
        self.file = append_to(&self.path)?;
        self.bytes = 0;
        Ok(())
    }

    /// Writes the number of repetitions of this second's refusals.
    fn write_repeats(&mut self) {
        for (event, times) in std::mem::take(&mut self.repeats) {
            if times > 0 {
                self.write(&event, Some(times));
            }
        }
        let others = std::mem::take(&mut self.overflow);
        if others > 0 {
            let event = AuditEvent { who: "others".into(), outcome: "refused".into(), ..AuditEvent::default() };
            self.write(&event, Some(others));
        }
    }
}

/// Returns the path of rotated file `number`.
fn rotated_path(path: &Path, number: usize) -> PathBuf {
    let mut name = path.to_owned().into_os_string();
    name.push(format!(".{number}"));
    PathBuf::from(name)
}

/// Returns the last `count` lines of a file that are valid JSON, newest first. Only the last megabytes of the file are read.
fn last_lines(mut file: File, count: usize) -> std::io::Result<Vec<serde_json::Value>> {
    /// Maximum number of bytes to read.
    const MAX_READ_BYTES: u64 = 8 << 20;
    let length = file.metadata()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(MAX_READ_BYTES)))?;
    let mut bytes = Vec::new();
    file.take(MAX_READ_BYTES).read_to_end(&mut bytes)?;
    let lines = bytes.split(|byte| *byte == b'\n').rev().filter(|line| !line.is_empty());
    Ok(lines.filter_map(|line| serde_json::from_slice(line).ok()).take(count).collect())
}

fn append_to(path: &Path) -> std::io::Result<File> {
    let mut options = OpenOptions::new();
    options.create(true).append(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.open(path)
}

/// Returns the current time in UTC, with milliseconds.
fn now() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let moment = OffsetDateTime::from(UNIX_EPOCH + since);
    let seconds = crate::expiration::format(moment);
    format!("{}.{:03}Z", seconds.trim_end_matches('Z'), since.subsec_millis())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(job: u64, outcome: &str) -> AuditEvent {
        AuditEvent { who: "viewer eve".into(), job: Some(job), outcome: outcome.into(), ..AuditEvent::default() }
    }

    fn lines(path: &Path) -> Vec<serde_json::Value> {
        let text = std::fs::read_to_string(path).unwrap();
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    #[test]
    fn every_action_is_logged_at_once_and_repeated_refusals_counted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("audit.jsonl");
        let audit = Audit::open(&path).unwrap();
        for job in 0..3 {
            audit.record(&event(job, "ok"));
        }
        assert_eq!(lines(&path).len(), 3);
        for _ in 0..1000 {
            audit.record_refusal(event(7, "PermissionDenied"));
        }
        audit.record_refusal(AuditEvent { what: Some("a\"b\n\u{7}".into()), ..event(8, "PermissionDenied") });
        drop(audit.clone());
        drop(audit);
        let record = lines(&path);
        assert!(record.iter().all(|line| line["time"].as_str().is_some_and(|time| time.ends_with('Z'))));
        let lines_of_job = |job: u64| record.iter().filter(move |line| line["job"] == job);
        let times: u64 = lines_of_job(7).map(|line| line["times"].as_u64().unwrap_or(1)).sum();
        assert_eq!(times, 1000);
        assert!(lines_of_job(7).count() < 10);
        assert_eq!(lines_of_job(8).next().unwrap()["what"], "a\"b\n\u{7}");
        drop(Audit::open(&path).unwrap());
        assert_eq!(lines(&path), record, "what is there stays");
    }

    #[test]
    fn a_full_file_is_put_aside_and_the_oldest_goes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("audit.jsonl");
        let audit = Audit::with_max_bytes(&path, 1000).unwrap();
        for job in 0..500 {
            audit.record(&event(job, "ok"));
        }
        drop(audit);
        let files = std::fs::read_dir(folder.path()).unwrap().count();
        assert_eq!(files, 1 + Audit::ROTATED_FILES);
        let bytes = |name: &str| std::fs::metadata(folder.path().join(name)).unwrap().len();
        assert!(bytes("audit.jsonl") <= 1000 && bytes("audit.jsonl.1") <= 1000);
        assert_eq!(lines(&path).last().unwrap()["job"], 499);
        let first = lines(&path)[0]["job"].as_u64().unwrap();
        assert_eq!(lines(&folder.path().join("audit.jsonl.1")).last().unwrap()["job"], first - 1);
        let audit = Audit::with_max_bytes(&path, 1000).unwrap();
        let latest: Vec<u64> = audit.latest(20).unwrap().iter().map(|line| line["job"].as_u64().unwrap()).collect();
        assert_eq!(latest, (480..500).rev().collect::<Vec<_>>(), "also from rotated files");
        assert!(audit.latest(1000).unwrap().len() < 200, "what is gone is gone");
    }
}
