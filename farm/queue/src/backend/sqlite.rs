//! A log in one SQLite file: WAL mode, every commit synced, one transaction per batch.
//!
//! After a crash, SQLite itself restores whole transactions. The checksum of each record detects pages that the disk has changed.
//! The mark beside the log ([`super::watermark`]) detects missing pages: those that SQLite ignores because they are damaged. In
//! both cases the log is not opened. A closed log contains the information of the mark in its own header and can be moved without
//! the mark. The file is locked, so that a second coordinator fails immediately.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use sqlx::sqlite::{
    SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqliteLockingMode, SqliteRow, SqliteSynchronous,
};
use sqlx::{ConnectOptions as _, Connection as _, Row as _};

use super::rows::{LogRows, Row, blank_checksum, check_rows, checksum, note_checksum, note_page};
use super::watermark::{Identity, Watermark, WatermarkFile, WatermarkState};
use crate::{Batch, LogContents, LossPolicy, MissingRecords, NotePage, Queue, QueueError, is_out_of_space};

/// A log in an SQLite file.
#[derive(Debug)]
pub struct Sqlite {
    connection: SqliteConnection,
    path: PathBuf,
    loss_policy: LossPolicy,
    /// Header as read from the file; `None`: damaged.
    header: Option<Header>,
    /// The mark, once the log is loaded.
    watermark: Option<Watermark>,
    /// Whether the log may be a copy, or has lost its mark. Then incarnations may have been assigned that it does not contain.
    is_moved: bool,
    /// Number of the next record; the numbers have no gaps.
    next: i64,
}

/// Header of the file.
#[derive(Debug, Clone, Copy)]
struct Header {
    identity: Identity,
    /// Number of the last record if the log was closed or is a copy. Such a log needs no mark.
    sealed: Option<i64>,
}

impl Header {
    fn checksum(&self) -> Vec<u8> {
        let mut hash = blake3::Hasher::new();
        hash.update(&self.identity).update(&self.sealed.map_or([0xff; 8], i64::to_le_bytes));
        hash.finalize().as_bytes()[..16].to_vec()
    }

    fn read(row: &SqliteRow) -> Option<Self> {
        let identity: Vec<u8> = row.try_get(0).ok()?;
        let header = Self { identity: identity.try_into().ok()?, sealed: row.try_get(1).ok()? };
        let sum: Vec<u8> = row.try_get(2).ok()?;
        (sum == header.checksum()).then_some(header)
    }
}

/// Minimum content that the file must have.
struct RequiredContent {
    /// Number of the last record that must exist.
    sequence: i64,
    /// Highest incarnation that is known to be reserved.
    incarnation: u32,
    /// Error if content is missing, or if that cannot be determined.
    error: Option<QueueError>,
}

/// Statements that create the tables.
///
/// A note's `sequence` is the number of the first record of its batch, or of the last record before the batch if it has no records.
/// When the tail of the log is cut off, this removes the notes of batches that are removed completely.
const TABLES: &str = "
    CREATE TABLE log (sequence INTEGER PRIMARY KEY, checksum BLOB NOT NULL, record BLOB NOT NULL) STRICT;
    CREATE TABLE snapshot (sequence INTEGER PRIMARY KEY, checksum BLOB NOT NULL, state BLOB NOT NULL) STRICT;
    CREATE TABLE notes (subject INTEGER NOT NULL, number INTEGER NOT NULL, sequence INTEGER NOT NULL,
        checksum BLOB NOT NULL, note BLOB NOT NULL, PRIMARY KEY (subject, number)) STRICT, WITHOUT ROWID;
    CREATE TABLE header (identity BLOB NOT NULL, sealed INTEGER, checksum BLOB NOT NULL) STRICT;
    PRAGMA application_id = 0x66656d63;
    PRAGMA user_version = 2;
";

/// Inserts a note. The first number of a subject is 1.
const INSERT_NOTE: &str = "
    INSERT INTO notes (subject, number, sequence, checksum, note)
    VALUES (?1, 1 + (SELECT ifnull(max(number), 0) FROM notes WHERE subject = ?1), ?2, ?3, ?4)";

