//! The log under the scheduler: records that are durable before anybody hears of them, and snapshots that replace them.
//!
//! Beside the log lie notes: by subject, read in pages when somebody asks, never when a log is opened.
//!
//! A record is bytes; what they mean is the scheduler's affair. One [`Queue`], several backends, one conformance suite
//! (`tests/conformance.rs`). A batch is appended whole or not at all.
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

/// What a log holds.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Contents {
    /// The newest snapshot.
    pub snapshot: Option<Vec<u8>>,
    /// The records since then, oldest first.
    pub records: Vec<Vec<u8>>,
    /// Records at the end of a write that was cut: never acknowledged, and dropped. A database has none.
    pub torn: u64,
    /// What was acknowledged and is not here, where that was accepted.
    pub lost: Option<Lost>,
}

/// What a log lacks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lost {
    /// The last record that is there; 0: none.
    pub kept: i64,
    /// The last that is known to have been there; `None`: nobody knows.
    pub known: Option<i64>,
}

/// What to do with a log that lacks what was acknowledged.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Loss {
    /// It is not opened.
    #[default]
    Refused,
    /// It goes on with what there is, for good; [`Contents::lost`] tells.
    Accepted,
}

/// What becomes durable at once.
#[derive(Debug, Clone, Copy, Default)]
pub struct Batch<'a> {
    /// Records of the log.
    pub records: &'a [Vec<u8>],
    /// What is kept beside the log: no snapshot holds it or replaces it, and a start does not read it.
    pub notes: &'a [Note],
    /// Subjects whose notes of before go.
    pub forgotten: &'a [u64],
}

impl<'a> Batch<'a> {
    /// Records alone.
    pub fn of(records: &'a [Vec<u8>]) -> Self {
        Self { records, ..Self::default() }
    }

    fn is_empty(&self) -> bool {
        self.records.is_empty() && self.notes.is_empty() && self.forgotten.is_empty()
    }
}

/// Something that is kept beside the log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    /// What it is about; at most `i64::MAX`.
    pub subject: u64,
    /// Content of the note.
    pub bytes: Vec<u8>,
}

/// Some of a subject's notes.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Page {
    /// What they say, oldest first; a damaged one is left out.
    pub notes: Vec<Vec<u8>>,
    /// Where the next page begins; `None`: there is none.
    pub next: Option<u64>,
}

impl Page {
    /// Most notes of a page.
    pub const NOTES: usize = 64;
    /// Bytes after which a page ends.
    pub const BYTES: usize = 256 << 10;

    /// A page of the first of these notes, which have numbers; of a damaged one there is nothing else.
    fn of(notes: impl IntoIterator<Item = (u64, Option<Vec<u8>>)>) -> Self {
        let (mut page, mut bytes) = (Self::default(), 0);
        for (place, (number, note)) in notes.into_iter().enumerate() {
            if place == Self::NOTES || bytes >= Self::BYTES {
                page.next = Some(number);
                break;
            }
            bytes += note.as_ref().map_or(0, Vec::len);
            page.notes.extend(note);
        }
        page
    }
}

