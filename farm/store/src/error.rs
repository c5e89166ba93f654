//! Why an artifact cannot be had or kept.

use femc_model::Digest;

/// Why an artifact cannot be had or kept.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// It is not there, or what was there was damaged.
    #[error("there is no artifact {digest}")]
    Missing {
        /// Digest of the artifact.
        digest: Digest,
    },
    /// The bytes are others than announced.
    #[error("the bytes are those of {found}, not of {announced}")]
    Mismatch {
        /// Digest that was announced.
        announced: Digest,
        /// Digest of the bytes that came.
        found: Digest,
    },
    /// What was there was damaged and removed, and so was what was put in its place.
    #[error("what the store keeps as {digest} is damaged, again and again")]
    Unsound {
        /// Digest of the artifact.
        digest: Digest,
    },
    /// Beyond the store's limit.
    #[error("an artifact of more than {limit} bytes")]
    TooLarge {
        /// Bytes.
        limit: u64,
    },
    /// An address that is none.
    #[error("{url} is no address of an artifact store: {message}; write it like s3://bucket/prefix")]
    Url {
        /// Address of the store.
        url: String,
        /// What is wrong with it.
        message: String,
    },
    /// The medium refused the call, or cannot be reached.
    #[error("artifact store {store}: {error}")]
    Medium {
        /// Its name: a folder, an address, or `memory`.
        store: String,
        /// Error of the medium.
        error: object_store::Error,
    },
}
