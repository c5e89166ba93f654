//! The scheduler's durable log: records that are durable before they are acknowledged, and snapshots that replace them.
//!
//! Notes are stored beside the log, by subject. They are read in pages on request, never when a log is opened.
//!
//! A record is a byte string; only the scheduler interprets it. There is one trait, [`Queue`], with several backends and one
//! conformance suite (`tests/suite/conformance.rs`). A batch is appended either whole or not at all.
#![deny(missing_docs)]

mod backend;
#[cfg(feature = "testing")]
pub mod testing;

use std::fs::File;
use std::future::Future;
use std::io;

pub use backend::memory::Memory;
pub use backend::postgres::{Database, Leader, Postgres, Standby};
pub use backend::sqlite::Sqlite;

/// Contents of a log.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LogContents {
    /// The newest snapshot.
    pub snapshot: Option<Vec<u8>>,
    /// The records since then, oldest first.
    pub records: Vec<Vec<u8>>,
    /// Number of records dropped at the end because their write was interrupted; they were never acknowledged. Always 0 in a
    /// database.
    pub torn: u64,
    /// Acknowledged records that are missing, if the loss was accepted.
    pub missing: Option<MissingRecords>,
}

/// Description of missing records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MissingRecords {
    /// Number of the last existing record; 0: none.
    pub last_existing: i64,
    /// Number of the last record known to have existed; `None`: unknown.
    pub last_known: Option<i64>,
}

/// Policy for a log that lacks acknowledged records.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum LossPolicy {
    /// The log is not opened.
    #[default]
    Refuse,
    /// The log is opened without the missing records, permanently; [`LogContents::missing`] describes the loss.
    Accept,
}

/// A set of changes that become durable together.
#[derive(Debug, Clone, Copy, Default)]
pub struct Batch<'a> {
    /// Records of the log.
    pub records: &'a [Vec<u8>],
    /// Notes beside the log: snapshots neither contain nor replace them, and opening the log does not read them.
    pub notes: &'a [Note],
    /// Subjects whose earlier notes are removed.
    pub forgotten: &'a [u64],
}

impl<'a> Batch<'a> {
    /// Creates a batch of records only.
    pub fn from_records(records: &'a [Vec<u8>]) -> Self {
        Self { records, ..Self::default() }
    }

    fn is_empty(&self) -> bool {
        self.records.is_empty() && self.notes.is_empty() && self.forgotten.is_empty()
    }
}

/// A note, stored beside the log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    /// Number of the subject; at most `i64::MAX`.
    pub subject: u64,
    /// Content of the note.
    pub bytes: Vec<u8>,
}

/// A page of a subject's notes.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct NotePage {
    /// Contents of the notes, oldest first; damaged notes are left out.
    pub notes: Vec<Vec<u8>>,
    /// Start of the next page; `None`: this is the last page.
    pub next: Option<u64>,
}

impl NotePage {
    /// Maximum number of notes in a page.
    pub const MAX_NOTES: usize = 64;
    /// Bytes after which a page ends.
    pub const MAX_BYTES: usize = 256 << 10;

    /// Creates a page of the first of these numbered notes; the content of a damaged note is `None`.
    fn from_notes(notes: impl IntoIterator<Item = (u64, Option<Vec<u8>>)>) -> Self {
        let (mut page, mut bytes) = (Self::default(), 0);
        for (index, (number, note)) in notes.into_iter().enumerate() {
            if index == Self::MAX_NOTES || bytes >= Self::MAX_BYTES {
                page.next = Some(number);
                break;
            }
            bytes += note.as_ref().map_or(0, Vec::len);
            page.notes.extend(note);
        }
        page
    }
}

/// An append-only log with one writer, and notes beside it.
pub trait Queue: Send + 'static {
    /// Loads the log; call this before anything else. Returns exactly the acknowledged batches, each of them whole. Fails if some
    /// of them are missing, or if that cannot be determined, unless the loss is accepted.
    fn load(&mut self) -> impl Future<Output = Result<LogContents, QueueError>> + Send;

    /// Appends a batch, either whole or not at all. It is on the disk when this returns. Without room ([`Remedy::FreeSpace`]),
    /// nothing is appended, and the call may be retried.
    fn append(&mut self, batch: Batch<'_>) -> impl Future<Output = Result<(), QueueError>> + Send;

    /// Replaces everything before with the snapshot `state`.
    fn snapshot(&mut self, state: &[u8]) -> impl Future<Output = Result<(), QueueError>> + Send;

    /// Reserves a number, the incarnation, for the writer that starts now. It is at least `min_incarnation`, and no earlier writer
    /// has had it, even if records of the log are lost. It is durable when this returns.
    fn reserve(&mut self, min_incarnation: u32) -> impl Future<Output = Result<u32, QueueError>> + Send {
        async move { Ok(min_incarnation) }
    }

    /// Returns a page of a subject's notes. `from` is 0 or the `next` of the previous page.
    fn notes(&mut self, subject: u64, from: u64) -> impl Future<Output = Result<NotePage, QueueError>> + Send;

    /// Checks that this is still the only writer. If another writer may take over, this fails once that has happened or cannot be
    /// ruled out. It sends no request and is nearly free.
    fn check(&mut self) -> Result<(), QueueError> {
        Ok(())
    }

    /// Returns a copy of the present contents: an SQLite file that [`Sqlite::open`] opens, positioned at its start. The file has no
    /// name and vanishes when it is dropped. The log is not changed, even if this fails.
    fn copy(&mut self) -> impl Future<Output = Result<File, QueueError>> + Send {
        async { Err(QueueError::NoCopy { instead: "it is kept elsewhere" }) }
    }

    /// Closes the log and moves everything from files beside the log into the log itself. A log whose writer was killed is not less
    /// complete.
    fn close(self) -> impl Future<Output = Result<(), QueueError>> + Send
    where
        Self: Sized,
    {
        async { Ok(()) }
    }
}