/// An append-only log of one writer, and notes beside it.
pub trait Queue: Send + 'static {
    /// What there is, before anything else is asked of it: all that was acknowledged, whole batches, nothing else. Where
    /// that is not there, or cannot be known to be, it fails, unless the loss is accepted.
    fn load(&mut self) -> impl Future<Output = Result<Contents, QueueError>> + Send;

    /// Appends a batch; it is on the disk when this returns. Whole or not at all. Where there is no room
    /// ([`Remedy::Room`]) nothing is appended, and the same may be tried again.
    fn append(&mut self, batch: Batch<'_>) -> impl Future<Output = Result<(), QueueError>> + Send;

    /// Puts `state` in place of everything before it.
    fn snapshot(&mut self, state: &[u8]) -> impl Future<Output = Result<(), QueueError>> + Send;

    /// A number for the writer that begins now, `least` or more: no writer before has had it, whatever else of the log is
    /// lost. Durable when this returns.
    fn reserve(&mut self, least: u32) -> impl Future<Output = Result<u32, QueueError>> + Send {
        async move { Ok(least) }
    }

    /// A subject's notes from `from` on, which is 0 or the `next` of the page before.
    fn notes(&mut self, subject: u64, from: u64) -> impl Future<Output = Result<Page, QueueError>> + Send;

    /// Whether this is still the one writer: where another may take its place, fails once that has happened or cannot be
    /// ruled out. Asks nobody, and costs next to nothing.
    fn check(&mut self) -> Result<(), QueueError> {
        Ok(())
    }

    /// A copy of all that it holds now: an SQLite file that [`Sqlite::open`] opens, at its beginning and without a name, gone
    /// when it is dropped. The log is as it was, also where this fails.
    fn copy(&mut self) -> impl Future<Output = Result<File, QueueError>> + Send {
        async { Err(QueueError::NoCopy { instead: "it is kept elsewhere" }) }
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
    /// Try the same again when there is room: the log is as it was.
    Room,
    /// A person must look.
    None,
}

impl QueueError {
    /// What to do about it.
    pub fn remedy(&self) -> Remedy {
        match self {
            Self::Away { .. } | Self::Deposed { .. } => Remedy::Reopen,
            Self::Full { .. } => Remedy::Room,
            Self::Medium(error) if no_room(error) => Remedy::Room,
            Self::Address { .. }
            | Self::Rejected { .. }
            | Self::Foreign { .. }
            | Self::ForeignTables { .. }
            | Self::InUse { .. }
            | Self::Damaged { .. }
            | Self::DamagedSnapshot
            | Self::Lost { .. }
            | Self::Unsure { .. }
            | Self::NoCopy { .. }
            | Self::Database { .. }
            | Self::Medium(_)
            | Self::Sqlite(_) => Remedy::None,
        }
    }
}

/// Whether a disk, or somebody's share of it, is full.
fn no_room(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded)
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
    /// A record is damaged or gone: what follows it means nothing.
    #[error("record {sequence} of the log is damaged or gone, and {after} sound ones follow it")]
    Damaged {
        /// Number of the record.
        sequence: i64,
        /// Sound records after it.
        after: u64,
    },
    /// The snapshot is damaged.
    #[error("the log's snapshot is damaged")]
    DamagedSnapshot,
    /// Records that were durable are gone from the end.
    #[error("{path} ends with record {kept}, but record {known} was durable: {} are gone", known - kept)]
    Lost {
        /// The file.
        path: String,
        /// The last record that is there.
        kept: i64,
        /// The last that is known to have been there.
        known: i64,
    },
    /// Records may be gone.
    #[error("whether all that was durable is in {path} cannot be told: {why}")]
    Unsure {
        /// The file.
        path: String,
        /// Reason for which durable records may be missing.
        why: String,
    },
    /// There is no room; nothing was written.
    #[error("no room for the log in {place}: {message}")]
    Full {
        /// The file or the database.
        place: String,
        /// Error of the operating system or the database.
        message: String,
    },
    /// A log of this kind is copied by other means.
    #[error("this log is not copied by the coordinator: {instead}")]
    NoCopy {
        /// How to copy this kind of log.
        instead: &'static str,
    },
    /// Reading or writing the log failed.
    #[error("log: {0}")]
    Medium(#[from] io::Error),
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
        /// Error of the connection.
        message: String,
    },
    /// The database does not let this user in, or does not let it do what it must.
    #[error("the database {database} refuses: {message}")]
    Rejected {
        /// Where, and its name.
        database: String,
        /// Error of the server.
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
        /// Error of the server.
        message: String,
    },
    /// SQLite failed.
    #[error("log: {0}")]
    Sqlite(#[from] sqlx::Error),
}
