//! Converts wire types from and to the farm's types. Conversion to the wire always succeeds; conversion from the wire is checked.

mod collect;
mod failure;
mod graph;
mod job;
mod log;
mod session;
mod status;
mod task;
#[cfg(test)]
pub(crate) mod tests;
mod usage;

use femc_model::{Artifact, Digest};

use crate::wire;
pub(crate) use collect::collect_mode;

/// An invalid message.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConvertError {
    /// A batch contains another batch.
    #[error("nested batch: a batched message may not contain a batch")]
    Nested,
    /// A required field is missing.
    #[error("{field} is missing")]
    Missing {
        /// Name of the field.
        field: &'static str,
    },
    /// An enumeration has a number that this program does not know.
    #[error("{field} has the unknown value {value}")]
    Unknown {
        /// Name of the field.
        field: &'static str,
        /// Value received.
        value: i32,
    },
    /// A digest is not 32 bytes long.
    #[error("{field} is not a digest of 32 bytes")]
    Digest {
        /// Name of the field.
        field: &'static str,
    },
    /// A value is out of its range.
    #[error("{field} is out of range")]
    Range {
        /// Name of the field.
        field: &'static str,
    },
    /// The protocol version is not supported.
    #[error(
        "the worker uses protocol {found}, but the coordinator accepts {} to {}; {}",
        crate::OLDEST_PROTOCOL,
        crate::PROTOCOL,
        if *found > crate::PROTOCOL { "upgrade the coordinator first, then its workers" } else { "upgrade this worker" }
    )]
    Protocol {
        /// Protocol version of the worker.
        found: u32,
    },
}

pub(crate) fn required<T>(field: &'static str, value: Option<T>) -> Result<T, ConvertError> {
    value.ok_or(ConvertError::Missing { field })
}

pub(crate) fn parse_digest(field: &'static str, bytes: &[u8]) -> Result<Digest, ConvertError> {
    Digest::try_from(bytes).map_err(|_| ConvertError::Digest { field })
}

pub(crate) fn digest_bytes(digest: &Digest) -> Vec<u8> {
    digest.as_bytes().to_vec()
}

/// Converts every element.
pub(crate) fn convert_all<W, M: TryFrom<W, Error = ConvertError>>(values: Vec<W>) -> Result<Vec<M>, ConvertError> {
    values.into_iter().map(M::try_from).collect()
}

pub(crate) fn convert_optional<W, M: TryFrom<W, Error = ConvertError>>(
    value: Option<W>,
) -> Result<Option<M>, ConvertError> {
    value.map(M::try_from).transpose()
}

impl From<Artifact> for wire::Artifact {
    fn from(artifact: Artifact) -> Self {
        Self { digest: digest_bytes(&artifact.digest), bytes: artifact.bytes }
    }
}

impl TryFrom<wire::Artifact> for Artifact {
    type Error = ConvertError;

    fn try_from(wire: wire::Artifact) -> Result<Self, ConvertError> {
        Ok(Self { digest: parse_digest("artifact.digest", &wire.digest)?, bytes: wire.bytes })
    }
}
