//! Verification of artifacts: reading finds bytes that no longer match their digest, and removes them, so that they can be stored
//! again.
//!
//! A disk may lose the end of a file or change a bit of it, long after it has confirmed the write. Reading an artifact detects
//! this; a check for its existence does not. Therefore an artifact is read before the farm relies on it instead of having it sent
//! or produced again. Reading costs less than sending.

use bytes::Bytes;
use femc_model::{Artifact, Digest};
use object_store::ObjectStoreExt as _;

use crate::{Store, StoreError, artifact_path};

/// Result of verifying an artifact.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Integrity {
    /// The artifact is intact and has this size in bytes.
    Intact(u64),
    /// The bytes did not match the digest; the artifact is removed.
    Damaged,
    /// The artifact does not exist.
    Missing,
}

/// State of reading an artifact from start to end, with the digest of the bytes read.
pub(crate) struct ArtifactReader {
    hash: blake3::Hasher,
    size: u64,
    offset: u64,
}

impl Store {
    /// Begins to read an artifact.
    pub(crate) async fn open_reader(&self, digest: &Digest) -> Result<ArtifactReader, StoreError> {
        let size = self.size(digest).await?.ok_or(StoreError::Missing { digest: *digest })?;
        Ok(ArtifactReader { hash: blake3::Hasher::new(), size, offset: 0 })
    }

    /// Reads the next block; `None` at the end.
    pub(crate) async fn next(&self, digest: &Digest, reader: &mut ArtifactReader) -> Result<Option<Bytes>, StoreError> {
        if reader.offset >= reader.size {
            return Ok(None);
        }
        let end = reader.size.min(reader.offset + Self::READ_SIZE);
        let block = match self.objects.get_range(&artifact_path(digest), reader.offset..end).await {
            Err(object_store::Error::NotFound { .. }) => return Err(StoreError::Missing { digest: *digest }),
            other => other.map_err(|error| self.medium_error(error))?,
        };
        reader.offset = end;
        Ok(Some(block))
    }

    /// Reads an artifact and checks its bytes. Waits for a permit of [`Store::READERS`].
    async fn read_and_check(&self, digest: &Digest) -> Result<Integrity, StoreError> {
        // The semaphore is never closed.
        let _reader = self.readers.acquire().await.ok();
        self.read_and_check_with_permit(digest).await
    }

    /// Reads an artifact and checks its bytes. The caller holds a permit.
    async fn read_and_check_with_permit(&self, digest: &Digest) -> Result<Integrity, StoreError> {
        let mut reader = match self.open_reader(digest).await {
            Err(StoreError::Missing { .. }) => return Ok(Integrity::Missing),
            other => other?,
        };
        loop {
            match self.next(digest, &mut reader).await {
                Ok(Some(mut block)) => {
                    while !block.is_empty() {
                        reader.update(&block.split_to(block.len().min(Self::HASH_SLICE)));
                        tokio::task::yield_now().await;
                    }
                }
                Ok(None) => break,
                Err(StoreError::Missing { .. }) => return Ok(Integrity::Missing),
                Err(error) => return Err(error),
            }
        }
        let size = reader.size;
        Ok(if reader.digest() == *digest { Integrity::Intact(size) } else { Integrity::Damaged })
    }

    /// Reads an artifact to its end and checks its bytes. A damaged artifact is removed.
    pub async fn verify(&self, digest: &Digest) -> Result<Integrity, StoreError> {
        let found = self.read_and_check(digest).await?;
        self.apply_integrity(digest, found).await
    }

    /// Checks only the size of an artifact that was recently stored or read with this size; verifies any other artifact.
    async fn check(&self, digest: &Digest) -> Result<Integrity, StoreError> {
        let seen = self.recent().size(digest);
        match self.size(digest).await? {
            None => Ok(Integrity::Missing),
            Some(size) if seen == Some(size) => Ok(Integrity::Intact(size)),
            Some(_) => self.verify(digest).await,
        }
    }

    /// Returns the remembered result for an artifact that was recently stored or read with this size, without asking the medium;
    /// verifies any other artifact. Another process may have damaged a remembered artifact since.
    pub async fn verify_unless_recent(&self, artifact: &Artifact) -> Result<Integrity, StoreError> {
        let seen = self.recent().size(&artifact.digest);
        match seen {
            Some(bytes) if bytes == artifact.bytes => Ok(Integrity::Intact(bytes)),
            Some(_) | None => self.verify(&artifact.digest).await,
        }
    }

    /// Returns the digests of `digests` that are missing, in their order. Several are checked at the same time. Artifacts that were
    /// not stored or read recently are verified, and removed if they are damaged.
    pub async fn missing(&self, digests: &[Digest]) -> Result<Vec<Digest>, StoreError> {
        let mut missing = Vec::new();
        for some in digests.chunks(Self::MAX_CONCURRENT_CHECKS) {
            let ask = |digest: Digest| {
                let store = self.clone();
                tokio::spawn(async move { store.check(&digest).await })
            };
            let asked: Vec<_> = some.iter().copied().map(ask).collect();
            for (digest, asked) in some.iter().zip(asked) {
                // A check that panicked has no result: the artifact counts as missing.
                match asked.await.unwrap_or(Ok(Integrity::Missing))? {
                    Integrity::Intact(_) => {}
                    Integrity::Damaged | Integrity::Missing => missing.push(*digest),
                }
            }
        }
        Ok(missing)
    }

    /// Applies the result of a reading: remembers a sound artifact, removes a damaged one. The damaged artifact is read again under
    /// the exclusive lock, when no put is in progress, and removed only if it is still damaged. Otherwise a replacement that was
    /// just stored could be removed.
    async fn apply_integrity(&self, digest: &Digest, found: Integrity) -> Result<Integrity, StoreError> {
        match found {
            Integrity::Intact(bytes) => self.recent().insert(Artifact { digest: *digest, bytes }),
            Integrity::Missing => self.recent().remove(digest),
            Integrity::Damaged => {
                // The permit is acquired before the lock: every put waits for the lock, so its owner must not wait for other
                // readers.
                let _reader = self.readers.acquire().await.ok();
                let _alone = self.gate.write().await;
                let again = self.read_and_check_with_permit(digest).await?;
                if again == Integrity::Damaged {
                    self.remove(digest).await?;
                }
                return Ok(again);
            }
        }
        Ok(found)
    }
}

impl ArtifactReader {
    /// Adds the next bytes to the digest.
    pub(crate) fn update(&mut self, bytes: &[u8]) {
        self.hash.update(bytes);
    }

    /// Returns the digest of all bytes so far.
    pub(crate) fn digest(&self) -> Digest {
        Digest::from_bytes(*self.hash.finalize().as_bytes())
    }
}
