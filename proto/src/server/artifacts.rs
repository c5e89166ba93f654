//! The service `Artifacts`. It uses the store directly, without the scheduler.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use femc_fault::{Point, pass_point_async};
use femc_model::{Artifact, Digest, Refusal};
use femc_service::{CallerKey, TransferSlot, store_refusal};
use femc_store::{Integrity, Novelty, StoreError};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tokio_stream::{Stream, StreamExt as _};
use tonic::{Request, Response, Status, Streaming};

use super::uploads::UploadAdmission;
use super::{Server, audit_entry, collect};
use crate::convert::{self, digest_bytes, parse_digest, required};
use crate::error::to_status;
use crate::{MAX_PIECE_SIZE, wire};
use wire::put_request::Part;

/// Largest number of digests in one request.
const MAX_DIGESTS: usize = 1 << 16;

#[tonic::async_trait]
impl wire::artifacts_server::Artifacts for Server {
    async fn missing(&self, request: Request<wire::MissingRequest>) -> Result<Response<wire::MissingReply>, Status> {
        let caller_key = request.extensions().get::<CallerKey>().cloned().unwrap_or_default();
        let requested = request.into_inner().digests;
        if requested.len() > MAX_DIGESTS {
            return Err(to_status(&Refusal::TooLarge { what: "digests".into(), limit: MAX_DIGESTS as u64 }));
        }
        let digests = requested.iter().map(|bytes| parse_digest("digest", bytes)).collect::<Result<Vec<_>, _>>()?;
        self.promises.record(&digests).await;
        // The store may read the artifacts, which takes a place. Clients send an empty request as a greeting.
        let _slot = if digests.is_empty() { None } else { Some(self.transfer_slots.acquire(caller_key).await) };
        let missing = self.store.missing(&digests).await.map_err(|error| store_status(&error))?;
        let digests = missing.iter().map(digest_bytes).collect();
        Ok(Response::new(wire::MissingReply { digests }))
    }

    async fn offer(&self, request: Request<wire::OfferRequest>) -> Result<Response<wire::OfferReply>, Status> {
        use wire::offer_reply::Answer;
        let caller_key = request.extensions().get::<CallerKey>().cloned().unwrap_or_default();
        let name = parse_digest("digest", &request.into_inner().digest)?;
        self.promises.record(&[name]).await;
        // Wait for an upload that is being finished before asking the store.
        let from = self.uploads.wanted_offset(&name).await;
        let found = self.verified_size(&name, caller_key).await.map_err(|error| store_status(&error))?;
        let answer = if found.is_some() { Answer::There(wire::Empty {}) } else { Answer::From(from) };
        Ok(Response::new(wire::OfferReply { answer: Some(answer) }))
    }

    async fn put(&self, request: Request<Streaming<wire::PutRequest>>) -> Result<Response<wire::PutReply>, Status> {
        let caller_key = request.extensions().get::<CallerKey>().cloned().unwrap_or_default();
        let slot = self.transfer_slots.acquire(caller_key).await;
        // Use a separate task, so that all received bytes of an upload are processed even if the sender is gone.
        let put = tokio::spawn(receive_upload(self.clone(), slot, request.into_inner()));
        let artifact = put.await.map_err(|error| Status::internal(error.to_string()))??;
        Ok(Response::new(wire::PutReply { artifact: Some(artifact.into()) }))
    }

    async fn collect(&self, request: Request<wire::CollectRequest>) -> Result<Response<wire::CollectReply>, Status> {
        let trail = audit_entry(&request);
        let request = request.into_inner();
        let mode = convert::collect_mode(request.mode)?;
        trail.set_action(&format!("{mode:?}"));
        let collected = collect::collect(self, mode, Duration::from_millis(request.grace)).await;
        Ok(Response::new(collected.map_err(|no| to_status(&no))?.into()))
    }

    type GetStream = Pin<Box<dyn Stream<Item = Result<wire::GetReply, Status>> + Send>>;