/// Numbers of rows, descending, with a statement that inserts this number of rows.
static INSERT_STATEMENTS: LazyLock<[(usize, String); 3]> = LazyLock::new(|| {
    [64, 8, 1].map(|rows| {
        let placeholders = vec!["(?, ?, ?)"; rows].join(", ");
        (rows, format!("INSERT INTO log (sequence, checksum, record) VALUES {placeholders}"))
    })
});

impl Sqlite {
    /// `PRAGMA application_id`: the letters `femc`.
    pub const APPLICATION_ID: i64 = 0x6665_6d63;
    /// `PRAGMA user_version`: the version of the tables, not of the records.
    pub const VERSION: i64 = 2;

    /// Opens the log at `path`, or creates it. A log that has lost acknowledged records fails to load.
    pub async fn open(path: &Path) -> Result<Self, QueueError> {
        Self::open_with(path, LossPolicy::Refuse).await
    }

    /// Opens the log at `path`, or creates it.
    /// - `loss_policy`: policy for a log that has lost acknowledged records.
    pub async fn open_with(path: &Path, loss: LossPolicy) -> Result<Self, QueueError> {
        let options = connect_options(path)
            .create_if_missing(true)
            .locking_mode(SqliteLockingMode::Exclusive)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full);
        let in_use =
            |error| if is_busy(&error) { QueueError::InUse { path: path.display().to_string() } } else { error.into() };
        let mut connection = options.connect().await.map_err(in_use)?;
        // Take the lock now, not at the first write.
        sqlx::raw_sql("BEGIN EXCLUSIVE; COMMIT;").execute(&mut connection).await.map_err(in_use)?;
        let application = query_number(&mut connection, "PRAGMA application_id").await?;
        let version = query_number(&mut connection, "PRAGMA user_version").await?;
        let tables = query_number(&mut connection, "SELECT count(*) FROM sqlite_schema").await?;
        match (application, version, tables) {
            (0, 0, 0) => create_tables(&mut connection).await.map_err(|error| map_write_error(error, path))?,
            (Self::APPLICATION_ID, Self::VERSION, _) => {}
            _ => return Err(QueueError::ForeignFile { path: path.display().to_string(), application, version }),
        }
        let headers = sqlx::query("SELECT identity, sealed, checksum FROM header").fetch_all(&mut connection).await?;
        let header = if let [header] = &headers[..] { Header::read(header) } else { None };
        Ok(Self {
            connection,
            path: path.to_owned(),
            loss_policy: loss,
            header,
            watermark: None,
            is_moved: false,
            next: 1,
        })
    }

    /// Returns the path of a file beside the log: the log's path followed by `end`.
    fn sibling_path(&self, suffix: &str) -> PathBuf {
        let mut name = self.path.clone().into_os_string();
        name.push(suffix);
        PathBuf::from(name)
    }

    /// Determines the minimum content of the file. Changes nothing but `is_moved`.
    fn required_content(&mut self) -> Result<RequiredContent, QueueError> {
        let (path, mark) = (self.path.display().to_string(), self.sibling_path("-mark"));
        let found = Watermark::read(&mark)?;
        let incarnation = match found {
            WatermarkFile::Valid(state) => state.incarnation,
            WatermarkFile::Missing | WatermarkFile::Damaged => 0,
        };
        let at = |sequence| RequiredContent { sequence, incarnation, error: None };
        let lacks = |lack| RequiredContent { error: Some(lack), ..at(0) };
        let unsure = |why: String| lacks(QueueError::Unverifiable { path: path.clone(), why });
        let mark = mark.display();
        let Some(Header { identity, sealed }) = self.header else {
            return Ok(unsure("its header is damaged".into()));
        };
        Ok(match (found, sealed) {
            (WatermarkFile::Valid(state), _) if state.identity == identity => {
                at(state.sequence.max(sealed.unwrap_or(0)))
            }
            // The log of the mark is gone, and this one has just been created.
            (WatermarkFile::Valid(WatermarkState { sequence: known @ 1.., .. }), Some(0)) => {
                lacks(QueueError::MissingRecords { path: path.clone(), kept: 0, known })
            }
            // Another log replaces the log of the mark: for instance a copy.
            (WatermarkFile::Valid(_) | WatermarkFile::Missing | WatermarkFile::Damaged, Some(sealed)) => {
                self.is_moved = sealed > 0;
                at(sealed)
            }
            (WatermarkFile::Valid(_), None) => unsure(format!("{mark} belongs to another log")),
            (WatermarkFile::Missing, None) => {
                unsure(format!("{mark}, which states the last durable record, is missing"))
            }
            (WatermarkFile::Damaged, None) => {
                unsure(format!("{mark}, which states the last durable record, is damaged"))
            }
        })
    }

    /// Reads the sound content of the log, and determines what it must contain. Changes nothing in the file.
    async fn read(&mut self) -> Result<(LogRows, RequiredContent), QueueError> {
        let newest = "SELECT sequence, checksum, state FROM snapshot ORDER BY sequence DESC LIMIT 1";
        let snapshot = sqlx::query(newest).fetch_optional(&mut self.connection).await?;
        let snapshot = snapshot.as_ref().map(read_row).transpose()?;
        let rows = sqlx::query("SELECT sequence, checksum, record FROM log WHERE sequence > ? ORDER BY sequence")
            .bind(snapshot.as_ref().map_or(0, |snapshot| snapshot.sequence))
            .fetch_all(&mut self.connection)
            .await?;
        let rows: Vec<Row> = rows.iter().map(read_row).collect::<Result<_, _>>()?;
        let mut checked = check_rows(snapshot, rows)?;
        let mut required = self.required_content()?;
        if required.error.is_none() && checked.last < required.sequence {
            let path = self.path.display().to_string();
            required.error = Some(QueueError::MissingRecords { path, kept: checked.last, known: required.sequence });
        }
        required.error = checked.damage.take().or(required.error);
        Ok((checked, required))
    }

    /// Copies the write-ahead log, of which SQLite ignores the damaged part: closing the log would delete it.
    fn copy_write_ahead_log(&self) {
        let (ahead, copy) = (self.sibling_path("-wal"), self.sibling_path("-wal-lost"));
        if fs::metadata(&ahead).is_ok_and(|file| file.len() > 0) {
            match fs::copy(&ahead, &copy) {
                Ok(_) => tracing::warn!(path = %copy.display(), "copied the write-ahead log"),
                Err(error) => tracing::warn!(path = %copy.display(), %error, "cannot copy the write-ahead log"),
            }
        }
    }

    /// Creates or updates the mark, which states from now on how much the log must contain.
    async fn start_watermark(&mut self, last: i64, incarnation: u32) -> Result<(), QueueError> {
        let identity = match self.header {
            Some(Header { identity, .. }) => identity,
            None => new_identity(&mut self.connection).await?,
        };
        let path = self.sibling_path("-mark");
        let state = WatermarkState { identity, sequence: last, incarnation };
        if self.watermark.as_ref().is_none_or(|mark| *mark.state() != state) {
            self.watermark = Some(Watermark::create(&path, state)?);
        }
        let header = Header { identity, sealed: None };
        if self.header.is_none_or(|header| header.sealed.is_some()) {
            self.seal(header).await?;
            // Write the unsealed header into the main file: a copy of this file without the mark is then detected.
            let checkpoint = sqlx::raw_sql("PRAGMA wal_checkpoint(TRUNCATE)").execute(&mut self.connection).await;
            checkpoint.map_err(|error| map_write_error(error, &self.path))?;
        }
        Ok(())
    }

    async fn seal(&mut self, header: Header) -> Result<(), QueueError> {
        self.begin_transaction().await?;
        let sealed = put_header(&mut self.connection, header).await;
        self.finish_transaction(sealed).await?;
        self.header = Some(header);
        Ok(())
    }

    async fn begin_transaction(&mut self) -> Result<(), QueueError> {
        let begun = sqlx::query("BEGIN IMMEDIATE").execute(&mut self.connection).await;
        begun.map(drop).map_err(|error| map_write_error(error, &self.path))
    }

    /// Records that `count` more numbers are durable.
    fn advance(&mut self, count: usize) {
        self.next += count as i64;
        if let Some(mark) = &mut self.watermark {
            mark.advance(self.next - 1);
        }
    }

    /// Commits a transaction, or rolls it back after an error.
    async fn finish_transaction(&mut self, done: Result<(), sqlx::Error>) -> Result<(), QueueError> {
        let ended = match done {
            Ok(()) => sqlx::query("COMMIT").execute(&mut self.connection).await.map(drop),
            Err(error) => Err(error),
        };
        if let Err(error) = ended {
            // This fails if SQLite has already rolled back by itself.
            let _ = sqlx::query("ROLLBACK").execute(&mut self.connection).await;
            return Err(map_write_error(error, &self.path));
        }
        Ok(())
    }
}

