//! Uploads of artifacts in pieces: hashed while they arrive, stored only if the digest is the announced one.

use bytes::BytesMut;
use femc_model::{Artifact, Digest};
use object_store::{MultipartUpload, ObjectStoreExt as _};

use crate::{Novelty, Store, StoreError, artifact_path};

/// Bytes buffered in memory before a part is written to the medium; S3 requires at least 5 MiB per part.
const PART: usize = 8 << 20;

/// An upload in progress. If it is dropped before [`Upload::finish`], no readable artifact remains.
pub struct Upload {
    store: Store,
    expected_digest: Digest,
    hash: blake3::Hasher,
    buffer: BytesMut,
    size: u64,
    parts: Option<Box<dyn MultipartUpload>>,
}

impl Upload {
    pub(crate) fn new(store: Store, announced: Digest) -> Self {
        Self {
            store,
            expected_digest: announced,
            hash: blake3::Hasher::new(),
            buffer: BytesMut::new(),
            size: 0,
            parts: None,
        }
    }

    /// Returns the number of bytes received so far.
    pub fn size(&self) -> u64 {
        self.size
    }

    /// Cancels the upload and removes its parts from the medium.
    pub async fn abandon(mut self) {
        self.abort().await;
    }

    /// Adds the next piece. After an error the upload cannot be used any more.
    pub async fn write(&mut self, piece: &[u8]) -> Result<(), StoreError> {
        self.size += piece.len() as u64;
        if self.size > self.store.limit {
            self.abort().await;
            return Err(StoreError::TooLarge { limit: self.store.limit });
        }
        self.hash.update(piece);
        self.buffer.extend_from_slice(piece);
        while self.buffer.len() >= PART {
            self.flush().await?;
        }
        Ok(())
    }

    async fn flush(&mut self) -> Result<(), StoreError> {
        let parts = match &mut self.parts {
            Some(parts) => parts,
            None => {
                let begun = self.store.objects.put_multipart(&artifact_path(&self.expected_digest)).await;
                self.parts.insert(begun.map_err(|error| self.store.medium_error(error))?)
            }
        };
        // All parts have the same size, because some servers require it. The last part may be shorter.
        let part = self.buffer.split_to(self.buffer.len().min(PART)).freeze();
        parts.put_part(part.into()).await.map_err(|error| self.store.medium_error(error))
    }

    async fn abort(&mut self) {
        if let Some(mut parts) = self.parts.take() {
            // Parts that cannot be removed are not readable, either.
            let _ = parts.abort().await;
        }
    }

    /// Stores the artifact if its bytes have the announced digest. An artifact of several parts replaces an existing one.
    pub async fn finish(mut self) -> Result<(Artifact, Novelty), StoreError> {
        let found = Digest::from_bytes(*self.hash.finalize().as_bytes());
        if found != self.expected_digest {
            self.abort().await;
            return Err(StoreError::Mismatch { announced: self.expected_digest, found });
        }
        if self.parts.is_none() {
            return self.store.put_with_novelty(self.buffer.freeze()).await;
        }
        if !self.buffer.is_empty() {
            self.flush().await?;
        }
        if let Some(mut parts) = self.parts.take() {
            let _open = self.store.gate.read().await;
            parts.complete().await.map_err(|error| self.store.medium_error(error))?;
        }
        let artifact = Artifact { digest: found, bytes: self.size };
        self.store.recent().insert(artifact);
        Ok((artifact, Novelty::Older))
    }
}

impl std::fmt::Debug for Upload {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Upload")
            .field("announced", &self.expected_digest)
            .field("size", &self.size)
            .finish_non_exhaustive()
    }
}
