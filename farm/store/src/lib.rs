//! Artifacts by content: tiles, sums, images and scene bundles, named by the BLAKE3 digest of their bytes.
//!
//! Over `object_store`, so that a folder, memory and an S3-compatible server behave alike. An artifact is written
//! whole or not at all, never changed, and checked whenever it is read: one that is damaged is removed and reported as
//! missing, so that whoever needs it has it made again. It is also read before anybody is told that it need not be put
//! (`mend`).
#![deny(missing_docs)]

mod backend;
mod error;
mod mend;
mod seen;
mod upload;

use std::path::Path as FilePath;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use femc_model::{Artifact, Digest};
use object_store::local::LocalFileSystem;
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt as _, PutMode, PutOptions};
use tokio::sync::{RwLock, Semaphore};
use tokio_stream::StreamExt as _;

use crate::seen::Seen;

pub use backend::http::{Plain, connector};
pub use error::StoreError;
pub use mend::Soundness;
pub use object_store;
pub use upload::Upload;

/// Where artifacts live; clones share it.
#[derive(Debug, Clone)]
pub struct Store {
    /// For messages.
    name: Arc<str>,
    objects: Arc<dyn ObjectStore>,
    /// Where the objects are files.
    folder: Option<Arc<FilePath>>,
    limit: u64,
    seen: Arc<Mutex<Seen>>,
    /// Held for reading while something becomes readable, for writing while something damaged is removed.
    gate: Arc<RwLock<()>>,
    /// Who reads only to see whether bytes are sound waits for one of these: each has a block in memory.
    readers: Arc<Semaphore>,
}

impl Store {
    /// Most bytes of an artifact, unless [`Store::with_limit`] says otherwise.
    pub const LIMIT: u64 = 1 << 30;
    /// Questions to the medium at a time.
    const AT_ONCE: usize = 32;
    /// Bytes that are asked of the medium at once.
    pub const READ: u64 = 4 << 20;
    /// Artifacts that are read at once to see whether they are sound.
    const READERS: usize = 8;
    /// Bytes that are hashed without a break.
    const BITE: usize = 256 << 10;
    /// How often an artifact is put in the place of a damaged one.
    const TRIES: usize = 3;

    /// In a folder of this machine, which is made if it is not there; every artifact is synced to the disk.
    pub fn folder(path: &FilePath) -> Result<Self, StoreError> {
        let name = path.display().to_string();
        let wrong = |error| StoreError::Medium { store: name.clone(), error };
        std::fs::create_dir_all(path)
            .map_err(|error| wrong(object_store::Error::Generic { store: "folder", source: Box::new(error) }))?;
        let files = LocalFileSystem::new_with_prefix(path).map_err(wrong)?.with_fsync(true);
        Ok(Self { folder: Some(path.into()), ..Self::on(&name, Arc::new(files)) })
    }

    /// In memory, as long as a clone lives.
    pub fn memory() -> Self {
        Self::on("memory", Arc::new(InMemory::new()))
    }

    /// In a bucket: `s3://bucket/prefix`, with region, keys and endpoint from the usual `AWS_` variables. Nothing is asked of
    /// the server yet; [`Store::probe`] does.
    pub fn s3(url: &str) -> Result<Self, StoreError> {
        Ok(Self::on(url, backend::s3::open(url)?))
    }

    /// Over any medium.
    pub fn over(name: &str, objects: Arc<dyn ObjectStore>) -> Self {
        Self::on(name, objects)
    }

    fn on(name: &str, objects: Arc<dyn ObjectStore>) -> Self {
        let readers = Arc::new(Semaphore::new(Self::READERS));
        let (seen, gate) = (Arc::default(), Arc::default());
        Self { name: name.into(), objects, folder: None, limit: Self::LIMIT, seen, gate, readers }
    }

    pub(crate) fn medium(&self, error: object_store::Error) -> StoreError {
        StoreError::Medium { store: self.name.to_string(), error }
    }

    /// What it lies on, past all checks: for tests, which do harm there.
    pub fn medium_itself(&self) -> &Arc<dyn ObjectStore> {
        &self.objects
    }

