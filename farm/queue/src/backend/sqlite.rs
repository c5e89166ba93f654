//! A log in one SQLite file: WAL mode, every commit synced, one transaction a batch.
//!
//! SQLite restores whole transactions after a crash by itself. The checksum of each record finds what SQLite cannot:
//! pages that the disk has lost or changed. The file is locked, so that a second coordinator finds out at once.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use sqlx::sqlite::{
    SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqliteLockingMode, SqliteRow, SqliteSynchronous,
};
use sqlx::{ConnectOptions as _, Connection as _, Row as _};

use super::rows::{Row, checksum, contents, note_checksum, page};
use crate::{Batch, Contents, Page, Queue, QueueError};

/// A log in a file.
#[derive(Debug)]
pub struct Sqlite {
    connection: SqliteConnection,
    path: PathBuf,
    /// Number of the next record; they have no gaps.
    next: i64,
}

const TABLES: &str = "
    CREATE TABLE log (sequence INTEGER PRIMARY KEY, checksum BLOB NOT NULL, record BLOB NOT NULL) STRICT;
    CREATE TABLE snapshot (sequence INTEGER PRIMARY KEY, checksum BLOB NOT NULL, state BLOB NOT NULL) STRICT;
";

/// What later versions have added. A version that does not know them works beside them.
///
/// A note's `sequence` is that of the first record of its batch, or of the last before: a tail that is cut takes along the notes
/// of batches of which nothing is left.
const LATER_TABLES: &str = "
    CREATE TABLE IF NOT EXISTS notes (subject INTEGER NOT NULL, number INTEGER NOT NULL, sequence INTEGER NOT NULL,
        checksum BLOB NOT NULL, note BLOB NOT NULL, PRIMARY KEY (subject, number)) STRICT, WITHOUT ROWID;
";

/// The first number of a subject is 1.
const NOTE: &str = "
    INSERT INTO notes (subject, number, sequence, checksum, note)
    VALUES (?1, 1 + (SELECT ifnull(max(number), 0) FROM notes WHERE subject = ?1), ?2, ?3, ?4)";

/// Statements that insert so many rows, the longest first.
static INSERTS: LazyLock<[(usize, String); 3]> = LazyLock::new(|| {
    [64, 8, 1].map(|rows| {
        let places = vec!["(?, ?, ?)"; rows].join(", ");
        (rows, format!("INSERT INTO log (sequence, checksum, record) VALUES {places}"))
    })
});

impl Sqlite {
    /// `PRAGMA application_id`: the letters of femc.
    pub const APPLICATION: i64 = 0x6665_6d63;
    /// `PRAGMA user_version`: of the tables, not of the records.
    pub const VERSION: i64 = 1;

    /// Opens the log at `path`, or makes it.
    pub async fn open(path: &Path) -> Result<Self, QueueError> {
        let options = SqliteConnectOptions::new()
            .filename(path)
            .create_if_missing(true)
            .locking_mode(SqliteLockingMode::Exclusive)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .busy_timeout(std::time::Duration::from_millis(200))
            .disable_statement_logging();
        let in_use =
            |error| if is_busy(&error) { QueueError::InUse { path: path.display().to_string() } } else { error.into() };
        let mut connection = options.connect().await.map_err(in_use)?;
        // Takes the lock now, not at the first write.
        sqlx::raw_sql("BEGIN EXCLUSIVE; COMMIT;").execute(&mut connection).await.map_err(in_use)?;
        let number = async |connection: &mut SqliteConnection, sql: &'static str| -> Result<i64, QueueError> {
            Ok(sqlx::query(sql).fetch_one(connection).await?.try_get(0)?)
        };
        let application = number(&mut connection, "PRAGMA application_id").await?;
        let version = number(&mut connection, "PRAGMA user_version").await?;
        let tables = number(&mut connection, "SELECT count(*) FROM sqlite_schema").await?;
        if (application, version, tables) == (0, 0, 0) {
            let mut begin = connection.begin().await?;
            sqlx::raw_sql(TABLES).execute(&mut *begin).await?;
            sqlx::raw_sql("PRAGMA application_id = 0x66656d63; PRAGMA user_version = 1;").execute(&mut *begin).await?;
            begin.commit().await?;
        } else if (application, version) != (Self::APPLICATION, Self::VERSION) {
            return Err(QueueError::Foreign { path: path.display().to_string(), application, version });
        }
        sqlx::raw_sql(LATER_TABLES).execute(&mut connection).await?;
        Ok(Self { connection, path: path.to_owned(), next: 1 })
    }
}

fn is_busy(error: &sqlx::Error) -> bool {
    // SQLITE_BUSY and SQLITE_LOCKED, with their extended codes.
    let code = error.as_database_error().and_then(|error| error.code()?.parse::<i64>().ok());
    code.is_some_and(|code| matches!(code & 0xff, 5 | 6))
}

