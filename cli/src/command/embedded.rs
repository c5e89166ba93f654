//! A farm in this process: the coordinator and the workers of `femc coordinator` and `femc worker`, on a loopback port that the
//! system chooses. It costs one copy of every result through a socket. In return there is only one way to render.

use super::client::{self, FarmClient, login_name};
use super::site::site;
use crate::exit::{Failure, failed};
use crate::output::Printer;
use femc_coordinator::{AccessControl, ArtifactStorage, Config, Coordinator, Handle, LogStorage, LoginTokens, Site};
use femc_model::Digest;
use femc_pipeline::method_choice::SolvedFirstPass;
use femc_proto::Dialer;
use femc_trust::{Authority, Holder, Role, TokenFile, Tokens};
use femc_worker::{Cache, PieceCache, Worker, WorkerError};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use tempfile::TempDir;
use tokio::sync::watch;
use tokio::task::JoinSet;

/// Configuration of the farm.
pub struct EmbeddedConfig<'a> {
    /// Address of this machine to listen on; port 0: any free port.
    pub listen: SocketAddr,
    /// Location of the log.
    pub log: LogStorage,
    /// Location of the artifacts.
    pub artifacts: ArtifactStorage,
    /// Number of workers. Without workers, the farm only serves pages.
    pub workers: u32,
    /// Threads of each worker; `None`: all cores.
    pub threads: Option<u32>,
    /// First pass that was solved before the job.
    pub solved: Option<SolvedFirstPass>,
    /// Web pages.
    pub site: Site,
    /// Tokens that clients need; `None`: all clients of this machine are accepted.
    pub tokens: Option<&'a RunTokens>,
}

impl EmbeddedConfig<'_> {
    /// Returns the configuration of a run that keeps its state in files.
    pub fn with_files(log: PathBuf, artifacts: PathBuf, workers: u32, threads: Option<u32>) -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 0)),
            log: LogStorage::Sqlite(log),
            artifacts: ArtifactStorage::Folder(artifacts),
            workers,
            threads,
            solved: None,
            site: site(),
            tokens: None,
        }
    }
}

/// Tokens of one run: for its user, for the browsers of its user, and for its workers. They are valid while this object lives and the
/// farm runs.
pub struct RunTokens {
    folder: TempDir,
    user: TokenFile,
    worker: TokenFile,
    logins: LoginTokens,
}

impl RunTokens {
    /// Validity in days, far beyond the length of a run.
    const DAYS: u32 = 30;

    /// Makes new tokens, that of the user with this role.
    pub fn new(role: Role) -> Result<Self, Failure> {
        let folder = tempfile::Builder::new().prefix("femc-tokens-").tempdir().map_err(failed)?;
        let authority = Authority::init(&folder.path().join("authority"), "view").map_err(failed)?;
        let token = |holder: Holder| authority.issue_token(holder, Self::DAYS).map_err(failed);
        let user = token(Holder::User { name: user_name(), role })?;
        let worker = token(Holder::Worker { name: "worker".into() })?;
        let logins = LoginTokens::new(user.token().secret()).map_err(failed)?;
        Ok(Self { folder, user, worker, logins })
    }

    /// Returns the tokens for addresses of pages. A browser exchanges such a token for the token of the user, once.
    pub fn logins(&self) -> &LoginTokens {
        &self.logins
    }

    /// Returns the token of the user, for programs.
    pub fn user_token(&self) -> String {
        self.user.token().secret()
    }

    /// Writes a page that leads to a page of the farm, and returns its path. Browsers are started with this path, because other
    /// users of the machine can read the arguments of a program, but not this file.
    pub fn entrance(&self, url: &str) -> Result<String, Failure> {
        let path = self.folder.path().join("open.html");
        let address = url.replace('&', "&amp;");
        let page = format!(
            "<!doctype html>\n<meta charset=\"utf-8\">\n<meta http-equiv=\"refresh\" content=\"0; url={address}\">\n"
        );
        std::fs::write(&path, page).map_err(failed)?;
        Ok(path.display().to_string())
    }

    fn access_control(&self) -> Result<AccessControl, Failure> {
        let authority = Authority::open(&self.folder.path().join("authority")).map_err(failed)?;
        let tokens = Tokens::open(authority.tokens_path()).map_err(failed)?;
        Ok(AccessControl { identity: None, revoked: None, tokens: Some(tokens), logins: Some(self.logins.clone()) })
    }
}

/// A running farm.
pub struct EmbeddedFarm {
    coordinator: Handle,
    workers: JoinSet<Result<(), WorkerError>>,
    stop: watch::Sender<()>,
}

impl EmbeddedFarm {
    /// Starts the farm, and connects to it.
    pub async fn start(settings: EmbeddedConfig<'_>) -> Result<(Self, FarmClient), Failure> {
        let config = Config {
            listen: settings.listen,
            log: settings.log,
            artifacts: settings.artifacts,
            site: settings.site,
            access_control: settings.tokens.map(RunTokens::access_control).transpose()?,
            // The workers stop together with the coordinator, so there are none to wait for after a restart.
            scheduler: femc_schedule::Config { regroup: 0, ..femc_schedule::Config::default() },
            ..Config::default()
        };
        let coordinator = Coordinator::start(config).await.map_err(failed)?;
        let (stop, stopped) = watch::channel(());
        // No cache is needed: the store is on the same disk.
        let (mut workers, cache) = (JoinSet::new(), Cache::with_pieces(PieceCache::in_memory(0)));
        if let Some(SolvedFirstPass { key, solution }) = settings.solved {
            cache.insert_solution(Digest::from_bytes(key), solution);
        }
        let dialer = |token: fn(&RunTokens) -> &TokenFile| {
            let token = settings.tokens.map(|tokens| token(tokens).clone());
            token.map_or_else(Dialer::tcp, |token| Dialer::tcp().with_token(token))
        };
        for number in 1..=settings.workers {
            let config = femc_worker::Config {
                name: format!("worker {number}"),
                threads: settings.threads.map_or(0, |threads| threads as usize),
                cache: cache.clone(),
                dial: dialer(|tokens| &tokens.worker),
                ..femc_worker::Config::new(coordinator.url())
            };
            let mut stopped = stopped.clone();
            workers.spawn(Worker::run(config, async move {
                // Returns when the sender is dropped.
                let _ = stopped.changed().await;
            }));
        }
        let client = FarmClient::connect(&dialer(|tokens| &tokens.user), &coordinator.url(), client::SERVER_OPTIONS)
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
        open_browser(&page);
    }

    /// Returns the farm's address.
    pub fn url(&self) -> String {
        self.coordinator.url()
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

/// Returns the name of the user, as far as a holder of a token can have it.
fn user_name() -> String {
    let name: String = login_name().chars().filter(|letter| letter.is_ascii_alphanumeric()).collect();
    if name.is_empty() { "user".into() } else { name }
}

/// Opens a page in a browser if there is a desktop. The address is valid in any case.
pub fn open_browser(page: &str) {
    let has_desktop = ["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|name| std::env::var_os(name).is_some());
    let opener = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    if has_desktop || cfg!(target_os = "macos") {
        let mut browser = Command::new(opener);
        browser.arg(page).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        // The browser runs independently.
        if let Err(error) = browser.spawn() {
            tracing::debug!(%error, opener, "cannot open a browser");
        }
    }
}
