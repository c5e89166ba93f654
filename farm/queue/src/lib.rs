//! The log under the scheduler: records that are durable before anybody hears of them, and snapshots that replace them.
//!
//! A record is bytes; what they mean is the scheduler's affair. One [`Queue`], several backends, one conformance suite
//! (`tests/conformance.rs`). A batch is appended whole or not at all.
#![deny(missing_docs)]

mod backend;
#[cfg(feature = "testing")]
pub mod testing;

use std::future::Future;

pub use backend::memory::Memory;
pub use backend::postgres::{Database, Leader, Postgres, Standby};
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

    /// Whether this is still the one writer: where another may take its place, fails once that has happened or cannot be
    /// ruled out. Asks nobody, and costs next to nothing.
    fn check(&mut self) -> Result<(), QueueError> {
        Ok(())
    }

    /// The writer's end: what lay beside the log's own place is brought there. A log whose writer was killed is as whole.
    fn close(self) -> impl Future<Output = Result<(), QueueError>> + Send
    where
        Self: Sized,
    {
        async { Ok(()) }
    }
}

/// What to do about an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Remedy {
    /// Open the log again, later: what it holds is whole.
    Reopen,
    /// A person must look.
    None,
}

impl QueueError {
    /// What to do about it.
    pub fn remedy(&self) -> Remedy {
        match self {
            Self::Away { .. } | Self::Deposed { .. } => Remedy::Reopen,
            Self::Address { .. }
            | Self::Rejected { .. }
            | Self::Foreign { .. }
            | Self::ForeignTables { .. }
            | Self::InUse { .. }
            | Self::Damaged { .. }
            | Self::DamagedSnapshot
            | Self::Database { .. }
            | Self::Medium(_)
            | Self::Sqlite(_) => Remedy::None,
        }
    }
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
    /// The address of the database makes no sense.
    #[error("this is no address of a PostgreSQL database: {message}")]
    Address {
        /// What is wrong with it.
        message: String,
    },
    /// The database does not answer, or the connection broke: later it may be there again.
    #[error("the database {database} cannot be reached: {message}")]
    Away {
        /// Where, and its name.
        database: String,
        /// What happened.
        message: String,
    },
    /// The database does not let this user in, or does not let it do what it must.
    #[error("the database {database} refuses: {message}")]
    Rejected {
        /// Where, and its name.
        database: String,
        /// What the server said.
        message: String,
    },
    /// The schema `femc` of the database is not a log of this program, or of another version.
    #[error(
        "the schema femc of the database {database} is not a femc log of version {}: version {}",
        Postgres::VERSION,
        found.as_deref().unwrap_or("unknown")
    )]
    ForeignTables {
        /// Where, and its name.
        database: String,
        /// The version that it states.
        found: Option<String>,
    },
    /// Another coordinator leads: nothing was written.
    #[error("another coordinator leads; leadership {epoch} of this one is over")]
    Deposed {
        /// Of the leadership that is over.
        epoch: i64,
    },
    /// PostgreSQL failed in a way that trying again does not mend.
    #[error("the database {database} failed: {message}")]
    Database {
        /// Where, and its name.
        database: String,
        /// What the server said.
        message: String,
    },
    /// SQLite said no.
    #[error("log: {0}")]
    Sqlite(#[from] sqlx::Error),
}
