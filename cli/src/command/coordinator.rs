//! `femc coordinator`: runs the farm's coordinator.

use super::client::runtime;
use super::interrupt::Interrupt;
use super::metrics;
use super::site::site;
use crate::args::MetricsArgs;
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::Printer;
use crate::values::{ByteSize, DurationArg};
use clap::Args;
use femc_coordinator::{
    AccessControl, ArtifactStorage, Config, Coordinator, CoordinatorError, Exposure, Handle, Leadership, LogStorage,
    LossPolicy, Metrics, NotifyConfig, NotifyKey, Postgres, QueueError, UrlPrefix,
};
use femc_metrics::ProcessReport;
use femc_trust::{Audit, Holder, Identity, RevocationList, Tokens, browser_fingerprint};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::time::Duration;

/// Run the farm's coordinator
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc coordinator\n  \
    femc coordinator --listen 127.0.0.1:7878 --store sqlite:farm.db --artifacts artifacts\n  \
    AWS_ENDPOINT_URL=http://minio:9000 AWS_ALLOW_HTTP=true femc coordinator --artifacts s3://farm/artifacts\n  \
    femc coordinator --on-end 'mail -s \"femc: $FEMC_NAME is $FEMC_STATE\" \"$FEMC_OWNER\"'\n  \
    femc coordinator --notify-allow https://hooks.example.com/femc/ --notify-key notify.key\n  \
    femc coordinator --share ann=3 --share bob=1    # ann's jobs get three times the worker time of bob's\n  \
    femc coordinator --store postgres://femc@127.0.0.1/farm --artifacts artifacts    # one of several: one leads\n  \
    femc coordinator --listen 127.0.0.1:0    # any free port; the first line on stdout says which\n\n\
    After Ctrl-C, SIGTERM or a crash, start the coordinator again with the same --store and --artifacts to resume; its workers \
    reconnect by themselves.\n\n\
    Several coordinators can share one PostgreSQL database and one artifacts folder. One leads and listens; the others stand \
    by, and one of them takes over within seconds if the leader dies, freezes or loses the database. Give workers and clients \
    all addresses: --join http://one:7878,http://two:7878. The password can come from PGPASSWORD or ~/.pgpass. All tables are \
    in the schema femc, which is created if it does not exist.")]