fn row(row: &SqliteRow) -> Result<Row, sqlx::Error> {
    Ok(Row { sequence: row.try_get(0)?, sum: row.try_get(1)?, bytes: row.try_get(2)? })
}

impl Queue for Sqlite {
    async fn load(&mut self) -> Result<Contents, QueueError> {
        let newest = "SELECT sequence, checksum, state FROM snapshot ORDER BY sequence DESC LIMIT 1";
        let snapshot = sqlx::query(newest).fetch_optional(&mut self.connection).await?;
        let snapshot = snapshot.as_ref().map(row).transpose()?;
        let rows = sqlx::query("SELECT sequence, checksum, record FROM log WHERE sequence > ? ORDER BY sequence")
            .bind(snapshot.as_ref().map_or(0, |snapshot| snapshot.sequence))
            .fetch_all(&mut self.connection)
            .await?;
        let rows: Vec<Row> = rows.iter().map(row).collect::<Result<_, _>>()?;
        let (contents, last) = contents(snapshot, rows)?;
        if contents.torn > 0 {
            let mut cut = self.connection.begin().await?;
            sqlx::query("DELETE FROM log WHERE sequence > ?").bind(last).execute(&mut *cut).await?;
            sqlx::query("DELETE FROM notes WHERE sequence > ?").bind(last).execute(&mut *cut).await?;
            cut.commit().await?;
        }
        self.next = last + 1;
        Ok(contents)
    }

    async fn append(&mut self, Batch { records, notes, forgotten }: Batch<'_>) -> Result<(), QueueError> {
        let mut batch = self.connection.begin().await?;
        let (mut sequence, mut rest) = (self.next, records);
        while !rest.is_empty() {
            // Each statement is a message to SQLite's thread and back: many rows in one, in a few lengths that stay prepared.
            let (rows, sql) =
                INSERTS.iter().find(|(rows, _)| *rows <= rest.len()).unwrap_or(&INSERTS[INSERTS.len() - 1]);
            let (some, later) = rest.split_at(*rows);
            let mut insert = sqlx::query(sql.as_str());
            for (sequence, record) in (sequence..).zip(some) {
                insert = insert.bind(sequence).bind(checksum(sequence, record)).bind(record.as_slice());
            }
            insert.execute(&mut *batch).await?;
            sequence += some.len() as i64;
            rest = later;
        }
        for &subject in forgotten {
            sqlx::query("DELETE FROM notes WHERE subject = ?").bind(subject.cast_signed()).execute(&mut *batch).await?;
        }
        let at = if records.is_empty() { self.next - 1 } else { self.next };
        for note in notes {
            sqlx::query(NOTE)
                .bind(note.subject.cast_signed())
                .bind(at)
                .bind(note_checksum(&note.bytes))
                .bind(note.bytes.as_slice())
                .execute(&mut *batch)
                .await?;
        }
        batch.commit().await?;
        self.next += records.len() as i64;
        Ok(())
    }

    async fn snapshot(&mut self, state: &[u8]) -> Result<(), QueueError> {
        let last = self.next - 1;
        let mut batch = self.connection.begin().await?;
        sqlx::query("INSERT OR REPLACE INTO snapshot (sequence, checksum, state) VALUES (?, ?, ?)")
            .bind(last)
            .bind(checksum(last, state))
            .bind(state)
            .execute(&mut *batch)
            .await?;
        sqlx::query("DELETE FROM snapshot WHERE sequence < ?").bind(last).execute(&mut *batch).await?;
        sqlx::query("DELETE FROM log WHERE sequence <= ?").bind(last).execute(&mut *batch).await?;
        batch.commit().await?;
        Ok(())
    }

    async fn notes(&mut self, subject: u64, from: u64) -> Result<Page, QueueError> {
        let rows = sqlx::query(
            "SELECT number, checksum, note FROM notes WHERE subject = ? AND number >= ? ORDER BY number LIMIT ?",
        )
        .bind(subject.cast_signed())
        .bind(from.cast_signed())
        .bind(Page::NOTES as i64 + 1)
        .fetch_all(&mut self.connection)
        .await?;
        Ok(page(rows.iter().map(row).collect::<Result<_, _>>()?))
    }

    /// Beside the log, where there is room for one. Meanwhile nothing is appended.
    async fn copy(&mut self) -> Result<File, QueueError> {
        let mut name = self.path.clone().into_os_string();
        name.push(".copy");
        let path = PathBuf::from(name);
        // What a coordinator that was killed has left.
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error.into()),
            Ok(()) | Err(_) => {}
        }
        let copied = sqlx::query("VACUUM INTO ?").bind(path.display().to_string()).execute(&mut self.connection).await;
        let file = copied.map_err(QueueError::from).and_then(|_| Ok(File::open(&path)?));
        // Gone before it was made, where it could not be.
        let _ = fs::remove_file(&path);
        file
    }

    /// One file holds it all from then on; until then the newest records may lie in the file beside it, `-wal`.
    async fn close(self) -> Result<(), QueueError> {
        Ok(self.connection.close().await?)
    }
}