fn connect_options(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new().filename(path).busy_timeout(Duration::from_millis(200)).disable_statement_logging()
}

async fn query_number(connection: &mut SqliteConnection, sql: &'static str) -> Result<i64, sqlx::Error> {
    sqlx::query(sql).fetch_one(connection).await?.try_get(0)
}

/// Creates a unique identity for a log.
async fn new_identity(connection: &mut SqliteConnection) -> Result<Identity, sqlx::Error> {
    let random: Vec<u8> = sqlx::query("SELECT randomblob(16)").fetch_one(connection).await?.try_get(0)?;
    random.try_into().map_err(|_| sqlx::Error::Protocol("randomblob(16) did not return 16 bytes".into()))
}

/// Creates the tables. The header is sealed, because the log has no mark yet.
async fn create_tables(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    let mut transaction = connection.begin().await?;
    sqlx::raw_sql(TABLES).execute(&mut *transaction).await?;
    let identity = new_identity(&mut transaction).await?;
    put_header(&mut transaction, Header { identity, sealed: Some(0) }).await?;
    transaction.commit().await
}

async fn put_header(connection: &mut SqliteConnection, header: Header) -> Result<(), sqlx::Error> {
    sqlx::query("DELETE FROM header").execute(&mut *connection).await?;
    let put = sqlx::query("INSERT INTO header (identity, sealed, checksum) VALUES (?, ?, ?)");
    let put = put.bind(header.identity.to_vec()).bind(header.sealed).bind(header.checksum());
    put.execute(connection).await.map(drop)
}

