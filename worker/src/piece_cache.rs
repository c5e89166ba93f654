//! Cache of scene pieces, so that a second job of a scene downloads none of them.
//!
//! The pieces are in memory or in a folder, up to a number of bytes. The least recently used piece is removed first. Every piece
//! read is checked against its digest; a damaged file is removed and downloaded again. Several workers of a machine may share a
//! folder. Each of them then counts the files that it found at its start and those that it adds itself.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use femc_model::Digest;

/// Pieces by digest. Clones share them.
#[derive(Debug, Clone)]
pub struct PieceCache(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    limit: u64,
    storage: Storage,
    state: Mutex<State>,
    fetched: AtomicU64,
}

#[derive(Debug)]
enum Storage {
    Memory,
    Folder(PathBuf),
}

#[derive(Debug, Default)]
struct State {
    entries: BTreeMap<Digest, Entry>,
    /// Total size of all entries in bytes.
    bytes: u64,
    /// Number of uses so far; serves as the clock for the age of entries.
    uses: u64,
}

#[derive(Debug)]
struct Entry {
    bytes: u64,
    used: u64,
    /// Bytes of the piece; only for pieces in memory.
    content: Option<Bytes>,
}

impl State {
    fn add(&mut self, digest: Digest, bytes: u64, content: Option<Bytes>) {
        self.uses += 1;
        self.bytes += bytes;
        let old = self.entries.insert(digest, Entry { bytes, used: self.uses, content });
        self.bytes -= old.map_or(0, |old| old.bytes);
    }

    fn forget(&mut self, digest: &Digest) {
        self.bytes -= self.entries.remove(digest).map_or(0, |entry| entry.bytes);
    }

    /// Removes the least recently used entries until there is room for `bytes` more; returns the digests of the removed entries.
    fn make_room(&mut self, bytes: u64, limit: u64) -> Vec<Digest> {
        let mut gone = Vec::new();
        while self.bytes.saturating_add(bytes) > limit {
            let oldest = self.entries.iter().min_by_key(|(_, entry)| entry.used).map(|(digest, _)| *digest);
            let Some(oldest) = oldest else { break };
            self.forget(&oldest);
            gone.push(oldest);
        }
        gone
    }
}

impl PieceCache {
    /// Default limit in memory, bytes.
    pub const DEFAULT_MEMORY_LIMIT: u64 = 256 << 20;
    /// Default limit in a folder, bytes.
    pub const DEFAULT_FOLDER_LIMIT: u64 = 10 << 30;
    /// Age after which the unfinished file of a killed worker is removed.
    const STALE: Duration = Duration::from_secs(3600);

    /// Creates a cache of up to `limit` bytes in memory; 0 disables it.
    pub fn in_memory(limit: u64) -> Self {
        Self::with_state(limit, Storage::Memory, State::default())
    }

    /// Creates a cache of up to `limit` bytes in `folder`. The folder is created if missing. Pieces from an earlier run count.
    pub fn in_folder(folder: &Path, limit: u64) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let (mut found, mut state) = (Vec::new(), State::default());
        for entry in fs::read_dir(folder)? {
            let entry = entry?;
            let (Some(name), Ok(data)) = (entry.file_name().to_str().map(str::to_owned), entry.metadata()) else {
                continue;
            };
            let modified = data.modified().unwrap_or(SystemTime::UNIX_EPOCH);
            match name.parse::<Digest>() {
                Ok(digest) if data.is_file() => found.push((modified, digest, data.len())),
                Err(_) if name.starts_with(".new-") && modified.elapsed().is_ok_and(|age| age > Self::STALE) => {
                    // If this fails, the file takes space but does no harm.
                    let _ = fs::remove_file(entry.path());
                }
                Ok(_) | Err(_) => {}
            }
        }
        found.sort_unstable();
        found.into_iter().for_each(|(_, digest, bytes)| state.add(digest, bytes, None));
        let pieces = Self::with_state(limit, Storage::Folder(folder.to_owned()), state);
        let gone = pieces.lock().make_room(0, limit);
        pieces.delete(&gone);
        Ok(pieces)
    }

    fn with_state(limit: u64, storage: Storage, state: State) -> Self {
        Self(Arc::new(Inner { limit, storage, state: Mutex::new(state), fetched: AtomicU64::new(0) }))
    }

    /// Returns the total size of the cached pieces in bytes.
    pub fn bytes(&self) -> u64 {
        self.lock().bytes
    }

    /// Returns the number of bytes that were not cached and had to be downloaded.
    pub fn fetched(&self) -> u64 {
        self.0.fetched.load(Ordering::Relaxed)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // A panic within the few lines under this lock leaves the state consistent.
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the piece if it is cached and undamaged.
    pub(crate) fn get(&self, digest: &Digest) -> Option<Bytes> {
        let kept = {
            let mut state = self.lock();
            state.uses += 1;
            let uses = state.uses;
            let entry = state.entries.get_mut(digest)?;
            entry.used = uses;
            entry.content.clone()
        };
        let bytes = match &self.0.storage {
            Storage::Memory => kept,
            Storage::Folder(folder) => read(&folder.join(digest.to_string())),
        };
        let sound = bytes.filter(|bytes| Digest::compute(bytes) == *digest);
        if sound.is_none() {
            tracing::warn!(%digest, "a cached scene piece is missing or damaged; downloading it again");
            self.lock().forget(digest);
            self.delete(&[*digest]);
        }
        sound
    }

    /// Caches a downloaded piece unless it is larger than the limit.
    pub(crate) fn insert(&self, digest: &Digest, bytes: &Bytes) {
        let size = bytes.len() as u64;
        self.0.fetched.fetch_add(size, Ordering::Relaxed);
        if size > self.0.limit {
            return;
        }
        let gone = {
            let mut state = self.lock();
            // Two threads may have downloaded the piece at the same time.
            state.forget(digest);
            state.make_room(size, self.0.limit)
        };
        self.delete(&gone);
        let content = match &self.0.storage {
            Storage::Memory => Some(bytes.clone()),
            Storage::Folder(folder) => {
                if let Err(error) = write(folder, digest, bytes) {
                    tracing::warn!(folder = %folder.display(), %error, "cannot cache a scene piece");
                    return;
                }
                None
            }
        };
        self.lock().add(*digest, size, content);
    }

    fn delete(&self, digests: &[Digest]) {
        if let Storage::Folder(folder) = &self.0.storage {
            for digest in digests {
                // Another worker may have removed the file already.
                let _ = fs::remove_file(folder.join(digest.to_string()));
            }
        }
    }
}

