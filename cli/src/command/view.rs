//! `femc view FILE.paths|SCENE`: shows recorded light in a browser, from files or while a scene is rendered.

use super::client::{self, FarmClient};
use super::embedded::{self, EmbeddedConfig, EmbeddedFarm, RunTokens};
use super::interrupt::Interrupt;
use super::site::site;
use super::submit::unique_key;
use crate::args::{FormatArgs, SettingsArgs, StatsMode};
use crate::clock::Clock;
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::{Printer, Progress, job as show, json};
use crate::request::ResolvedRequest;
use clap::Args;
use femc_coordinator::{ArtifactStorage, LightFault, LightFile, LightSource, LogStorage, MAX_LIGHT_BYTES, Site};
use femc_model::JobId;
use femc_pipeline::method_choice::SolvedFirstPass;
use femc_trust::{Role, Token};
use serde::Serialize;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Show recorded light paths in a browser: statistics files, or a scene while it is rendered
///
/// The server accepts connections of this machine only. Its address signs in one browser, once; then the command prints another address.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc render scenes/gallery.mgf -o gallery.exr --stats && femc view gallery.paths\n  \
    femc view day.paths night.paths                            # compares two files in one plot: A red, B blue\n  \
    femc view scenes/gallery.mgf --size 160x120 --spp 256      # shows the light while the frame grows\n\n\
    Files of several frames (`femc paths --union --out ALL.paths`) are shown as one set of paths.\n\n\
    Render settings apply to scenes. The frames of a scene are rendered in memory, with --stats, and are gone when the command \
    ends; `femc render --stats` keeps them. Ctrl-C ends the command.")]
pub struct ViewArgs {
    /// One or two statistics files, or one scene
    #[arg(value_name = "FILE.paths|SCENE", required = true, num_args = 1..=2)]
    inputs: Vec<PathBuf>,
    /// Port of this machine [default: any free port]
    #[arg(long, value_name = "PORT", default_value_t = 0, hide_default_value = true)]
    port: u16,
    /// Only print the address, and do not open a browser. With --json, the document has a token for programs, too
    #[arg(long)]
    no_browser: bool,
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    settings: SettingsArgs,
}

/// Address of the pages.
#[derive(Serialize)]
struct ViewReport {
    /// Address that signs in one browser.
    url: String,
    /// Token for programs, valid until the command ends.
    token: String,
}

/// Interval between two requests for the progress of a scene.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(500);

/// Runs `femc view`.
pub fn run(args: &ViewArgs, printer: Printer) -> Result<Exit, Failure> {
    if site().files.is_empty() {
        return Err(failed(
            "this femc was built without its web pages; `femc paths` queries light statistics without a browser",
        ));
    }
    let is_statistics = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "paths");
    match &args.inputs[..] {
        inputs if inputs.iter().all(is_statistics) => view_files(args, printer),
        [scene] => view_scene(scene, args, printer),
        _ => Err(usage("give one scene, or one or two statistics files (.paths)")),
    }
}

/// Shows files until the user stops the command.
fn view_files(args: &ViewArgs, printer: Printer) -> Result<Exit, Failure> {
    let files: Vec<LightFile> = args.inputs.iter().map(|path| checked_file(path)).collect::<Result<_, _>>()?;
    let site = Site { light_files: files, ..site() };
    client::runtime()?.block_on(async {
        let mut interrupt = Interrupt::listen()?;
        let (mut farm, _client, tokens) = start(args, Role::Viewer, EmbeddedWork::default(), site).await?;
        let page = if args.inputs.len() == 2 { "/view?b=1" } else { "/view" };
        let addresses = Addresses { args, farm: farm.url(), tokens: &tokens, page: page.to_owned(), printer };
        let outcome = tokio::select! {
            () = interrupt.wait() => Ok(Exit::Done),
            fault = addresses.print() => Err(fault),
            broken = farm.wait_for_failure() => return Err(broken),
        };
        farm.stop().await;
        outcome
    })
}

/// Checks that a file can be shown, before the browser opens.
fn checked_file(path: &Path) -> Result<LightFile, Failure> {
    let fault = |message: String| failed(format!("{}: {message}", path.display()));
    let size = std::fs::metadata(path).map_err(|error| fault(error.to_string()))?.len();
    if size > MAX_LIGHT_BYTES {
        let limit = MAX_LIGHT_BYTES >> 20;
        return Err(fault(format!(
            "the file has {} MiB, at most {limit} can be shown; `femc paths` has no limit",
            size >> 20
        )));
    }
    let bytes = std::fs::read(path).map_err(|error| fault(error.to_string()))?;
    let name = path.display().to_string();
    let source = LightSource { name: name.clone(), parts: vec![bytes.into()], is_growing: false };
    match femc_pictures::open_light("check", vec![source]) {
        Ok(Some(_)) => Ok(LightFile { name, path: path.to_owned() }),
        Ok(None) => Err(fault("the file contains no recorded paths; render with --stats".into())),
        Err(LightFault { message, .. }) => {
            Err(fault(format!("{message}; render the frame again with --stats, by the same version of femc")))
        }
    }
}

