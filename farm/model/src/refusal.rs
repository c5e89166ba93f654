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
    #[error("the lease is over: another epoch holds the task, or it is finished")]
    StaleEpoch,
    /// The artifact does not exist.
    #[error("there is no artifact {digest}")]
    NoSuchArtifact {
        /// Digest of the artifact.
        digest: Digest,
    },
    /// The bytes do not have the announced digest.
    #[error("the bytes are not those of {digest}")]
    DigestMismatch {
        /// Announced digest.
        digest: Digest,
    },
    /// A quantity exceeds its limit.
    #[error("{what}: at most {limit}")]
    TooLarge {
        /// Quantity that exceeds its limit.
        what: String,
        /// Maximum permitted value.
        limit: u64,
    },
    /// The artifact is larger than the store accepts, from any sender at any time.
    #[error("an artifact of more than {limit} bytes: the store takes no more")]
    ArtifactTooLarge {
        /// Limit in bytes.
        limit: u64,
    },
    /// The job needs artifacts that are not in the store.
    #[error(
        "the store lacks {count} of the artifacts that the job needs, as {}; upload them and submit again",
        digests.first().map_or_else(String::new, ToString::to_string)
    )]
    MissingArtifacts {
        /// Digests of some missing artifacts: at most [`Refusal::MOST_NAMED`].
        digests: Vec<Digest>,
        /// Number of missing artifacts.
        count: u64,
    },
    /// The upload continues at another offset than the sender expects.
    #[error("the upload goes on at byte {offset}")]
    Resume {
        /// Next byte that the store expects.
        offset: u64,
    },
    /// The caller lacks the permission.
    #[error("{who} may not do this: it takes {takes}")]
    Forbidden {
        /// Holder of the credential in the request.
        who: String,
        /// Holders who have the permission, such as `an admin`.
        takes: String,
    },
    /// The coordinator is stopping, or its log or store does not respond. Retry later.
    #[error("not now: {message}")]
    Unavailable {
        /// Reason why the coordinator cannot answer now.
        message: String,
    },
    /// A disk of the farm is full or nearly full.
    #[error("the farm takes no new jobs: it has {} MiB left for {place}; make room there (`femc gc`), and submit again", free >> 20)]
    NoRoom {
        /// Data on the disk, and its path.
        place: String,
        /// Free bytes.
        free: u64,
    },
    /// The caller is not authenticated.
    #[error("you are not known here: {message}")]
    Unauthenticated {
        /// Fault of the credential.
        message: String,
    },
}

impl Refusal {
    /// Maximum number of artifacts that a refusal names. The limit exists because a refusal is sent in a header.
    pub const MOST_NAMED: usize = 64;
}
