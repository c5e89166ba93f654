//! Upload, download and garbage collection of artifacts. An interrupted transfer resumes by itself as long as it makes progress.

use std::collections::BTreeSet;
use std::time::Duration;

use bytes::{Bytes, BytesMut};
use femc_model::{Artifact, Digest, Refusal};
use tokio::time::Instant;

use crate::client::Client;
use crate::convert::{digest_bytes, required};
use crate::error::CallError;
use crate::server::{CollectMode, CollectReport};
use crate::{MAX_PIECE_SIZE, wire};
use wire::offer_reply::Answer;
use wire::put_request::Part;

/// Direction of a transfer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Direction {
    /// To the store.
    Up,
    /// From the store.
    Down,
}

/// Retry state of a transfer; limits the time without progress.
struct RetryState {
    direction: Direction,
    reached: u64,
    /// Time of the first failure since the last progress.
    failing_since: Option<Instant>,
    pause: Duration,
}

impl RetryState {
    const MAX_STALL: Duration = Duration::from_secs(10);
    const FIRST_PAUSE: Duration = Duration::from_millis(50);
    const MAX_PAUSE: Duration = Duration::from_secs(2);

    fn new(direction: Direction) -> Self {
        Self { direction, reached: 0, failing_since: None, pause: Self::FIRST_PAUSE }
    }

    fn advance_to(&mut self, offset: u64) {
        if offset > self.reached {
            *self = Self { reached: offset, ..Self::new(self.direction) };
        }
    }

    /// Waits before a retry. Returns the error if a retry makes no sense or the time is over.
    async fn wait_before_retry(&mut self, error: CallError) -> Result<(), CallError> {
        let makes_sense = match &error {
            CallError::Unreachable { .. } | CallError::Refused(Refusal::Resume { .. }) => true,
            // The part stored by an earlier sender had wrong bytes. The server has dropped it, so a retry can succeed.
            CallError::Refused(Refusal::DigestMismatch { .. }) => self.direction == Direction::Up && self.reached > 0,
            CallError::Refused(_)
            | CallError::Address { .. }
            | CallError::NoIdentity { .. }
            | CallError::InsecureToken { .. }
            | CallError::NoAuthority { .. }
            | CallError::Answer(_)
            | CallError::Status { .. } => false,
        };
        if let CallError::Refused(Refusal::Resume { offset }) = &error {
            // Another sender has made progress with the upload.
            self.advance_to(*offset);
        }
        let since = *self.failing_since.get_or_insert_with(Instant::now);
        if !makes_sense || since.elapsed() + self.pause > Self::MAX_STALL {
            return Err(error);
        }
        tracing::debug!(%error, reached = self.reached, "a transfer was interrupted and will resume");
        tokio::time::sleep(self.pause).await;
        self.pause = (2 * self.pause).min(Self::MAX_PAUSE);
        Ok(())
    }
}

impl Client {
    /// Uploads an artifact to the coordinator's store unless it is there.
    pub async fn put(&self, bytes: Bytes) -> Result<Artifact, CallError> {
        let artifact = Artifact::from_bytes(&bytes);
        let mut retry = RetryState::new(Direction::Up);
        loop {
            match self.upload_once(&artifact, &bytes, &mut retry).await {
                Ok(()) => return Ok(artifact),
                Err(error) => retry.wait_before_retry(error).await?,
            }
        }
    }

    /// Uploads those of `all` that are not in the store; returns their total size in bytes.
    pub async fn put_all(&self, all: &[Bytes]) -> Result<u64, CallError> {
        let digests: Vec<Digest> = all.iter().map(|bytes| Digest::compute(bytes)).collect();
        let mut missing: BTreeSet<Digest> = self.missing(&digests).await?.into_iter().collect();
        let mut sent = 0;
        for (digest, bytes) in digests.iter().zip(all) {
            if missing.remove(digest) {
                self.put(bytes.clone()).await?;
                sent += bytes.len() as u64;
            }
        }
        Ok(sent)
    }

