//! A farm in this process: the coordinator and the workers of `femc coordinator` and `femc worker`, on a loopback port that the
//! system chooses. It costs one copy of every result through a socket. In return there is only one way to render.

use super::client::{self, FarmClient};
use super::site::site;
use crate::exit::{Failure, failed};
use crate::output::Printer;
use femc_coordinator::{ArtifactStorage, Config, Coordinator, Handle, LogStorage};
use femc_proto::Dialer;
use femc_worker::{Cache, PieceCache, Worker, WorkerError};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use tokio::sync::watch;
use tokio::task::JoinSet;

/// Configuration of the farm.
#[derive(Clone, Debug)]
pub struct EmbeddedConfig {
    /// SQLite file of the log.
    pub log: PathBuf,
    /// Folder of the artifacts.
    pub artifacts: PathBuf,
    /// Number of workers, >= 1.
    pub workers: u32,
    /// Threads of each worker; `None`: all cores.
    pub threads: Option<u32>,
}

/// A running farm.
pub struct EmbeddedFarm {
    coordinator: Handle,
    workers: JoinSet<Result<(), WorkerError>>,
    stop: watch::Sender<()>,
}

impl EmbeddedFarm {
    /// Starts the farm, and connects to it.
    pub async fn start(settings: EmbeddedConfig) -> Result<(Self, FarmClient), Failure> {
        let config = Config {
            log: LogStorage::Sqlite(settings.log),
            artifacts: ArtifactStorage::Folder(settings.artifacts),
            site: site(),
            // The workers stop together with the coordinator, so there are none to wait for after a restart.
            scheduler: femc_schedule::Config { regroup: 0, ..femc_schedule::Config::default() },
            ..Config::default()
        };
        let coordinator = Coordinator::start(config).await.map_err(failed)?;
        let (stop, stopped) = watch::channel(());
        // No cache is needed: the store is on the same disk.
        let (mut workers, cache) = (JoinSet::new(), Cache::with_pieces(PieceCache::in_memory(0)));
        for number in 1..=settings.workers {
            let config = femc_worker::Config {
                name: format!("worker {number}"),
                threads: settings.threads.map_or(0, |threads| threads as usize),
                cache: cache.clone(),
                ..femc_worker::Config::new(coordinator.url())
            };
            let mut stopped = stopped.clone();
            workers.spawn(Worker::run(config, async move {
                // Returns when the sender is dropped.
                let _ = stopped.changed().await;
            }));
        }
        let client = FarmClient::connect(&Dialer::tcp(), &coordinator.url(), client::SERVER_OPTIONS)
            .await
            .map_err(|unmet| unmet.failure)?;
        Ok((Self { coordinator, workers, stop }, client))
    }

    /// Prints the farm's address for browsers, and opens a browser if there is a desktop.
    pub fn show_in_browser(&self, printer: Printer) {
        let page = format!("{}/", self.coordinator.url());
        if site().files.is_empty() {
            printer.warning(format!(
                "--watch: this femc was built without its web page; {page}api/v1/feed has the same data as JSON"
            ));
            return;
        }
        printer.note(format!("the run in a browser: {page}"));
        let has_desktop = ["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|name| std::env::var_os(name).is_some());
        let opener = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
        if has_desktop || cfg!(target_os = "macos") {
            let mut browser = Command::new(opener);
            browser.arg(&page).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
            // The browser runs independently; the address is valid in any case.
            if let Err(error) = browser.spawn() {
                tracing::debug!(%error, opener, "cannot open a browser");
            }
        }
    }

    /// Waits until a part of the farm ends by itself, which happens only after an error.
    pub async fn wait_for_failure(&mut self) -> Failure {
        tokio::select! {
            error = self.coordinator.failed() => failed(error),
            Some(worker) = self.workers.join_next() => match worker {
                Ok(Err(error)) => failed(format!("a worker ended: {error}")),
                Ok(Ok(())) => failed("a worker ended"),
                Err(panic) => failed(format!("a worker ended: {panic}")),
            },
        }
    }

    /// Stops the farm. Unfinished tasks go back to the log, so that the next run resumes them. Drop clients before.
    pub async fn stop(mut self) {
        drop(self.stop);
        while let Some(worker) = self.workers.join_next().await {
            if let Ok(Err(error)) = worker {
                tracing::warn!(%error, "a worker ended with an error");
            }
        }
        if let Err(error) = self.coordinator.stop().await {
            tracing::warn!(%error, "the coordinator ended with an error");
        }
    }
}
