//! Content-addressed store of artifacts: tiles, sums, images and scene bundles, named by the BLAKE3 digest of their bytes.
//!
//! It is built on `object_store`, so that a folder, memory and an S3-compatible server behave alike. An artifact is written either
//! whole or not at all, is never changed, and is verified whenever it is read. A damaged artifact is removed and reported as
//! missing, so that it is produced again. An artifact is also verified before a client is allowed to skip its upload
//! (`verification`).
#![deny(missing_docs)]

mod backend;
mod error;
mod recent;
mod upload;
mod verification;

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

use crate::recent::RecentArtifacts;

pub use backend::http::{PlaintextPolicy, https_connector};
pub use error::StoreError;
pub use object_store;
pub use upload::Upload;
pub use verification::Integrity;

/// A store of artifacts. Clones share it.
#[derive(Debug, Clone)]
pub struct Store {
    /// Name for messages.
    name: Arc<str>,
    objects: Arc<dyn ObjectStore>,
    /// Folder of the objects, if they are files.
    folder: Option<Arc<FilePath>>,
    limit: u64,
    recent: Arc<Mutex<RecentArtifacts>>,
    /// Lock held for reading while an artifact becomes readable, and for writing while a damaged artifact is removed.
    gate: Arc<RwLock<()>>,
    /// Permits for reading an artifact only to verify it. They limit memory: each reader holds one block.
    readers: Arc<Semaphore>,
}

impl Store {
    /// Default size limit of an artifact in bytes; see [`Store::with_limit`].
    pub const LIMIT: u64 = 1 << 30;
    /// Number of artifacts that [`Store::missing`] checks at the same time.
    const MAX_CONCURRENT_CHECKS: usize = 32;
    /// Bytes per read request to the medium.
    pub const READ_SIZE: u64 = 4 << 20;
    /// Maximum number of artifacts that are verified at the same time.
    const READERS: usize = 8;
    /// Number of bytes that are hashed before other tasks get a turn.
    const HASH_SLICE: usize = 256 << 10;
    /// Number of attempts to replace a damaged artifact.
    const MAX_ATTEMPTS: usize = 3;

    /// Opens a store in a local folder, which is created if needed. Every artifact is synced to the disk.
    pub fn open_folder(path: &FilePath) -> Result<Self, StoreError> {
        let name = path.display().to_string();
        let wrong = |error| StoreError::Medium { store: name.clone(), error };
        std::fs::create_dir_all(path)
            .map_err(|error| wrong(object_store::Error::Generic { store: "folder", source: Box::new(error) }))?;
        let files = LocalFileSystem::new_with_prefix(path).map_err(wrong)?.with_fsync(true);
        Ok(Self { folder: Some(path.into()), ..Self::from_objects(&name, Arc::new(files)) })
    }

    /// Creates a store in memory, which lives until its last clone is dropped.
    pub fn in_memory() -> Self {
        Self::from_objects("memory", Arc::new(InMemory::new()))
    }

    /// Opens a store in a bucket: `s3://bucket/prefix`, with region, keys and endpoint from the usual `AWS_` variables. No request
    /// is sent to the server yet; [`Store::probe`] sends one.
    pub fn open_s3(url: &str) -> Result<Self, StoreError> {
        Ok(Self::from_objects(url, backend::s3::open(url)?))
    }

    /// Creates a store on any medium.
    pub fn from_object_store(name: &str, objects: Arc<dyn ObjectStore>) -> Self {
        Self::from_objects(name, objects)
    }

    fn from_objects(name: &str, objects: Arc<dyn ObjectStore>) -> Self {
        let readers = Arc::new(Semaphore::new(Self::READERS));
        let (seen, gate) = (Arc::default(), Arc::default());
        Self { name: name.into(), objects, folder: None, limit: Self::LIMIT, recent: seen, gate, readers }
    }

    pub(crate) fn medium_error(&self, error: object_store::Error) -> StoreError {
        StoreError::Medium { store: self.name.to_string(), error }
    }

    /// Returns the medium below the store, without any checks: for tests that damage artifacts.
    pub fn objects(&self) -> &Arc<dyn ObjectStore> {
        &self.objects
    }

