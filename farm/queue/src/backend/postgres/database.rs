//! The address of a PostgreSQL database, and the classification of its errors.

use std::fmt;
use std::io;
use std::str::FromStr;
use std::time::Duration;

use sqlx::ConnectOptions as _;
use sqlx::postgres::{PgConnectOptions, PgConnection, PgSslMode};

use crate::QueueError;

/// A PostgreSQL database, given by its address. It is displayed without user and password.
///
/// The connection is encrypted unless the server is on this machine or the address contains `sslmode=disable`. As usual with
/// PostgreSQL, the server's identity is verified only with `sslmode=verify-full` (and `sslrootcert=FILE`, if this machine does not
/// trust the authority that issued the server's certificate).
#[derive(Clone)]
pub struct Database {
    url: String,
    options: Box<PgConnectOptions>,
}

/// Durability of commits on a connection.
#[derive(Debug, Clone, Copy)]
pub(super) enum Commit {
    /// A commit waits for the disk.
    Durable,
    /// A commit waits for nothing; its writes may be lost.
    Fleeting,
}

impl Database {
    /// Timeout for establishing a connection and for answering a small query.
    const TIMEOUT: Duration = Duration::from_secs(5);

    pub(super) async fn connect(&self, commit: Commit) -> Result<PgConnection, QueueError> {
        let setting = match commit {
            Commit::Durable => "on",
            Commit::Fleeting => "off",
        };
        let options = self.options.as_ref().clone().options([("synchronous_commit", setting)]);
        self.with_timeout(options.connect()).await
    }

    /// Waits for the server's answer to `request`, with a timeout.
    pub(super) async fn with_timeout<T>(
        &self,
        request: impl Future<Output = Result<T, sqlx::Error>>,
    ) -> Result<T, QueueError> {
        match tokio::time::timeout(Self::TIMEOUT, request).await {
            Ok(answer) => answer.map_err(|error| self.map_sql_error(&error)),
            Err(_) => Err(self.unreachable_error("it does not answer")),
        }
    }

    pub(super) fn unreachable_error(&self, message: impl fmt::Display) -> QueueError {
        QueueError::Unreachable { database: self.to_string(), message: message.to_string() }
    }

    /// Returns the reason if a failed connection would fail again.
    fn permanent_cause(&self, error: &io::Error) -> Option<String> {
        use rustls::Error::{AlertReceived, InvalidCertificate, PeerIncompatible};
        let cause = error.get_ref().and_then(|cause| cause.downcast_ref::<rustls::Error>());
        match (cause, error.kind()) {
            (Some(InvalidCertificate(_)), _) => Some(format!(
                "{error}; give the authority's certificate with `sslrootcert=FILE`, and address the server by the name in its \
                 certificate"
            )),
            (Some(AlertReceived(_) | PeerIncompatible(_)), _) => Some(error.to_string()),
            // Connections to a port do not fail with these errors. Connections to a socket in a folder do while the server is away.
            (None, io::ErrorKind::NotFound | io::ErrorKind::PermissionDenied)
                if self.options.get_socket().is_none() && self.url.contains("ssl") =>
            {
                Some(format!("{error}: check the files that sslrootcert, sslcert and sslkey name"))
            }
            _ => None,
        }
    }

    /// Converts an error, according to the class of its PostgreSQL code.
    pub(super) fn map_sql_error(&self, error: &sqlx::Error) -> QueueError {
        let rejected = |message: String| QueueError::Rejected { database: self.to_string(), message };
        match error {
            sqlx::Error::Database(db_error) => match db_error.code().as_deref().map(|code| code.split_at(2)) {
                // Invalid authorization; unknown database; insufficient privilege.
                Some(("28", _) | ("3D", _) | ("42", "501")) => rejected(db_error.message().to_owned()),
                // Disk full: the server keeps running.
                Some(("53", "100")) => {
                    QueueError::OutOfSpace { place: self.to_string(), message: db_error.message().to_owned() }
                }
                // Connection error, transaction rollback, read-only server, insufficient resources, shutdown, system error.
                Some(("08" | "25" | "40" | "53" | "57" | "58", _)) => self.unreachable_error(db_error.message()),
                _ => QueueError::Database { database: self.to_string(), message: db_error.message().to_owned() },
            },
            sqlx::Error::Tls(error) => rejected(format!(
                "no encrypted connection: {error}; to connect without encryption, append `?sslmode=disable` to the address"
            )),
            sqlx::Error::Io(error) => match self.permanent_cause(error) {
                Some(message) => rejected(message),
                None => self.unreachable_error(error),
            },
            sqlx::Error::Protocol(message) => self.unreachable_error(message),
            other => QueueError::Database { database: self.to_string(), message: other.to_string() },
        }
    }
}

