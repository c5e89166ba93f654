//! Garbage collection: removes artifacts from the store that no job refers to.
//!
//! The collection lists the store first, then asks the jobs for the artifacts that they refer to. It removes an artifact that is
//! not referenced, not young and not promised to a client. So it never removes an artifact that a running submission was told is in
//! the store. If the submission takes longer than the grace period, it is refused with the names of the missing artifacts and
//! uploads them again.

use std::collections::BTreeSet;
use std::time::{Duration, SystemTime};

use femc_model::{Artifact, Digest, Refusal};
use femc_service::{References, store_refusal};
use femc_store::{Store, StoredArtifact, Sweep};
use tokio::task::JoinSet;

use super::promises::Promises;
use super::{Call, Server, inputs};

/// Mode of a garbage collection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CollectMode {
    /// Only counts the garbage.
    DryRun,
    /// Removes the garbage.
    Remove,
}

/// Number and size of a set of artifacts.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ArtifactTotals {
    /// Number of artifacts.
    pub artifacts: u64,
    /// Total size in bytes.
    pub bytes: u64,
}

impl ArtifactTotals {
    fn add(&mut self, artifact: &Artifact) {
        self.artifacts += 1;
        self.bytes += artifact.bytes;
    }
}

/// Contents of a store, as a collection classifies them.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct CollectReport {
    /// Artifacts that some job refers to.
    pub referenced: ArtifactTotals,
    /// Unreferenced artifacts that are younger than the grace period, or that a client was recently told are in the store.
    pub young: ArtifactTotals,
    /// Artifacts removed or, in a dry run, to be removed. Includes the files of unfinished uploads.
    pub garbage: ArtifactTotals,
    /// Names of the first artifacts of the garbage.
    pub names: Vec<Artifact>,
}

/// Shortest allowed grace period. A result's artifacts must be recorded in the log within it.
pub const MIN_GRACE: Duration = Duration::from_secs(60);
/// Largest number of artifacts named in an answer.
const MAX_NAMES: usize = 10_000;
/// Number of artifacts removed in one step. Uploads wait during a step.
const REMOVAL_BATCH: usize = 64;

pub(super) async fn collect(server: &Server, mode: CollectMode, grace: Duration) -> Result<CollectReport, Refusal> {
    if grace < MIN_GRACE {
        let message = format!("must be at least {} s, or results in transit would be lost", MIN_GRACE.as_secs());
        return Err(Refusal::Invalid { field: "grace".into(), message });
    }
    let busy = |message: String| Refusal::Unavailable { message };
    let _alone = server.collection_lock.try_lock().map_err(|_| busy("another garbage collection is running".into()))?;
    if let Some(wait) = server.promises.overflow_remaining() {
        let minutes = wait.as_secs() / 60 + 1;
        return Err(busy(format!("too many recent uploads to identify garbage; try again in {minutes} min")));
    }
    let listing = server.store.listing().await.map_err(|error| store_refusal(&error))?;
    let references = server.call_raw(|reply| Call::References { reply }).await?;
    let references = referenced_artifacts(&server.store, references).await?;
    let now = SystemTime::now();
    let (mut report, mut old) = (CollectReport::default(), Vec::new());
    for StoredArtifact { artifact, last_modified: kept } in listing {
        let is_old = now.duration_since(kept).is_ok_and(|age| age >= grace);
        if references.contains(&artifact.digest) {
            report.referenced.add(&artifact);
        } else if is_old {
            old.push(artifact);
        } else {
            report.young.add(&artifact);
        }
    }
    for some in old.chunks(REMOVAL_BATCH) {
        let _closed = server.promises.block_recording().await;
        let (young, garbage): (Vec<Artifact>, Vec<Artifact>) =
            some.iter().partition(|artifact| server.promises.is_promised(&artifact.digest, grace));
        young.iter().for_each(|artifact| report.young.add(artifact));
        if mode == CollectMode::Remove {
            remove_artifacts(server, &garbage).await?;
        }
        for artifact in garbage {
            report.garbage.add(&artifact);
            if report.names.len() < MAX_NAMES {
                report.names.push(artifact);
            }
        }
    }
    let sweep = match mode {
        CollectMode::DryRun => Sweep::Count,
        CollectMode::Remove => Sweep::Remove,
    };
    // An interrupted upload may resume for a while, no matter how short the grace period is.
    let idle = grace.max(Promises::DURATION);
    let (uploads, bytes) = server.store.sweep_uploads(idle, sweep).await.map_err(|error| store_refusal(&error))?;
    report.garbage.artifacts += uploads;
    report.garbage.bytes += bytes;
    Ok(report)
}

/// Returns all artifacts that jobs refer to, directly or through their scenes.
pub(super) async fn referenced_artifacts(
    store: &Store,
    References { mut artifacts, scenes }: References,
) -> Result<BTreeSet<Digest>, Refusal> {
    for scene in scenes {
        match inputs::scene_pieces(store, &scene).await {
            Ok(pieces) => artifacts.extend(pieces),
            // The pieces of a lost or invalid scene are unknown, and it cannot be rendered anyway.
            Err(Refusal::MissingArtifacts { .. } | Refusal::Invalid { .. }) => {
                tracing::warn!(%scene, "the scene of a job is lost");
            }
            Err(other) => return Err(other),
        }
    }
    Ok(artifacts)
}

async fn remove_artifacts(server: &Server, garbage: &[Artifact]) -> Result<(), Refusal> {
    let mut removals = JoinSet::new();
    for artifact in garbage {
        let (store, digest) = (server.store.clone(), artifact.digest);
        removals.spawn(async move { store.remove(&digest).await });
    }
    while let Some(removed) = removals.join_next().await {
        removed.unwrap_or(Ok(())).map_err(|error| store_refusal(&error))?;
    }
    Ok(())
}
