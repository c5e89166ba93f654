//! Bytes that are not those of their name any more: found by reading, and removed, so that they can be put again.
//!
//! A disk may lose the end of a file, or change a bit of it, long after it has said that the file is safe. Whoever reads an
//! artifact finds out; whoever only asks whether it is there does not. So what is about to be relied on, because somebody
//! would else send it or make it, is read first: the reading costs less than the sending.

use bytes::Bytes;
use femc_model::{Artifact, Digest};
use object_store::ObjectStoreExt as _;

use crate::{Store, StoreError, place};

/// What reading an artifact came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Soundness {
    /// It is there, whole, with so many bytes.
    Sound(u64),
    /// It was there with other bytes than its own; it is removed.
    Damaged,
    /// It is not there.
    Missing,
}

/// Reads an artifact to its end, and what its bytes' digest is.
pub(crate) struct Reading {
    hash: blake3::Hasher,
    size: u64,
    at: u64,
}

impl Store {
    /// Begins to read.
    pub(crate) async fn begin(&self, digest: &Digest) -> Result<Reading, StoreError> {
        let size = self.size(digest).await?.ok_or(StoreError::Missing { digest: *digest })?;
        Ok(Reading { hash: blake3::Hasher::new(), size, at: 0 })
    }

    /// The next block; `None` at the end.
    pub(crate) async fn next(&self, digest: &Digest, reading: &mut Reading) -> Result<Option<Bytes>, StoreError> {
        if reading.at >= reading.size {
            return Ok(None);
        }
        let end = reading.size.min(reading.at + Self::READ);
        let block = match self.objects.get_range(&place(digest), reading.at..end).await {
            Err(object_store::Error::NotFound { .. }) => return Err(StoreError::Missing { digest: *digest }),
            other => other.map_err(|error| self.medium(error))?,
        };
        reading.at = end;
        Ok(Some(block))
    }

    /// Reads it when fewer than so many are read: whether its bytes are its own.
    async fn look(&self, digest: &Digest) -> Result<Soundness, StoreError> {
        // It is never closed.
        let _reader = self.readers.acquire().await.ok();
        self.look_now(digest).await
    }

    /// The same of who has the permit to.
    async fn look_now(&self, digest: &Digest) -> Result<Soundness, StoreError> {
        let mut reading = match self.begin(digest).await {
            Err(StoreError::Missing { .. }) => return Ok(Soundness::Missing),
            other => other?,
        };
        loop {
            match self.next(digest, &mut reading).await {
                Ok(Some(mut block)) => {
                    while !block.is_empty() {
                        reading.take(&block.split_to(block.len().min(Self::BITE)));
                        tokio::task::yield_now().await;
                    }
                }
                Ok(None) => break,
                Err(StoreError::Missing { .. }) => return Ok(Soundness::Missing),
                Err(error) => return Err(error),
            }
        }
        let size = reading.size;
        Ok(if reading.digest() == *digest { Soundness::Sound(size) } else { Soundness::Damaged })
    }

    /// Reads it to its end. One that is damaged is removed.
    pub async fn verify(&self, digest: &Digest) -> Result<Soundness, StoreError> {
        let found = self.look(digest).await?;
        self.conclude(digest, found).await
    }

    /// The same by its size alone, if it came in or was read lately.
    async fn check(&self, digest: &Digest) -> Result<Soundness, StoreError> {
        let seen = self.seen().size(digest);
        match self.size(digest).await? {
            None => Ok(Soundness::Missing),
            Some(size) if seen == Some(size) => Ok(Soundness::Sound(size)),
            Some(_) => self.verify(digest).await,
        }
    }

    /// The same from memory alone, if it came in or was read lately with so many bytes: somebody else may have harmed it since.
    pub async fn known(&self, artifact: &Artifact) -> Result<Soundness, StoreError> {
        let seen = self.seen().size(&artifact.digest);
        match seen {
            Some(bytes) if bytes == artifact.bytes => Ok(Soundness::Sound(bytes)),
            Some(_) | None => self.verify(&artifact.digest).await,
        }
    }

    /// Those of `digests` that are not there, in their order; asks for several at once. What did not come in lately is read, and
    /// removed if it is damaged.
    pub async fn missing(&self, digests: &[Digest]) -> Result<Vec<Digest>, StoreError> {
        let mut missing = Vec::new();
        for some in digests.chunks(Self::AT_ONCE) {
            let ask = |digest: Digest| {
                let store = self.clone();
                tokio::spawn(async move { store.check(&digest).await })
            };
            let asked: Vec<_> = some.iter().copied().map(ask).collect();
            for (digest, asked) in some.iter().zip(asked) {
                // One that panicked knows nothing.
                match asked.await.unwrap_or(Ok(Soundness::Missing))? {
                    Soundness::Sound(_) => {}
                    Soundness::Damaged | Soundness::Missing => missing.push(*digest),
                }
            }
        }
        Ok(missing)
    }

    /// What reading has found: remembered, or removed. Only what is damaged still while nothing is put is removed: else the
    /// bytes might go that somebody has just put there in its place.
    async fn conclude(&self, digest: &Digest, found: Soundness) -> Result<Soundness, StoreError> {
        match found {
            Soundness::Sound(bytes) => self.seen().note(Artifact { digest: *digest, bytes }),
            Soundness::Missing => self.seen().forget(digest),
            Soundness::Damaged => {
                // In this order: who holds the gate waits for no other reading, while every put waits for it.
                let _reader = self.readers.acquire().await.ok();
                let _alone = self.gate.write().await;
                let again = self.look_now(digest).await?;
                if again == Soundness::Damaged {
                    self.remove(digest).await?;
                }
                return Ok(again);
            }
        }
        Ok(found)
    }
}

impl Reading {
    /// Takes in the next bytes.
    pub(crate) fn take(&mut self, bytes: &[u8]) {
        self.hash.update(bytes);
    }

    /// Of all bytes that were taken in.
    pub(crate) fn digest(&self) -> Digest {
        Digest::from_bytes(*self.hash.finalize().as_bytes())
    }
}
