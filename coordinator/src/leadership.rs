//! Leader election among several coordinators that share one PostgreSQL database. A coordinator is a standby, becomes leader, is
//! deposed, and is a standby again.
//!
//! A standby does not listen: a worker or a client that connects to it fails at once and tries the next one. The port is reserved
//! all the same, so that a conflict shows at the start. A term starts with the content of the log. At its end the coordinator drops
//! all its state: sessions and calls are closed, and nothing is acknowledged that is not durable.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use femc_queue::{Database, Leader, Postgres, QueueError, Remedy, Standby};
use femc_store::Store;
use tokio::net::TcpSocket;
use tokio::sync::watch;

use crate::config::{Config, CoordinatorError};
use crate::start::{Coordinator, Handle};

/// State of a coordinator among the coordinators of its farm.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Leadership {
    /// The coordinator is the leader and serves.
    Leader,
    /// Another coordinator is the leader, or its death has not been detected yet.
    Standby {
        /// URL of the leader, once it is known.
        leader: Option<String>,
    },
    /// The coordinator cannot reach its database and retries.
    Disconnected {
        /// Error of the last attempt to reach the database.
        message: String,
    },
}

/// A candidate for leadership, with everything that it needs for a term.
struct Candidate {
    config: Config,
    store: Store,
    database: Database,
    silence: Duration,
    leadership: watch::Sender<Leadership>,
    stopped: watch::Receiver<()>,
}

/// Starts a candidate on the current tokio runtime. Fails if the database cannot be reached now, so that a wrong address does not
/// look like waiting.
pub(crate) async fn start_candidate(
    config: Config,
    store: Store,
    database: Database,
    silence: Duration,
) -> Result<Handle, CoordinatorError> {
    let (port, address) = reserve_port(config.listen)?;
    let (stop, stopped) = watch::channel(());
    let (standing, news) = watch::channel(Leadership::Standby { leader: None });
    let config = Config { listen: address, ..config };
    let url = config.url(address);
    let candidate = Candidate { config, store, database, silence, leadership: standing, stopped };
    let standby = candidate.open_standby().await?;
    let run = tokio::spawn(candidate.run(standby, port));
    Ok(Handle::new(address, url, stop, run, news))
}

/// Reserves the port without listening on it.
fn reserve_port(address: SocketAddr) -> Result<(TcpSocket, SocketAddr), CoordinatorError> {
    let bound = || -> io::Result<_> {
        let port = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
        // Connections of an earlier term that are still closing must not block the port. `TcpListener::bind` does the same.
        #[cfg(unix)]
        port.set_reuseaddr(true)?;
        port.bind(address)?;
        let address = port.local_addr()?;
        Ok((port, address))
    };
    bound().map_err(|error| CoordinatorError::Listen { address, error })
}

impl Candidate {
    /// Maximum number of connections that wait to be accepted.
    const BACKLOG: u32 = 1024;
    /// First pause after the connection to the database was lost. Later pauses double.
    const FIRST_PAUSE: Duration = Duration::from_millis(100);
    /// Longest pause.
    const MAX_PAUSE: Duration = Duration::from_secs(3);

    async fn open_standby(&self) -> Result<Standby, QueueError> {
        let standby = Standby::open(self.database.clone(), self.config.url(self.config.listen), self.silence).await?;
        Ok(standby.with_loss_policy(self.config.loss_policy))
    }

    /// Runs until it is stopped, or an error occurs that retries cannot resolve.
    async fn run(self, standby: Standby, port: TcpSocket) -> Result<(), CoordinatorError> {
        let (mut standby, mut port) = (Some(standby), Some(port));
        let mut pause = Self::FIRST_PAUSE;
        let mut stopped = self.stopped.clone();
        loop {
            let elected = tokio::select! {
                biased;
                _ = stopped.changed() => return Ok(()),
                elected = self.wait_for_election(standby.take()) => elected,
            };
            let ended = match elected {
                Ok(queue) => {
                    pause = Self::FIRST_PAUSE;
                    self.serve_term(queue, port.take()).await
                }
                Err(error) => Err(error.into()),
            };
            match ended {
                Ok(()) => return Ok(()),
                Err(CoordinatorError::Queue(error)) if error.remedy() == Remedy::Reopen => {
                    self.note_queue_error(&error);
                }
                Err(error) => return Err(error),
            }
            // Reserve the port again at once, before another program takes it. If this fails, the next term retries.
            port = port.or_else(|| reserve_port(self.config.listen).ok().map(|(port, _)| port));
            tokio::select! {
                biased;
                _ = stopped.changed() => return Ok(()),
                () = tokio::time::sleep(pause) => pause = (2 * pause).min(Self::MAX_PAUSE),
            }
        }
    }

    /// Waits until this coordinator is the leader. Publishes the present leader meanwhile.
    async fn wait_for_election(&self, standby: Option<Standby>) -> Result<Postgres, QueueError> {
        let standby = match standby {
            Some(standby) => standby,
            None => self.open_standby().await?,
        };
        standby.wait_for_lead(|Leader { url, .. }| self.set_leadership(Leadership::Standby { leader: Some(url) })).await
    }

    /// Leads until it is stopped or deposed.
    async fn serve_term(&self, queue: Postgres, port: Option<TcpSocket>) -> Result<(), CoordinatorError> {
        let epoch = queue.epoch();
        let address = self.config.listen;
        let port = port.map_or_else(|| Ok(reserve_port(address)?.0), Ok::<_, CoordinatorError>)?;
        let listener = port.listen(Self::BACKLOG).map_err(|error| CoordinatorError::Listen { address, error })?;
        let mut term = Coordinator::start_on_listener(listener, self.config.clone(), self.store.clone(), queue).await?;
        tracing::info!(epoch, "leads");
        self.set_leadership(Leadership::Leader);
        let mut stopped = self.stopped.clone();
        tokio::select! {
            biased;
            _ = stopped.changed() => term.stop().await,
            error = term.failed() => Err(error),
        }
    }

    fn note_queue_error(&self, error: &QueueError) {
        match error {
            QueueError::Deposed { epoch } => {
                tracing::warn!(epoch, "another coordinator is the leader now; this one stands by");
                self.set_leadership(Leadership::Standby { leader: None });
            }
            error => self.set_leadership(Leadership::Disconnected { message: error.to_string() }),
        }
    }

    fn set_leadership(&self, leadership: Leadership) {
        self.leadership.send_if_modified(|shown| {
            let is_new = *shown != leadership;
            *shown = leadership;
            is_new
        });
    }
}