pub struct CoordinatorArgs {
    /// Address and port to listen on
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:7878")]
    listen: SocketAddr,
    /// Log of jobs: sqlite:PATH, postgres://USER@HOST:PORT/DATABASE, or memory (lost at the end)
    #[arg(long, value_name = "STORE", default_value = "sqlite:femc-farm/farm.db", value_parser = store)]
    store: LogStorage,
    /// With postgres://: a leader without a sign of life for longer than this is replaced; must be the same for all coordinators of
    /// a farm
    #[arg(long, value_name = "DURATION", default_value = "3s", value_parser = silence)]
    silence: Duration,
    /// A worker that is silent for longer than this loses its leases, 1s to 10m; choose more for unreliable networks
    #[arg(long, value_name = "DURATION", default_value = "4.5s", value_parser = lease)]
    lease: Duration,
    /// Compact the log after this many records: fewer make restarts faster, more save disk writes
    #[arg(long, value_name = "N", default_value = "20000", value_parser = clap::value_parser!(u32).range(1..))]
    compact: u32,
    /// Expire jobs this long after their end, 1m or more, like 30d: then they cannot be fetched, and `femc gc` frees their
    /// artifacts (without it they are kept forever)
    #[arg(long, value_name = "DURATION", value_parser = keep_ended)]
    keep_ended: Option<Duration>,
    /// Size limit of the shared-result cache: the latest results are kept for later jobs; results that a job waits for are always
    /// kept
    #[arg(long, value_name = "SIZE", default_value = "16GiB")]
    keep_shared: ByteSize,
    /// Store of scenes, tiles and images: a folder, s3://BUCKET/PREFIX (keys, region and endpoint come from AWS_ACCESS_KEY_ID,
    /// AWS_SECRET_ACCESS_KEY, AWS_REGION, AWS_ENDPOINT_URL, AWS_ALLOW_HTTP), or memory (lost at the end); several coordinators
    /// share one
    #[arg(long, value_name = "DIR|URL", default_value = "femc-farm/artifacts", value_parser = artifacts)]
    artifacts: ArtifactStorage,
    /// Free space to keep on the disks of the log and of the artifacts, like 256MiB: below it, no new jobs are accepted and running
    /// jobs continue; below four times this size the coordinator warns
    #[arg(long, value_name = "SIZE", default_value = "256MiB")]
    keep_free: ByteSize,
    /// Open a log that has lost acknowledged records, and continue with the rest; such a log is not opened otherwise. A backup
    /// (`femc backup`) may have more: check it first
    #[arg(long)]
    accept_loss: bool,
    /// Weight of an owner in the fair share of worker time among jobs of equal priority; repeatable (default weight: 1)
    #[arg(long, value_name = "OWNER=WEIGHT", value_parser = share)]
    share: Vec<(String, u32)>,
    /// Identity of this coordinator (`femc ca issue coordinator NAME`): connections are encrypted, and only clients with an
    /// identity of the same authority are accepted
    #[arg(long, env = "FEMC_IDENTITY", value_name = "FILE", conflicts_with = "insecure")]
    identity: Option<PathBuf>,
    /// List of revoked identities, the file `revoked` in the authority's folder; read again when it changes
    #[arg(long, value_name = "FILE", requires = "identity")]
    revoked: Option<PathBuf>,
    /// List of valid tokens, the file `tokens` in the authority's folder (`femc ca token`); read again when it changes: a token
    /// whose line is removed is refused. Without --identity all clients need a token, also on this machine
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Audit log of changes and refusals, one line of JSON each [default: audit.jsonl beside the log's file]
    #[arg(long, value_name = "FILE")]
    audit: Option<PathBuf>,
    /// Allow jobs to name URLs that begin with this prefix, to which a message is posted when they have ended
    /// (`femc submit --notify`); repeatable. Without it none is allowed, so that users cannot reach this machine's network
    #[arg(long, value_name = "PREFIX", requires = "notify_key")]
    notify_allow: Vec<UrlPrefix>,
    /// File with the key that signs these messages (Standard Webhooks): 16 bytes or more, or whsec_ and their base64
    #[arg(long, value_name = "FILE")]
    notify_key: Option<PathBuf>,
    /// Shell command to run when a job has ended: the job is in FEMC_JOB, FEMC_NAME, FEMC_OWNER, FEMC_STATE, FEMC_FRAMES,
    /// FEMC_FRAMES_DONE, and as JSON on standard input
    #[arg(long, value_name = "COMMAND")]
    on_end: Option<String>,
    /// Listen without encryption on an address that other machines can reach
    #[arg(long)]
    insecure: bool,
    #[command(flatten)]
    metrics: MetricsArgs,
}

fn store(text: &str) -> Result<LogStorage, String> {
    match text.split_once(':') {
        None if text == "memory" => Ok(LogStorage::Memory),
        Some(("sqlite", path)) if !path.is_empty() => Ok(LogStorage::Sqlite(PathBuf::from(path))),
        Some(("postgres" | "postgresql", _)) => match text.parse() {
            Ok(database) => Ok(LogStorage::Postgres { database, silence: Postgres::SILENCE }),
            Err(error) => Err(format!("{error}; write it like postgres://user@host:5432/database")),
        },
        _ => Err("give sqlite:PATH, like sqlite:farm.db, postgres://user@host/database, or memory".to_owned()),
    }
}

fn silence(text: &str) -> Result<Duration, String> {
    parse_duration_within(text, 3600.0, "1s to 1h")
}

fn lease(text: &str) -> Result<Duration, String> {
    parse_duration_within(text, 600.0, "1s to 10m")
}

fn keep_ended(text: &str) -> Result<Duration, String> {
    let DurationArg { seconds } = text.parse::<DurationArg>().map_err(|error| error.to_string())?;
    // Clients that wait for the end of a job must still find the job.
    if seconds < 60.0 {
        return Err("give 1m or more".to_owned());
    }
    Duration::try_from_secs_f64(seconds).map_err(|error| error.to_string())
}

/// Parses a duration from one second to `most`; `range` describes this range in the error.
fn parse_duration_within(text: &str, most: f64, range: &str) -> Result<Duration, String> {
    let DurationArg { seconds } = text.parse::<DurationArg>().map_err(|error| error.to_string())?;
    if (1.0..=most).contains(&seconds) { Ok(Duration::from_secs_f64(seconds)) } else { Err(format!("give {range}")) }
}

fn artifacts(text: &str) -> Result<ArtifactStorage, String> {
    match text.split_once("://") {
        _ if text == "memory" => Ok(ArtifactStorage::Memory),
        None => Ok(ArtifactStorage::Folder(PathBuf::from(text))),
        Some(("file", path)) => Ok(ArtifactStorage::Folder(PathBuf::from(path))),
        Some(("s3", _)) => Ok(ArtifactStorage::S3(text.to_owned())),
        Some((scheme, _)) => {
            Err(format!("{scheme}:// is not supported yet; give a folder, s3://BUCKET/PREFIX, or memory"))
        }
    }
}

fn share(text: &str) -> Result<(String, u32), String> {
    let fault = || "give OWNER=WEIGHT with a whole weight from 1 to 1000000, like ann=3".to_owned();
    let (owner, weight) = text.rsplit_once('=').ok_or_else(fault)?;
    let weight = weight.parse().ok().filter(|weight| (1..=1_000_000).contains(weight)).ok_or_else(fault)?;
    if owner.is_empty() { Err(fault()) } else { Ok((owner.to_owned(), weight)) }
}

/// Runs `femc coordinator`.
pub fn run(args: CoordinatorArgs, printer: Printer) -> Result<Exit, Failure> {
    if let LogStorage::Sqlite(path) = &args.store
        && let Some(folder) = path.parent().filter(|folder| *folder != Path::new(""))
    {
        std::fs::create_dir_all(folder).map_err(|e| failed(format!("--store {}: {e}", folder.display())))?;
    }
    let log = match args.store {
        LogStorage::Postgres { .. } if args.artifacts == ArtifactStorage::Memory => {
            return Err(usage(
                "--artifacts memory: coordinators on one database must share a folder; give --artifacts DIR",
            ));
        }
        LogStorage::Postgres { database, .. } => LogStorage::Postgres { database, silence: args.silence },
        log => log,
    };
    let entrance = access_control(args.identity.as_deref(), args.revoked, args.token_file.as_deref())?;
    if args.token_file.is_some() && args.identity.is_none() && !args.listen.ip().is_loopback() {
        return Err(usage(format!(
            "--token-file: {} is reachable from other machines, and tokens would cross the network unencrypted; give \
             --identity (`femc ca --help`)",
            args.listen
        )));
    }
    let warning = entrance.as_ref().and_then(|entrance| browser_warning(entrance.identity.as_ref()?));
    let audit = open_audit(args.audit, &log)?;
    let exposure = if args.insecure { Exposure::Anybody } else { Exposure::Loopback };
    if args.insecure && !args.listen.ip().is_loopback() {
        printer.warning(format!(
            "{} is reachable from other machines; everybody who can reach it can submit jobs and read images",
            args.listen
        ));
    }
    let key = args.notify_key.as_deref().map(NotifyKey::read).transpose();
    let key = key.map_err(|error| failed(format!("--notify-key: {error}")))?;
    let announce = NotifyConfig { allowed: args.notify_allow, key, on_end: args.on_end };
    let config = Config {
        announce,
        listen: args.listen,
        exposure,
        access_control: entrance,
        audit,
        site: site(),
        log,
        artifacts: args.artifacts,
        scheduler: femc_schedule::Config {
            keep_ended: args.keep_ended.map(|keep| u64::try_from(keep.as_millis()).unwrap_or(u64::MAX)),
            shared_bytes: args.keep_shared.0,
            weights: args.share.into_iter().collect(),
            ..femc_schedule::Config::with_lease(args.lease.as_millis() as u64)
        },
        snapshot_interval: args.compact as usize,
        keep_free: args.keep_free.0,
        loss_policy: if args.accept_loss { LossPolicy::Accept } else { LossPolicy::Refuse },
        ..Config::default()
    };
    let service_metrics = config.metrics.clone();
    super::open_files::raise_limit();
    runtime()?.block_on(async {
        let mut interrupt = Interrupt::listen()?;
        let mut coordinator = Coordinator::start(config).await.map_err(|e| map_coordinator_error(&e))?;
        let (mut standing, url) = (coordinator.leadership(), coordinator.url());
        metrics::start_page(args.metrics.metrics, reporter(service_metrics, &coordinator), printer).await?;
        loop {
            print_leadership(printer, &standing.borrow_and_update(), &url, warning.as_deref());
            tokio::select! {
                error = coordinator.failed() => return Err(map_coordinator_error(&error)),
                () = interrupt.wait() => break,
                Ok(()) = standing.changed() => {}
            }
        }
        coordinator.stop().await.map_err(|e| map_coordinator_error(&e))?;
        printer.note("stopped; start it again with the same --store and --artifacts to resume");
        Ok(Exit::Done)
    })
}

/// Returns a function that reports the coordinator's metrics.
fn reporter(
    service_metrics: Metrics,
    coordinator: &Handle,
) -> impl Fn() -> Pin<Box<dyn Future<Output = ProcessReport> + Send>> + Clone + Send + Sync + 'static {
    let standing = coordinator.leadership();
    move || {
        let (service_metrics, standing) = (service_metrics.clone(), standing.borrow().clone());
        Box::pin(async move { service_metrics.report(&standing).await })
    }
}