    async fn upload_once(&self, artifact: &Artifact, bytes: &Bytes, retry: &mut RetryState) -> Result<(), CallError> {
        let digest = digest_bytes(&artifact.digest);
        let offer = wire::OfferRequest { digest: digest.clone() };
        let reply = self.artifacts().offer(offer).await.map_err(|status| self.call_error(&status))?;
        let from = match required("offer.answer", reply.into_inner().answer)? {
            Answer::There(_) => return Ok(()),
            // The stored part is longer than the artifact, so an earlier sender had other bytes. Begin at 0.
            Answer::From(from) if from > artifact.bytes => 0,
            Answer::From(from) => from,
        };
        retry.advance_to(from);
        let head = wire::PutRequest { part: Some(Part::Digest(digest)), offset: from };
        let pieces = (from as usize..bytes.len()).step_by(MAX_PIECE_SIZE).map({
            let bytes = bytes.clone();
            move |at| Part::Piece(bytes.slice(at..bytes.len().min(at + MAX_PIECE_SIZE)))
        });
        let pieces = pieces.map(|part| wire::PutRequest { part: Some(part), offset: 0 });
        let parts = tokio_stream::iter(std::iter::once(head).chain(pieces));
        let reply = self.artifacts().put(parts).await.map_err(|status| self.call_error(&status))?;
        let stored: Artifact = required("put.artifact", reply.into_inner().artifact)?.try_into()?;
        if stored == *artifact { Ok(()) } else { Err(Refusal::DigestMismatch { digest: artifact.digest }.into()) }
    }

    /// Downloads an artifact and checks its digest. Fails beyond `limit` bytes.
    pub async fn get(&self, name: &Digest, limit: u64) -> Result<Bytes, CallError> {
        self.download(name, None, limit).await
    }

    /// Downloads an artifact like [`Self::get`] when its size is known. Another size counts as damage.
    pub async fn get_exactly(&self, artifact: &Artifact) -> Result<Bytes, CallError> {
        let Artifact { digest, bytes } = artifact;
        match self.download(digest, Some(*bytes), *bytes).await {
            Err(CallError::Refused(Refusal::ArtifactTooLarge { .. })) => {
                Err(Refusal::DigestMismatch { digest: *digest }.into())
            }
            other => other,
        }
    }

    async fn download(&self, name: &Digest, size: Option<u64>, limit: u64) -> Result<Bytes, CallError> {
        let (mut bytes, mut patience) = (BytesMut::new(), RetryState::new(Direction::Down));
        while let Err(error) = self.download_rest(name, size, limit, &mut bytes).await {
            patience.advance_to(bytes.len() as u64);
            patience.wait_before_retry(error).await?;
        }
        let is_as_long = size.is_none_or(|size| size == bytes.len() as u64);
        if !is_as_long || Digest::compute(&bytes) != *name {
            return Err(Refusal::DigestMismatch { digest: *name }.into());
        }
        Ok(bytes.freeze())
    }

    /// Downloads the bytes that are still missing.
    async fn download_rest(
        &self,
        name: &Digest,
        size: Option<u64>,
        limit: u64,
        bytes: &mut BytesMut,
    ) -> Result<(), CallError> {
        let request = wire::GetRequest { digest: digest_bytes(name), offset: bytes.len() as u64, bytes: size };
        let reply = self.artifacts().get(request).await.map_err(|status| self.call_error(&status))?;
        let mut stream = reply.into_inner();
        while let Some(reply) = stream.message().await.map_err(|status| self.call_error(&status))? {
            if bytes.len() as u64 + reply.piece.len() as u64 > limit {
                return Err(Refusal::ArtifactTooLarge { limit }.into());
            }
            bytes.extend_from_slice(&reply.piece);
        }
        Ok(())
    }

    /// Collects garbage: removes artifacts that no job refers to and that are older than `grace`, or only counts them.
    pub async fn collect(&self, mode: CollectMode, grace: Duration) -> Result<CollectReport, CallError> {
        let grace = u64::try_from(grace.as_millis()).unwrap_or(u64::MAX);
        let request = wire::CollectRequest { mode: wire::CollectMode::from(mode).into(), grace };
        let reply = self.artifacts().collect(request).await.map_err(|status| self.call_error(&status))?;
        Ok(reply.into_inner().try_into()?)
    }
}

#[cfg(test)]
mod tests;