    /// Returns the name of the store for people: a folder, an address, or `memory`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Checks that the store can be reached. Waits while requests are retried.
    pub async fn probe(&self) -> Result<(), StoreError> {
        let first = self.objects.list(None).next().await.transpose();
        first.map(drop).map_err(|error| self.medium_error(error))
    }

    /// Returns this store with another size limit for artifacts, in bytes.
    pub fn with_limit(self, limit: u64) -> Self {
        Self { limit, ..self }
    }

    /// Returns the size limit of an artifact in bytes.
    pub fn limit(&self) -> u64 {
        self.limit
    }

    /// Checks whether the artifact exists, without verifying its bytes.
    pub async fn has(&self, digest: &Digest) -> Result<bool, StoreError> {
        Ok(self.size(digest).await?.is_some())
    }

    /// Returns the artifact's size in bytes; `None` if it does not exist.
    pub async fn size(&self, digest: &Digest) -> Result<Option<u64>, StoreError> {
        match self.objects.head(&artifact_path(digest)).await {
            Ok(meta) => Ok(Some(meta.size)),
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(self.medium_error(error)),
        }
    }

    pub(crate) fn recent(&self) -> MutexGuard<'_, RecentArtifacts> {
        // Nothing panics while this lock is held.
        self.recent.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Stores `bytes`. An existing sound artifact is left unchanged.
    pub async fn put(&self, bytes: Bytes) -> Result<Artifact, StoreError> {
        Ok(self.put_with_novelty(bytes).await?.0)
    }

    pub(crate) async fn put_with_novelty(&self, bytes: Bytes) -> Result<(Artifact, Novelty), StoreError> {
        if bytes.len() as u64 > self.limit {
            return Err(StoreError::TooLarge { limit: self.limit });
        }
        let artifact = Artifact::from_bytes(&bytes);
        for _ in 0..Self::MAX_ATTEMPTS {
            let options = PutOptions { mode: PutMode::Create, ..PutOptions::default() };
            let put = {
                let _open = self.gate.read().await;
                self.objects.put_opts(&artifact_path(&artifact.digest), bytes.clone().into(), options).await
            };
            match put {
                Ok(_) => {
                    self.recent().insert(artifact);
                    return Ok((artifact, Novelty::New));
                }
                Err(object_store::Error::AlreadyExists { .. }) => {}
                Err(error) => return Err(self.medium_error(error)),
            }
            if let Integrity::Intact(_) = self.verify(&artifact.digest).await? {
                return Ok((artifact, Novelty::Older));
            }
        }
        Err(StoreError::Unsound { digest: artifact.digest })
    }

    /// Begins the upload of an artifact that arrives in pieces.
    pub fn upload(&self, announced: Digest) -> Upload {
        Upload::new(self.clone(), announced)
    }

    /// Returns all bytes of the artifact, verified. A damaged artifact is removed and reported as missing.
    pub async fn get(&self, digest: &Digest) -> Result<Bytes, StoreError> {
        let result = match self.objects.get(&artifact_path(digest)).await {
            Err(object_store::Error::NotFound { .. }) => return Err(StoreError::Missing { digest: *digest }),
            other => other.map_err(|error| self.medium_error(error))?,
        };
        let bytes = result.bytes().await.map_err(|error| self.medium_error(error))?;
        if Digest::compute(&bytes) != *digest {
            self.verify(digest).await?;
            return Err(StoreError::Missing { digest: *digest });
        }
        Ok(bytes)
    }

    /// Sends the artifact's bytes from `offset` on to `out`, in pieces of at most `piece` bytes, until `out` is closed. The whole
    /// artifact is read and verified, including the bytes before `offset`. A damaged artifact is removed. It is reported as a
    /// mismatch after most of it has been sent.
    pub async fn read(
        &self,
        digest: &Digest,
        offset: u64,
        piece: usize,
        out: &tokio::sync::mpsc::Sender<Result<Bytes, StoreError>>,
    ) -> Result<(), StoreError> {
        let (mut reader, mut at) = (self.open_reader(digest).await?, 0);
        while let Some(mut block) = self.next(digest, &mut reader).await? {
            while !block.is_empty() {
                let mut bytes = block.split_to(block.len().min(piece.max(1)));
                reader.update(&bytes);
                let skipped = usize::try_from(offset.saturating_sub(at)).unwrap_or(usize::MAX).min(bytes.len());
                at += bytes.len() as u64;
                let bytes = bytes.split_off(skipped);
                if !bytes.is_empty() && out.send(Ok(bytes)).await.is_err() {
                    return Ok(());
                }
            }
        }
        let found = reader.digest();
        if found != *digest {
            self.verify(digest).await?;
            return Err(StoreError::Mismatch { announced: *digest, found });
        }
        Ok(())
    }

