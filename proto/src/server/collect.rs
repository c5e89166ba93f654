//! Removing from the store what no job refers to.
//!
//! The store is listed first, then the jobs are asked what they name; what is neither named nor young nor promised to
//! somebody goes. So nothing goes that a submission under way has been told is there; should it be too slow for the grace
//! period, it is refused by name and uploads again.

use std::collections::BTreeSet;
use std::time::{Duration, SystemTime};

use femc_model::{Artifact, Digest, Refusal};
use femc_service::{References, store_refusal};
use femc_store::{Store, Stored, Sweep};
use tokio::task::JoinSet;

use super::promised::Promised;
use super::{Call, Server, inputs};

/// What a collection does with garbage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CollectMode {
    /// Only counts it.
    DryRun,
    /// Removes it.
    Remove,
}

/// Artifacts, counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Volume {
    /// Number of artifacts.
    pub artifacts: u64,
    /// Their bytes.
    pub bytes: u64,
}

impl Volume {
    fn add(&mut self, artifact: &Artifact) {
        self.artifacts += 1;
        self.bytes += artifact.bytes;
    }
}

/// What a store holds.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Collected {
    /// Some job refers to these.
    pub referenced: Volume,
    /// Nobody does, but they are younger than the grace period, or somebody was told lately that they are there.
    pub young: Volume,
    /// Removed, or in a dry run: would be. Also files of uploads that nobody finished.
    pub garbage: Volume,
    /// The first of the garbage.
    pub names: Vec<Artifact>,
}

/// Shortest grace period: a result's artifacts must have reached the log within it.
pub const LEAST_GRACE: Duration = Duration::from_secs(60);
/// Most artifacts that an answer names.
const NAMES: usize = 10_000;
/// Artifacts that are removed at a time; meanwhile uploads wait.
const AT_ONCE: usize = 64;

pub(super) async fn collect(server: &Server, mode: CollectMode, grace: Duration) -> Result<Collected, Refusal> {
    if grace < LEAST_GRACE {
        let message = format!("at least {} s: results on their way would be lost", LEAST_GRACE.as_secs());
        return Err(Refusal::Invalid { field: "grace".into(), message });
    }
    let busy = |message: String| Refusal::Unavailable { message };
    let _alone = server.collecting.try_lock().map_err(|_| busy("another collection of garbage is under way".into()))?;
    if let Some(wait) = server.promised.is_blind_for() {
        let minutes = wait.as_secs() / 60 + 1;
        return Err(busy(format!("too much has been uploaded lately to tell garbage; try again in {minutes} min")));
    }
    let listing = server.store.listing().await.map_err(|error| store_refusal(&error))?;
    let references = server.question(|reply| Call::References { reply }).await?;
    let references = named(&server.store, references).await?;
    let now = SystemTime::now();
    let (mut collected, mut old) = (Collected::default(), Vec::new());
    for Stored { artifact, kept } in listing {
        let is_old = now.duration_since(kept).is_ok_and(|age| age >= grace);
        if references.contains(&artifact.digest) {
            collected.referenced.add(&artifact);
        } else if is_old {
            old.push(artifact);
        } else {
            collected.young.add(&artifact);
        }
    }
    for some in old.chunks(AT_ONCE) {
        let _closed = server.promised.close().await;
        let (young, garbage): (Vec<Artifact>, Vec<Artifact>) =
            some.iter().partition(|artifact| server.promised.holds(&artifact.digest, grace));
        young.iter().for_each(|artifact| collected.young.add(artifact));
        if mode == CollectMode::Remove {
            remove(server, &garbage).await?;
        }
        for artifact in garbage {
            collected.garbage.add(&artifact);
            if collected.names.len() < NAMES {
                collected.names.push(artifact);
            }
        }
    }
    let sweep = match mode {
        CollectMode::DryRun => Sweep::Count,
        CollectMode::Remove => Sweep::Remove,
    };
    // An upload that was cut may go on for a while, however short the grace period.
    let idle = grace.max(Promised::HOLDS);
    let (uploads, bytes) = server.store.sweep_uploads(idle, sweep).await.map_err(|error| store_refusal(&error))?;
    collected.garbage.artifacts += uploads;
    collected.garbage.bytes += bytes;
    Ok(collected)
}

/// All that jobs name, also through their scenes.
pub(super) async fn named(
    store: &Store,
    References { mut artifacts, scenes }: References,
) -> Result<BTreeSet<Digest>, Refusal> {
    for scene in scenes {
        match inputs::pieces(store, &scene).await {
            Ok(pieces) => artifacts.extend(pieces),
            // Of a scene that is lost or no scene nothing is known, and nothing can be rendered.
            Err(Refusal::MissingArtifacts { .. } | Refusal::Invalid { .. }) => {
                tracing::warn!(%scene, "the scene of a job is lost");
            }
            Err(other) => return Err(other),
        }
    }
    Ok(artifacts)
}

async fn remove(server: &Server, garbage: &[Artifact]) -> Result<(), Refusal> {
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