    /// Its name for people: a folder, an address, or `memory`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether it is there and answers; waits for as long as it retries.
    pub async fn probe(&self) -> Result<(), StoreError> {
        let first = self.objects.list(None).next().await.transpose();
        first.map(drop).map_err(|error| self.medium(error))
    }

    /// The same store with another limit of bytes an artifact.
    pub fn with_limit(self, limit: u64) -> Self {
        Self { limit, ..self }
    }

    /// Most bytes of an artifact.
    pub fn limit(&self) -> u64 {
        self.limit
    }

    /// Whether it is there.
    pub async fn has(&self, digest: &Digest) -> Result<bool, StoreError> {
        Ok(self.size(digest).await?.is_some())
    }

    /// Its bytes' number, if it is there.
    pub async fn size(&self, digest: &Digest) -> Result<Option<u64>, StoreError> {
        match self.objects.head(&place(digest)).await {
            Ok(meta) => Ok(Some(meta.size)),
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(self.medium(error)),
        }
    }

    pub(crate) fn seen(&self) -> MutexGuard<'_, Seen> {
        // Nothing panics under this lock.
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Keeps `bytes`; what is there already is left alone, if it is whole.
    pub async fn put(&self, bytes: Bytes) -> Result<Artifact, StoreError> {
        Ok(self.keep(bytes).await?.0)
    }

    pub(crate) async fn keep(&self, bytes: Bytes) -> Result<(Artifact, Novelty), StoreError> {
        if bytes.len() as u64 > self.limit {
            return Err(StoreError::TooLarge { limit: self.limit });
        }
        let artifact = Artifact::of(&bytes);
        for _ in 0..Self::TRIES {
            let options = PutOptions { mode: PutMode::Create, ..PutOptions::default() };
            let put = {
                let _open = self.gate.read().await;
                self.objects.put_opts(&place(&artifact.digest), bytes.clone().into(), options).await
            };
            match put {
                Ok(_) => {
                    self.seen().note(artifact);
                    return Ok((artifact, Novelty::New));
                }
                Err(object_store::Error::AlreadyExists { .. }) => {}
                Err(error) => return Err(self.medium(error)),
            }
            if let Soundness::Sound(_) = self.verify(&artifact.digest).await? {
                return Ok((artifact, Novelty::Older));
            }
        }
        Err(StoreError::Unsound { digest: artifact.digest })
    }

    /// Begins to keep an artifact that comes in pieces.
    pub fn upload(&self, announced: Digest) -> Upload {
        Upload::new(self.clone(), announced)
    }

    /// All its bytes, checked. Damaged ones are removed and reported as missing.
    pub async fn get(&self, digest: &Digest) -> Result<Bytes, StoreError> {
        let result = match self.objects.get(&place(digest)).await {
            Err(object_store::Error::NotFound { .. }) => return Err(StoreError::Missing { digest: *digest }),
            other => other.map_err(|error| self.medium(error))?,
        };
        let bytes = result.bytes().await.map_err(|error| self.medium(error))?;
        if Digest::of(&bytes) != *digest {
            self.verify(digest).await?;
            return Err(StoreError::Missing { digest: *digest });
        }
        Ok(bytes)
    }

    /// Its bytes from `offset` on in pieces of at most `piece` bytes, sent to `out` until that is closed. All of it is read
    /// and checked, also what is not sent: one that is damaged is removed, and reported as a mismatch when most of it has
    /// been sent.
    pub async fn read(
        &self,
        digest: &Digest,
        offset: u64,
        piece: usize,
        out: &tokio::sync::mpsc::Sender<Result<Bytes, StoreError>>,
    ) -> Result<(), StoreError> {
        let (mut reading, mut at) = (self.begin(digest).await?, 0);
        while let Some(mut block) = self.next(digest, &mut reading).await? {
            while !block.is_empty() {
                let mut bytes = block.split_to(block.len().min(piece.max(1)));
                reading.take(&bytes);
                let skipped = usize::try_from(offset.saturating_sub(at)).unwrap_or(usize::MAX).min(bytes.len());
                at += bytes.len() as u64;
                let bytes = bytes.split_off(skipped);
                if !bytes.is_empty() && out.send(Ok(bytes)).await.is_err() {
                    return Ok(());
                }
            }
        }
        let found = reading.digest();
        if found != *digest {
            self.verify(digest).await?;
            return Err(StoreError::Mismatch { announced: *digest, found });
        }
        Ok(())
    }

