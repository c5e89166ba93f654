//! A log in PostgreSQL, for several coordinators of which one leads.
//!
//! The leader holds an advisory lock on its writing connection and has the greatest epoch. The lock reveals the leader's death
//! immediately. The epoch protects the log: every write checks the epoch within its own transaction and keeps it from changing
//! until the transaction ends. So a leader that was frozen, cut off or declared dead by mistake can write nothing once another one
//! leads. A batch is one statement and therefore one transaction, durable when it returns.
//!
//! This needs a server and a second connection for heartbeats ([`heartbeat`]). A connection pooler that shares one connection among
//! many clients (PgBouncer's transaction mode) makes the lock meaningless: connect directly.

mod database;
mod election;
mod heartbeat;
mod schema;

use std::fs::File;
use std::time::Duration;

use sqlx::Row as _;
use sqlx::postgres::{PgConnection, PgRow};

use super::rows::{LogRows, Row, check_rows, checksum, note_checksum, note_page};
use crate::{Batch, LogContents, LossPolicy, MissingRecords, NotePage, Queue, QueueError};
pub use database::Database;
pub use election::{Leader, Standby};
use heartbeat::HeartbeatTask;

/// A log whose leader is this process.
#[derive(Debug)]
pub struct Postgres {
    database: Database,
    connection: PgConnection,
    heartbeat: HeartbeatTask,
    epoch: i64,
    loss_policy: LossPolicy,
    /// Number of the next record; the numbers have no gaps.
    next_sequence: i64,
}

impl Postgres {
    /// Version of the tables, not of the records.
    pub const VERSION: i32 = schema::VERSION;
    /// Default time after which a leader without a heartbeat counts as dead.
    pub const SILENCE: Duration = Duration::from_secs(3);

    /// Returns the epoch of this leadership: each leadership has the next greater one.
    pub fn epoch(&self) -> i64 {
        self.epoch
    }

    /// Runs `work` on the connection. Fails as soon as this process cannot be sure that it leads.
    async fn while_leading<T>(
        database: &Database,
        heartbeat: &mut HeartbeatTask,
        work: impl Future<Output = Result<T, sqlx::Error>>,
    ) -> Result<T, QueueError> {
        tokio::select! {
            biased;
            done = work => done.map_err(|error| database.map_sql_error(&error)),
            doubt = heartbeat.until_doubtful() => Err(doubt),
        }
    }
}

/// `SELECT`s the leader's row if the epoch in `$1` leads, and prevents a change of leader until the transaction ends. Heartbeats
/// are not blocked, because they do not change the key.
macro_rules! as_leader {
    ($rest:literal) => {
        concat!("WITH mine AS MATERIALIZED (SELECT epoch FROM femc.leader WHERE epoch = $1 FOR KEY SHARE) ", $rest)
    };
}

const APPEND: &str = as_leader!(
    ", logged AS (INSERT INTO femc.log (sequence, checksum, record)
         SELECT row.* FROM mine, unnest($2::bigint[], $3::bytea[], $4::bytea[]) AS row),
       forgotten AS (DELETE FROM femc.notes WHERE subject = ANY($5) AND EXISTS (SELECT FROM mine)),
       noted AS (INSERT INTO femc.notes (subject, sequence, checksum, note)
         SELECT row.subject, $9, row.checksum, row.note
         FROM mine, unnest($6::bigint[], $7::bytea[], $8::bytea[]) AS row (subject, checksum, note))
     SELECT epoch FROM mine"
);
const SNAPSHOT: &str = as_leader!(
    ", older AS (DELETE FROM femc.snapshot WHERE sequence < $2 AND EXISTS (SELECT FROM mine)),
       covered AS (DELETE FROM femc.log WHERE sequence <= $2 AND EXISTS (SELECT FROM mine))
     INSERT INTO femc.snapshot (sequence, checksum, state) SELECT $2, $3, $4 FROM mine
     ON CONFLICT (sequence) DO UPDATE SET checksum = excluded.checksum, state = excluded.state"
);
/// Removes the records after `$2`, with their notes. Returns the number of the last removed record.
const DELETE_TAIL: &str = as_leader!(
    ", noted AS (DELETE FROM femc.notes WHERE sequence > $2 AND EXISTS (SELECT FROM mine)),
       cut AS (DELETE FROM femc.log WHERE sequence > $2 AND EXISTS (SELECT FROM mine) RETURNING sequence)
     SELECT (SELECT max(sequence) FROM cut) FROM mine"
);
/// Reserves an incarnation that is at least the number of minutes since the year 2020, as far as 24 bits allow. So a leader of a
/// restored dump, or of a standby server that has lost the tail, does not reuse the incarnations of the lost leaders.
const RESERVE: &str = "
    UPDATE femc.leader SET incarnation = greatest(incarnation + 1, $2,
        least(floor(extract(epoch FROM clock_timestamp() - timestamptz '2020-01-01 00:00Z') / 60), 16711680)::bigint)
    WHERE epoch = $1 RETURNING incarnation";

fn read_row(row: &PgRow) -> Result<Row, sqlx::Error> {
    Ok(Row { sequence: row.try_get(0)?, checksum: row.try_get(1)?, bytes: row.try_get(2)? })
}

/// Reads the latest snapshot and the records after it.
async fn read_log(connection: &mut PgConnection) -> Result<(Option<Row>, Vec<Row>), sqlx::Error> {
    let newest = "SELECT sequence, checksum, state FROM femc.snapshot ORDER BY sequence DESC LIMIT 1";
    let snapshot = sqlx::query(newest).fetch_optional(&mut *connection).await?;
    let snapshot = snapshot.as_ref().map(read_row).transpose()?;
    let after = "SELECT sequence, checksum, record FROM femc.log WHERE sequence > $1 ORDER BY sequence";
    let rows = sqlx::query(after).bind(snapshot.as_ref().map_or(0, |snapshot| snapshot.sequence));
    let rows = rows.fetch_all(&mut *connection).await?;
    Ok((snapshot, rows.iter().map(read_row).collect::<Result<_, _>>()?))
}

