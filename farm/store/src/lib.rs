//! Artefacts by content: tiles, sums, images and scene bundles, named by the BLAKE3 digest of their bytes.
//!
//! Over `object_store`, so that a folder, memory and (later) an S3-compatible server behave alike. An artefact is written
//! whole or not at all, never changed, and checked whenever it is read: one that is damaged is removed and reported as
//! missing, so that whoever needs it has it made again.
#![deny(missing_docs)]

mod upload;

use std::path::Path as FilePath;
use std::sync::Arc;

use bytes::Bytes;
use femc_model::{Artefact, Digest};
use object_store::local::LocalFileSystem;
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt as _, PutMode, PutOptions};
use tokio_stream::StreamExt as _;

pub use object_store;
pub use upload::Upload;

/// Where artefacts live; clones share it.
#[derive(Debug, Clone)]
pub struct Store {
    objects: Arc<dyn ObjectStore>,
    limit: u64,
}

/// Why an artefact cannot be had or kept.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// It is not there, or what was there was damaged.
    #[error("there is no artefact {digest}")]
    Missing {
        /// Which.
        digest: Digest,
    },
    /// The bytes are others than announced.
    #[error("the bytes are those of {found}, not of {announced}")]
    Mismatch {
        /// As announced.
        announced: Digest,
        /// As computed.
        found: Digest,
    },
    /// Beyond the store's limit.
    #[error("an artefact of more than {limit} bytes")]
    TooLarge {
        /// Bytes.
        limit: u64,
    },
    /// The medium said no.
    #[error("artefact store: {0}")]
    Medium(#[from] object_store::Error),
}

impl Store {
    /// Most bytes of an artefact, unless [`Store::with_limit`] says otherwise.
    pub const LIMIT: u64 = 1 << 30;

    /// In a folder of this machine, which is made if it is not there; every artefact is synced to the disk.
    pub fn folder(path: &FilePath) -> Result<Self, StoreError> {
        std::fs::create_dir_all(path)
            .map_err(|error| object_store::Error::Generic { store: "folder", source: Box::new(error) })?;
        let files = LocalFileSystem::new_with_prefix(path)?.with_fsync(true);
        Ok(Self { objects: Arc::new(files), limit: Self::LIMIT })
    }

    /// In memory, as long as a clone lives.
    pub fn memory() -> Self {
        Self::over(Arc::new(InMemory::new()))
    }

    /// Over any medium.
    pub fn over(objects: Arc<dyn ObjectStore>) -> Self {
        Self { objects, limit: Self::LIMIT }
    }

    /// The same store with another limit of bytes an artefact.
    pub fn with_limit(self, limit: u64) -> Self {
        Self { limit, ..self }
    }

    /// Most bytes of an artefact.
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
            Err(error) => Err(error.into()),
        }
    }

    /// Keeps `bytes`; what is there already is left alone.
    pub async fn put(&self, bytes: Bytes) -> Result<Artefact, StoreError> {
        if bytes.len() as u64 > self.limit {
            return Err(StoreError::TooLarge { limit: self.limit });
        }
        let artefact = Artefact::of(&bytes);
        let options = PutOptions { mode: PutMode::Create, ..PutOptions::default() };
        match self.objects.put_opts(&place(&artefact.digest), bytes.into(), options).await {
            Ok(_) | Err(object_store::Error::AlreadyExists { .. }) => Ok(artefact),
            Err(error) => Err(error.into()),
        }
    }

    /// Begins to keep an artefact that comes in pieces.
    pub fn upload(&self, announced: Digest) -> Upload {
        Upload::new(self.clone(), announced)
    }

    /// All its bytes, checked. Damaged ones are removed and reported as missing.
    pub async fn get(&self, digest: &Digest) -> Result<Bytes, StoreError> {
        let result = match self.objects.get(&place(digest)).await {
            Err(object_store::Error::NotFound { .. }) => return Err(StoreError::Missing { digest: *digest }),
            other => other?,
        };
        let bytes = result.bytes().await?;
        if Digest::of(&bytes) != *digest {
            self.remove(digest).await?;
            return Err(StoreError::Missing { digest: *digest });
        }
        Ok(bytes)
    }

    /// Its bytes from `offset` on in pieces of at most `piece` bytes, sent to `out` until that is closed. Not checked
    /// here: the reader has the digest and must.
    pub async fn read(
        &self,
        digest: &Digest,
        offset: u64,
        piece: u64,
        out: &tokio::sync::mpsc::Sender<Result<Bytes, StoreError>>,
    ) -> Result<(), StoreError> {
        let size = self.size(digest).await?.ok_or(StoreError::Missing { digest: *digest })?;
        let mut at = offset;
        while at < size {
            let end = size.min(at + piece.max(1));
            let bytes = self.objects.get_range(&place(digest), at..end).await?;
            if out.send(Ok(bytes)).await.is_err() {
                break;
            }
            at = end;
        }
        Ok(())
    }

    /// Removes it; one that is not there is no error.
    pub async fn remove(&self, digest: &Digest) -> Result<(), StoreError> {
        match self.objects.delete(&place(digest)).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    /// Every artefact that is there, in no order.
    pub async fn list(&self) -> Result<Vec<Artefact>, StoreError> {
        let mut objects = self.objects.list(None);
        let mut all = Vec::new();
        while let Some(meta) = objects.next().await {
            let meta = meta?;
            let name: String = meta.location.parts().map(|part| part.as_ref().to_owned()).collect();
            if let Ok(digest) = name.parse() {
                all.push(Artefact { digest, bytes: meta.size });
            }
        }
        Ok(all)
    }
}

/// Two digits for the folder, the rest for the file: no folder grows too large.
fn place(digest: &Digest) -> Path {
    let name = digest.to_string();
    Path::from_iter([&name[..2], &name[2..]])
}
