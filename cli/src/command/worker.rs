//! `femc worker --join URL`: runs a worker of a farm.

use super::client::{ConnectFailure, FarmClient, Retryable, runtime};
use super::interrupt::Interrupt;
use super::{metrics, outbox};
use crate::args::{IdentityArgs, MetricsArgs};
use crate::clock::Clock;
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::Printer;
use crate::values::{ByteSize, ByteSizeError, DurationArg, Hours};
use clap::Args;
use femc_proto::Dialer;
use femc_worker::clip::{self, FFMPEG};
use femc_worker::{
    Availability, Cache, Config, MemoryLimit, PieceCache, StopBehavior, Worker, WorkerError, WorkingHours,
};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Run a worker of a farm
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc worker --join http://127.0.0.1:7878\n  \
    femc worker --join http://farm:7878 --threads 8 --tags lab,big\n  \
    femc worker --join http://one:7878,http://two:7878                   # two coordinators: connects to the leader\n  \
    femc worker --join http://farm:7878 --nice 10 --memory 8G            # beside other work\n  \
    femc worker --join http://farm:7878 --hours 'Mon-Fri 20:00-06:00,Sat-Sun 00:00-24:00'\n  \
    femc worker --join http://farm:7878 --idle-exit 10m                  # on a rented machine\n  \
    femc worker --join http://farm:7878 --cache /var/cache/femc --cache-size 50GiB\n\n\
    After Ctrl-C or SIGTERM, the worker has --grace to finish its running tasks, and gives back the rest; a second signal ends \
    it at once. A worker that loses its coordinator reconnects when the coordinator is back.")]
pub struct WorkerArgs {
    /// URL of the farm's coordinator; several URLs with commas: the one that answers is used
    #[arg(long, value_name = "URL,..", env = "FEMC_SERVER")]
    join: String,
    #[command(flatten)]
    identity: IdentityArgs,
    /// Number of render threads [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    threads: Option<u32>,
    /// Tags that the worker offers: jobs with tags go to workers that have all of them. `ffmpeg` is added if it is on the
    /// PATH
    #[arg(long, value_name = "A,B", value_delimiter = ',')]
    tags: Vec<String>,
    /// Name for people [default: the machine's]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Folder for results that the coordinator has not acknowledged, or memory: after a restart, the worker uploads the results in
    /// the folder [default: one under the user's state folder, by coordinator and name]
    #[arg(long, value_name = "DIR", value_parser = outbox::parse)]
    outbox: Option<outbox::OutboxArg>,
    /// Limit of resident memory above which the worker drops cached scenes, then gives tasks back: 8G, 512M
    ///
    /// Limit of resident memory above which the worker drops cached scenes, then gives tasks back: 8G, 512M. A task starts only if
    /// the worker's size plus the most that a task of this kind has added so far is below the limit. The limit is not strict: a
    /// single task may need more than expected.
    #[arg(long, value_name = "SIZE", value_parser = memory)]
    memory: Option<ByteSize>,
    /// Niceness of the render threads, 0 to 19: higher values yield to other programs
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=19))]
    nice: Option<u8>,
    /// Local time in which the worker takes tasks, like 20:00-06:00 or 'Mon-Fri 20:00-06:00,Sat-Sun 00:00-24:00'
    ///
    /// Local time in which the worker takes tasks, like 20:00-06:00 or 'Mon-Fri 20:00-06:00,Sat-Sun 00:00-24:00'. A window over
    /// midnight belongs to the day on which it begins. Outside of the windows the worker finishes its running task, gives back the
    /// others, and stays connected.
    #[arg(long, value_name = "WINDOWS")]
    hours: Option<Hours>,
    /// Exit with code 0 after this long without a task: 10m, 1h
    #[arg(long, value_name = "DURATION")]
    idle_exit: Option<DurationArg>,
    /// Folder that caches pieces of scenes across restarts [default: cache in memory]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// Size limit of this cache; the least recently used pieces are removed first [default: 256MiB, with --cache 10GiB]
    #[arg(long, value_name = "SIZE")]
    cache_size: Option<ByteSize>,
    /// On a stop request: time to finish running tasks before they are given back
    #[arg(long, value_name = "DURATION", default_value = "60s")]
    grace: DurationArg,
    #[command(flatten)]
    metrics: MetricsArgs,
    /// Time to wait for the coordinator at the start
    #[arg(long, value_name = "DURATION", default_value = "30s")]
    patience: DurationArg,
}

/// Interval between two connection attempts.
const RETRY_INTERVAL: Duration = Duration::from_millis(300);

/// Smallest memory limit. A smaller one must be a typing error.
const MIN_MEMORY: u64 = 1 << 20;

