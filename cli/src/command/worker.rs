//! `femc worker --join URL`: a farm machine.

use super::client::{Farm, runtime};
use super::interrupt::Interrupt;
use crate::clock::Clock;
use crate::exit::{Exit, Failure, failed};
use crate::output::Say;
use crate::request::{Budget, Volume};
use clap::Args;
use femc_worker::{AtStop, Cache, Config, Pieces, Worker, WorkerError};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Render for a farm, until it is stopped
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc worker --join http://127.0.0.1:7878\n  \
    femc worker --join http://farm:7878 --threads 8 --tags lab,big\n  \
    femc worker --join http://farm:7878 --cache /var/cache/femc --cache-size 50GiB\n\n\
    Ctrl-C or SIGTERM lets the worker finish what it is at and gives back the rest; a second one ends it at once. A worker that loses its coordinator looks for it until it is back.")]
pub struct WorkerArgs {
    /// The farm's coordinator
    #[arg(long, value_name = "URL", env = "FEMC_SERVER")]
    join: String,
    /// Threads that render [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    threads: Option<u32>,
    /// What the worker offers: jobs with tags go to workers that have them all
    #[arg(long, value_name = "A,B", value_delimiter = ',')]
    tags: Vec<String>,
    /// Name for people [default: the machine's]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Folder that keeps pieces of scenes, also for the next start [default: they are kept in memory]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// Most bytes of such pieces; what was used longest ago goes first [default: 256MiB, with --cache 10GiB]
    #[arg(long, value_name = "SIZE")]
    cache_size: Option<Volume>,
    /// How long to look for the coordinator at the start
    #[arg(long, value_name = "DURATION", default_value = "30s")]
    patience: Budget,
}

/// Between two looks.
const RETRY: Duration = Duration::from_millis(300);

/// Work.
pub fn run(args: WorkerArgs, say: Say) -> Result<Exit, Failure> {
    let pieces = pieces(args.cache.as_deref(), args.cache_size)?;
    runtime()?.block_on(async {
        let mut interrupt = Interrupt::listen()?;
        tokio::select! {
            found = coordinator(&args.join, args.patience) => found?,
            () = interrupt.wait() => return Ok(Exit::Done),
        }
        let config = Config {
            name: args.name.unwrap_or_else(machine),
            threads: args.threads.map_or(0, |threads| threads as usize),
            tags: args.tags,
            cache: Cache::with(pieces),
            at_stop: AtStop::Finish,
            ..Config::new(args.join)
        };
        let stop = async move {
            interrupt.wait().await;
            say.note("stopping after the task that runs; once more to stop at once");
        };
        match Worker::run(config, stop).await {
            Ok(()) => {
                say.note("stopped");
                Ok(Exit::Done)
            }
            Err(WorkerError::Call(error)) => Err(super::client::told(error)),
            Err(error @ WorkerError::Threads(_)) => Err(failed(error)),
        }
    })
}

/// Where pieces of scenes are kept.
fn pieces(folder: Option<&Path>, size: Option<Volume>) -> Result<Pieces, Failure> {
    let Some(folder) = folder else {
        return Ok(Pieces::memory(size.map_or(Pieces::IN_MEMORY, |size| size.0)));
    };
    let limit = size.map_or(Pieces::IN_FOLDER, |size| size.0);
    let wrong = |e| failed(format!("--cache {}: {e}; give a folder that can be written", folder.display()));
    Pieces::folder(folder, limit).map_err(wrong)
}

/// Wait for the coordinator: it may be starting too.
async fn coordinator(url: &str, patience: Budget) -> Result<(), Failure> {
    let begun = Clock.now();
    loop {
        match Farm::connect(url).await {
            Err(failure)
                if failure.exit == Exit::Unreachable && Clock.since(begun).as_secs_f64() < patience.seconds =>
            {
                tokio::time::sleep(RETRY).await;
            }
            found => return found.map(drop),
        }
    }
}

/// The machine's name.
fn machine() -> String {
    let file = std::fs::read_to_string("/etc/hostname").ok().map(|name| name.trim().to_owned());
    let named = file.into_iter().chain(std::env::var("HOSTNAME")).chain(std::env::var("COMPUTERNAME"));
    named.into_iter().find(|name| !name.is_empty()).unwrap_or_else(|| "worker".to_owned())
}
