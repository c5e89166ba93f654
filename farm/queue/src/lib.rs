//! The log under the scheduler: records that are durable before anybody hears of them, and snapshots that replace them.
//!
//! A record is bytes; what they mean is the scheduler's affair. One [`Queue`], several backends, one conformance suite
//! (`tests/conformance.rs`). A batch is appended whole or not at all.
#![deny(missing_docs)]

mod backend;

use std::future::Future;

pub use backend::memory::Memory;
pub use backend::sqlite::Sqlite;

/// What a log holds.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Contents {
    /// The newest snapshot.
    pub snapshot: Option<Vec<u8>>,
    /// The records since then, oldest first.
    pub records: Vec<Vec<u8>>,
    /// Records at the end that were damaged and are dropped; they were never acknowledged, or the disk has lost them.
    pub torn: u64,
}

/// An append-only log of one writer.
pub trait Queue: Send + 'static {
    /// What there is. Drops a torn tail, so that appending goes on after the last sound record.
    fn load(&mut self) -> impl Future<Output = Result<Contents, QueueError>> + Send;

    /// Appends records; they are on the disk when this returns. Whole or not at all.
    fn append(&mut self, records: &[Vec<u8>]) -> impl Future<Output = Result<(), QueueError>> + Send;

    /// Puts `state` in place of everything before it.
    fn snapshot(&mut self, state: &[u8]) -> impl Future<Output = Result<(), QueueError>> + Send;
}

/// What a log may answer instead.
#[derive(Debug, thiserror::Error)]
pub enum QueueError {
    /// The file is not a log of this program, or of another version.
    #[error("{path} is not a femc log of version {}: application {application:#x}, version {version}", Sqlite::VERSION)]
    Foreign {
        /// The file.
        path: String,
        /// SQLite's `application_id`.
        application: i64,
        /// SQLite's `user_version`.
        version: i64,
    },
    /// Another coordinator has it open.
    #[error("{path} is in use by another coordinator")]
    InUse {
        /// The file.
        path: String,
    },
    /// A record before the end is damaged or gone: what follows it means nothing.
    #[error("record {sequence} of the log is damaged, and {after} sound ones follow it")]
    Damaged {
        /// Number of the record.
        sequence: i64,
        /// Sound records after it.
        after: u64,
    },
    /// The snapshot is damaged.
    #[error("the log's snapshot is damaged")]
    DamagedSnapshot,
    /// The medium said no.
    #[error("log: {0}")]
    Medium(#[from] std::io::Error),
    /// SQLite said no.
    #[error("log: {0}")]
    Sqlite(#[from] sqlx::Error),
}
