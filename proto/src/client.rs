//! What a program that is not the coordinator uses: ask, fetch, and be a worker.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use femc_model::{
    Artifact, Attempts, Control, Crew, Digest, Drain, FrameParts, FrameRecord, FromWorker, JobId, JobSpec, JobStatus,
    LogRecord, OwnerUsage, Registration, Tick, ToWorker, WorkerId, WorkerName, WorkerStatus,
};
use hyper_util::rt::TokioIo;
use tokio::io::{AsyncWrite, AsyncWriteExt as _};
use tokio::sync::mpsc;
use tokio_stream::StreamExt as _;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Endpoint, Uri};

use crate::addresses::Addresses;
use crate::bearer::{Bearer, Bearing};
use crate::convert::{ConvertError, digest, digest_bytes, each, need};
use crate::error::{BackupError, CallError, Why, from_status};
use crate::many::{Many, together};
use crate::net::Dial;
use crate::{ASSIGNMENT, MESSAGE, PIECE, tls, wire};
use crate::{JobShape, Listing};
use wire::artifacts_client::ArtifactsClient;
use wire::attempts_reply::Part;
use wire::backup_reply::Part as BackupPart;
use wire::jobs_client::JobsClient;
use wire::workers_client::WorkersClient;

/// A connection to a coordinator; clones share it. It mends itself when the coordinator comes back, or when another of
/// those that were given leads.
#[derive(Debug, Clone)]
pub struct Client {
    addresses: Arc<Addresses>,
    channel: Bearing,
}

impl Client {
    /// How long one of several coordinators may take to answer the first call: one that is frozen takes connections.
    const PATIENCE: Duration = Duration::from_millis(1500);

    /// Connects to `urls`: one, such as `http://127.0.0.1:7878`, or several with commas between, of which the first that
    /// answers is used.
    pub async fn connect(urls: &str) -> Result<Self, CallError> {
        Self::connect_by(&Dial::tcp(), urls).await
    }

    /// The same over another network.
    pub async fn connect_by(dial: &Dial, urls: &str) -> Result<Self, CallError> {
        let addresses = Arc::new(Addresses::parse(urls)?);
        let mut left = addresses.count();
        if left == 1 {
            return Self::open(dial, addresses).await;
        }
        loop {
            let client = Self::open(dial, addresses.clone()).await?;
            left -= 1;
            let silent = || CallError::Unreachable {
                url: client.url().into(),
                message: "it does not answer".into(),
                why: Why::Away,
            };
            match tokio::time::timeout(Self::PATIENCE, client.missing(&[])).await {
                Ok(Ok(_)) => return Ok(client),
                Ok(Err(error)) if left == 0 => return Err(error),
                Err(_) if left == 0 => return Err(silent()),
                Ok(Err(_)) | Err(_) => {}
            }
        }
    }

    async fn open(dial: &Dial, addresses: Arc<Addresses>) -> Result<Self, CallError> {
        let url = || addresses.list();
        let is_alone = addresses.count() == 1;
        // Where another may have taken over, a coordinator that is silent is left soon.
        let (every, patience) = if is_alone { (10, 10) } else { (1, 3) };
        let address = |message: String| CallError::Address { url: url(), message };
        let mut endpoint = Endpoint::from_shared(addresses.first().to_string())
            .map_err(|error| address(chain(&error)))?
            .http2_keep_alive_interval(Duration::from_secs(every))
            .keep_alive_timeout(Duration::from_secs(patience))
            .initial_stream_window_size(4 << 20)
            .initial_connection_window_size(16 << 20);
        if addresses.are_encrypted() {
            let tls = match (&dial.identity, &dial.pass) {
                (Some(identity), _) => tls::client(identity),
                (None, Some(pass)) => {
                    tls::known_by(pass.authority().ok_or_else(|| CallError::NoAuthority { url: url() })?)
                }
                (None, None) => return Err(CallError::NoIdentity { url: url() }),
            };
            endpoint = endpoint.tls_config(tls).map_err(|error| address(chain(&error)))?;
        } else if let Some(far) = dial.pass.as_ref().and_then(|_| addresses.beyond_this_machine()) {
            return Err(CallError::OpenToken { url: far.into() });
        }
        let bearer = Bearer::of(dial.pass.as_deref());
        let channel = if is_alone && dial.way.is_none() {
            endpoint.connect_timeout(Duration::from_secs(5)).connect().await
        } else {
            let (dial, addresses) = (dial.clone(), addresses.clone());
            let connector = tower::service_fn(move |_: Uri| {
                let link = addresses.clone().reach(dial.clone());
                async move { link.await.map(TokioIo::new) }
            });
            endpoint.connect_with_connector(connector).await
        };
        let channel = channel.map_err(|error| CallError::Unreachable {
            url: url(),
            message: chain(&error),
            why: tls::why(&error),
        })?;
        Ok(Self { addresses, channel: InterceptedService::new(channel, bearer) })
    }