    /// Returns a part of the artifact's bytes, unverified: call [`Store::verify`] or [`Store::verify_unless_recent`] first.
    /// - `range`: within the artifact.
    pub async fn read_range(&self, digest: &Digest, range: std::ops::Range<u64>) -> Result<Bytes, StoreError> {
        let wanted = range.end.saturating_sub(range.start);
        if wanted == 0 {
            return Ok(Bytes::new());
        }
        let bytes = match self.objects.get_range(&artifact_path(digest), range).await {
            Err(object_store::Error::NotFound { .. }) => return Err(StoreError::Missing { digest: *digest }),
            other => other.map_err(|error| self.medium_error(error))?,
        };
        // If the object is shorter than the range, a medium may return only the bytes that exist.
        if bytes.len() as u64 == wanted { Ok(bytes) } else { Err(StoreError::Missing { digest: *digest }) }
    }

    /// Removes the artifact; a missing artifact is not an error.
    pub async fn remove(&self, digest: &Digest) -> Result<(), StoreError> {
        self.recent().remove(digest);
        let deleted = self.objects.delete(&artifact_path(digest)).await;
        // Forget it again: a concurrent check may have found it before the deletion and noted it.
        self.recent().remove(digest);
        match deleted {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(self.medium_error(error)),
        }
    }

    /// Returns all artifacts, in arbitrary order.
    pub async fn list(&self) -> Result<Vec<Artifact>, StoreError> {
        Ok(self.listing().await?.into_iter().map(|stored| stored.artifact).collect())
    }

    /// Returns all artifacts with the times at which they were stored, by the medium's clock.
    pub async fn listing(&self) -> Result<Vec<StoredArtifact>, StoreError> {
        let mut objects = self.objects.list(None);
        let mut all = Vec::new();
        while let Some(meta) = objects.next().await {
            let meta = meta.map_err(|error| self.medium_error(error))?;
            let name: String = meta.location.parts().map(|part| part.as_ref().to_owned()).collect();
            if let Ok(digest) = name.parse() {
                let artifact = Artifact { digest, bytes: meta.size };
                all.push(StoredArtifact { artifact, last_modified: meta.last_modified.into() });
            }
        }
        Ok(all)
    }

    /// Counts or removes the files of uploads that made no progress for `idle`. Returns the number of the files and their total
    /// bytes. In a bucket there are no such files: a rule of the bucket removes incomplete uploads.
    pub async fn sweep_uploads(&self, idle: Duration, sweep: Sweep) -> Result<(u64, u64), StoreError> {
        let Some(folder) = self.folder.clone() else { return Ok((0, 0)) };
        let work = move || {
            let staged = backend::folder::upload_files(&folder, idle)?;
            if sweep == Sweep::Remove {
                staged.iter().try_for_each(|(path, _)| backend::folder::remove(path))?;
            }
            Ok((staged.len() as u64, staged.iter().map(|(_, bytes)| bytes).sum()))
        };
        let swept = tokio::task::spawn_blocking(work).await.unwrap_or_else(|panic| Err(std::io::Error::other(panic)));
        swept.map_err(|error| {
            self.medium_error(object_store::Error::Generic { store: "folder", source: Box::new(error) })
        })
    }
}

/// Age of an artifact that has just been stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Novelty {
    /// The artifact was written by this call.
    New,
    /// The artifact may be older: it existed before, or arrived in parts (S3 dates it by the first part).
    Older,
}

/// Action of a sweep on files that are no longer needed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sweep {
    /// Only count them.
    Count,
    /// Remove them.
    Remove,
}

/// An artifact in the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StoredArtifact {
    /// Digest and size.
    pub artifact: Artifact,
    /// Time of the last write, by the clock of the medium.
    pub last_modified: SystemTime,
}

/// Returns the path of an artifact: two digits name the folder, the rest names the file, so that no folder grows too large.
pub fn artifact_path(digest: &Digest) -> Path {
    let name = digest.to_string();
    Path::from_iter([&name[..2], &name[2..]])
}
