//! Artefacts for threads that compute: blocking downloads, and failed calls as failures of a task.

use bytes::Bytes;
use femc_model::{Artefact, Digest, Failure, Refusal};
use femc_proto::{CallError, Client};
use tokio::runtime::Handle;

/// Most bytes of a scene bundle.
const BUNDLE: u64 = 1 << 30;

/// What a failed call means for a task.
pub(crate) fn failure(error: &CallError) -> Failure {
    let message = error.to_string();
    match error {
        CallError::Refused(Refusal::NoSuchArtefact { digest } | Refusal::DigestMismatch { digest }) => {
            Failure::LostInputs { digests: vec![*digest], message }
        }
        CallError::Refused(_)
        | CallError::Address { .. }
        | CallError::Unreachable { .. }
        | CallError::Answer(_)
        | CallError::Status { .. } => Failure::Store { message },
    }
}

/// Downloads for a thread outside of the runtime.
#[derive(Debug, Clone)]
pub(crate) struct Fetch(Handle);

impl Fetch {
    pub(crate) fn new(runtime: Handle) -> Self {
        Self(runtime)
    }

    pub(crate) fn bundle(&self, client: &Client, digest: &Digest) -> Result<Bytes, Failure> {
        self.0.block_on(client.get(digest, BUNDLE)).map_err(|error| failure(&error))
    }

    /// All of `artefacts` in their order, side by side; each is there, or lost, or not to be had.
    pub(crate) fn all(&self, client: &Client, artefacts: &[Artefact]) -> Vec<Result<Bytes, Failure>> {
        self.0.block_on(async {
            let download = |artefact: Artefact| {
                let client = client.clone();
                tokio::spawn(async move { client.get(&artefact.digest, artefact.bytes).await })
            };
            let downloads: Vec<_> = artefacts.iter().copied().map(download).collect();
            let mut all = Vec::with_capacity(downloads.len());
            for download in downloads {
                all.push(match download.await {
                    Ok(bytes) => bytes.map_err(|error| failure(&error)),
                    Err(error) => Err(Failure::Panicked { message: error.to_string() }),
                });
            }
            all
        })
    }
}