fn memory(text: &str) -> Result<ByteSize, String> {
    let size: ByteSize = text.parse().map_err(|error: ByteSizeError| error.to_string())?;
    if size.0 < MIN_MEMORY {
        return Err(format!("no task would ever fit; give some GiB, at least {}", ByteSize(MIN_MEMORY)));
    }
    Ok(size)
}

/// Returns a schedule that takes tasks within `hours`.
fn work_schedule(hours: Hours) -> WorkingHours {
    WorkingHours::from_fn(move || if hours.contains_now() { Availability::Available } else { Availability::Off })
}

/// Runs `femc worker`.
pub fn run(args: WorkerArgs, printer: Printer) -> Result<Exit, Failure> {
    let unknown = || usage("--memory: this system does not report how much memory a process uses; omit --memory");
    let memory = args.memory.map(|ByteSize(bytes)| MemoryLimit::for_process(bytes).ok_or_else(unknown)).transpose()?;
    let dial = args.identity.dial()?;
    let cache_pieces = open_cache(args.cache.as_deref(), args.cache_size)?;
    runtime()?.block_on(async {
        let mut interrupt = Interrupt::listen()?;
        tokio::select! {
            found = wait_for_coordinator(&dial, &args.join, args.patience) => found?,
            () = interrupt.wait() => return Ok(Exit::Done),
        }
        let name = args.name.unwrap_or_else(host_name);
        let config = Config {
            outbox: outbox::config(args.outbox, &args.join, &name),
            name,
            threads: args.threads.map_or(0, |threads| threads as usize),
            tags: tags(args.tags),
            memory,
            niceness: args.nice,
            working_hours: args.hours.map_or_else(WorkingHours::default, work_schedule),
            idle_limit: args.idle_exit.map(|limit| Duration::from_secs_f64(limit.seconds.min(1e9))),
            cache: Cache::with_pieces(cache_pieces),
            stop_behavior: StopBehavior::Finish { within: Duration::from_secs_f64(args.grace.seconds.min(1e9)) },
            dial,
            ..Config::new(args.join)
        };
        let service_metrics = config.metrics.clone();
        metrics::start_page(args.metrics.metrics, move || std::future::ready(service_metrics.report()), printer)
            .await?;
        let stop = async move {
            interrupt.wait().await;
            printer.note("stopping after the running task; signal again to stop at once");
        };
        match Worker::run(config, stop).await {
            Ok(()) => {
                printer.note("stopped");
                Ok(Exit::Done)
            }
            Err(WorkerError::Call(error)) => Err(super::client::map_call_error(error)),
            Err(error @ WorkerError::Nice { .. }) => Err(failed(format!("--nice: {error}; omit --nice"))),
            Err(error @ WorkerError::Threads(_)) => Err(failed(error)),
            Err(error @ WorkerError::Outbox { .. }) => {
                Err(failed(format!("--{error}; give another folder, or memory")))
            }
        }
    })
}

/// Returns the worker's tags: the typed ones, and `ffmpeg` if it can be run.
fn tags(mut tags: Vec<String>) -> Vec<String> {
    if !tags.iter().any(|tag| tag == FFMPEG) && clip::ffmpeg_version().is_some() {
        tags.push(FFMPEG.to_owned());
    }
    tags
}

/// Opens the cache of scene pieces.
fn open_cache(folder: Option<&Path>, size: Option<ByteSize>) -> Result<PieceCache, Failure> {
    let Some(folder) = folder else {
        return Ok(PieceCache::in_memory(size.map_or(PieceCache::DEFAULT_MEMORY_LIMIT, |size| size.0)));
    };
    let limit = size.map_or(PieceCache::DEFAULT_FOLDER_LIMIT, |size| size.0);
    let wrong = |e| failed(format!("--cache {}: {e}; give a folder that can be written", folder.display()));
    PieceCache::in_folder(folder, limit).map_err(wrong)
}

/// Waits for the coordinator, which may also be starting.
async fn wait_for_coordinator(dial: &Dialer, url: &str, patience: DurationArg) -> Result<(), Failure> {
    let begun = Clock.now();
    loop {
        match FarmClient::connect(dial, url, "--join").await {
            Err(ConnectFailure { retryable: Retryable::Yes, .. })
                if Clock.since(begun).as_secs_f64() < patience.seconds =>
            {
                tokio::time::sleep(RETRY_INTERVAL).await;
            }
            met => return met.map(drop).map_err(|unmet| unmet.failure),
        }
    }
}

/// Returns the machine's name.
fn host_name() -> String {
    let file = std::fs::read_to_string("/etc/hostname").ok().map(|name| name.trim().to_owned());
    let named = file.into_iter().chain(std::env::var("HOSTNAME")).chain(std::env::var("COMPUTERNAME"));
    named.into_iter().find(|name| !name.is_empty()).unwrap_or_else(|| "worker".to_owned())
}