fn read(path: &Path) -> Option<Bytes> {
    let bytes = fs::read(path).ok()?;
    // The modification time keeps the order of use across restarts. If this fails, the order of download remains.
    let _ = File::options().write(true).open(path).and_then(|file| file.set_modified(SystemTime::now()));
    Some(bytes.into())
}

/// Writes a file atomically.
fn write(folder: &Path, digest: &Digest, bytes: &[u8]) -> io::Result<()> {
    let new = folder.join(format!(".new-{digest}-{}", std::process::id()));
    let written = fs::write(&new, bytes).and_then(|()| fs::rename(&new, folder.join(digest.to_string())));
    if written.is_err() {
        let _ = fs::remove_file(&new);
    }
    written
}

#[cfg(test)]
mod tests {
    use super::*;

    fn piece(fill: u8) -> (Digest, Bytes) {
        let bytes = Bytes::from(vec![fill; 100]);
        (Digest::compute(&bytes), bytes)
    }

    fn keep(pieces: &PieceCache, fill: u8) {
        let (digest, bytes) = piece(fill);
        pieces.insert(&digest, &bytes);
    }

    fn has(pieces: &PieceCache, fill: u8) -> bool {
        let (digest, bytes) = piece(fill);
        pieces.get(&digest).inspect(|found| assert_eq!(*found, bytes)).is_some()
    }

    fn keeps_the_latest(pieces: &PieceCache) {
        (1..=3).for_each(|fill| keep(pieces, fill));
        assert!(has(pieces, 1), "used lately");
        keep(pieces, 4);
        assert_eq!([1, 2, 3, 4].map(|fill| has(pieces, fill)), [true, false, true, true]);
        assert_eq!(pieces.bytes(), 300);
        pieces.insert(&Digest::compute(&[0; 400]), &vec![0; 400].into());
        assert_eq!((pieces.bytes(), pieces.fetched()), (300, 800), "what does not fit pushes nothing out");
        keep(pieces, 4);
        assert_eq!(pieces.bytes(), 300, "twice is once");
    }

    #[test]
    fn what_was_used_longest_ago_makes_room() {
        keeps_the_latest(&PieceCache::in_memory(399));
        let folder = tempfile::tempdir().unwrap();
        keeps_the_latest(&PieceCache::in_folder(&folder.path().join("new"), 399).unwrap());
        assert_eq!(fs::read_dir(folder.path().join("new")).unwrap().count(), 3, "what went is gone from the disk");
        let none = PieceCache::in_memory(0);
        keep(&none, 1);
        assert!(!has(&none, 1));
    }

    #[test]
    fn folder_outlives_worker_and_smaller_limit_applies_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let first = PieceCache::in_folder(folder.path(), 1000).unwrap();
        (1..=5).for_each(|fill| keep(&first, fill));
        drop(first);
        fs::write(folder.path().join("a person's note"), "stays").unwrap();
        let second = PieceCache::in_folder(folder.path(), 1000).unwrap();
        assert_eq!((second.bytes(), has(&second, 3)), (500, true));
        assert_eq!(second.fetched(), 0);
        let third = PieceCache::in_folder(folder.path(), 250).unwrap();
        assert_eq!(third.bytes(), 200);
        assert!(has(&third, 3), "the order of use is remembered");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3);
    }

    #[test]
    fn a_damaged_file_is_fetched_again() {
        let folder = tempfile::tempdir().unwrap();
        let pieces = PieceCache::in_folder(folder.path(), 1000).unwrap();
        keep(&pieces, 1);
        let path = folder.path().join(piece(1).0.to_string());
        fs::write(&path, b"something else").unwrap();
        assert!(!has(&pieces, 1) && !path.exists());
        assert_eq!(pieces.bytes(), 0);
        keep(&pieces, 1);
        assert!(has(&pieces, 1));
        fs::remove_file(&path).unwrap();
        assert!(!has(&pieces, 1), "somebody else has removed it");
    }
}
