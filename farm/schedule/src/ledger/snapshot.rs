//! The ledger and its facts as bytes: a version, and the rest in postcard.

use femc_model::{Tick, reading_version};
use serde::{Deserialize, Serialize};

use super::Ledger;
use crate::Fact;

/// A snapshot that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SnapshotError {
    /// Written by another version.
    #[error(
        "the farm's log is of version {found}, and this program reads versions {} to {}: finish its jobs with the program that \
         wrote it, or begin with a new log",
        Ledger::OLDEST_VERSION,
        Ledger::VERSION
    )]
    Version {
        /// What its first byte says.
        found: u8,
    },
    /// Attempts that another version noted.
    #[error(
        "attempts were noted in version {found}, and this program reads version {} only: they are left out of its reports",
        crate::attempts::VERSION
    )]
    NoteVersion {
        /// What the note's first byte says.
        found: u8,
    },
    /// A roster of workers that another version noted.
    #[error(
        "workers were noted in version {found}, which this program does not read: they are known again when they come"
    )]
    RosterVersion {
        /// What the note's first byte says.
        found: u8,
    },
    /// Not what [`Ledger::encode`] writes.
    #[error("snapshot or fact is damaged: {0}")]
    Damaged(#[from] postcard::Error),
    /// No bytes at all.
    #[error("snapshot or fact is empty")]
    Empty,
}

impl Ledger {
    /// First byte of snapshots and of facts.
    pub const VERSION: u8 = 11;
    /// Earliest version that is read.
    pub const OLDEST_VERSION: u8 = 8;

    /// Version and content, for a snapshot.
    pub fn encode(&self) -> Result<Vec<u8>, SnapshotError> {
        encode(self)
    }

    /// What [`Self::encode`] wrote.
    pub fn decode(bytes: &[u8]) -> Result<Self, SnapshotError> {
        decode(bytes)
    }
}

impl Fact {
    /// Version, time and content, for the log.
    pub fn encode(&self, now: Tick) -> Result<Vec<u8>, SnapshotError> {
        encode(&(now, self))
    }

    /// What [`Self::encode`] wrote.
    pub fn decode(bytes: &[u8]) -> Result<(Tick, Self), SnapshotError> {
        decode(bytes)
    }
}

fn encode(value: &impl Serialize) -> Result<Vec<u8>, SnapshotError> {
    // A fact mostly fits.
    let mut bytes = Vec::with_capacity(128);
    bytes.push(Ledger::VERSION);
    Ok(postcard::to_extend(value, bytes)?)
}

fn decode<T: for<'a> Deserialize<'a>>(bytes: &[u8]) -> Result<T, SnapshotError> {
    match bytes.split_first() {
        Some((&version, content)) if (Ledger::OLDEST_VERSION..=Ledger::VERSION).contains(&version) => {
            Ok(reading_version(version, || postcard::from_bytes(content))?)
        }
        Some((&found, _)) => Err(SnapshotError::Version { found }),
        None => Err(SnapshotError::Empty),
    }
}
