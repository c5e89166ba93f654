//! Artefacts on their way to the store.

use femc_model::Failure;
use femc_proto::{CallError, Client};

use crate::execute::Product;
use crate::fetch;

/// Why a result is not in the store.
#[derive(Debug)]
pub(crate) enum NotSent {
    /// The connection broke: the result is kept and sent again.
    Later,
    /// The task has failed, or the store will not have it.
    Failed(Failure),
}

/// Puts all of a result's artefacts into the coordinator's store.
pub(crate) async fn upload(client: &Client, product: &Product) -> Result<(), NotSent> {
    for bytes in &product.artefacts {
        client.put(bytes.clone()).await.map_err(|error| match error {
            CallError::Unreachable { .. } => NotSent::Later,
            CallError::Refused(_) | CallError::Address { .. } | CallError::Answer(_) | CallError::Status { .. } => {
                NotSent::Failed(fetch::failure(&error))
            }
        })?;
    }
    Ok(())
}