    /// The coordinator's address.
    pub fn url(&self) -> &str {
        self.addresses.used()
    }

    fn jobs(&self) -> JobsClient<Bearing> {
        JobsClient::new(self.channel.clone()).max_decoding_message_size(MESSAGE)
    }

    pub(crate) fn artifacts(&self) -> ArtifactsClient<Bearing> {
        ArtifactsClient::new(self.channel.clone()).max_decoding_message_size(2 * PIECE)
    }

    pub(crate) fn error(&self, status: &tonic::Status) -> CallError {
        from_status(self.url(), status)
    }

    /// Queues a job; a second submission with the same key gives the same job.
    pub async fn submit(&self, key: Option<String>, spec: JobSpec) -> Result<JobId, CallError> {
        let request = wire::SubmitRequest { job: Some(spec.into()), key };
        let reply = self.jobs().submit(request).await.map_err(|status| self.error(&status))?;
        Ok(JobId(reply.into_inner().job))
    }

    /// Every job.
    pub async fn list(&self) -> Result<Vec<JobStatus>, CallError> {
        Ok(self.listing().await?.jobs)
    }

    /// Every job, and what somebody should look after.
    pub async fn listing(&self) -> Result<Listing, CallError> {
        let reply = self.jobs().list(wire::ListRequest {}).await.map_err(|status| self.error(&status))?;
        let wire::ListReply { jobs, warnings } = reply.into_inner();
        Ok(Listing { jobs: each(jobs)?, warnings })
    }

    /// One job.
    pub async fn status(&self, job: JobId) -> Result<JobStatus, CallError> {
        let request = wire::StatusRequest { job: job.0 };
        let reply = self.jobs().status(request).await.map_err(|status| self.error(&status))?;
        Ok(reply.into_inner().try_into()?)
    }

    /// The job's status now and at every change, until it has ended.
    pub async fn watch(&self, job: JobId) -> Result<Watch, CallError> {
        let request = wire::WatchRequest { job: job.0 };
        let reply = self.jobs().watch(request).await.map_err(|status| self.error(&status))?;
        Ok(Watch { url: self.url().into(), stream: reply.into_inner() })
    }

    /// Pauses, resumes, cancels, retries, changes the priority.
    pub async fn control(&self, job: JobId, control: Control) -> Result<(), CallError> {
        let request = wire::ControlRequest { job: job.0, control: Some(control.into()) };
        self.jobs().control(request).await.map_err(|status| self.error(&status))?;
        Ok(())
    }

    /// What there is of a job's frames in work, ascending.
    pub async fn parts(&self, job: JobId) -> Result<Vec<FrameParts>, CallError> {
        let request = wire::PartsRequest { job: job.0 };
        let reply = self.jobs().parts(request).await.map_err(|status| self.error(&status))?;
        Ok(each(reply.into_inner().frames)?)
    }

