//! Uploads of artifacts to the store.

use std::sync::atomic::Ordering;

use bytes::Bytes;
use femc_model::{Attempt, Failure, LogPlace, LogText, TaskLog};
use femc_proto::{CallError, Client};

use crate::execute::Product;
use crate::fetch;
use crate::log::cut;
use crate::table::Task;

/// Reason why a result is not in the store.
#[derive(Debug)]
pub(crate) enum NotSent {
    /// The connection broke. The result is kept and sent again.
    Later,
    /// The task failed, or the store rejects the result.
    Failed(Failure),
}

/// Uploads all artifacts of a result to the coordinator's store.
pub(crate) async fn upload(client: &Client, task: &Task, product: &Product) -> Result<(), NotSent> {
    for bytes in &product.artifacts {
        client.put(bytes.clone()).await.map_err(|error| match error {
            CallError::Unreachable { .. } => NotSent::Later,
            CallError::Refused(_)
            | CallError::Address { .. }
            | CallError::NoIdentity { .. }
            | CallError::OpenToken { .. }
            | CallError::NoAuthority { .. }
            | CallError::Answer(_)
            | CallError::Status { .. } => NotSent::Failed(fetch::failure(&error)),
        })?;
    }
    let bytes = product.artifacts.iter().map(|bytes| bytes.len() as u64).sum();
    task.account.sent.store(bytes, Ordering::Relaxed);
    Ok(())
}

/// Returns the log of a finished task for its report. A long log is uploaded to the store if possible.
pub(crate) async fn upload_log(client: &Client, task: &Task) -> Option<TaskLog> {
    let (seconds, text) = task.written_log()?;
    let text = match task.log_place(task.outcome()) {
        LogPlace::Store => match client.put(Bytes::copy_from_slice(text.as_bytes())).await {
            Ok(artifact) => LogText::Stored(artifact),
            Err(error) => {
                LogText::Inline(cut(&format!("cannot store the log: {error}\n{text}"), LogText::INLINE).into())
            }
        },
        LogPlace::Report => LogText::Inline(text.clone()),
    };
    let attempt = if matches!(task.outcome(), Some(Ok(_))) { Attempt::Done } else { Attempt::Failed };
    Some(TaskLog { attempt, seconds: *seconds, text })
}
