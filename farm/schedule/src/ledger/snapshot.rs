//! Encoding of the ledger and its facts: a version byte, and the rest in postcard.

use femc_model::{Tick, with_log_version};
use serde::{Deserialize, Serialize};

use super::Ledger;
use crate::Fact;

/// Error of decoding a snapshot, a fact or a note.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SnapshotError {
    /// Another version wrote it.
    #[error(
        "the farm's log has version {found}, and this program reads versions {} to {}: finish its jobs with the program that \
         wrote it, or start with a new log",
        Ledger::OLDEST_VERSION,
        Ledger::VERSION
    )]
    Version {
        /// Version in its first byte.
        found: u8,
    },
    /// Another version recorded these attempts.
    #[error(
        "records of attempts have version {found}, and this program reads only version {}: its reports lack these attempts",
        crate::attempts::VERSION
    )]
    NoteVersion {
        /// Version in the note's first byte.
        found: u8,
    },
    /// Another version recorded this roster of workers.
    #[error(
        "the list of workers has version {found}, which this program does not read: workers reappear when they connect"
    )]
    RosterVersion {
        /// Version in the note's first byte.
        found: u8,
    },
    /// The bytes are not an encoding of [`Ledger::encode`].
    #[error("snapshot or fact is damaged: {0}")]
    Damaged(#[from] postcard::Error),
    /// There are no bytes.
    #[error("snapshot or fact is empty")]
    Empty,
}

impl Ledger {
    /// First byte of snapshots and of facts.
    pub const VERSION: u8 = 12;
    /// Earliest version that can be read.
    pub const OLDEST_VERSION: u8 = 8;

    /// Encodes version and content, for a snapshot.
    pub fn encode(&self) -> Result<Vec<u8>, SnapshotError> {
        encode(self)
    }

    /// Decodes the bytes of [`Self::encode`].
    pub fn decode(bytes: &[u8]) -> Result<Self, SnapshotError> {
        decode(bytes)
    }
}

impl Fact {
    /// Encodes version, time and content, for the log.
    pub fn encode(&self, now: Tick) -> Result<Vec<u8>, SnapshotError> {
        encode(&(now, self))
    }

    /// Decodes the bytes of [`Self::encode`].
    pub fn decode(bytes: &[u8]) -> Result<(Tick, Self), SnapshotError> {
        decode(bytes)
    }
}

fn encode(value: &impl Serialize) -> Result<Vec<u8>, SnapshotError> {
    // Enough for most facts.
    let mut bytes = Vec::with_capacity(128);
    bytes.push(Ledger::VERSION);
    Ok(postcard::to_extend(value, bytes)?)
}

fn decode<T: for<'a> Deserialize<'a>>(bytes: &[u8]) -> Result<T, SnapshotError> {
    match bytes.split_first() {
        Some((&version, content)) if (Ledger::OLDEST_VERSION..=Ledger::VERSION).contains(&version) => {
            Ok(with_log_version(version, || postcard::from_bytes(content))?)
        }
        Some((&found, _)) => Err(SnapshotError::Version { found }),
        None => Err(SnapshotError::Empty),
    }
}