    /// The finished frames of a job, ascending.
    pub async fn frames(&self, job: JobId) -> Result<Vec<FrameRecord>, CallError> {
        self.ask_frames(wire::FramesRequest { job: job.0, times: false }).await
    }

    /// The finished frames of a job, ascending, with the times of their attempts. An older coordinator leaves the times out.
    pub async fn frames_with_times(&self, job: JobId) -> Result<Vec<FrameRecord>, CallError> {
        self.ask_frames(wire::FramesRequest { job: job.0, times: true }).await
    }

    async fn ask_frames(&self, request: wire::FramesRequest) -> Result<Vec<FrameRecord>, CallError> {
        let reply = self.jobs().frames(request).await.map_err(|status| self.error(&status))?;
        Ok(each(reply.into_inner().frames)?)
    }

    /// What workers wrote down while they did the job's tasks, oldest first, of attempts reported since then.
    pub async fn logs(&self, job: JobId, since: Tick) -> Result<Vec<LogRecord>, CallError> {
        let request = wire::LogsRequest { job: job.0, since: since.0 };
        let reply = self.jobs().logs(request).await.map_err(|status| self.error(&status))?;
        Ok(each(reply.into_inner().logs)?)
    }

    /// What a job is made of, and what the attempts at its tasks took.
    pub async fn attempts(&self, job: JobId) -> Result<(JobShape, Attempts), CallError> {
        let request = wire::AttemptsRequest { job: job.0 };
        let reply = self.jobs().attempts(request).await.map_err(|status| self.error(&status))?;
        let (mut stream, mut shape, mut attempts) = (reply.into_inner(), None, Attempts::default());
        while let Some(part) = stream.message().await.map_err(|status| self.error(&status))? {
            match need("attempts.part", part.part)? {
                Part::Job(job) => shape = Some(job.try_into()?),
                Part::Attempts(page) => {
                    for record in page.attempts {
                        attempts.put(record.try_into()?);
                    }
                }
            }
        }
        Ok((need("attempts.job", shape)?, attempts))
    }

    /// A job as it was submitted.
    pub async fn spec(&self, job: JobId) -> Result<JobSpec, CallError> {
        let request = wire::AttemptsRequest { job: job.0 };
        let reply = self.jobs().attempts(request).await.map_err(|status| self.error(&status))?;
        // It comes before the attempts.
        let part = reply.into_inner().message().await.map_err(|status| self.error(&status))?;
        let Some(Part::Job(shape)) = part.and_then(|part| part.part) else {
            return Err(ConvertError::Missing { field: "attempts.job" }.into());
        };
        Ok(*JobShape::try_from(shape)?.spec)
    }

    /// The workers that are there, in order of joining.
    pub async fn workers(&self) -> Result<Vec<WorkerStatus>, CallError> {
        Ok(self.crew().await?.there)
    }

    /// The workers that are there, and those that were.
    pub async fn crew(&self) -> Result<Crew, CallError> {
        let reply =
            self.jobs().list_workers(wire::ListWorkersRequest {}).await.map_err(|status| self.error(&status))?;
        Ok(reply.into_inner().try_into()?)
    }

    /// What the owners' jobs used of the farm, by month and owner.
    pub async fn usage(&self) -> Result<Vec<OwnerUsage>, CallError> {
        let reply = self.jobs().usage(wire::UsageRequest {}).await.map_err(|status| self.error(&status))?;
        Ok(each(reply.into_inner().usage)?)
    }

    /// Gives workers no more tasks, or tasks again; returns the sessions that it was done to.
    pub async fn drain(&self, worker: WorkerName, drain: Drain) -> Result<Vec<WorkerId>, CallError> {
        let request = wire::DrainWorkersRequest::from((worker, drain));
        let reply = self.jobs().drain_workers(request).await.map_err(|status| self.error(&status))?;
        Ok(reply.into_inner().workers.into_iter().map(WorkerId).collect())
    }