    async fn get(&self, request: Request<wire::GetRequest>) -> Result<Response<Self::GetStream>, Status> {
        let caller_key = request.extensions().get::<CallerKey>().cloned().unwrap_or_default();
        let wire::GetRequest { digest: name, offset, bytes } = request.into_inner();
        let name = parse_digest("digest", &name)?;
        let mut found = self.store.size(&name).await.map_err(|error| store_status(&error))?;
        let is_other = |found: Option<u64>| found.is_some() && bytes.is_some() && found != bytes;
        if is_other(found) {
            found = self.verified_size(&name, caller_key.clone()).await.map_err(|error| store_status(&error))?;
        }
        if found.is_none() {
            self.farm.report_lost(name).await;
            return Err(to_status(&Refusal::NoSuchArtifact { digest: name }));
        }
        if is_other(found) {
            // The store is not at fault: the caller expects another artifact.
            return Err(to_status(&Refusal::DigestMismatch { digest: name }));
        }
        let slot = Arc::new(self.transfer_slots.acquire(caller_key).await);
        let (server, reading) = (self.clone(), slot.clone());
        let (send, receive) = mpsc::channel::<Result<Bytes, StoreError>>(1);
        tokio::spawn(async move {
            let _held = reading;
            if let Err(error) = server.store.read(&name, offset, MAX_PIECE_SIZE, &send).await {
                let is_bad = matches!(error, StoreError::Mismatch { .. } | StoreError::Missing { .. });
                // The stored artifact may be sound: it was damaged on the way, or it was uploaded again meanwhile.
                if is_bad && matches!(server.store.has(&name).await, Ok(false)) {
                    server.farm.report_lost(name).await;
                }
                let _ = send.send(Err(error)).await;
            }
        });
        let sent = self.traffic.sent.clone();
        let replies = ReceiverStream::new(receive).map(move |piece| {
            // Hold the place until the last byte is read or the reader is gone.
            let _held = &slot;
            sent.add(piece.as_ref().map_or(0, |piece| piece.len() as u64));
            piece.map(|piece| wire::GetReply { piece }).map_err(|error| store_status(&error))
        });
        Ok(Response::new(Box::pin(replies)))
    }
}

impl Server {
    /// Returns the size of an artifact if the store has it undamaged. Verification reads the artifact, which takes a place.
    async fn verified_size(&self, name: &Digest, caller_key: CallerKey) -> Result<Option<u64>, StoreError> {
        if !self.store.has(name).await? {
            return Ok(None);
        }
        let _slot = self.transfer_slots.acquire(caller_key).await;
        Ok(match self.store.verify(name).await? {
            Integrity::Intact(bytes) => Some(bytes),
            Integrity::Damaged | Integrity::Missing => None,
        })
    }
}

async fn receive_upload(
    server: Server,
    _slot: TransferSlot,
    mut parts: Streaming<wire::PutRequest>,
) -> Result<Artifact, Status> {
    let first = required("digest", parts.message().await?)?;
    let Part::Digest(announced) = required("digest", first.part)? else {
        return Err(Status::invalid_argument("an upload must begin with the digest"));
    };
    let announced = parse_digest("digest", &announced)?;
    server.promises.record(&[announced]).await;
    let mut upload = match server.uploads.begin_or_resume(&server.store, announced, first.offset).await {
        Ok(UploadAdmission::Granted(upload)) => upload,
        // The sender can stop.
        Ok(UploadAdmission::AlreadyStored(artifact)) => return Ok(artifact),
        Err(no) => return Err(to_status(&no)),
    };
    while let Some(part) = parts.message().await? {
        let Part::Piece(piece) = required("piece", part.part)? else {
            return Err(Status::invalid_argument("an upload must have only one digest"));
        };
        pass_point_async(Point::CoordinatorMidUpload).await;
        server.traffic.received.add(piece.len() as u64);
        if let Some(artifact) = upload.write(&piece).await.map_err(|no| to_status(&no))? {
            return Ok(artifact);
        }
    }
    // Note it again: the upload may have taken long, and an artifact that was stored before keeps its old time.
    server.promises.record(&[announced]).await;
    let (artifact, novelty) = upload.finish().await.map_err(|no| to_status(&no))?;
    if novelty == Novelty::New {
        // A new artifact is young, which protects it from collection.
        server.promises.remove(&announced);
    }
    Ok(artifact)
}

pub(super) fn store_status(error: &StoreError) -> Status {
    to_status(&store_refusal(error))
}
