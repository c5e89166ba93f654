//! Inputs for the threads that compute: blocking downloads, the translation of failed calls into task failures, and the pool that
//! prepares scenes and frames.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use bytes::Bytes;
use femc_model::{Artifact, Digest, Failure, Manifest, Refusal};
use femc_proto::{CallError, Client};
use rayon::ThreadPool;
use tokio::runtime::Handle;
use tracing::Span;

use crate::meter::Activity;
use crate::task_table::Task;

/// Largest size in bytes of the artifact that a job's `bundle` names: a manifest or, from an earlier version, a whole scene.
const BUNDLE: u64 = 1 << 30;

/// Translates a failed call into a task failure.
pub(crate) fn call_failure(error: &CallError) -> Failure {
    let message = error.to_string();
    match error {
        CallError::Refused(Refusal::NoSuchArtifact { digest } | Refusal::DigestMismatch { digest }) => {
            Failure::LostInputs { digests: vec![*digest], message }
        }
        CallError::Refused(Refusal::ArtifactTooLarge { limit }) => Failure::TooLarge { limit: *limit },
        CallError::Refused(_)
        | CallError::Address { .. }
        | CallError::NoIdentity { .. }
        | CallError::InsecureToken { .. }
        | CallError::NoAuthority { .. }
        | CallError::Unreachable { .. }
        | CallError::Answer(_)
        | CallError::Status { .. } => Failure::Store { message },
    }
}

/// Access to a task's inputs.
#[derive(Debug, Clone)]
pub(crate) struct Fetcher {
    mode: FetchMode,
    /// Threads that prepare scenes and frames. Each hand has its own pool. A cancelled task that builds a large tree keeps its pool
    /// busy after its hand is abandoned, and the next task must not wait for that.
    pool: Arc<ThreadPool>,
    /// Task that reads these inputs.
    task: Option<Arc<Task>>,
}

#[derive(Debug, Clone)]
enum FetchMode {
    /// Downloads on demand, for a thread outside of the runtime.
    Blocking(Handle),
    /// Inputs that are all downloaded already.
    Prefetched(Arc<BTreeMap<Digest, Result<Bytes, Failure>>>),
}

impl Fetcher {
    /// Creates an access that downloads on demand on this runtime and prepares frames on `pool`.
    pub(crate) fn blocking(runtime: Handle, pool: Arc<ThreadPool>) -> Self {
        Self { mode: FetchMode::Blocking(runtime), pool, task: None }
    }

    /// Returns a copy that prepares frames on `pool`.
    pub(crate) fn with_pool(&self, pool: Arc<ThreadPool>) -> Self {
        Self { pool, ..self.clone() }
    }

    /// Returns the threads that prepare frames.
    pub(crate) fn pool(&self) -> &Arc<ThreadPool> {
        &self.pool
    }

    /// Returns a copy that charges its downloads to `task`.
    pub(crate) fn for_task(&self, task: &Arc<Task>) -> Self {
        Self { task: Some(task.clone()), ..self.clone() }
    }

    /// Adds downloaded bytes to the task's account.
    fn count(&self, bytes: usize) {
        if let Some(task) = &self.task {
            task.account.fetched.fetch_add(bytes as u64, Ordering::Relaxed);
        }
    }