fn access_control(
    identity: Option<&Path>,
    revoked: Option<PathBuf>,
    tokens: Option<&Path>,
) -> Result<Option<AccessControl>, Failure> {
    let identity = identity.map(coordinator_identity).transpose()?;
    let revoked =
        revoked.map(RevocationList::open).transpose().map_err(|error| failed(format!("--revoked: {error}")))?;
    let tokens = tokens.map(Tokens::open).transpose().map_err(|error| {
        failed(format!(
            "--token-file: {error}; `femc ca token` makes tokens and the file `tokens` in the authority's folder"
        ))
    })?;
    let is_open = identity.is_none() && tokens.is_none();
    Ok((!is_open).then_some(AccessControl { identity, revoked, tokens, logins: None }))
}

/// Reads an identity file. Fails if the identity is not a coordinator's.
fn coordinator_identity(path: &Path) -> Result<Identity, Failure> {
    let identity = crate::args::read_identity(path)?;
    if !matches!(identity.holder(), Holder::Coordinator { .. }) {
        let what = "is not for a coordinator; issue one with `femc ca issue coordinator NAME`";
        return Err(failed(format!("--identity {}: the identity of {} {what}", path.display(), identity.holder())));
    }
    Ok(identity)
}

/// Opens the audit log at the requested path, or beside the log of jobs if that is a file.
fn open_audit(requested: Option<PathBuf>, log: &LogStorage) -> Result<Option<Audit>, Failure> {
    let default_path = match log {
        LogStorage::Sqlite(path) => Some(path.with_file_name("audit.jsonl")),
        LogStorage::Memory | LogStorage::Postgres { .. } => None,
    };
    let audit = requested.or(default_path).map(|path| Audit::open(&path)).transpose();
    audit.map_err(|error| failed(format!("--audit: {error}; give a file that can be written")))
}

