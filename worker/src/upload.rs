//! Uploads of artifacts to the store.

use std::sync::atomic::Ordering;

use bytes::Bytes;
use femc_model::{AttemptOutcome, Failure, LogDestination, LogText, TaskLog};
use femc_proto::{CallError, Client};

use crate::execute::Product;
use crate::fetch;
use crate::log::truncate;
use crate::task_table::Task;

/// Reason why a result is not in the store.
#[derive(Debug)]
pub(crate) enum UploadFailure {
    /// The connection broke. The result is kept and sent again.
    Retry,
    /// The task failed, or the store rejects the result.
    Failed(Failure),
}

/// Uploads all artifacts of a result to the coordinator's store.
pub(crate) async fn upload(client: &Client, task: &Task, product: &Product) -> Result<(), UploadFailure> {
    for bytes in &product.artifacts {
        client.put(bytes.clone()).await.map_err(|error| match error {
            CallError::Unreachable { .. } => UploadFailure::Retry,
            CallError::Refused(_)
            | CallError::Address { .. }
            | CallError::NoIdentity { .. }
            | CallError::InsecureToken { .. }
            | CallError::NoAuthority { .. }
            | CallError::Answer(_)
            | CallError::Status { .. } => UploadFailure::Failed(fetch::call_failure(&error)),
        })?;
    }
    let bytes = product.artifacts.iter().map(|bytes| bytes.len() as u64).sum();
    task.account.sent.store(bytes, Ordering::Relaxed);
    Ok(())
}

/// Returns the log of a finished task for its report. A long log is uploaded to the store if possible.
pub(crate) async fn upload_log(client: &Client, task: &Task) -> Option<TaskLog> {
    let (seconds, text) = task.final_log()?;
    let text = match task.log_destination(task.outcome()) {
        LogDestination::Store => match client.put(Bytes::copy_from_slice(text.as_bytes())).await {
            Ok(artifact) => LogText::Stored(artifact),
            Err(error) => {
                LogText::Inline(truncate(&format!("cannot store the log: {error}\n{text}"), LogText::MAX_INLINE).into())
            }
        },
        LogDestination::Report => LogText::Inline(text.clone()),
    };
    let attempt = if matches!(task.outcome(), Some(Ok(_))) { AttemptOutcome::Done } else { AttemptOutcome::Failed };
    Some(TaskLog { outcome: attempt, seconds: *seconds, text })
}