/// Remedy for an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Remedy {
    /// Open the log again, later: its contents are intact.
    Reopen,
    /// Retry the call when there is room: the log is unchanged.
    FreeSpace,
    /// No automatic remedy: a person must intervene.
    None,
}

impl QueueError {
    /// Returns the remedy for this error.
    pub fn remedy(&self) -> Remedy {
        match self {
            Self::Unreachable { .. } | Self::Deposed { .. } => Remedy::Reopen,
            Self::OutOfSpace { .. } => Remedy::FreeSpace,
            Self::Io(error) if is_out_of_space(error) => Remedy::FreeSpace,
            Self::Address { .. }
            | Self::Rejected { .. }
            | Self::ForeignFile { .. }
            | Self::ForeignTables { .. }
            | Self::InUse { .. }
            | Self::Damaged { .. }
            | Self::DamagedSnapshot
            | Self::MissingRecords { .. }
            | Self::Unverifiable { .. }
            | Self::NoCopy { .. }
            | Self::Database { .. }
            | Self::Io(_)
            | Self::Sqlite(_) => Remedy::None,
        }
    }
}

/// Checks whether a disk or a quota is full.
fn is_out_of_space(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded)
}

/// Error of a log.
#[derive(Debug, thiserror::Error)]
pub enum QueueError {
    /// The file is not a log of this program, or has another version.
    #[error(
        "{path} is not a femc log of version {}: found application id {application:#x}, version {version}",
        Sqlite::VERSION
    )]
    ForeignFile {
        /// Path of the file.
        path: String,
        /// SQLite's `application_id`.
        application: i64,
        /// SQLite's `user_version`.
        version: i64,
    },
    /// Another coordinator has the log open.
    #[error("{path} is in use by another coordinator")]
    InUse {
        /// Path of the file.
        path: String,
    },
    /// A record is damaged or missing: the records after it cannot be used.
    #[error("record {sequence} of the log is damaged or missing, and {after} valid records follow it")]
    Damaged {
        /// Number of the record.
        sequence: i64,
        /// Number of sound records after it.
        after: u64,
    },
    /// The snapshot is damaged.
    #[error("the log's snapshot is damaged")]
    DamagedSnapshot,
    /// Durable records are missing at the end.
    #[error("{path} ends with record {kept}, but record {known} was durable: {} records are missing", known - kept)]
    MissingRecords {
        /// Path of the file.
        path: String,
        /// Number of the last existing record.
        kept: i64,
        /// Number of the last record known to have existed.
        known: i64,
    },
    /// Durable records may be missing; this cannot be determined.
    #[error("cannot check that {path} contains all durable records: {why}")]
    Unverifiable {
        /// Path of the file.
        path: String,
        /// Reason why records may be missing.
        why: String,
    },
    /// There is no room for the log; nothing was written.
    #[error("no room for the log in {place}: {message}")]
    OutOfSpace {
        /// The file or the database.
        place: String,
        /// Error of the operating system or the database.
        message: String,
    },
    /// A log of this kind must be copied with other tools.
    #[error("the coordinator cannot copy this log: {instead}")]
    NoCopy {
        /// Tool or command that copies this kind of log.
        instead: &'static str,
    },
    /// The log cannot be read or written.
    #[error("log: {0}")]
    Io(#[from] io::Error),
    /// The address of the database is invalid.
    #[error("invalid address of a PostgreSQL database: {message}")]
    Address {
        /// Description of the problem.
        message: String,
    },
    /// The database does not answer, or the connection broke. It may be available again later.
    #[error("cannot reach the database {database}: {message}")]
    Unreachable {
        /// Host and name of the database.
        database: String,
        /// Error of the connection.
        message: String,
    },
    /// The database rejects this user, or denies a necessary permission.
    #[error("cannot use the database {database}: {message}")]
    Rejected {
        /// Host and name of the database.
        database: String,
        /// Error of the server.
        message: String,
    },
    /// The schema `femc` of the database is not a log of this program, or has another version.
    #[error(
        "the schema femc of the database {database} is not a femc log of version {}: found version {}",
        Postgres::VERSION,
        found.as_deref().unwrap_or("unknown")
    )]
    ForeignTables {
        /// Host and name of the database.
        database: String,
        /// Version found in the schema.
        found: Option<String>,
    },
    /// Another coordinator leads: nothing was written.
    #[error("another coordinator leads; the leadership of this coordinator (epoch {epoch}) has ended")]
    Deposed {
        /// Epoch of the leadership that is over.
        epoch: i64,
    },
    /// PostgreSQL failed, and a retry does not help.
    #[error("the database {database} failed: {message}")]
    Database {
        /// Host and name of the database.
        database: String,
        /// Error of the server.
        message: String,
    },
    /// SQLite failed.
    #[error("log: {0}")]
    Sqlite(#[from] sqlx::Error),
}
