//! Connection to a coordinator: the one of this process, or one at `--server`.

use crate::args::ServerArgs;
use crate::clock::Clock;
use crate::exit::{Failure, failed, unreachable, usage};
use crate::request::ResolvedRequest;
use femc_model::{
    Artifact, Attempts, Control, Digest, Drain, FrameParts, FrameRecord, Grid, JobId, JobSpec, JobStatus, LogRecord,
    OwnerUsage, Refusal, Stage, Tick, WorkerId, WorkerList, WorkerSelector,
};
use femc_proto::{
    BackupError, CallError, Client, CollectMode, CollectReport, Dialer, JobList, JobShape, ProbeResult,
    UnreachableCause,
};
use femc_worker::Parcel;
use std::time::Duration;

/// Time that a call waits for a coordinator that has gone away.
pub const RECONNECT_TIMEOUT: Duration = Duration::from_secs(60);
/// Time that one of several coordinators may take to become the leader. A leader that froze is replaced only after `--silence`.
const FAILOVER_TIMEOUT: Duration = Duration::from_secs(10);
/// Number of repeated uploads of a scene that the store has lost meanwhile.
const MAX_REUPLOADS: usize = 2;
/// Pause between two attempts.
const RETRY_INTERVAL: Duration = Duration::from_millis(500);

/// A connection to a coordinator. Its errors are converted into failures of this program.
#[derive(Clone, Debug)]
pub struct FarmClient {
    client: Client,
}

/// Options of client commands that set the coordinator's address.
pub const SERVER_OPTIONS: &str = "--server or FEMC_SERVER";

/// A failed connection to a coordinator.
#[derive(Debug)]
pub struct ConnectFailure {
    /// Reason, address and advice.
    pub failure: Failure,
    /// Whether a coordinator may still start there.
    pub retryable: Retryable,
}

/// Whether waiting may help.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Retryable {
    /// Nothing answers there yet: a coordinator may be about to start.
    Yes,
    /// Something answers, and it cannot be used.
    No,
}

/// Runs `work` with the coordinator at `--server`.
pub fn block_on<T>(
    server: &ServerArgs,
    work: impl AsyncFnOnce(&FarmClient) -> Result<T, Failure>,
) -> Result<T, Failure> {
    runtime()?.block_on(async {
        let dial = server.identity.dial()?;
        let farm = FarmClient::connect(&dial, &server.server, SERVER_OPTIONS).await.map_err(|unmet| unmet.failure)?;
        work(&farm).await
    })
}

/// Creates a runtime for network calls. Rendering has threads of its own.
pub fn runtime() -> Result<tokio::runtime::Runtime, Failure> {
    tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(|e| failed(format!("cannot start threads: {e}")))
}

impl FarmClient {
    /// Connects, and checks that a coordinator answers. If there are several addresses, it waits for another coordinator to take
    /// over.
    /// - `option`: option that the address comes from.
    pub async fn connect(dial: &Dialer, url: &str, option: &str) -> Result<Self, ConnectFailure> {
        let begun = Clock.now();
        loop {
            match Self::connect_and_probe(dial, url).await {
                Err(CallError::Unreachable { .. }) if url.contains(',') && Clock.since(begun) < FAILOVER_TIMEOUT => {
                    tokio::time::sleep(RETRY_INTERVAL).await;
                }
                Ok(client) => return Ok(Self { client }),
                Err(error) => return Err(diagnose_connection(error, option).await),
            }
        }
    }

    /// Connects and makes a first call: a connection alone does not show that the other end answers.
    async fn connect_and_probe(dial: &Dialer, url: &str) -> Result<Client, CallError> {
        let client = Client::connect_with(dial, url).await?;
        client.missing(&[]).await?;
        Ok(client)
    }

    /// Returns the coordinator's address.
    pub fn url(&self) -> &str {
        self.client.url()
    }

