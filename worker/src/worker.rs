//! The main loop of a worker: connect, work, lose the coordinator, reconnect.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use femc_model::{Refusal, Registration};
use femc_proto::{CallError, Client, Why};
use tokio::runtime::Handle;
use tokio::sync::mpsc;
use tracing::Instrument as _;

use crate::clock::Stopwatch;
use crate::config::{Config, Hands, WorkerError};
use crate::execute::Tools;
use crate::fetch::Fetch;
use crate::finish::Finish;
use crate::memory::Memory;
use crate::meter::Meter;
use crate::nice::Nice;
use crate::outbox::Outbox;
use crate::plan::{FEATURES, FIRST_PASS, FIRST_PASS_BLOCKS, LAYERS, PAINTING, STATISTICS};
use crate::session::{End, Session};
use crate::table::{Table, Task};
use crate::threads::LeftBehind;
use crate::{availability, simulated, threads};

/// A farm machine.
#[derive(Debug)]
pub struct Worker;

impl Worker {
    /// First pause after the coordinator is lost. The pause doubles after every failed attempt.
    const FIRST_PAUSE: Duration = Duration::from_millis(100);
    /// Longest pause.
    const LONGEST_PAUSE: Duration = Duration::from_secs(5);

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
        let nice = Nice::tried(config.nice)?;
        let pool = threads::pool(config.name.clone(), config.threads, nice)?;
        let registration = Registration {
            name: config.name.clone(),
            instance: config.instance,
            engine: config.engine.clone(),
            threads: pool.current_num_threads() as u32,
            slots: 1,
            tags: offered(&config.tags),
            held: Vec::new(),
            died: None,
        };
        let tools = Tools {
            pool: pool.clone(),
            cache: config.cache.clone(),
            fetch: Fetch::blocking(Handle::current(), pool),
            memory: Memory::new(config.memory.clone()),
            nice,
            journal: config.journal.clone(),
            left_behind: LeftBehind::default(),
        };
        let table = Arc::new(Table::default());
        let (done, mut finished) = mpsc::unbounded_channel();
        let (outbox, mut restored) = match config.outbox.clone() {
            None => (Outbox::default(), Vec::new()),
            Some(place) => Outbox::open(place, &config.engine).await?,
        };
        config.journal.open(outbox.folder(), config.instance);
        let meter = match config.hands {
            Hands::Threads => Meter::of_process(),
            Hands::Simulated(_) => Meter::none(),
        };
        config.metrics.watch(&table, &config.cache, &meter, &tools.left_behind);
        let finish = Finish { done, outbox: outbox.clone(), worker: Arc::from(config.name.as_str()) };
        let ahead = match &config.hands {
            Hands::Threads => threads::start(&config.name, &tools, &table, &finish)?,
            Hands::Simulated(pace) => simulated::start(pace, &tools, &table, &finish),
        };
        let mut stop = std::pin::pin!(async {
            tokio::select! {
                biased;
                () = stop => config.journal.close(),
                () = availability::idle(&table, config.idle_limit) => {}
            }
        });
        let mut pause = Self::FIRST_PAUSE;
        let mut away = Stopwatch::start();
        let outcome = loop {
            let session = async {
                let client = tokio::select! {
                    biased;
                    client = Client::connect_by(&config.dial, &config.join) => client?,
                    () = &mut stop => return Ok(End::Stopped),
                };
                pause = Self::FIRST_PAUSE;
                let kept = restored.drain(..).map(|restored| Task::restored(restored, client.clone(), &meter));
                kept.for_each(|task| table.keep(Arc::new(task)));
                let session = Session::new(client, &table, &outbox, &ahead, &mut finished, &config, &meter);
                let held = table.held().iter().map(|task| task.lease()).collect();
                let died = config.journal.death();
                session.run(Registration { held, died, ..registration.clone() }, stop.as_mut()).await
            };
            // `worker` is the number that the coordinator assigns.
            let span = tracing::info_span!("session", worker = tracing::field::Empty, machine = config.name);
            let ended = session.instrument(span).await;
            config.metrics.disconnected();
            let is_gone = match ended {
                Ok(End::Stopped) => break Ok(()),
                Ok(End::Lost) => {
                    away = Stopwatch::start();
                    CallError::Unreachable {
                        url: config.join.clone(),
                        message: "the session ended".into(),
                        why: Why::Away,
                    }
                }
                Err(
                    error @ (CallError::Refused(Refusal::Forbidden { .. } | Refusal::Unauthenticated { .. })
                    | CallError::Address { .. }
                    | CallError::NoIdentity { .. }
                    | CallError::OpenToken { .. }
                    | CallError::NoAuthority { .. }
                    | CallError::Answer(_)
                    | CallError::Status { .. }),
                ) => break Err(error.into()),
                Err(error @ (CallError::Unreachable { .. } | CallError::Refused(_))) => error,
            };
            if config.patience.is_some_and(|patience| away.elapsed() > patience) {
                break Err(is_gone.into());
            }
            tracing::info!(error = %is_gone, ?pause, "coordinator unreachable; trying again after a pause");
            tokio::select! {
                biased;
                () = tokio::time::sleep(pause) => pause = (2 * pause).min(Self::LONGEST_PAUSE),
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
fn offered(tags: &[String]) -> Vec<String> {
    let mut tags = tags.to_vec();
    for known in [FIRST_PASS, FIRST_PASS_BLOCKS, STATISTICS, LAYERS, FEATURES, PAINTING] {
        if !tags.iter().any(|tag| tag == known) {
            tags.push(known.to_owned());
        }
    }
    tags
}
