//! Scratch databases on the server that `FEMC_TEST_POSTGRES` names; `tests/postgres COMMAND` starts one for a command.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

use femc_require::Prerequisite;
use sqlx::postgres::{PgConnectOptions, PgConnection, PgSslMode};
use sqlx::{AssertSqlSafe, ConnectOptions as _};
use tokio::sync::Notify;

use crate::LogContents;
use crate::backend::postgres;

/// A database for one test. It is not dropped: that would take a second, and the test server itself is temporary.
#[derive(Debug)]
pub struct ScratchDatabase {
    server: PgConnectOptions,
    name: String,
}

impl ScratchDatabase {
    /// Creates a database; `None` without a server (see [`Prerequisite::or_skip`]).
    ///
    /// # Panics
    /// If a required server is missing or refuses.
    pub async fn new() -> Option<Self> {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let url = Prerequisite::Postgres.variable_or_skip("FEMC_TEST_POSTGRES")?;
        let server: PgConnectOptions = url.parse().expect("FEMC_TEST_POSTGRES is an address");
        let server = server.ssl_mode(PgSslMode::Disable);
        // A later process may have the same number.
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos());
        let name = format!("femc_{}_{now}_{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        let database = Self { server, name };
        database.run_on_server(&format!("CREATE DATABASE {}", database.name)).await;
        Some(database)
    }

    /// Returns its address in the form that `--store` takes.
    pub fn url(&self) -> String {
        self.options().to_url_lossy().to_string()
    }

    /// Returns its address with the host name of the server's certificate, and the file with the certificate's authority; `None` if
    /// the server has no certificate (see [`Prerequisite::or_skip`]).
    pub fn encrypted_url(&self) -> Option<(String, String)> {
        let authority = Prerequisite::Postgres.variable_or_skip("FEMC_TEST_POSTGRES_CA")?;
        let url = self.options().host("localhost").to_url_lossy().to_string();
        let (address, _) = url.split_once('?').unwrap_or((&url, ""));
        Some((format!("{address}?sslmode=verify-full&sslrootcert={authority}"), authority))
    }

    fn options(&self) -> PgConnectOptions {
        self.server.clone().database(&self.name)
    }

    async fn run_on_server(&self, sql: &str) {
        let mut server = self.server.connect().await.expect("the server accepts the connection");
        run(&mut server, sql).await;
    }

    /// Runs statements on the database behind a coordinator's back.
    ///
    /// # Panics
    /// If the server refuses.
    pub async fn tamper(&self, sql: &str) {
        let mut connection = self.options().connect().await.expect("the server accepts the connection");
        run(&mut connection, sql).await;
    }

    /// Runs a query whose result is one number, and returns the number.
    ///
    /// # Panics
    /// If the query fails.
    pub async fn query_number(&self, sql: &str) -> i64 {
        let mut connection = self.options().connect().await.expect("the server accepts the connection");
        sqlx::query_scalar(AssertSqlSafe(sql)).fetch_one(&mut connection).await.expect("a number")
    }
}

impl ScratchDatabase {
    /// Reads the log in the database at one point in time, whichever coordinator leads; `None`: no log exists.
    ///
    /// # Panics
    /// If it cannot be read, or is damaged.
    pub async fn log_contents(&self) -> Option<LogContents> {
        if self.query_number("SELECT count(*) FROM pg_tables WHERE schemaname = 'femc' AND tablename = 'log'").await
            == 0
        {
            return None;
        }
        let mut connection = self.options().connect().await.expect("the server accepts the connection");
        Some(postgres::read_contents(&mut connection).await.expect("a sound log"))
    }
}

async fn run(connection: &mut PgConnection, sql: &str) {
    let result = sqlx::raw_sql(AssertSqlSafe(sql)).execute(connection).await;
    result.unwrap_or_else(|error| panic!("{sql}: {error}"));
}

/// Locks `table` of the database at `url` until `release`.
///
/// # Panics
/// If the server refuses.
pub async fn lock_table(url: &str, table: &str, release: Arc<Notify>) {
    let options: PgConnectOptions = url.parse().expect("an address");
    let mut connection = options.connect().await.expect("the server accepts the connection");
    run(&mut connection, &format!("BEGIN; LOCK TABLE {table} IN ACCESS EXCLUSIVE MODE")).await;
    release.notified().await;
    run(&mut connection, "COMMIT").await;
}
