//! Start and graceful stop of a coordinator.

use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use femc_model::Tick;
use femc_proto::{Connected, Io, ServeError, Server, TcpIncoming};
use femc_queue::{Batch, Memory, MissingRecords, Queue, Sqlite};
use femc_schedule::{Fact, Ledger, Roster, Scheduler};
use femc_store::Store;
use femc_trust::AuditEvent;
use tokio::net::TcpListener;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;
use tokio_stream::Stream;

use crate::actor::Actor;
use crate::any_queue::AnyQueue;
use crate::config::{ArtifactStorage, Config, CoordinatorError, Exposure, LogStorage};
use crate::full_log::ActorInputs;
use crate::leadership::{self, Leadership};
use crate::roster::ROSTER_SUBJECT;

/// Future that completes when the server must stop.
type StopSignal = Pin<Box<dyn Future<Output = ()> + Send>>;

/// Future that completes when the server has stopped.
type ServeFuture = Pin<Box<dyn Future<Output = Result<(), ServeError>> + Send>>;

/// Coordinator of the farm.
#[derive(Debug)]
pub struct Coordinator;

impl Coordinator {
    /// Maximum number of calls that wait for the actor.
    const CALLS: usize = 1024;

    /// Starts on the current tokio runtime. When this returns, the coordinator listens, unless it is one of several: then it may be
    /// a standby, see [`Handle::leadership`].
    pub async fn start(config: Config) -> Result<Handle, CoordinatorError> {
        Self::open_boxed(config).await
    }

    /// [`Self::open`] as a boxed future. The compiler generates the code of an async function in the crate that polls it. With the
    /// box, that is this crate, and not every program that starts a coordinator.
    #[inline(never)]
    fn open_boxed(config: Config) -> Pin<Box<dyn Future<Output = Result<Handle, CoordinatorError>> + Send>> {
        Box::pin(Self::open(config))
    }

    async fn open(config: Config) -> Result<Handle, CoordinatorError> {
        if !config.is_encrypted() && config.exposure == Exposure::Loopback && !config.listen.ip().is_loopback() {
            return Err(CoordinatorError::Exposed { address: config.listen });
        }
        let store = match &config.artifacts {
            ArtifactStorage::Memory => Store::in_memory(),
            ArtifactStorage::Folder(path) => Store::open_folder(path)?,
            ArtifactStorage::S3(url) => Store::open_s3(url)?,
        };
        tokio::spawn({
            let store = store.clone();
            async move {
                if let Err(error) = store.probe().await {
                    // The store may come back. Until then, requests that need it fail.
                    tracing::warn!(%error, "the artifact store does not respond");
                }
            }
        });
        match config.log.clone() {
            LogStorage::Memory => Self::start_with(config, store, Memory::default()).await,
            LogStorage::Sqlite(path) => {
                let queue = Sqlite::open_with(&path, config.loss_policy).await?;
                config.metrics.set_log_file(path);
                Self::start_with(config, store, queue).await
            }
            LogStorage::Postgres { database, silence } => {
                leadership::start_candidate(config, store, database, silence).await
            }
        }
    }

    /// Starts with this log and this store. Ignores those in `config`.
    pub async fn start_with(config: Config, store: Store, queue: impl Queue) -> Result<Handle, CoordinatorError> {
        let listen = |error| CoordinatorError::Listen { address: config.listen, error };
        let listener = TcpListener::bind(config.listen).await.map_err(listen)?;
        let address = listener.local_addr().map_err(listen)?;
        Self::start_on_listener(listener, Config { listen: address, ..config }, store, queue).await
    }

    /// Like [`Self::start_with`], on a port that already listens. Its address is `config.listen`.
    pub(crate) async fn start_on_listener(
        listener: TcpListener,
        config: Config,
        store: Store,
        queue: impl Queue,
    ) -> Result<Handle, CoordinatorError> {
        let incoming = TcpIncoming::from(listener).with_nodelay(Some(true));
        let serve = |server: Server, stop| -> ServeFuture { Box::pin(server.serve(incoming, stop)) };
        Self::start_server(config, store, AnyQueue::new(queue), Box::new(serve)).await
    }

    /// Like [`Self::start_with`], on connections that do not arrive over TCP, and that end when `incoming` is dropped.
    /// `config.listen` is only the address that is reported to others.
    pub async fn start_on_stream<C: Io + Connected>(
        incoming: impl Stream<Item = io::Result<C>> + Send + 'static,
        config: Config,
        store: Store,
        queue: impl Queue,
    ) -> Result<Handle, CoordinatorError> {
        let serve = |server: Server, stop| -> ServeFuture {
            Box::pin(async move {
                tokio::select! {
                    biased;
                    outcome = server.serve_forever(incoming) => outcome,
                    () = stop => Ok(()),
                }
            })
        };
        Self::start_server(config, store, AnyQueue::new(queue), Box::new(serve)).await
    }