    /// Uploads the artifacts of a scene that the farm's store lacks. Returns the number of bytes sent.
    async fn upload(&self, scene: &Parcel) -> Result<u64, Failure> {
        self.client.put_all(&scene.artifacts()).await.map_err(map_call_error)
    }

    /// Queues a job of `scene`, after uploading the missing part of the scene. Returns the job and the number of bytes sent. `key`:
    /// a second submission with the same key is the same job, so the call is repeated if the coordinator goes away before it
    /// answers.
    pub async fn submit(&self, scene: &Parcel, key: Digest, spec: JobSpec) -> Result<(JobId, u64), Failure> {
        let mut sent = self.upload(scene).await?;
        let submit = || with_retry(|| self.client.submit(Some(key.to_string()), spec.clone()));
        for _ in 0..MAX_REUPLOADS {
            match submit().await {
                // The artifacts were removed between upload and submission.
                Err(CallError::Refused(Refusal::MissingArtifacts { .. })) => sent += self.upload(scene).await?,
                submitted => return Ok((submitted.map_err(map_call_error)?, sent)),
            }
        }
        Ok((submit().await.map_err(map_call_error)?, sent))
    }

    /// Returns an artifact's bytes.
    pub async fn get(&self, artifact: &Artifact) -> Result<Vec<u8>, Failure> {
        Ok(self.client.get_exactly(artifact).await.map_err(map_call_error)?.to_vec())
    }

    /// Returns an artifact's bytes, or `None` if the artifact is gone or damaged.
    pub async fn get_if_present(&self, artifact: &Artifact) -> Result<Option<Vec<u8>>, Failure> {
        match self.client.get_exactly(artifact).await {
            Ok(bytes) => Ok(Some(bytes.to_vec())),
            Err(CallError::Refused(Refusal::NoSuchArtifact { .. } | Refusal::DigestMismatch { .. })) => Ok(None),
            Err(error) => Err(map_call_error(error)),
        }
    }

    /// Returns all jobs.
    pub async fn jobs(&self) -> Result<Vec<JobStatus>, Failure> {
        self.client.list().await.map_err(map_call_error)
    }

    /// Returns all jobs, and what needs attention.
    pub async fn listing(&self) -> Result<JobList, Failure> {
        self.client.listing().await.map_err(map_call_error)
    }

    /// Returns all jobs. Waits for a coordinator that is away for a while.
    pub async fn jobs_with_retry(&self) -> Result<Vec<JobStatus>, Failure> {
        with_retry(|| self.client.list()).await.map_err(map_call_error)
    }

    /// Returns the status of one job.
    pub async fn status(&self, job: JobId) -> Result<JobStatus, Failure> {
        self.client.status(job).await.map_err(map_call_error)
    }

    /// Returns the status of one job. Waits for a coordinator that is away for a while.
    pub async fn status_with_retry(&self, job: JobId) -> Result<JobStatus, Failure> {
        self.status_reporting_outage(job, |_| {}).await
    }

    /// Like [`Self::status_with_retry`], but calls `on_outage` repeatedly with the time that the coordinator has been away.
    pub async fn status_reporting_outage(
        &self,
        job: JobId,
        on_outage: impl FnMut(Duration),
    ) -> Result<JobStatus, Failure> {
        with_retry_reporting(|| self.client.status(job), on_outage).await.map_err(map_call_error)
    }

    /// Returns the finished frames of a job, ascending, without the outputs of the job as a whole.
    pub async fn frames(&self, job: JobId) -> Result<Vec<FrameRecord>, Failure> {
        let mut frames = self.client.frames(job).await.map_err(map_call_error)?;
        frames.retain(|record| record.frame != Stage::JOB_FRAME);
        Ok(frames)
    }

    /// Returns the finished frames of a job, ascending, with the times of their attempts if the coordinator knows them.
    pub async fn frames_with_times(&self, job: JobId) -> Result<Vec<FrameRecord>, Failure> {
        self.client.frames_with_times(job).await.map_err(map_call_error)
    }

