//! Sessions of workers. The reader of a session also checks that reported artifacts really are in the store.

use femc_model::{
    Artifact, BoundedMap, Digest, Failure, FromWorker, JobId, JobSpec, LogText, TaskResult, ToWorker, WorkerId,
};
use femc_proto::WorkerMessages;
use femc_store::{Integrity, Store};
use tokio::sync::mpsc;

use crate::actor::SessionEvent;

/// Actor's end of a session.
#[derive(Debug)]
pub(crate) struct WorkerSession {
    pub(crate) out: mpsc::Sender<ToWorker>,
    /// Jobs whose specification was sent most recently. Any other job is sent, or sent again, before its tasks.
    pub(crate) jobs: BoundedMap<JobId, ()>,
}

impl WorkerSession {
    pub(crate) fn new(out: mpsc::Sender<ToWorker>) -> Self {
        Self { out, jobs: BoundedMap::new(JobSpec::SESSION_SPECS) }
    }
}

/// Forwards the worker's messages until the session ends.
pub(crate) async fn forward_messages(
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
                tracing::warn!(worker = worker.0, %error, "cannot read the worker's messages; its session ends");
                break;
            }
            None => break,
        };
        if actor.send((worker, check_message(message, &store).await)).await.is_err() {
            return;
        }
    }
    // The send fails if the actor is gone. This is ignored.
    let _ = actor.send((worker, SessionEvent::Ended)).await;
}

/// Checks a message against the store. A completion whose artifacts are not all in the store becomes
/// [`SessionEvent::ArtifactMissing`]. Artifacts that a worker reports as lost are read. This removes damaged ones, so that they can
/// be uploaded again.
async fn check_message(mut message: FromWorker, store: &Store) -> SessionEvent {
    check_log(&mut message, store).await;
    if let FromWorker::Failed { failure: Failure::LostInputs { digests, .. }, .. } = &message {
        for digest in digests {
            if let Err(error) = store.get(digest).await {
                tracing::warn!(%error, "an input is missing or damaged");
            }
        }
    }
    let lacks = match &message {
        FromWorker::Completed { result, .. } => first_missing_artifact(result, store).await,
        _ => None,
    };
    match lacks {
        Some((artifact, error)) => SessionEvent::ArtifactMissing(Box::new(message), artifact, error),
        None => SessionEvent::Message(Box::new(message)),
    }
}

/// Returns the first artifact of a result that is missing or damaged in the store, with the store's message. A damaged artifact is
/// removed, so that it is accepted when it is uploaded again.
async fn first_missing_artifact(result: &TaskResult, store: &Store) -> Option<(Digest, String)> {
    for artifact in result.artifacts() {
        let Artifact { digest, bytes } = artifact;
        let message = match store.verify_unless_recent(&artifact).await {
            Ok(Integrity::Intact(found)) if found == bytes => continue,
            Ok(Integrity::Intact(found)) => format!("artifact {digest} has {found} bytes, expected {bytes}"),
            Ok(Integrity::Damaged) => format!("artifact {digest} is damaged in the store"),
            Ok(Integrity::Missing) => format!("artifact {digest} is not in the store"),
            Err(error) => error.to_string(),
        };
        return Some((digest, message));
    }
    None
}

/// Replaces a log that did not arrive with a text that says so. The task is not repeated because of it.
async fn check_log(message: &mut FromWorker, store: &Store) {
    let (FromWorker::Completed { log: Some(log), .. } | FromWorker::Failed { log: Some(log), .. }) = message else {
        return;
    };
    if let LogText::Stored(artifact) = log.text
        && !matches!(store.verify_unless_recent(&artifact).await, Ok(Integrity::Intact(bytes)) if bytes == artifact.bytes)
    {
        log.text = LogText::Inline("the coordinator did not receive the log".into());
    }
}