/// Returns SQLite's extended error code.
fn sqlite_code(error: &sqlx::Error) -> Option<i64> {
    error.as_database_error()?.code()?.parse().ok()
}

fn is_busy(error: &sqlx::Error) -> bool {
    // SQLITE_BUSY and SQLITE_LOCKED, with their extended codes.
    sqlite_code(error).is_some_and(|code| matches!(code & 0xff, 5 | 6))
}

/// Converts an error of a write to the log at `path`.
fn map_write_error(error: sqlx::Error, path: &Path) -> QueueError {
    // SQLITE_FULL, or SQLITE_IOERR, which SQLite reports when a quota is exceeded.
    let is_full = match sqlite_code(&error).map(|code| code & 0xff) {
        Some(13) => true,
        Some(10) => is_disk_full(path),
        _ => false,
    };
    if !is_full {
        return error.into();
    }
    let message = error.as_database_error().map_or_else(|| error.to_string(), |error| error.message().to_owned());
    QueueError::OutOfSpace { place: path.display().to_string(), message }
}

/// Checks whether a test file beside the log cannot be written for lack of space.
fn is_disk_full(path: &Path) -> bool {
    let mut name = path.to_owned().into_os_string();
    name.push("-room");
    let written = File::create(&name).and_then(|mut file| file.write_all(&[0; 1 << 16]));
    // The test file is not needed any more.
    let _ = fs::remove_file(&name);
    written.is_err_and(|error| is_out_of_space(&error))
}

