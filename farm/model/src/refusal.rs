//! Why the coordinator says no.

use serde::{Deserialize, Serialize};

use crate::{Digest, JobId};

/// A request that was understood and refused. Crosses the wire as an enum, not as text.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum Refusal {
    /// No such job.
    #[error("there is no job {job}")]
    NoSuchJob {
        /// Number that was asked for.
        job: JobId,
    },
    /// No such worker.
    #[error("there is no worker {worker}")]
    NoSuchWorker {
        /// Name that was asked for.
        worker: String,
    },
    /// The job has ended, so that this cannot be done to it.
    #[error("job {job} has ended")]
    Ended {
        /// The job.
        job: JobId,
    },
    /// A field's value makes no sense.
    #[error("{field}: {message}")]
    Invalid {
        /// Name of the field.
        field: String,
        /// What is wrong with it.
        message: String,
    },
    /// The message is about a lease that is over.
    #[error("the lease is over: another epoch holds the task, or it is finished")]
    StaleEpoch,
    /// No such artifact.
    #[error("there is no artifact {digest}")]
    NoSuchArtifact {
        /// Digest of the artifact.
        digest: Digest,
    },
    /// The bytes do not have the digest that was announced.
    #[error("the bytes are not those of {digest}")]
    DigestMismatch {
        /// Digest that was announced.
        digest: Digest,
    },
    /// Beyond a limit.
    #[error("{what}: at most {limit}")]
    TooLarge {
        /// Quantity that is beyond its limit.
        what: String,
        /// The most there may be.
        limit: u64,
    },
    /// More than the store takes of one artifact, whoever sends it and whenever.
    #[error("an artifact of more than {limit} bytes: the store takes no more")]
    ArtifactTooLarge {
        /// Bytes.
        limit: u64,
    },
    /// The job needs artifacts that are not in the store.
    #[error(
        "the store lacks {count} of the artifacts that the job needs, as {}; upload them and submit again",
        digests.first().map_or_else(String::new, ToString::to_string)
    )]
    MissingArtifacts {
        /// Some of them: at most [`Refusal::MOST_NAMED`].
        digests: Vec<Digest>,
        /// Number of missing artifacts.
        count: u64,
    },
    /// The upload is elsewhere than its sender believes.
    #[error("the upload goes on at byte {offset}")]
    Resume {
        /// The next byte that is wanted.
        offset: u64,
    },
    /// Who asks may not do this.
    #[error("{who} may not do this: it takes {takes}")]
    Forbidden {
        /// Holder of the credential that was shown.
        who: String,
        /// Holders that may, such as `an admin`.
        takes: String,
    },
    /// The coordinator is stopping, or its log or store does not answer: ask again later.
    #[error("not now: {message}")]
    Unavailable {
        /// Reason for which the coordinator cannot answer now.
        message: String,
    },
    /// A disk of the farm is full, or nearly.
    #[error("the farm takes no new jobs: it has {} MiB left for {place}; make room there (`femc gc`), and submit again", free >> 20)]
    NoRoom {
        /// What lies there, and where.
        place: String,
        /// Bytes that are free.
        free: u64,
    },
    /// Who asks has not shown who it is.
    #[error("you are not known here: {message}")]
    Unauthenticated {
        /// What was wrong with what it showed.
        message: String,
    },
}

impl Refusal {
    /// Most artifacts that a refusal names: it travels in a header.
    pub const MOST_NAMED: usize = 64;
}