/// Returns a note about the warning of browsers at a coordinator with this identity, and its remedy.
fn browser_warning(identity: &Identity) -> Option<String> {
    let fingerprint = browser_fingerprint(identity.authority()).ok()?;
    Some(format!(
        "browsers warn about an unknown authority until its certificate is imported: `femc ca export` writes the certificate, \
         without a key; its SHA-256 fingerprint is {fingerprint}"
    ))
}

fn print_leadership(printer: Printer, standing: &Leadership, url: &str, warning: Option<&str>) {
    match standing {
        Leadership::Leader => {
            printer.result(format!("listening on {url}"));
            if !site().files.is_empty() {
                printer.note(format!("the farm in a browser: {url}/"));
                warning.into_iter().for_each(|warning| printer.note(warning));
            }
        }
        Leadership::Standby { leader: Some(leader) } => printer.note(format!("standing by; {leader} leads")),
        Leadership::Standby { leader: None } => {}
        Leadership::Disconnected { message } => printer.warning(format!("{message}; retrying until it is back")),
    }
}

fn map_coordinator_error(error: &CoordinatorError) -> Failure {
    match error {
        CoordinatorError::Listen { .. } => failed(format!("--listen: {error}; give another address or port")),
        CoordinatorError::Exposed { .. } => {
            usage(format!("--listen: {error}; use 127.0.0.1, or give --identity (`femc ca --help`) or --insecure"))
        }
        CoordinatorError::Queue(QueueError::Unreachable { .. }) => {
            failed(format!("--store: {error}; check that PostgreSQL runs there and listens on that port"))
        }
        CoordinatorError::Queue(QueueError::Rejected { .. }) => {
            failed(format!("--store: {error}; check user, password (PGPASSWORD, ~/.pgpass) and database"))
        }
        CoordinatorError::Queue(QueueError::ForeignTables { .. }) => {
            failed(format!("--store: {error}; nothing was changed: give another database"))
        }
        CoordinatorError::Queue(
            QueueError::MissingRecords { .. } | QueueError::Unverifiable { .. } | QueueError::Damaged { .. },
        ) => failed(format!(
            "--store: {error}; nothing was changed: restore a copy (`femc backup --help`), or continue with the remaining records: \
                 --accept-loss"
        )),
        CoordinatorError::Queue(QueueError::DamagedSnapshot) => {
            failed(format!("--store: {error}; nothing was changed: restore a copy (`femc backup --help`)"))
        }
        CoordinatorError::Queue(QueueError::OutOfSpace { .. }) => failed(format!(
            "--store: {error}; all acknowledged records are kept: free disk space and start the coordinator again"
        )),
        CoordinatorError::Queue(_) | CoordinatorError::Ledger(_) => failed(format!("--store: {error}")),
        CoordinatorError::Store(_) => failed(format!("--artifacts: {error}")),
        CoordinatorError::Serve(_) | CoordinatorError::Panicked => failed(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinator_options_parse_and_bad_values_are_refused() {
        assert!(matches!(store("sqlite:a/b.db"), Ok(LogStorage::Sqlite(path)) if path == Path::new("a/b.db")));
        assert!(matches!(store("memory"), Ok(LogStorage::Memory)));
        assert!(matches!(store("postgres://ann:secret@host/farm"), Ok(LogStorage::Postgres { .. })));
        for wrong in ["postgres:farm", "postgres://ann:secret@host:port/farm"] {
            let error = store(wrong).expect_err("no address");
            assert!(error.contains("postgres://user@host") && !error.contains("secret"), "{error}");
        }
        assert!(store("sqlite:").is_err() && store("farm.db").is_err());
        assert_eq!(silence("1500ms"), Ok(Duration::from_millis(1500)));
        assert!(["0s", "10ms", "2h", "long"].iter().all(|text| silence(text).is_err()));
        assert_eq!(lease("30s"), Ok(Duration::from_secs(30)));
        assert!(["0.5s", "11m", "ever"].iter().all(|text| lease(text).is_err()));
        assert_eq!(keep_ended("30d"), Ok(Duration::from_secs(30 * 86_400)));
        assert!(["59s", "1e30d", "ever"].iter().all(|text| keep_ended(text).is_err()));
        assert_eq!(share("ann=3"), Ok(("ann".into(), 3)));
        assert!(["ann", "ann=0", "=3", "ann=-1", "ann=many"].iter().all(|text| share(text).is_err()));
        assert_eq!(artifacts("a/b"), Ok(ArtifactStorage::Folder("a/b".into())));
        assert_eq!(artifacts("s3://bucket/prefix"), Ok(ArtifactStorage::S3("s3://bucket/prefix".into())));
        assert!(artifacts("gs://bucket/prefix").is_err_and(|error| error.contains("not supported yet")));
    }
}
