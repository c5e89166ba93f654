//! A worker's session: its reader, which also sees that what is reported is really in the store.

use femc_model::{
    Artifact, Digest, Failure, FromWorker, JobId, JobSpec, Latest, LogText, TaskResult, ToWorker, WorkerId,
};
use femc_proto::WorkerMessages;
use femc_store::{Soundness, Store};
use tokio::sync::mpsc;

use crate::actor::SessionEvent;

/// The actor's end of a session.
#[derive(Debug)]
pub(crate) struct Worker {
    pub(crate) out: mpsc::Sender<ToWorker>,
    /// Jobs that it has been told about, the latest: others are told again.
    pub(crate) jobs: Latest<JobId, ()>,
}

impl Worker {
    pub(crate) fn new(out: mpsc::Sender<ToWorker>) -> Self {
        Self { out, jobs: Latest::new(JobSpec::SESSION_SPECS) }
    }
}

/// Passes on what the worker says until it says no more.
pub(crate) async fn listen(
    worker: WorkerId,
    mut messages: WorkerMessages,
    store: Store,
    actor: mpsc::Sender<(WorkerId, SessionEvent)>,
) {
    loop {
        let message = tokio::select! {
            biased;
            message = messages.next() => message,
            () = actor.closed() => return,
        };
        let message = match message {
            Some(Ok(message)) => message,
            Some(Err(error)) => {
                tracing::warn!(worker = worker.0, %error, "worker makes no sense");
                break;
            }
            None => break,
        };
        if actor.send((worker, checked(message, &store).await)).await.is_err() {
            return;
        }
    }
    // The actor is gone: then there is nobody to tell.
    let _ = actor.send((worker, SessionEvent::Over)).await;
}

/// A completion whose artifacts are not all in the store becomes [`SessionEvent::ArtifactMissing`]. Artifacts that a worker calls
/// lost are read, which removes those that are damaged, so that they can be put again.
async fn checked(mut message: FromWorker, store: &Store) -> SessionEvent {
    check_log(&mut message, store).await;
    if let FromWorker::Failed { failure: Failure::LostInputs { digests, .. }, .. } = &message {
        for digest in digests {
            if let Err(error) = store.get(digest).await {
                tracing::warn!(%error, "an input is lost");
            }
        }
    }
    let lacks = match &message {
        FromWorker::Completed { result, .. } => lacking(result, store).await,
        _ => None,
    };
    match lacks {
        Some((artifact, error)) => SessionEvent::ArtifactMissing(Box::new(message), artifact, error),
        None => SessionEvent::Said(Box::new(message)),
    }
}

/// The first artifact of a result that is not in the store as it should be, and what the store says. One that is damaged is
/// removed: it is wanted again when somebody offers it.
async fn lacking(result: &TaskResult, store: &Store) -> Option<(Digest, String)> {
    for artifact in result.artifacts() {
        let Artifact { digest, bytes } = artifact;
        let message = match store.known(&artifact).await {
            Ok(Soundness::Sound(found)) if found == bytes => continue,
            Ok(Soundness::Sound(found)) => format!("artifact {digest} has {found} bytes, not {bytes}"),
            Ok(Soundness::Damaged) => format!("the store has damaged artifact {digest}"),
            Ok(Soundness::Missing) => format!("artifact {digest} did not arrive, or the store has lost it"),
            Err(error) => error.to_string(),
        };
        return Some((digest, message));
    }
    None
}

/// A log that did not arrive says so; it is no reason to do the task again.
async fn check_log(message: &mut FromWorker, store: &Store) {
    let (FromWorker::Completed { log: Some(log), .. } | FromWorker::Failed { log: Some(log), .. }) = message else {
        return;
    };
    if let LogText::Stored(artifact) = log.text
        && !matches!(store.known(&artifact).await, Ok(Soundness::Sound(bytes)) if bytes == artifact.bytes)
    {
        log.text = LogText::Inline("the log did not arrive".into());
    }
}
