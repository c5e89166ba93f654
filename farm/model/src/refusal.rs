//! Reasons why the coordinator refuses a request.

use serde::{Deserialize, Serialize};

use crate::{Digest, JobId};

/// Refusal of a well-formed request. It crosses the wire as an enum, not as text.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum Refusal {
    /// The job does not exist.
    #[error("there is no job {job}")]
    NoSuchJob {
        /// Number of the requested job.
        job: JobId,
    },
    /// The worker does not exist.
    #[error("there is no worker {worker}")]
    NoSuchWorker {
        /// Name of the requested worker.
        worker: String,
    },
    /// The job has ended, and the action needs a job that has not.
    #[error("job {job} has ended")]
    Ended {
        /// The job.
        job: JobId,
    },
    /// The value of a field is not valid.
    #[error("{field}: {message}")]
    Invalid {
        /// Name of the field.
        field: String,
        /// Fault of the value.
        message: String,
    },
    /// The message is about a lease that is over.
    #[error("the lease is no longer valid: the task is finished, or a lease with another epoch holds it")]
    StaleEpoch,
    /// The artifact does not exist.
    #[error("there is no artifact {digest}")]
    NoSuchArtifact {
        /// Digest of the artifact.
        digest: Digest,
    },
    /// The bytes do not have the announced digest.
    #[error("the received bytes do not have the digest {digest}")]
    DigestMismatch {
        /// Announced digest.
        digest: Digest,
    },
    /// A quantity exceeds its limit.
    #[error("too many {what}: at most {limit}")]
    TooLarge {
        /// Quantity that exceeds its limit.
        what: String,
        /// Maximum permitted value.
        limit: u64,
    },
    /// The artifact is larger than the store accepts, from any sender at any time.
    #[error("the artifact exceeds {limit} bytes, the size limit of the store")]
    ArtifactTooLarge {
        /// Limit in bytes.
        limit: u64,
    },
    /// The job needs artifacts that are not in the store.
    #[error(
        "{count} artifacts of the job are not in the store, for example {}; upload them and submit again",
        digests.first().map_or_else(String::new, ToString::to_string)
    )]
    MissingArtifacts {
        /// Digests of some missing artifacts: at most [`Refusal::MAX_NAMED`].
        digests: Vec<Digest>,
        /// Number of missing artifacts.
        count: u64,
    },
    /// The upload continues at another offset than the sender expects.
    #[error("the upload must resume at byte {offset}")]
    Resume {
        /// Next byte that the store expects.
        offset: u64,
    },
    /// The caller lacks the permission.
    #[error("permission denied for {who}: this requires {takes}")]
    Forbidden {
        /// Holder of the credential in the request.
        who: String,
        /// Holders who have the permission, such as `an admin`.
        takes: String,
    },
    /// The coordinator is stopping, or its log or store does not respond. Retry later.
    #[error("temporarily unavailable: {message}")]
    Unavailable {
        /// Reason why the coordinator cannot answer now.
        message: String,
    },
    /// A disk of the farm is full or nearly full.
    #[error(
        "the farm accepts no new jobs: only {} MiB are free for {place}; \
         free disk space there (`femc gc`) and submit again",
        free >> 20
    )]
    NoRoom {
        /// Data on the disk, and its path.
        place: String,
        /// Free bytes.
        free: u64,
    },
    /// The caller is not authenticated.
    #[error("authentication failed: {message}")]
    Unauthenticated {
        /// Fault of the credential.
        message: String,
    },
}

impl Refusal {
    /// Maximum number of artifacts that a refusal names. The limit exists because a refusal is sent in a header.
    pub const MAX_NAMED: usize = 64;
}
