//! One coordinator of several on one PostgreSQL: it stands by, leads, is deposed, stands by again.
//!
//! Whoever does not lead does not listen: a worker or a client that tries it hears so at once, and tries the next. The
//! port is kept all the same, so that a taken one shows at the start. A term begins with what the log holds and ends with
//! everything that the coordinator knew: sessions and calls are dropped, and nobody is told what is not durable.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use femc_queue::{Database, Leader, Postgres, QueueError, Remedy, Standby};
use femc_store::Store;
use tokio::net::TcpSocket;
use tokio::sync::watch;

use crate::config::{Config, CoordinatorError};
use crate::start::{Coordinator, Handle};

/// Where a coordinator stands among those of its farm.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Standing {
    /// It serves.
    Leads,
    /// Another serves, or is about to be found dead.
    StandsBy {
        /// Where the other is reached, once that is known.
        leader: Option<String>,
    },
    /// It looks for its database.
    Seeks {
        /// Error of the last attempt to reach the database.
        message: String,
    },
}

/// A candidate, with all that it needs for a term.
struct Candidate {
    config: Config,
    store: Store,
    database: Database,
    silence: Duration,
    standing: watch::Sender<Standing>,
    stopped: watch::Receiver<()>,
}

/// Waits for its turn on the current tokio runtime. Fails if the database is not there now: a wrong address shall not look
/// like patience.
pub(crate) async fn start(
    config: Config,
    store: Store,
    database: Database,
    silence: Duration,
) -> Result<Handle, CoordinatorError> {
    let (port, address) = reserve(config.listen)?;
    let (stop, stopped) = watch::channel(());
    let (standing, news) = watch::channel(Standing::StandsBy { leader: None });
    let config = Config { listen: address, ..config };
    let url = config.url(address);
    let candidate = Candidate { config, store, database, silence, standing, stopped };
    let standby = candidate.stand_by().await?;
    let run = tokio::spawn(candidate.run(standby, port));
    Ok(Handle::new(address, url, stop, run, news))
}

/// The port, without listening on it.
fn reserve(address: SocketAddr) -> Result<(TcpSocket, SocketAddr), CoordinatorError> {
    let bound = || -> io::Result<_> {
        let port = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
        // Connections of an earlier term that still close shall not hinder; as `TcpListener::bind` has it.
        #[cfg(unix)]
        port.set_reuseaddr(true)?;
        port.bind(address)?;
        let address = port.local_addr()?;
        Ok((port, address))
    };
    bound().map_err(|error| CoordinatorError::Listen { address, error })
}

impl Candidate {
    /// Connections that may wait to be accepted.
    const BACKLOG: u32 = 1024;
    /// First pause after the database was lost; it doubles.
    const FIRST_PAUSE: Duration = Duration::from_millis(100);
    /// Longest pause.
    const LONGEST_PAUSE: Duration = Duration::from_secs(3);

    async fn stand_by(&self) -> Result<Standby, QueueError> {
        let standby = Standby::open(self.database.clone(), self.config.url(self.config.listen), self.silence).await?;
        Ok(standby.with(self.config.loss))
    }

    /// Until it is told to stop, or something is broken that waiting does not mend.
    async fn run(self, standby: Standby, port: TcpSocket) -> Result<(), CoordinatorError> {
        let (mut standby, mut port) = (Some(standby), Some(port));
        let mut pause = Self::FIRST_PAUSE;
        let mut stopped = self.stopped.clone();
        loop {
            let elected = tokio::select! {
                biased;
                _ = stopped.changed() => return Ok(()),
                elected = self.elected(standby.take()) => elected,
            };
            let ended = match elected {
                Ok(queue) => {
                    pause = Self::FIRST_PAUSE;
                    self.term(queue, port.take()).await
                }
                Err(error) => Err(error.into()),
            };
            match ended {
                Ok(()) => return Ok(()),
                Err(CoordinatorError::Queue(error)) if error.remedy() == Remedy::Reopen => self.note(&error),
                Err(error) => return Err(error),
            }
            // Taken again at once, before somebody else's connection gets it; if it cannot be had now, the next term tries.
            port = port.or_else(|| reserve(self.config.listen).ok().map(|(port, _)| port));
            tokio::select! {
                biased;
                _ = stopped.changed() => return Ok(()),
                () = tokio::time::sleep(pause) => pause = (2 * pause).min(Self::LONGEST_PAUSE),
            }
        }
    }

    /// Waits until it leads; tells who does meanwhile.
    async fn elected(&self, standby: Option<Standby>) -> Result<Postgres, QueueError> {
        let standby = match standby {
            Some(standby) => standby,
            None => self.stand_by().await?,
        };
        standby.lead(|Leader { url, .. }| self.tell(Standing::StandsBy { leader: Some(url) })).await
    }

    /// Leads until it is told to stop or may lead no longer.
    async fn term(&self, queue: Postgres, port: Option<TcpSocket>) -> Result<(), CoordinatorError> {
        let epoch = queue.epoch();
        let address = self.config.listen;
        let port = port.map_or_else(|| Ok(reserve(address)?.0), Ok::<_, CoordinatorError>)?;
        let listener = port.listen(Self::BACKLOG).map_err(|error| CoordinatorError::Listen { address, error })?;
        let mut term = Coordinator::at(listener, self.config.clone(), self.store.clone(), queue).await?;
        tracing::info!(epoch, "leads");
        self.tell(Standing::Leads);
        let mut stopped = self.stopped.clone();
        tokio::select! {
            biased;
            _ = stopped.changed() => term.stop().await,
            error = term.failed() => Err(error),
        }
    }

    fn note(&self, error: &QueueError) {
        match error {
            QueueError::Deposed { epoch } => {
                tracing::warn!(epoch, "leads no longer: another coordinator does");
                self.tell(Standing::StandsBy { leader: None });
            }
            error => self.tell(Standing::Seeks { message: error.to_string() }),
        }
    }

    fn tell(&self, standing: Standing) {
        self.standing.send_if_modified(|shown| {
            let is_new = *shown != standing;
            *shown = standing;
            is_new
        });
    }
}
