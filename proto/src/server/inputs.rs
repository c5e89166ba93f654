//! Checks the store for a job's inputs before the job reaches the scheduler.

use femc_model::{Digest, Manifest, Refusal};
use femc_service::store_refusal;
use femc_store::{Store, StoreError};

use super::promises::Promises;

/// Returns the artifacts that hold a scene, without its manifest.
pub(super) async fn scene_pieces(store: &Store, bundle: &Digest) -> Result<Vec<Digest>, Refusal> {
    let missing = |digest: &Digest| Refusal::MissingArtifacts { digests: vec![*digest], count: 1 };
    let size = store.size(bundle).await.map_err(|error| store_refusal(&error))?.ok_or_else(|| missing(bundle))?;
    if size > Manifest::MAX_BYTES {
        // A bundle of an earlier version, which may be that large.
        return Ok(Vec::new());
    }
    let bytes = store.get(bundle).await.map_err(|error| match error {
        StoreError::Missing { digest } => missing(&digest),
        other => store_refusal(&other),
    })?;
    if !Manifest::is_manifest(&bytes) {
        return Ok(Vec::new());
    }
    let invalid =
        |error: &dyn std::fmt::Display| Refusal::Invalid { field: "bundle".into(), message: error.to_string() };
    let manifest = Manifest::decode(&bytes).map_err(|error| invalid(&error))?;
    Ok(manifest.pieces.iter().map(|piece| piece.artifact.digest).collect())
}

/// Refuses a job whose scene is incomplete. The scene's artifacts are protected from collection for a while.
pub(super) async fn check_scene(store: &Store, promises: &Promises, bundle: &Digest) -> Result<(), Refusal> {
    promises.record(&[*bundle]).await;
    let pieces = scene_pieces(store, bundle).await?;
    promises.record(&pieces).await;
    let mut missing = store.missing(&pieces).await.map_err(|error| store_refusal(&error))?;
    if missing.is_empty() {
        return Ok(());
    }
    let count = missing.len() as u64;
    missing.truncate(Refusal::MAX_NAMED);
    Err(Refusal::MissingArtifacts { digests: missing, count })
}