/// Renders a scene and shows its light until the user stops the command.
fn view_scene(scene: &Path, args: &ViewArgs, printer: Printer) -> Result<Exit, Failure> {
    let stats = args.settings.stats.or(Some(StatsMode::Some));
    let settings = SettingsArgs { stats, ..args.settings.clone() };
    let resolved = ResolvedRequest::open(scene, settings, printer)?.choose_method(printer)?;
    if resolved.settings.measure_only {
        return Err(usage("measure-only: `femc view` shows images; `femc measure` only measures"));
    }
    resolved.explain_method(printer);
    resolved.warn_of_lost_light(printer);
    let parcel = resolved.parcel()?;
    let spec = client::job_spec(&resolved, &parcel, resolved.plan.frames.clone())?;
    let Some(&first) = spec.frames.first() else { return Err(usage("--frames: there is no frame")) };
    let work = EmbeddedWork { workers: resolved.workers, threads: resolved.threads, solved: resolved.solved.clone() };
    client::runtime()?.block_on(async {
        let mut interrupt = Interrupt::listen()?;
        let (mut farm, client, tokens) = start(args, Role::Operator, work, site()).await?;
        let (job, _) = client.submit(&parcel, unique_key(), spec).await?;
        let page = format!("/jobs/{job}/light?frames={first}");
        let addresses = Addresses { args, farm: farm.url(), tokens: &tokens, page, printer };
        let outcome = tokio::select! {
            () = interrupt.wait() => Ok(Exit::Done),
            fault = addresses.print() => Err(fault),
            stopped = follow(&client, job, &resolved, printer) => stopped,
            broken = farm.wait_for_failure() => return Err(broken),
        };
        drop(client);
        farm.stop().await;
        outcome
    })
}

/// Shows the progress of a job in the terminal. Returns only after an error.
async fn follow(
    client: &FarmClient,
    job: JobId,
    resolved: &ResolvedRequest,
    printer: Printer,
) -> Result<Exit, Failure> {
    let mut progress = Some(Progress::new(printer, Clock));
    loop {
        let status = client.status(job).await?;
        if let Some(bar) = &mut progress {
            bar.show(&show::progress_snapshot(&status, Some(resolved.settings.stop)));
        }
        if status.state.has_ended()
            && let Some(mut bar) = progress.take()
        {
            bar.finish();
            show::failure_lines(&status).iter().for_each(|line| printer.warning(line));
            printer.note("the page stays until Ctrl-C");
        }
        tokio::time::sleep(PROGRESS_INTERVAL).await;
    }
}

/// Workers of a farm in this process. By default there are none, and the farm only serves pages.
#[derive(Default)]
struct EmbeddedWork {
    workers: u32,
    threads: Option<u32>,
    solved: Option<SolvedFirstPass>,
}

/// Starts a farm in memory that only holders of its tokens can use.
async fn start(
    args: &ViewArgs,
    role: Role,
    EmbeddedWork { workers, threads, solved }: EmbeddedWork,
    site: Site,
) -> Result<(EmbeddedFarm, FarmClient, RunTokens), Failure> {
    let tokens = RunTokens::new(role)?;
    let config = EmbeddedConfig {
        listen: SocketAddr::from(([127, 0, 0, 1], args.port)),
        log: LogStorage::Memory,
        artifacts: ArtifactStorage::Memory,
        workers,
        threads,
        solved,
        site,
        tokens: Some(&tokens),
    };
    let (farm, client) = EmbeddedFarm::start(config).await?;
    Ok((farm, client, tokens))
}

/// Addresses that lead browsers to a page.
struct Addresses<'a> {
    args: &'a ViewArgs,
    /// Address of the farm.
    farm: String,
    tokens: &'a RunTokens,
    page: String,
    printer: Printer,
}

impl Addresses<'_> {
    /// Prints an address and opens it in a browser. Prints another address whenever one was used. Returns only after an error.
    async fn print(&self) -> Failure {
        let mut current = self.tokens.logins().subscribe();
        let first = self.address(&current.borrow_and_update());
        if let Err(fault) = self.print_address(first.clone()).and_then(|()| self.open(&first)) {
            return fault;
        }
        // The sender lives as long as the tokens.
        while current.changed().await.is_ok() {
            let next = self.address(&current.borrow_and_update());
            if !self.args.format.json {
                self.printer.note("a browser has signed in; this address signs in another one:");
            }
            if let Err(fault) = self.print_address(next) {
                return fault;
            }
        }
        failed("no browser can sign in any more; run the command again")
    }

    fn address(&self, token: &Token) -> String {
        // The fragment of an address is not sent to servers and does not appear in their logs.
        format!("{}/login#token={}&from={}", self.farm, token.secret(), url_encoded(&self.page))
    }

    fn print_address(&self, url: String) -> Result<(), Failure> {
        if self.args.format.json {
            return json::print_line(self.printer, &ViewReport { url, token: self.tokens.user_token() });
        }
        self.printer.result(&url);
        Ok(())
    }

    fn open(&self, url: &str) -> Result<(), Failure> {
        if !self.args.no_browser {
            embedded::open_browser(&self.tokens.entrance(url)?);
        }
        Ok(())
    }
}

/// Encodes text for a value in the query or the fragment of a URL.
fn url_encoded(text: &str) -> String {
    let encode = |byte: u8| match byte {
        b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'-' | b'_' => char::from(byte).to_string(),
        _ => format!("%{byte:02X}"),
    };
    text.bytes().map(encode).collect()
}
