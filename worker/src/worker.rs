//! The main loop of a worker: connect, work, lose the coordinator, reconnect.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use femc_model::{Refusal, Registration};
use femc_proto::{CallError, Client, UnreachableCause};
use tokio::runtime::Handle;
use tokio::sync::mpsc;
use tracing::Instrument as _;

use crate::clock::Stopwatch;
use crate::config::{Config, Executor, WorkerError};
use crate::execute::Tools;
use crate::fetch::Fetcher;
use crate::memory::MemoryGuard;
use crate::meter::Meter;
use crate::niceness::Niceness;
use crate::outbox::Outbox;
use crate::outcome::OutcomeHandler;
use crate::session::{Session, SessionEnd};
use crate::task_table::{Task, TaskTable};
use crate::threads::AbandonedThreads;
use crate::{availability, simulated, threads};

/// A farm machine.
#[derive(Debug)]
pub struct Worker;

impl Worker {
    /// First pause after the coordinator is lost. The pause doubles after every failed attempt.
    const FIRST_PAUSE: Duration = Duration::from_millis(100);
    /// Longest pause.
    const MAX_PAUSE: Duration = Duration::from_secs(5);

    /// Works on the current tokio runtime until `stop` completes, then gives back its tasks and returns. When the coordinator is
    /// away, the worker reconnects, for at most the time that the configuration allows.
    pub async fn run(config: Config, stop: impl Future<Output = ()> + Send) -> Result<(), WorkerError> {
        Self::boxed(config, Box::pin(stop)).await
    }

    /// Returns [`Self::work`] as a boxed future. The compiler generates an async function where it is polled; the box makes that
    /// this crate instead of every program that runs a worker.
    #[inline(never)]
    fn boxed<'a>(
        config: Config,
        stop: Pin<Box<dyn Future<Output = ()> + Send + 'a>>,
    ) -> Pin<Box<dyn Future<Output = Result<(), WorkerError>> + Send + 'a>> {
        Box::pin(Self::work(config, stop))
    }

    async fn work(config: Config, stop: Pin<Box<dyn Future<Output = ()> + Send + '_>>) -> Result<(), WorkerError> {
        let nice = Niceness::try_new(config.niceness)?;
        let pool = threads::pool(config.name.clone(), config.threads, nice)?;
        let registration = Registration {
            name: config.name.clone(),
            instance: config.instance,
            engine: config.engine.clone(),
            threads: pool.current_num_threads() as u32,
            slots: 1,
            tags: offered_tags(&config.tags),
            held: Vec::new(),
            death: None,
        };
        let tools = Tools {
            pool: pool.clone(),
            cache: config.cache.clone(),
            fetch: Fetcher::blocking(Handle::current(), pool),
            memory: MemoryGuard::new(config.memory.clone()),
            nice,
            journal: config.journal.clone(),
            abandoned_threads: AbandonedThreads::default(),
        };
        let table = Arc::new(TaskTable::default());
        let (done, mut finished) = mpsc::unbounded_channel();
        let (outbox, mut restored) = match config.outbox.clone() {
            None => (Outbox::default(), Vec::new()),
            Some(storage) => Outbox::open(storage, &config.engine).await?,
        };
        config.journal.open(outbox.folder(), config.instance);
        let meter = match config.executor {
            Executor::Threads => Meter::for_process(),
            Executor::Simulated(_) => Meter::without_clock(),
        };
        config.metrics.attach(&table, &config.cache, &meter, &tools.abandoned_threads);
        let outcomes = OutcomeHandler { done, outbox: outbox.clone(), worker: Arc::from(config.name.as_str()) };
        let upcoming_frames = match &config.executor {
            Executor::Threads => threads::start(&config.name, &tools, &table, &outcomes)?,
            Executor::Simulated(pace) => simulated::start(pace, &tools, &table, &outcomes),
        };
        let mut stop = std::pin::pin!(async {
            tokio::select! {
                biased;
                () = stop => config.journal.close(),
                () = availability::wait_until_idle_limit(&table, config.idle_limit) => {}
            }
        });
        let mut pause = Self::FIRST_PAUSE;
        let mut away = Stopwatch::start();
        let outcome = loop {
            let session = async {
                let client = tokio::select! {
                    biased;
                    client = Client::connect_with(&config.dial, &config.coordinator) => client?,
                    () = &mut stop => return Ok(SessionEnd::Stopped),
                };
                pause = Self::FIRST_PAUSE;
                let kept = restored.drain(..).map(|restored| Task::from_restored(restored, client.clone(), &meter));
                kept.for_each(|task| table.insert_finished(Arc::new(task)));
                let session = Session::new(client, &table, &outbox, &upcoming_frames, &mut finished, &config, &meter);
                let held = table.held().iter().map(|task| task.lease()).collect();
                let died = config.journal.death();
                session.run(Registration { held, death: died, ..registration.clone() }, stop.as_mut()).await
            };
            // `worker` is the number that the coordinator assigns.
            let span = tracing::info_span!("session", worker = tracing::field::Empty, machine = config.name);
            let ended = session.instrument(span).await;
            config.metrics.on_disconnected();
            let is_gone = match ended {
                Ok(SessionEnd::Stopped) => break Ok(()),
                Ok(SessionEnd::Lost) => {
                    away = Stopwatch::start();
                    CallError::Unreachable {
                        url: config.coordinator.clone(),
                        message: "the session ended".into(),
                        cause: UnreachableCause::Connection,
                    }
                }
                Err(
                    error @ (CallError::Refused(Refusal::Forbidden { .. } | Refusal::Unauthenticated { .. })
                    | CallError::Address { .. }
                    | CallError::NoIdentity { .. }
                    | CallError::InsecureToken { .. }
                    | CallError::NoAuthority { .. }
                    | CallError::Answer(_)
                    | CallError::Status { .. }),
                ) => break Err(error.into()),
                Err(error @ (CallError::Unreachable { .. } | CallError::Refused(_))) => error,
            };
            if config.reconnect_limit.is_some_and(|patience| away.elapsed() > patience) {
                break Err(is_gone.into());
            }
            tracing::info!(error = %is_gone, ?pause, "coordinator unreachable; trying again after a pause");
            tokio::select! {
                biased;
                () = tokio::time::sleep(pause) => pause = (2 * pause).min(Self::MAX_PAUSE),
                () = &mut stop => break Ok(()),
            }
        };
        config.journal.close();
        table.close();
        // The outbox's last writes take milliseconds unless the disk is broken.
        let _ = tokio::task::spawn_blocking(move || outbox.close()).await;
        outcome
    }
}

/// Returns the tags that a worker offers: the configured ones and those that this version supports.
fn offered_tags(tags: &[String]) -> Vec<String> {
    let mut tags = tags.to_vec();
    for known in femc_graph::tag::ALL {
        if !tags.iter().any(|tag| tag == known) {
            tags.push(known.to_owned());
        }
    }
    tags
}
