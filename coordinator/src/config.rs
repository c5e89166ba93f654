//! Configuration of a coordinator, and its errors.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use femc_proto::{AccessControl, Limits, ServeError, Site};
use femc_queue::{Database, LossPolicy, QueueError};
use femc_schedule::SnapshotError;
use femc_store::StoreError;
use femc_trust::Audit;

use crate::announce::NotifyConfig;
use crate::clock::TimeSource;
use crate::metrics::Metrics;

/// Location of the log.
#[derive(Debug, Clone)]
pub enum LogStorage {
    /// In memory: nothing survives the process.
    Memory,
    /// A SQLite file at this path.
    Sqlite(PathBuf),
    /// A PostgreSQL database, which several coordinators may share: one is the leader, the others are standbys.
    Postgres {
        /// Address of the database.
        database: Database,
        /// Time of silence after which a leader is considered dead. It must be equal for all coordinators of a farm.
        silence: Duration,
    },
}

/// Location of the artifacts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ArtifactStorage {
    /// In memory: nothing survives the process.
    Memory,
    /// A folder at this path.
    Folder(PathBuf),
    /// A bucket, `s3://bucket/prefix`. Other settings come from the usual `AWS_` variables.
    S3(String),
}

/// Clients that may connect to a coordinator without access control.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exposure {
    /// Only programs on this machine. Any other listen address is refused.
    Loopback,
    /// Anybody who can reach the address.
    Anybody,
}

/// A coordinator's configuration.
#[derive(Debug, Clone)]
pub struct Config {
    /// Address to listen on; port 0: any free port.
    pub listen: SocketAddr,
    /// Clients that may connect, if connections are not encrypted.
    pub exposure: Exposure,
    /// Identity of the coordinator and the identities that it accepts; `None`: connections are not encrypted, and everyone is
    /// accepted.
    pub access_control: Option<AccessControl>,
    /// Limits of connections and messages.
    pub limits: Limits,
    /// Audit log of changes and refusals.
    pub audit: Option<Audit>,
    /// Notifications about the ends of jobs.
    pub announce: NotifyConfig,
    /// Content for browsers.
    pub site: Site,
    /// Location of the log.
    pub log: LogStorage,
    /// Location of the artifacts.
    pub artifacts: ArtifactStorage,
    /// Times and limits of the scheduler.
    pub scheduler: femc_schedule::Config,
    /// Number of log records after which a snapshot replaces them.
    pub snapshot_interval: usize,
    /// Bytes to keep free on the disks of the log and of the artifacts. With less, new jobs are refused. 0: no limit.
    pub keep_free: u64,
    /// Treatment of a log that lacks acknowledged records.
    pub loss_policy: LossPolicy,
    /// Source of time.
    pub time: TimeSource,
    /// Metrics of the coordinator.
    pub metrics: Metrics,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 0)),
            exposure: Exposure::Loopback,
            access_control: None,
            limits: Limits::default(),
            audit: None,
            announce: NotifyConfig::default(),
            site: Site::default(),
            log: LogStorage::Memory,
            artifacts: ArtifactStorage::Memory,
            scheduler: femc_schedule::Config::default(),
            snapshot_interval: 20_000,
            keep_free: 0,
            loss_policy: LossPolicy::Refuse,
            time: TimeSource::default(),
            metrics: Metrics::default(),
        }
    }
}

impl Config {
    /// Returns the coordinator's URL, if it listens at `address`.
    pub(crate) fn url(&self, address: SocketAddr) -> String {
        let scheme = if self.is_encrypted() { "https" } else { "http" };
        format!("{scheme}://{address}")
    }

    /// Returns whether connections are encrypted.
    pub(crate) fn is_encrypted(&self) -> bool {
        self.access_control.as_ref().is_some_and(|entrance| entrance.identity.is_some())
    }
}

/// Reason why a coordinator did not start, or stopped.
#[derive(Debug, thiserror::Error)]
pub enum CoordinatorError {
    /// The address is in use, or does not belong to this machine.
    #[error("cannot listen on {address}: {error}")]
    Listen {
        /// Address from the configuration.
        address: SocketAddr,
        /// Error of the operating system.
        error: std::io::Error,
    },
    /// Other machines can reach the address, and the configuration does not permit that.
    #[error("other machines can reach {address}, but connections are not encrypted")]
    Exposed {
        /// Address from the configuration.
        address: SocketAddr,
    },
    /// The log failed.
    #[error(transparent)]
    Queue(#[from] QueueError),
    /// The content of the log is invalid.
    #[error(transparent)]
    Ledger(#[from] SnapshotError),
    /// The artifact store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The server failed.
    #[error(transparent)]
    Serve(#[from] ServeError),
    /// A task of the coordinator panicked.
    #[error("the coordinator panicked")]
    Panicked,
}