    async fn start_server(
        config: Config,
        store: Store,
        mut queue: AnyQueue,
        serve: Box<dyn FnOnce(Server, StopSignal) -> ServeFuture + Send>,
    ) -> Result<Handle, CoordinatorError> {
        let (address, url) = (config.listen, config.url(config.listen));
        let (scheduler, records) = recover(&config, &mut queue).await?;
        let roster = roster(&mut queue).await?;
        let (calls, inbox) = mpsc::channel(Self::CALLS);
        let (stop, stopped) = watch::channel(());
        let (asked, figures) = mpsc::channel(1);
        config.metrics.begin_term(asked);
        let actor = Actor::new(scheduler, queue, store.clone(), records, roster, figures, &config);
        let actor = tokio::spawn(actor.run(ActorInputs { calls: inbox, stop: stopped }));
        let (serving, mut until) = watch::channel(());
        let server = serve(
            Server::new(calls, store)
                .with_access_control(config.access_control)
                .with_traffic(config.metrics.traffic())
                .with_limits(config.limits)
                .with_audit(config.audit)
                .with_site(config.site),
            Box::pin(async move {
                // Completes when the sender is dropped: on a stop, or because the actor has ended.
                let _ = until.changed().await;
            }),
        );
        let mut server = tokio::spawn(async move { server.await.map_err(CoordinatorError::from) });
        tracing::info!(%address, "coordinator listens");
        let run = tokio::spawn(async move {
            let outcome = actor.await.unwrap_or(Err(CoordinatorError::Panicked));
            if outcome.is_err() {
                // Answers from now on could be wrong.
                server.abort();
                let _ = server.await;
                return outcome;
            }
            drop(serving);
            // Wait for a limited time only: a client may hold its connection open.
            let grace = tokio::time::timeout(Duration::from_secs(1), &mut server).await;
            outcome.and(match grace {
                Ok(server) => server.unwrap_or(Err(CoordinatorError::Panicked)),
                Err(_) => {
                    // Frees the port before this returns.
                    server.abort();
                    let _ = server.await;
                    Ok(())
                }
            })
        });
        Ok(Handle::new(address, url, stop, run, watch::channel(Leadership::Leader).1))
    }
}

/// Restores the scheduler from the log. Returns it with the number of records since the snapshot.
async fn recover(config: &Config, queue: &mut AnyQueue) -> Result<(Scheduler, usize), CoordinatorError> {
    let contents = queue.load().await?;
    if contents.torn > 0 {
        tracing::warn!(
            records = contents.torn,
            "the log's last records are incomplete and ignored; they were never acknowledged"
        );
    }
    if let Some(lost) = contents.missing {
        report_loss(config, lost);
    }
    let mut ledger = contents.snapshot.as_deref().map(Ledger::decode).transpose()?.unwrap_or_default();
    for record in &contents.records {
        let (now, fact) = Fact::decode(record)?;
        ledger.apply(&fact, now);
    }
    let now: Tick = ledger.now();
    let incarnation = queue.reserve(ledger.incarnation() + 1).await?;
    ledger.raise_incarnation(incarnation - 1);
    let date = SystemTime::now().duration_since(UNIX_EPOCH).ok();
    let date = date.and_then(|since| u64::try_from(since.as_millis()).ok());
    let clock_zero = config.scheduler.clock_zero.or_else(|| date?.checked_sub(now.0));
    let (scheduler, opened) = Scheduler::new(femc_schedule::Config { clock_zero, ..config.scheduler.clone() }, ledger);
    queue.append(Batch::from_records(&[opened.encode(now)?])).await?;
    Ok((scheduler, contents.records.len() + 1))
}

/// Reads the last note with the roster of workers. If it cannot be read, the roster starts empty.
async fn roster(queue: &mut AnyQueue) -> Result<Roster, CoordinatorError> {
    let notes = queue.notes(ROSTER_SUBJECT, 0).await?.notes;
    let read = notes.last().map(|note| Roster::decode(note)).transpose();
    Ok(read
        .unwrap_or_else(|error| {
            tracing::warn!(%error, "cannot read the list of known workers; it starts empty");
            None
        })
        .unwrap_or_default())
}

/// Logs which acknowledged records are given up.
fn report_loss(config: &Config, MissingRecords { last_existing: kept, last_known: known }: MissingRecords) {
    let what = match known {
        Some(known) => format!("the log lost its records {} to {known}, or more", kept + 1),
        None => format!("the log ends with record {kept}; the number of lost records is unknown"),
    };
    tracing::warn!(kept, known, "{what}; continuing without them");
    if let Some(audit) = &config.audit {
        audit.record(&AuditEvent {
            who: "who started the coordinator".into(),
            call: "accept-loss".into(),
            what: Some(what),
            outcome: "ok".into(),
            ..AuditEvent::default()
        });
    }
}

/// A running coordinator.
#[derive(Debug)]
pub struct Handle {
    address: SocketAddr,
    url: String,
    stop: watch::Sender<()>,
    run: JoinHandle<Result<(), CoordinatorError>>,
    leadership: watch::Receiver<Leadership>,
}

impl Handle {
    pub(crate) fn new(
        address: SocketAddr,
        url: String,
        stop: watch::Sender<()>,
        run: JoinHandle<Result<(), CoordinatorError>>,
        leadership: watch::Receiver<Leadership>,
    ) -> Self {
        Self { address, url, stop, run, leadership }
    }

    /// Returns the present and future state among the coordinators of the farm. A single coordinator leads.
    pub fn leadership(&self) -> watch::Receiver<Leadership> {
        self.leadership.clone()
    }

    /// Returns the address on which it listens, with the actual port.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Returns the URL for workers and clients.
    pub fn url(&self) -> String {
        self.url.clone()
    }

    /// Says goodbye to the workers, makes all received messages durable, and stops.
    pub async fn stop(self) -> Result<(), CoordinatorError> {
        drop(self.stop);
        self.run.await.unwrap_or(Err(CoordinatorError::Panicked))
    }

    /// Waits until the coordinator stops because of an error, and returns the error.
    pub async fn failed(&mut self) -> CoordinatorError {
        match (&mut self.run).await {
            Ok(Err(error)) => error,
            Ok(Ok(())) | Err(_) => CoordinatorError::Panicked,
        }
    }
}
