//! What a coordinator needs to know, and why it may not start.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use femc_proto::{Entrance, Limits, ServeError, Site};
use femc_queue::{Database, Loss, QueueError};
use femc_schedule::SnapshotError;
use femc_store::StoreError;
use femc_trust::Audit;

use crate::announce::Announce;
use crate::clock::Time;
use crate::metrics::Metrics;

/// Where the log lives.
#[derive(Debug, Clone)]
pub enum Log {
    /// In memory: nothing outlives the process.
    Memory,
    /// In this SQLite file.
    Sqlite(PathBuf),
    /// In a PostgreSQL database, which other coordinators may share: one leads, the others stand by.
    Postgres {
        /// Address of the database.
        database: Database,
        /// A leader that gives no sign of life for so long is taken for dead; the same for all coordinators of a farm.
        silence: Duration,
    },
}

/// Where artifacts live.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Artifacts {
    /// In memory: nothing outlives the process.
    Memory,
    /// In this folder.
    Folder(PathBuf),
    /// In a bucket, `s3://bucket/prefix`; the rest is in the usual `AWS_` variables.
    S3(String),
}

/// Who may connect to a coordinator without an entrance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exposure {
    /// Programs of this machine; any other address is refused.
    Loopback,
    /// Anybody who can reach the address.
    Anybody,
}

/// A coordinator's configuration.
#[derive(Debug, Clone)]
pub struct Config {
    /// Where to listen; port 0: any free port.
    pub listen: SocketAddr,
    /// Who may connect, where nothing is encrypted.
    pub exposure: Exposure,
    /// Its identity and whom it lets in; `None`: connections are not encrypted, and everybody is.
    pub entrance: Option<Entrance>,
    /// Limits of connections and messages.
    pub limits: Limits,
    /// Where changes and refusals are noted.
    pub audit: Option<Audit>,
    /// Who is told of the ends of jobs.
    pub announce: Announce,
    /// What browsers are shown.
    pub site: Site,
    /// Place of the log.
    pub log: Log,
    /// Place of the artifacts.
    pub artifacts: Artifacts,
    /// The scheduler's times and limits.
    pub scheduler: femc_schedule::Config,
    /// Records of the log after which a snapshot takes their place.
    pub snapshot: usize,
    /// Bytes that shall stay free on the disks of the log and of the artifacts: with less, no new jobs are taken. 0: none.
    pub keep_free: u64,
    /// What to do with a log that lacks what was acknowledged.
    pub loss: Loss,
    /// The clock.
    pub time: Time,
    /// Where it counts what it does.
    pub metrics: Metrics,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 0)),
            exposure: Exposure::Loopback,
            entrance: None,
            limits: Limits::default(),
            audit: None,
            announce: Announce::default(),
            site: Site::default(),
            log: Log::Memory,
            artifacts: Artifacts::Memory,
            scheduler: femc_schedule::Config::default(),
            snapshot: 20_000,
            keep_free: 0,
            loss: Loss::Refused,
            time: Time::default(),
            metrics: Metrics::default(),
        }
    }
}

impl Config {
    /// Where it is reached, if it listens at `address`.
    pub(crate) fn url(&self, address: SocketAddr) -> String {
        let scheme = if self.is_encrypted() { "https" } else { "http" };
        format!("{scheme}://{address}")
    }

    /// Whether others can read what is said.
    pub(crate) fn is_encrypted(&self) -> bool {
        self.entrance.as_ref().is_some_and(|entrance| entrance.identity.is_some())
    }
}

/// Why a coordinator did not start, or stopped.
#[derive(Debug, thiserror::Error)]
pub enum CoordinatorError {
    /// The address is taken, or none of this machine's.
    #[error("cannot listen on {address}: {error}")]
    Listen {
        /// Address from the configuration.
        address: SocketAddr,
        /// Error of the operating system.
        error: std::io::Error,
    },
    /// The address can be reached from other machines, and that was not asked for.
    #[error("{address} can be reached from other machines, and connections are not encrypted")]
    Exposed {
        /// Address from the configuration.
        address: SocketAddr,
    },
    /// The log.
    #[error(transparent)]
    Queue(#[from] QueueError),
    /// The log's content.
    #[error(transparent)]
    Ledger(#[from] SnapshotError),
    /// The artifact store.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The server.
    #[error(transparent)]
    Serve(#[from] ServeError),
    /// A task of the coordinator panicked.
    #[error("the coordinator panicked")]
    Panicked,
}
