//! Errors of the artifact store.

use femc_model::Digest;

/// Error of the artifact store.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The artifact is missing, or it was damaged.
    #[error("there is no artifact {digest}")]
    Missing {
        /// Digest of the artifact.
        digest: Digest,
    },
    /// The bytes do not match the announced digest.
    #[error("the digest of the bytes is {found}, not the announced {announced}")]
    Mismatch {
        /// The announced digest.
        announced: Digest,
        /// Digest of the received bytes.
        found: Digest,
    },
    /// The stored artifact was damaged, and so were its replacements.
    #[error("the stored artifact {digest} is damaged, and so were its replacements")]
    Unsound {
        /// Digest of the artifact.
        digest: Digest,
    },
    /// The artifact exceeds the store's size limit.
    #[error("the artifact exceeds the limit of {limit} bytes")]
    TooLarge {
        /// Size limit in bytes.
        limit: u64,
    },
    /// The address of the store is invalid.
    #[error("{url} is not the address of an artifact store: {message}; write it like s3://bucket/prefix")]
    Url {
        /// Address of the store.
        url: String,
        /// Description of the problem.
        message: String,
    },
    /// The medium refused the request, or cannot be reached.
    #[error("artifact store {store}: {error}")]
    Medium {
        /// Name of the store: a folder, an address, or `memory`.
        store: String,
        /// Error of the medium.
        error: object_store::Error,
    },
}