    /// Runs `work` on the pool. Outside of a pool, rayon would start one of its own with all the machine's threads.
    pub(crate) fn prepare<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        let Some(task) = self.task.as_ref().filter(|task| task.is_begun()) else { return self.pool.install(work) };
        let span = Span::current();
        task.account.set_activity(Activity::Waiting);
        self.pool.install(|| {
            task.account.set_activity(Activity::Computing);
            span.in_scope(|| task.log.record_during(work))
        })
    }

    /// Blocks on `work`, which waits for the network.
    fn wait<T>(&self, runtime: &Handle, work: impl Future<Output = T>) -> T {
        match &self.task {
            Some(task) if task.is_begun() => task.account.transfer(|| runtime.block_on(work)),
            Some(_) | None => runtime.block_on(work),
        }
    }

    /// Returns a scene's manifest or, for a job from an earlier version, the scene itself.
    pub(crate) fn manifest_or_scene(&self, client: &Client, digest: &Digest) -> Result<Bytes, Failure> {
        match &self.mode {
            FetchMode::Blocking(runtime) => {
                let bytes = self.wait(runtime, client.get(digest, BUNDLE)).map_err(|error| call_failure(&error));
                bytes.inspect(|bytes| self.count(bytes.len()))
            }
            FetchMode::Prefetched(inputs) => prefetched_input(inputs, digest),
        }
    }

    /// Downloads all of `artifacts` in parallel and returns them in their order. Each one is present, lost or unavailable.
    pub(crate) fn fetch_all(&self, client: &Client, artifacts: &[Artifact]) -> Vec<Result<Bytes, Failure>> {
        match &self.mode {
            FetchMode::Blocking(runtime) => {
                let all = self.wait(runtime, download_all(client, artifacts));
                all.iter().flatten().for_each(|bytes| self.count(bytes.len()));
                all
            }
            FetchMode::Prefetched(inputs) => {
                artifacts.iter().map(|artifact| prefetched_input(inputs, &artifact.digest)).collect()
            }
        }
    }

    /// Downloads all inputs of a task before it begins, even those that are cached locally.
    pub(crate) async fn prefetch(&self, task: &Arc<Task>, artifacts: &[Artifact]) -> Self {
        let (client, bundle) = (&task.client, task.spec.bundle);
        let scene = client.get(&bundle, BUNDLE).await.map_err(|error| call_failure(&error));
        let manifest = scene.as_ref().ok().and_then(|bytes| Manifest::decode(bytes).ok()).unwrap_or_default();
        let pieces = manifest.pieces.iter().map(|piece| piece.artifact);
        let artifacts: Vec<Artifact> = artifacts.iter().copied().chain(pieces).collect();
        let all = download_all(client, &artifacts).await;
        let mut inputs: BTreeMap<_, _> = artifacts.iter().map(|artifact| artifact.digest).zip(all).collect();
        inputs.insert(bundle, scene);
        let inputs = Arc::new(inputs);
        let fetch = Self { mode: FetchMode::Prefetched(inputs.clone()), ..self.for_task(task) };
        inputs.values().flatten().for_each(|bytes| fetch.count(bytes.len()));
        fetch
    }
}

fn prefetched_input(inputs: &BTreeMap<Digest, Result<Bytes, Failure>>, digest: &Digest) -> Result<Bytes, Failure> {
    let missing = || {
        Err(Failure::LostInputs {
            digests: vec![*digest],
            message: "the artifact was not downloaded before the task began".into(),
        })
    };
    inputs.get(digest).cloned().unwrap_or_else(missing)
}

async fn download_all(client: &Client, artifacts: &[Artifact]) -> Vec<Result<Bytes, Failure>> {
    let download = |artifact: Artifact| {
        let client = client.clone();
        tokio::spawn(async move { client.get_exactly(&artifact).await })
    };
    let downloads: Vec<_> = artifacts.iter().copied().map(download).collect();
    let mut all = Vec::with_capacity(downloads.len());
    for download in downloads {
        all.push(match download.await {
            Ok(bytes) => bytes.map_err(|error| call_failure(&error)),
            Err(error) => Err(Failure::Panicked { message: error.to_string() }),
        });
    }
    all
}

#[cfg(test)]
mod tests {
    use femc_model::FailureVerdict;

    use super::*;

    #[test]
    fn too_large_artifact_is_fatal_and_rate_limit_is_not() {
        let of = |refusal: Refusal| call_failure(&CallError::Refused(refusal));
        let large = of(Refusal::ArtifactTooLarge { limit: 1 << 30 });
        assert_eq!((large.verdict(), large.cause()), (FailureVerdict::Fatal, "too_large"));
        let often = of(Refusal::TooLarge { what: "calls per second from worker a".into(), limit: 10 });
        assert_eq!(often.verdict(), FailureVerdict::Infrastructure);
        let digest = Digest::compute(b"tile");
        for damaged in [Refusal::NoSuchArtifact { digest }, Refusal::DigestMismatch { digest }] {
            assert_eq!(of(damaged).verdict(), FailureVerdict::Rebuild(vec![digest]));
        }
    }
}