    /// Returns a job as it was submitted.
    pub async fn spec(&self, job: JobId) -> Result<JobSpec, Failure> {
        self.client.spec(job).await.map_err(map_call_error)
    }

    /// Returns the finished outputs of a job as a whole; `None`: none yet.
    pub async fn job_outputs(&self, job: JobId) -> Result<Option<FrameRecord>, Failure> {
        let records = self.client.frames(job).await.map_err(map_call_error)?;
        Ok(records.into_iter().find(|record| record.frame == Stage::JOB_FRAME))
    }

    /// Returns the image of a finished frame, or `None` if it is damaged or gone.
    pub async fn image(&self, frame: &FrameRecord) -> Result<Option<Vec<u8>>, Failure> {
        match frame.image() {
            Some(image) => self.get_if_present(&image).await,
            None => Ok(None),
        }
    }

    /// Returns the finished parts of a job's frames in progress, ascending.
    pub async fn parts(&self, job: JobId) -> Result<Vec<FrameParts>, Failure> {
        let mut frames = self.client.parts(job).await.map_err(map_call_error)?;
        frames.retain(|parts| parts.frame != Stage::JOB_FRAME);
        Ok(frames)
    }

    /// Applies a control command to a job.
    pub async fn control(&self, job: JobId, control: Control) -> Result<(), Failure> {
        self.client.control(job, control).await.map_err(map_call_error)
    }

    /// Cancels a job, unless it has ended in the meantime.
    pub async fn cancel_if_running(&self, job: JobId) -> Result<(), Failure> {
        match self.client.control(job, Control::Cancel).await {
            Ok(()) | Err(CallError::Refused(Refusal::Ended { .. })) => Ok(()),
            Err(error) => Err(map_call_error(error)),
        }
    }

    /// Returns the log records of a job's tasks, oldest first, of attempts reported since `since`.
    pub async fn logs(&self, job: JobId, since: Tick) -> Result<Vec<LogRecord>, Failure> {
        self.client.logs(job, since).await.map_err(map_call_error)
    }

    /// Returns the shape of a job, and the usage of its attempts.
    pub async fn attempts(&self, job: JobId) -> Result<(JobShape, Attempts), Failure> {
        self.client.attempts(job).await.map_err(map_call_error)
    }

    /// Drains workers, or ends the draining. Returns the sessions concerned.
    pub async fn drain(&self, worker: WorkerSelector, drain: Drain) -> Result<Vec<WorkerId>, Failure> {
        self.client.drain(worker, drain).await.map_err(map_call_error)
    }

    /// Returns the usage of the farm, by month and owner.
    pub async fn usage(&self) -> Result<Vec<OwnerUsage>, Failure> {
        self.client.usage().await.map_err(map_call_error)
    }

    /// Returns the current and the former workers.
    pub async fn workers(&self) -> Result<WorkerList, Failure> {
        self.client.all_workers().await.map_err(map_call_error)
    }

    /// Copies the log into a file. Returns the artifacts that the log refers to and that the store has.
    pub async fn backup(&self, log: &mut tokio::fs::File) -> Result<Vec<Artifact>, Failure> {
        self.client.backup(log).await.map_err(|error| match error {
            BackupError::Call(error) => map_call_error(error),
            error @ BackupError::Write(_) => failed(error),
        })
    }

    /// Removes garbage from the store, or only reports it.
    pub async fn collect(&self, mode: CollectMode, grace: Duration) -> Result<CollectReport, Failure> {
        self.client.collect(mode, grace).await.map_err(map_call_error)
    }
}

/// Repeats a call while the coordinator is away.
async fn with_retry<T>(call: impl AsyncFn() -> Result<T, CallError>) -> Result<T, CallError> {
    with_retry_reporting(call, |_| {}).await
}

