//! The tables in PostgreSQL, and their version.

use sqlx::postgres::PgConnection;
use sqlx::{Connection as _, Row as _};

use super::database::Database;
use crate::QueueError;

/// Version of the tables.
pub(super) const VERSION: i32 = 2;

/// Key of the advisory lock that is held while the tables are created: the letters `fems`.
const CREATION_LOCK: i64 = 0x6665_6d73;

/// Statements that create the tables.
///
/// `leader` has one row, with the highest reserved incarnation. Writes to the log keep its key from changing; its other columns may
/// change during a write.
///
/// A note's `sequence` is the number of the first record of its batch, or of the last record before the batch if it has no records.
/// When the tail of the log is cut off, this removes the notes of batches that are removed completely.
const TABLES: &str = "
    CREATE TABLE femc.header (version integer NOT NULL);
    CREATE TABLE femc.leader (epoch bigint PRIMARY KEY, url text NOT NULL, backend integer NOT NULL,
        seen timestamptz NOT NULL, incarnation bigint NOT NULL DEFAULT 0) WITH (fillfactor = 50);
    CREATE TABLE femc.log (sequence bigint PRIMARY KEY, checksum bytea NOT NULL, record bytea NOT NULL);
    CREATE TABLE femc.snapshot (sequence bigint PRIMARY KEY, checksum bytea NOT NULL, state bytea NOT NULL);
    CREATE TABLE femc.notes (number bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
        subject bigint NOT NULL, sequence bigint NOT NULL, checksum bytea NOT NULL, note bytea NOT NULL);
    CREATE INDEX notes_by_subject ON femc.notes (subject, number);
    INSERT INTO femc.header VALUES (2);
    INSERT INTO femc.leader VALUES (0, '', 0, '-infinity');
";

/// Creates the tables if they are missing. Tables of another program or version are refused and not changed.
pub(super) async fn prepare(database: &Database, connection: &mut PgConnection) -> Result<(), QueueError> {
    let found = create_or_find_tables(connection).await.map_err(|error| database.map_sql_error(&error))?;
    if found.as_deref() == Some(VERSION.to_string().as_str()) {
        return Ok(());
    }
    Err(QueueError::ForeignTables { database: database.to_string(), found })
}

async fn create_or_find_tables(connection: &mut PgConnection) -> Result<Option<String>, sqlx::Error> {
    let mut transaction = connection.begin().await?;
    // Two coordinators may start at the same time.
    sqlx::query("SELECT pg_advisory_xact_lock($1)").bind(CREATION_LOCK).execute(&mut *transaction).await?;
    let query = "SELECT to_regnamespace('femc') IS NOT NULL, to_regclass('femc.header') IS NOT NULL,
        EXISTS (SELECT FROM pg_class WHERE relnamespace = to_regnamespace('femc'))";
    let found = sqlx::query(query).fetch_one(&mut *transaction).await?;
    let (has_schema, has_header, has_tables): (bool, bool, bool) =
        (found.try_get(0)?, found.try_get(1)?, found.try_get(2)?);
    if !has_tables {
        if !has_schema {
            sqlx::raw_sql("CREATE SCHEMA femc").execute(&mut *transaction).await?;
        }
        sqlx::raw_sql(TABLES).execute(&mut *transaction).await?;
    }
    // Read through JSON, because the header of another program may have other columns.
    let query = "SELECT to_jsonb(header) ->> 'version' FROM femc.header LIMIT 1";
    let version: Option<String> = if has_tables && !has_header {
        None
    } else {
        sqlx::query(query).fetch_optional(&mut *transaction).await?.map(|row| row.try_get(0)).transpose()?.flatten()
    };
    transaction.commit().await?;
    Ok(version)
}