impl FromStr for Database {
    type Err = QueueError;

    fn from_str(url: &str) -> Result<Self, QueueError> {
        let invalid_address = |message: String| QueueError::Address { message };
        if !["postgres://", "postgresql://"].iter().any(|scheme| url.starts_with(scheme)) {
            return Err(invalid_address("it does not begin with postgres://".into()));
        }
        let options: PgConnectOptions = url.parse().map_err(|error: sqlx::Error| match error {
            sqlx::Error::Configuration(error) => invalid_address(error.to_string()),
            other => invalid_address(other.to_string()),
        })?;
        let is_local =
            options.get_socket().is_some() || matches!(options.get_host(), "localhost" | "127.0.0.1" | "::1" | "[::1]");
        let options = match (options.get_ssl_mode(), is_local) {
            (PgSslMode::Prefer, true) => options.ssl_mode(PgSslMode::Disable),
            (PgSslMode::Prefer, false) => options.ssl_mode(PgSslMode::Require),
            _ => options,
        };
        let options = options.application_name("femc").disable_statement_logging();
        Ok(Self { url: url.to_owned(), options: Box::new(options) })
    }
}

impl fmt::Display for Database {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.options.get_socket() {
            Some(folder) => write!(f, "{}", folder.display())?,
            None => write!(f, "{}:{}", self.options.get_host(), self.options.get_port())?,
        }
        // In PostgreSQL, the default database name is the user's name.
        write!(f, "/{}", self.options.get_database().unwrap_or(self.options.get_username()))
    }
}

impl fmt::Debug for Database {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Database({self})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_shown_without_its_password() {
        let database: Database = "postgres://ann:secret@db.example:5433/farm".parse().unwrap();
        assert_eq!(database.to_string(), "db.example:5433/farm");
        assert!(!format!("{database:?}").contains("secret"));
        let database: Database = "postgresql://ann@localhost/farm?host=/run/postgresql".parse().unwrap();
        assert_eq!(database.to_string(), "/run/postgresql/farm");
    }

    #[test]
    fn remote_connections_are_encrypted_unless_the_url_disables_it() {
        for (url, expected) in [
            ("postgres://ann@localhost/farm", PgSslMode::Disable),
            ("postgres://ann@[::1]/farm", PgSslMode::Disable),
            ("postgres://ann@x/farm?host=/run/postgresql", PgSslMode::Disable),
            ("postgres://ann@localhost/farm?sslmode=verify-ca", PgSslMode::VerifyCa),
            ("postgres://ann@db.example/farm", PgSslMode::Require),
            ("postgres://ann@db.example/farm?sslmode=disable", PgSslMode::Disable),
            ("postgres://ann@db.example/farm?sslmode=verify-full", PgSslMode::VerifyFull),
        ] {
            let mode = url.parse::<Database>().unwrap().options.get_ssl_mode();
            assert_eq!(format!("{mode:?}"), format!("{expected:?}"), "{url}");
        }
    }

    #[test]
    fn what_is_no_address_is_refused_without_its_password() {
        for url in ["postgres://ann:secret@host:port/farm", "mysql://ann:secret@host/farm", "", "postgres:farm"] {
            let error = url.parse::<Database>().unwrap_err();
            assert!(matches!(error, QueueError::Address { .. }), "{error}");
            assert!(!error.to_string().contains("secret"), "{error}");
        }
    }
}