    /// A part of its bytes, unchecked: read it after [`Store::verify`] or [`Store::known`].
    /// - `range`: within the artifact.
    pub async fn part(&self, digest: &Digest, range: std::ops::Range<u64>) -> Result<Bytes, StoreError> {
        let wanted = range.end.saturating_sub(range.start);
        if wanted == 0 {
            return Ok(Bytes::new());
        }
        let bytes = match self.objects.get_range(&place(digest), range).await {
            Err(object_store::Error::NotFound { .. }) => return Err(StoreError::Missing { digest: *digest }),
            other => other.map_err(|error| self.medium(error))?,
        };
        // A medium may answer with the bytes that are left of a shorter object.
        if bytes.len() as u64 == wanted { Ok(bytes) } else { Err(StoreError::Missing { digest: *digest }) }
    }

    /// Removes it; one that is not there is no error.
    pub async fn remove(&self, digest: &Digest) -> Result<(), StoreError> {
        self.seen().forget(digest);
        let deleted = self.objects.delete(&place(digest)).await;
        // Again: who found it there meanwhile has noted it.
        self.seen().forget(digest);
        match deleted {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(self.medium(error)),
        }
    }

    /// Every artifact that is there, in no order.
    pub async fn list(&self) -> Result<Vec<Artifact>, StoreError> {
        Ok(self.listing().await?.into_iter().map(|stored| stored.artifact).collect())
    }

    /// The same with the times at which they were kept, by the medium's clock.
    pub async fn listing(&self) -> Result<Vec<Stored>, StoreError> {
        let mut objects = self.objects.list(None);
        let mut all = Vec::new();
        while let Some(meta) = objects.next().await {
            let meta = meta.map_err(|error| self.medium(error))?;
            let name: String = meta.location.parts().map(|part| part.as_ref().to_owned()).collect();
            if let Ok(digest) = name.parse() {
                let artifact = Artifact { digest, bytes: meta.size };
                all.push(Stored { artifact, kept: meta.last_modified.into() });
            }
        }
        Ok(all)
    }

    /// Files of uploads that have not got on for `idle`: their number and their bytes. A bucket has a rule of its own for
    /// such.
    pub async fn sweep_uploads(&self, idle: Duration, sweep: Sweep) -> Result<(u64, u64), StoreError> {
        let Some(folder) = self.folder.clone() else { return Ok((0, 0)) };
        let work = move || {
            let staged = backend::folder::staged(&folder, idle)?;
            if sweep == Sweep::Remove {
                staged.iter().try_for_each(|(path, _)| backend::folder::remove(path))?;
            }
            Ok((staged.len() as u64, staged.iter().map(|(_, bytes)| bytes).sum()))
        };
        let swept = tokio::task::spawn_blocking(work).await.unwrap_or_else(|panic| Err(std::io::Error::other(panic)));
        swept.map_err(|error| self.medium(object_store::Error::Generic { store: "folder", source: Box::new(error) }))
    }
}

/// How old an artifact is that has just been put.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Novelty {
    /// As old as this.
    New,
    /// Perhaps older: it was there before, or came in parts (S3 counts from the first of them).
    Older,
}

/// What a sweep does with what nobody needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sweep {
    /// Only counts it.
    Count,
    /// Removes it.
    Remove,
}

/// An artifact in the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stored {
    /// Digest and size.
    pub artifact: Artifact,
    /// Time of the last write, by the clock of the medium.
    pub kept: SystemTime,
}

/// Where an artifact lies: two digits for the folder, the rest for the file; no folder grows too large.
pub fn place(digest: &Digest) -> Path {
    let name = digest.to_string();
    Path::from_iter([&name[..2], &name[2..]])
}
