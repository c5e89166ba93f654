//! Sends a copy of the log and the names of the artifacts that it refers to.

use bytes::BytesMut;
use femc_model::Artifact;
use femc_service::Backup;
use femc_store::Store;
use tokio::io::AsyncReadExt as _;
use tokio::sync::mpsc;
use tonic::Status;

use super::artifacts::store_status;
use super::collect::referenced_artifacts;
use crate::error::to_status;
use crate::{MAX_PIECE_SIZE, wire};
use wire::backup_reply::Part;

type Sender = mpsc::Sender<Result<wire::BackupReply, Status>>;

/// Largest number of artifacts named in one message.
const MAX_NAMES: usize = 10_000;

/// Sends the names of the artifacts that the store has, then the log, as fast as the client reads.
pub(super) async fn send(store: Store, backup: Backup, out: Sender) {
    if let Err(status) = try_send(&store, backup, &out).await {
        // If the client is gone, the error is not needed.
        let _ = out.send(Err(status)).await;
    }
}

async fn try_send(store: &Store, Backup { log, references }: Backup, out: &Sender) -> Result<(), Status> {
    let digests: Vec<_> =
        referenced_artifacts(store, references).await.map_err(|no| to_status(&no))?.into_iter().collect();
    for some in digests.chunks(MAX_NAMES) {
        let mut artifacts = Vec::new();
        for &digest in some {
            // A missing artifact was merged into others in the meantime, or will be computed again when it is needed.
            let size = store.size(&digest).await.map_err(|error| store_status(&error))?;
            artifacts.extend(size.map(|bytes| wire::Artifact::from(Artifact { digest, bytes })));
        }
        send_part(Part::Artifacts(wire::ArtifactBatch { artifacts }), out).await?;
    }
    let mut log = tokio::fs::File::from_std(log);
    loop {
        let mut piece = BytesMut::with_capacity(MAX_PIECE_SIZE);
        let broken = |error: std::io::Error| Status::unavailable(format!("cannot read the copy of the log: {error}"));
        if log.read_buf(&mut piece).await.map_err(broken)? == 0 {
            return Ok(());
        }
        send_part(Part::Log(piece.freeze()), out).await?;
    }
}

async fn send_part(part: Part, out: &Sender) -> Result<(), Status> {
    let reply = wire::BackupReply { part: Some(part) };
    out.send(Ok(reply)).await.map_err(|_| Status::cancelled("the client is gone"))
}