/// Like [`with_retry`], but calls `on_outage` with the time that the coordinator has been away.
async fn with_retry_reporting<T>(
    call: impl AsyncFn() -> Result<T, CallError>,
    mut on_outage: impl FnMut(Duration),
) -> Result<T, CallError> {
    let begun = Clock.now();
    let mut is_logged = false;
    loop {
        match call().await {
            Err(error @ (CallError::Unreachable { .. } | CallError::Refused(Refusal::Unavailable { .. })))
                if Clock.since(begun) < RECONNECT_TIMEOUT =>
            {
                if matches!(error, CallError::Refused(_)) && !std::mem::replace(&mut is_logged, true) {
                    tracing::error!("{error}; retrying for {} s", RECONNECT_TIMEOUT.as_secs());
                }
                on_outage(Clock.since(begun));
                tokio::time::sleep(RETRY_INTERVAL).await;
            }
            answer => return answer,
        }
    }
}

/// Converts a failed first call. Looks at the address to find out what answers there.
async fn diagnose_connection(error: CallError, option: &str) -> ConnectFailure {
    let CallError::Unreachable { ref url, cause: UnreachableCause::Connection, .. } = error else {
        let may_come = match &error {
            CallError::Refused(Refusal::Unavailable { .. }) => Retryable::Yes,
            _ => Retryable::No,
        };
        return ConnectFailure { failure: map_call_error(error), retryable: may_come };
    };
    let advice = format!("start one with `femc coordinator`, or give its address with {option}");
    if url.contains(',') {
        return ConnectFailure { failure: unreachable(format!("{error}; {advice}")), retryable: Retryable::Yes };
    }
    let is_https = url.starts_with("https:");
    let (message, may_come) = match femc_proto::probe_address(url).await {
        ProbeResult::Unreachable { message } => {
            (format!("cannot connect to a coordinator at {url} ({message}); {advice}"), Retryable::Yes)
        }
        ProbeResult::Tls if !is_https => (
            format!(
                "{url} is encrypted; write https:// instead of http:// in {option}, and give --identity or --token-file"
            ),
            Retryable::No,
        ),
        ProbeResult::PlainHttp2 if is_https => (
            format!(
                "{url} is not encrypted: the coordinator there has no identity (`femc coordinator --identity`); \
                 write http:// instead of https:// in {option} if this is intended"
            ),
            Retryable::No,
        ),
        ProbeResult::Silent => (
            format!(
                "{url} accepts connections but does not answer: the coordinator there is stopped, overloaded or still starting, or \
                 a tunnel or proxy leads nowhere; retry when it is up, or give another address with {option}"
            ),
            Retryable::Yes,
        ),
        ProbeResult::OtherProtocol => (
            format!(
                "the server at {url} is not a coordinator: it uses another protocol; give the coordinator's address with {option}"
            ),
            Retryable::No,
        ),
        ProbeResult::PlainHttp2 | ProbeResult::Tls => {
            (format!("{error}; a server listens there: retry, or give another address with {option}"), Retryable::Yes)
        }
    };
    ConnectFailure { failure: unreachable(message), retryable: may_come }
}