fn read_row(row: &SqliteRow) -> Result<Row, sqlx::Error> {
    Ok(Row { sequence: row.try_get(0)?, checksum: row.try_get(1)?, bytes: row.try_get(2)? })
}

/// Removes the records after record `last`, with their notes.
async fn delete_tail(connection: &mut SqliteConnection, last: i64) -> Result<(), sqlx::Error> {
    sqlx::query("DELETE FROM log WHERE sequence > ?").bind(last).execute(&mut *connection).await?;
    sqlx::query("DELETE FROM notes WHERE sequence > ?").bind(last).execute(connection).await.map(drop)
}

/// Inserts a batch.
/// - `next`: number of its first record, or of the row that represents a batch without records.
async fn insert_batch(connection: &mut SqliteConnection, batch: Batch<'_>, next: i64) -> Result<(), sqlx::Error> {
    let Batch { records, notes, forgotten } = batch;
    let (mut sequence, mut rest) = (next, records);
    if records.is_empty() {
        let nothing = sqlx::query(INSERT_STATEMENTS[INSERT_STATEMENTS.len() - 1].1.as_str())
            .bind(next)
            .bind(blank_checksum(next));
        nothing.bind(&[][..]).execute(&mut *connection).await?;
    }
    while !rest.is_empty() {
        // Each statement is a message to SQLite's thread and back. So a statement inserts many rows; it has one of a few lengths,
        // which stay prepared.
        let (rows, sql) = INSERT_STATEMENTS
            .iter()
            .find(|(rows, _)| *rows <= rest.len())
            .unwrap_or(&INSERT_STATEMENTS[INSERT_STATEMENTS.len() - 1]);
        let (some, later) = rest.split_at(*rows);
        let mut insert = sqlx::query(sql.as_str());
        for (sequence, record) in (sequence..).zip(some) {
            insert = insert.bind(sequence).bind(checksum(sequence, record)).bind(record.as_slice());
        }
        insert.execute(&mut *connection).await?;
        sequence += some.len() as i64;
        rest = later;
    }
    for &subject in forgotten {
        sqlx::query("DELETE FROM notes WHERE subject = ?")
            .bind(subject.cast_signed())
            .execute(&mut *connection)
            .await?;
    }
    for note in notes {
        sqlx::query(INSERT_NOTE)
            .bind(note.subject.cast_signed())
            .bind(next)
            .bind(note_checksum(&note.bytes))
            .bind(note.bytes.as_slice())
            .execute(&mut *connection)
            .await?;
    }
    Ok(())
}

/// Inserts a snapshot and removes all snapshots and records that it replaces.
/// - `number`: number of the snapshot; it replaces all lower numbers.
async fn insert_snapshot(connection: &mut SqliteConnection, number: i64, state: &[u8]) -> Result<(), sqlx::Error> {
    sqlx::query("INSERT OR REPLACE INTO snapshot (sequence, checksum, state) VALUES (?, ?, ?)")
        .bind(number)
        .bind(checksum(number, state))
        .bind(state)
        .execute(&mut *connection)
        .await?;
    sqlx::query("DELETE FROM snapshot WHERE sequence < ?").bind(number).execute(&mut *connection).await?;
    sqlx::query("DELETE FROM log WHERE sequence <= ?").bind(number).execute(connection).await.map(drop)
}

/// Returns the minutes since the year 2020, as far as 24 bits allow: a later start gets a greater number.
fn minutes_since_2020() -> u32 {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u32::try_from(since_1970.as_secs().saturating_sub(1_577_836_800) / 60).unwrap_or(0).min((1 << 24) - (1 << 16))
}

impl Queue for Sqlite {
    async fn load(&mut self) -> Result<LogContents, QueueError> {
        let (LogRows { mut contents, last, .. }, required) = self.read().await?;
        if let Some(error) = required.error {
            self.copy_write_ahead_log();
            if self.loss_policy == LossPolicy::Refuse {
                return Err(error);
            }
            let known = match error {
                QueueError::Damaged { sequence, .. } => Some(required.sequence.max(sequence)),
                QueueError::MissingRecords { known, .. } => Some(known),
                _ => None,
            };
            contents.missing = Some(MissingRecords { last_existing: last, last_known: known });
            self.is_moved = true;
            self.begin_transaction().await?;
            let cut = delete_tail(&mut self.connection, last).await;
            self.finish_transaction(cut).await?;
        }
        self.start_watermark(last, required.incarnation).await?;
        self.next = last + 1;
        Ok(contents)
    }