    /// A copy of the coordinator's log, written to `log`; what the log refers to and the store has.
    pub async fn backup(&self, mut log: impl AsyncWrite + Unpin) -> Result<Vec<Artifact>, BackupError> {
        let reply = self.jobs().backup(wire::BackupRequest {}).await.map_err(|status| self.error(&status))?;
        let (mut stream, mut artifacts) = (reply.into_inner(), Vec::new());
        while let Some(part) = stream.message().await.map_err(|status| self.error(&status))? {
            match need("backup.part", part.part).map_err(CallError::from)? {
                BackupPart::Artifacts(some) => {
                    artifacts.extend(each::<_, Artifact>(some.artifacts).map_err(CallError::from)?);
                }
                BackupPart::Log(piece) => log.write_all(&piece).await?,
            }
        }
        log.flush().await?;
        Ok(artifacts)
    }

    /// Those of `digests` that the coordinator's store does not have.
    pub async fn missing(&self, digests: &[Digest]) -> Result<Vec<Digest>, CallError> {
        let request = wire::MissingRequest { digests: digests.iter().map(digest_bytes).collect() };
        let reply = self.artifacts().missing(request).await.map_err(|status| self.error(&status))?;
        let digests = reply.into_inner().digests;
        Ok(digests.iter().map(|bytes| digest("missing.digest", bytes)).collect::<Result<_, ConvertError>>()?)
    }

    /// Begins a worker's session.
    pub async fn session(&self, registration: Registration) -> Result<(Outgoing, Incoming), CallError> {
        let (send, receive) = mpsc::channel(256);
        let outgoing = Outgoing(send);
        outgoing.send(FromWorker::Register(registration)).await;
        let mut client = WorkersClient::new(self.channel.clone()).max_decoding_message_size(ASSIGNMENT);
        let messages = together(ReceiverStream::new(receive).map(wire::FromWorker::from));
        let reply = client.session(messages).await.map_err(|status| self.error(&status))?;
        Ok((outgoing, Incoming { url: self.url().into(), stream: reply.into_inner(), waiting: VecDeque::new() }))
    }
}

/// An error and what caused it, on one line.
fn chain(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    causes.last().map_or_else(String::new, ToString::to_string)
}

/// A job's statuses as they change.
#[derive(Debug)]
pub struct Watch {
    url: String,
    stream: Streaming<wire::JobStatus>,
}

impl Watch {
    /// The next status; `None` after that of the job's end.
    pub async fn next(&mut self) -> Result<Option<JobStatus>, CallError> {
        let status = self.stream.message().await.map_err(|status| from_status(&self.url, &status))?;
        Ok(status.map(JobStatus::try_from).transpose()?)
    }
}

/// A worker's way to the coordinator. Clones share it; the session ends when all are dropped.
#[derive(Debug, Clone)]
pub struct Outgoing(mpsc::Sender<FromWorker>);

impl Outgoing {
    /// Sends; waits while the connection is full. After the session's end the message goes nowhere, and the reader of
    /// [`Incoming`] hears of the end.
    pub async fn send(&self, message: FromWorker) {
        let _ = self.0.send(message).await;
    }
}

/// The coordinator's way to a worker.
#[derive(Debug)]
pub struct Incoming {
    url: String,
    stream: Streaming<wire::ToWorker>,
    /// Came together with the one before.
    waiting: VecDeque<wire::ToWorker>,
}

impl Incoming {
    /// The next message; `None` at the session's end.
    pub async fn next(&mut self) -> Result<Option<ToWorker>, CallError> {
        loop {
            if let Some(message) = self.waiting.pop_front() {
                return Ok(Some(message.try_into()?));
            }
            let message = self.stream.message().await.map_err(|status| from_status(&self.url, &status))?;
            match message.map(Many::split) {
                None => return Ok(None),
                Some(Ok(many)) => self.waiting.extend(many),
                Some(Err(one)) => return Ok(Some(one.try_into()?)),
            }
        }
    }
}