/// Returns the content of the log, whichever coordinator leads.
#[cfg(feature = "testing")]
pub(crate) async fn read_contents(connection: &mut PgConnection) -> Result<LogContents, QueueError> {
    use sqlx::Connection as _;
    let mut transaction = connection.begin_with("BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY").await?;
    let (snapshot, rows) = read_log(&mut transaction).await?;
    let LogRows { contents, damage, .. } = check_rows(snapshot, rows)?;
    damage.map_or(Ok(contents), Err)
}

impl Queue for Postgres {
    async fn load(&mut self) -> Result<LogContents, QueueError> {
        let read = read_log(&mut self.connection);
        let (snapshot, rows) = Self::while_leading(&self.database, &mut self.heartbeat, read).await?;
        let LogRows { mut contents, last, damage } = check_rows(snapshot, rows)?;
        match (damage, self.loss_policy) {
            (None, _) => {}
            (Some(damage), LossPolicy::Refuse) => return Err(damage),
            (Some(_), LossPolicy::Accept) => {
                let cut = sqlx::query(DELETE_TAIL).bind(self.epoch).bind(last).fetch_optional(&mut self.connection);
                let Some(row) = Self::while_leading(&self.database, &mut self.heartbeat, cut).await? else {
                    return Err(QueueError::Deposed { epoch: self.epoch });
                };
                let known = row.try_get(0).map_err(|error| self.database.map_sql_error(&error))?;
                contents.missing = Some(MissingRecords { last_existing: last, last_known: known });
            }
        }
        self.next_sequence = last + 1;
        Ok(contents)
    }

    async fn append(&mut self, batch: Batch<'_>) -> Result<(), QueueError> {
        if batch.is_empty() {
            return self.check();
        }
        let Batch { records, notes, forgotten } = batch;
        let sequences: Vec<i64> = (self.next_sequence..).take(records.len()).collect();
        let sums: Vec<Vec<u8>> = sequences.iter().zip(records).map(|(&at, record)| checksum(at, record)).collect();
        let last = self.next_sequence - 1 + records.len() as i64;
        let signed = |subjects: Vec<u64>| -> Vec<i64> { subjects.into_iter().map(u64::cast_signed).collect() };
        let append = sqlx::query(APPEND)
            .bind(self.epoch)
            .bind(sequences)
            .bind(sums)
            .bind(records)
            .bind(signed(forgotten.to_vec()))
            .bind(signed(notes.iter().map(|note| note.subject).collect()))
            .bind(notes.iter().map(|note| note_checksum(&note.bytes)).collect::<Vec<_>>())
            .bind(notes.iter().map(|note| note.bytes.as_slice()).collect::<Vec<_>>())
            .bind(if records.is_empty() { last } else { self.next_sequence })
            .fetch_optional(&mut self.connection);
        if Self::while_leading(&self.database, &mut self.heartbeat, append).await?.is_none() {
            return Err(QueueError::Deposed { epoch: self.epoch });
        }
        self.next_sequence = last + 1;
        Ok(())
    }

    async fn snapshot(&mut self, state: &[u8]) -> Result<(), QueueError> {
        let last = self.next_sequence - 1;
        let put = sqlx::query(SNAPSHOT).bind(self.epoch).bind(last).bind(checksum(last, state)).bind(state);
        let put = put.execute(&mut self.connection);
        if Self::while_leading(&self.database, &mut self.heartbeat, put).await?.rows_affected() != 1 {
            return Err(QueueError::Deposed { epoch: self.epoch });
        }
        Ok(())
    }

    async fn reserve(&mut self, min_incarnation: u32) -> Result<u32, QueueError> {
        let reserve = sqlx::query(RESERVE).bind(self.epoch).bind(i64::from(min_incarnation));
        let reserve = reserve.fetch_optional(&mut self.connection);
        let Some(row) = Self::while_leading(&self.database, &mut self.heartbeat, reserve).await? else {
            return Err(QueueError::Deposed { epoch: self.epoch });
        };
        let incarnation: i64 = row.try_get(0).map_err(|error| self.database.map_sql_error(&error))?;
        Ok(u32::try_from(incarnation).unwrap_or(u32::MAX))
    }

    async fn notes(&mut self, subject: u64, from: u64) -> Result<NotePage, QueueError> {
        let some = "SELECT number, checksum, note FROM femc.notes WHERE subject = $1 AND number >= $2
            ORDER BY number LIMIT $3";
        let read = sqlx::query(some)
            .bind(subject.cast_signed())
            .bind(from.cast_signed())
            .bind(NotePage::MAX_NOTES as i64 + 1)
            .fetch_all(&mut self.connection);
        let rows = Self::while_leading(&self.database, &mut self.heartbeat, read).await?;
        let rows: Result<Vec<Row>, sqlx::Error> = rows.iter().map(read_row).collect();
        Ok(note_page(rows.map_err(|error| self.database.map_sql_error(&error))?))
    }

    async fn copy(&mut self) -> Result<File, QueueError> {
        Err(QueueError::NoCopy {
            instead: "it is in PostgreSQL; copy it with `pg_dump --schema=femc`, which reads the log at one point in time",
        })
    }

    fn check(&mut self) -> Result<(), QueueError> {
        self.heartbeat.check()
    }
}