    async fn append(&mut self, batch: Batch<'_>) -> Result<(), QueueError> {
        if batch.is_empty() {
            return Ok(());
        }
        self.begin_transaction().await?;
        let put = insert_batch(&mut self.connection, batch, self.next).await;
        self.finish_transaction(put).await?;
        self.advance(batch.records.len().max(1));
        Ok(())
    }

    /// Stores a snapshot. It has a number like a record, so that its loss is detected.
    async fn snapshot(&mut self, state: &[u8]) -> Result<(), QueueError> {
        self.begin_transaction().await?;
        let replaced = insert_snapshot(&mut self.connection, self.next, state).await;
        self.finish_transaction(replaced).await?;
        self.advance(1);
        Ok(())
    }

    async fn reserve(&mut self, min_incarnation: u32) -> Result<u32, QueueError> {
        let Some(mark) = &mut self.watermark else { return Ok(min_incarnation) };
        let min_incarnation = if std::mem::take(&mut self.is_moved) {
            min_incarnation.max(minutes_since_2020())
        } else {
            min_incarnation
        };
        let incarnation = min_incarnation.max(mark.state().incarnation.saturating_add(1));
        mark.reserve(incarnation)?;
        Ok(incarnation)
    }

    async fn notes(&mut self, subject: u64, from: u64) -> Result<NotePage, QueueError> {
        let rows = sqlx::query(
            "SELECT number, checksum, note FROM notes WHERE subject = ? AND number >= ? ORDER BY number LIMIT ?",
        )
        .bind(subject.cast_signed())
        .bind(from.cast_signed())
        .bind(NotePage::MAX_NOTES as i64 + 1)
        .fetch_all(&mut self.connection)
        .await?;
        Ok(note_page(rows.iter().map(read_row).collect::<Result<_, _>>()?))
    }

    /// Writes the copy beside the log, where there is room for it. Nothing is appended meanwhile. The copy is a log of its own:
    /// this log's mark does not apply to it.
    async fn copy(&mut self) -> Result<File, QueueError> {
        let path = self.sibling_path(".copy");
        // A killed coordinator may have left a copy.
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error.into()),
            Ok(()) | Err(_) => {}
        }
        let copied = sqlx::query("VACUUM INTO ?").bind(path.display().to_string()).execute(&mut self.connection).await;
        let named = match copied {
            Ok(_) => seal_copy(&path, self.next - 1).await,
            Err(error) => Err(error),
        };
        let file = named.map_err(|error| map_write_error(error, &self.path)).and_then(|()| Ok(File::open(&path)?));
        // If the copy could not be written, there may be no file.
        let _ = fs::remove_file(&path);
        file
    }

    /// Closes the log. After this, one file contains everything; before, the newest records may be in the `-wal` file beside it.
    async fn close(mut self) -> Result<(), QueueError> {
        if let (Some(mark), Some(header)) = (&mut self.watermark, self.header) {
            let sealed = Some(mark.state().sequence);
            if let Err(error) = mark.sync() {
                tracing::warn!(%error, "cannot sync the log's mark to the disk");
            }
            match self.seal(Header { sealed, ..header }).await {
                // Without room, the header stays unsealed and the mark stays valid.
                Ok(()) | Err(QueueError::OutOfSpace { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(self.connection.close().await?)
    }
}

/// Gives a copy its own identity and seals it with its last record.
async fn seal_copy(path: &Path, last: i64) -> Result<(), sqlx::Error> {
    let mut copy = connect_options(path).journal_mode(SqliteJournalMode::Delete).connect().await?;
    let identity = new_identity(&mut copy).await?;
    put_header(&mut copy, Header { identity, sealed: Some(last) }).await?;
    copy.close().await
}