/// Converts a failed call into a failure of this program.
pub fn map_call_error(error: CallError) -> Failure {
    match error {
        CallError::Address { .. } => usage(format!("{error}; write it like http://127.0.0.1:7878")),
        CallError::NoIdentity { .. } => {
            usage(format!("{error}; give it with --identity or FEMC_IDENTITY, --token-file or FEMC_TOKEN_FILE"))
        }
        CallError::InsecureToken { .. } => usage(format!("{error}; give an address that begins with https://")),
        CallError::NoAuthority { .. } => {
            usage(format!("{error}; `femc ca token` writes token files with this certificate"))
        }
        CallError::Unreachable { cause: UnreachableCause::ServerCertificate, .. } => unreachable(format!(
            "{error}; this coordinator belongs to another farm than the given identity or token: \
             give one that this coordinator's farm has issued, or the address of your farm"
        )),
        CallError::Unreachable { cause: UnreachableCause::ClientCertificate, .. } => unreachable(format!(
            "{error}; the coordinator refuses this identity: another farm's authority has issued it, or it has expired; \
             give one that this farm has issued (`femc ca issue`)"
        )),
        // A coordinator answered here before, so the address is not examined again.
        CallError::Unreachable { cause: UnreachableCause::Connection, .. } => {
            unreachable(format!("{error}; it answered before: retry when it is back"))
        }
        CallError::Refused(refusal) => match refusal {
            Refusal::NoSuchJob { .. } => usage(format!("{refusal}; `femc jobs` lists all")),
            Refusal::NoSuchWorker { .. } => usage(format!("{refusal}; `femc workers` lists all")),
            Refusal::Ended { .. } | Refusal::Invalid { .. } => usage(refusal),
            Refusal::Unavailable { .. } => unreachable(refusal),
            Refusal::StaleEpoch
            | Refusal::NoSuchArtifact { .. }
            | Refusal::DigestMismatch { .. }
            | Refusal::TooLarge { .. }
            | Refusal::NoRoom { .. }
            | Refusal::ArtifactTooLarge { .. }
            | Refusal::MissingArtifacts { .. }
            | Refusal::Resume { .. } => failed(refusal),
            Refusal::Unauthenticated { .. } => failed(format!(
                "{refusal}; give an --identity or --token-file that this farm has issued and not revoked (`femc ca list`)"
            )),
            Refusal::Forbidden { .. } => {
                failed(format!("{refusal}; ask the administrator of the farm's authority (`femc ca`)"))
            }
        },
        CallError::Answer(_) | CallError::Status { .. } => failed(error),
    }
}

/// Returns the farm's specification of a job of `frames`.
pub fn job_spec(resolved: &ResolvedRequest, scene: &Parcel, frames: Vec<u32>) -> Result<JobSpec, Failure> {
    let settings = serde_json::to_string(&resolved.settings).map_err(failed)?;
    if settings.len() > JobSpec::MAX_SETTINGS && resolved.settings.measure.is_some() {
        let (found, limit) = (settings.len() >> 10, JobSpec::MAX_SETTINGS >> 10);
        return Err(usage(format!(
            "--measure: the request has {found} KiB, at most {limit} are possible in a job; a [[grid]] takes less than its points"
        )));
    }
    Ok(JobSpec {
        name: resolved.name(),
        bundle: scene.digest(),
        entry: resolved.entry(),
        settings,
        contents: first_pass_keys(resolved, &frames)?,
        frames,
        grid: Grid { film: resolved.film(), tile: resolved.plan.tiling.edge },
        graph: resolved.plan.graph.clone(),
        priority: resolved.priority.unwrap_or(DEFAULT_PRIORITY),
        owner: login_name(),
        tags: resolved.tags.clone(),
        notes: resolved.notes.clone(),
    })
}

/// Returns the keys of the frames' first passes, in runs of frames that share one; empty if the method has no first pass.
pub fn first_pass_keys(resolved: &ResolvedRequest, frames: &[u32]) -> Result<Vec<(u32, Digest)>, Failure> {
    if !resolved.plan.method.has_first_pass() {
        return Ok(Vec::new());
    }
    let blocks = femc_pipeline::planned_first_pass_blocks(&resolved.plan.graph);
    let mut runs: Vec<(u32, Digest)> = Vec::new();
    for (place, &frame) in (1..).zip(frames) {
        let frame_key = femc_pipeline::frame_key(&resolved.source, &resolved.settings, frame).map_err(failed)?;
        let key = Digest::from_bytes(femc_pipeline::first_pass_key(&frame_key, resolved.plan.method, blocks));
        match runs.last_mut() {
            Some((end, other)) if *other == key => *end = place,
            _ => runs.push((place, key)),
        }
    }
    Ok(runs)
}

/// Priority of a job without an explicit one.
pub const DEFAULT_PRIORITY: u8 = 50;

/// Returns the user's login name.
pub fn login_name() -> String {
    ["USER", "LOGNAME", "USERNAME"].iter().find_map(|name| std::env::var(name).ok()).unwrap_or_else(|| "advice".into())
}
