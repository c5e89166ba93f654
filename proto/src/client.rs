//! The client side: for programs that query, submit and download, and for workers.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use femc_model::{
    Artifact, Attempts, Control, Digest, Drain, FrameParts, FrameRecord, FromWorker, JobId, JobSpec, JobStatus,
    LogRecord, OwnerUsage, Registration, Tick, ToWorker, WorkerId, WorkerList, WorkerSelector, WorkerStatus,
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
use crate::batch::{Batch, batch_ready};
use crate::bearer::{AuthorizedChannel, TokenInterceptor};
use crate::convert::{ConvertError, convert_all, digest_bytes, parse_digest, required};
use crate::error::{BackupError, CallError, UnreachableCause, from_status};
use crate::net::Dialer;
use crate::{JobList, JobShape};
use crate::{MAX_ASSIGNMENT_SIZE, MAX_MESSAGE_SIZE, MAX_PIECE_SIZE, tls, wire};
use wire::artifacts_client::ArtifactsClient;
use wire::attempts_reply::Part;
use wire::backup_reply::Part as BackupPart;
use wire::jobs_client::JobsClient;
use wire::workers_client::WorkersClient;

/// A connection to a coordinator. Clones share it. It reconnects when the coordinator comes back, or when another of the given
/// coordinators leads.
#[derive(Debug, Clone)]
pub struct Client {
    addresses: Arc<Addresses>,
    channel: AuthorizedChannel,
}

impl Client {
    /// Timeout of the first call, if there are several coordinators: a frozen one still accepts connections.
    const FIRST_CALL_TIMEOUT: Duration = Duration::from_millis(1500);

    /// Connects to `urls`: one address, such as `http://127.0.0.1:7878`, or several separated by commas. The first one that answers
    /// is used.
    pub async fn connect(urls: &str) -> Result<Self, CallError> {
        Self::connect_with(&Dialer::tcp(), urls).await
    }

    /// Connects like [`Self::connect`], but over the network of `dial`.
    pub async fn connect_with(dial: &Dialer, urls: &str) -> Result<Self, CallError> {
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
                message: "no answer".into(),
                cause: UnreachableCause::Connection,
            };
            match tokio::time::timeout(Self::FIRST_CALL_TIMEOUT, client.missing(&[])).await {
                Ok(Ok(_)) => return Ok(client),
                Ok(Err(error)) if left == 0 => return Err(error),
                Err(_) if left == 0 => return Err(silent()),
                Ok(Err(_)) | Err(_) => {}
            }
        }
    }

    async fn open(dial: &Dialer, addresses: Arc<Addresses>) -> Result<Self, CallError> {
        let url = || addresses.list();
        let is_alone = addresses.count() == 1;
        // Leave a silent coordinator soon if another one may have taken over.
        let (every, patience) = if is_alone { (10, 10) } else { (1, 3) };
        let address = |message: String| CallError::Address { url: url(), message };
        let mut endpoint = Endpoint::from_shared(addresses.first().to_string())
            .map_err(|error| address(root_cause(&error)))?
            .http2_keep_alive_interval(Duration::from_secs(every))
            .keep_alive_timeout(Duration::from_secs(patience))
            .initial_stream_window_size(4 << 20)
            .initial_connection_window_size(16 << 20);
        if addresses.are_encrypted() {
            let tls = match (&dial.identity, &dial.token_file) {
                (Some(identity), _) => tls::client_config(identity),
                (None, Some(pass)) => tls::client_config_without_certificate(
                    pass.authority().ok_or_else(|| CallError::NoAuthority { url: url() })?,
                ),
                (None, None) => return Err(CallError::NoIdentity { url: url() }),
            };
            endpoint = endpoint.tls_config(tls).map_err(|error| address(root_cause(&error)))?;
        } else if let Some(far) = dial.token_file.as_ref().and_then(|_| addresses.first_remote_url()) {
            return Err(CallError::InsecureToken { url: far.into() });
        }
        let bearer = TokenInterceptor::new(dial.token_file.as_deref());
        let channel = if is_alone && dial.dial_fn.is_none() {
            endpoint.connect_timeout(Duration::from_secs(5)).connect().await
        } else {
            let (dial, addresses) = (dial.clone(), addresses.clone());
            let connector = tower::service_fn(move |_: Uri| {
                let link = addresses.clone().connect(dial.clone());
                async move { link.await.map(TokioIo::new) }
            });
            endpoint.connect_with_connector(connector).await
        };
        let channel = channel.map_err(|error| CallError::Unreachable {
            url: url(),
            message: root_cause(&error),
            cause: tls::unreachable_cause(&error),
        })?;
        Ok(Self { addresses, channel: InterceptedService::new(channel, bearer) })
    }

    /// Returns the coordinator's address.
    pub fn url(&self) -> &str {
        self.addresses.current_url()
    }

    fn jobs(&self) -> JobsClient<AuthorizedChannel> {
        JobsClient::new(self.channel.clone()).max_decoding_message_size(MAX_MESSAGE_SIZE)
    }

    pub(crate) fn artifacts(&self) -> ArtifactsClient<AuthorizedChannel> {
        ArtifactsClient::new(self.channel.clone()).max_decoding_message_size(2 * MAX_PIECE_SIZE)
    }

    pub(crate) fn call_error(&self, status: &tonic::Status) -> CallError {
        from_status(self.url(), status)
    }

    /// Submits a job. A second submission with the same key returns the same job, or is refused if its results would differ.
    pub async fn submit(&self, key: Option<String>, spec: JobSpec) -> Result<JobId, CallError> {
        let request = wire::SubmitRequest { job: Some(spec.into()), key };
        let reply = self.jobs().submit(request).await.map_err(|status| self.call_error(&status))?;
        Ok(JobId(reply.into_inner().job))
    }

    /// Lists all jobs.
    pub async fn list(&self) -> Result<Vec<JobStatus>, CallError> {
        Ok(self.listing().await?.jobs)
    }

    /// Lists all jobs, and the problems that need attention.
    pub async fn listing(&self) -> Result<JobList, CallError> {
        let reply = self.jobs().list(wire::ListRequest {}).await.map_err(|status| self.call_error(&status))?;
        let wire::ListReply { jobs, warnings } = reply.into_inner();
        Ok(JobList { jobs: convert_all(jobs)?, warnings })
    }

    /// Returns a job's status.
    pub async fn status(&self, job: JobId) -> Result<JobStatus, CallError> {
        let request = wire::StatusRequest { job: job.0 };
        let reply = self.jobs().status(request).await.map_err(|status| self.call_error(&status))?;
        Ok(reply.into_inner().try_into()?)
    }

    /// Streams the job's status, now and at every change, until the job has ended.
    pub async fn watch(&self, job: JobId) -> Result<JobWatch, CallError> {
        let request = wire::WatchRequest { job: job.0 };
        let reply = self.jobs().watch(request).await.map_err(|status| self.call_error(&status))?;
        Ok(JobWatch { url: self.url().into(), stream: reply.into_inner() })
    }

    /// Pauses, resumes, cancels or retries a job, or changes its priority.
    pub async fn control(&self, job: JobId, control: Control) -> Result<(), CallError> {
        let request = wire::ControlRequest { job: job.0, control: Some(control.into()) };
        self.jobs().control(request).await.map_err(|status| self.call_error(&status))?;
        Ok(())
    }

    /// Returns the parts of a job's unfinished frames, in ascending order.
    pub async fn parts(&self, job: JobId) -> Result<Vec<FrameParts>, CallError> {
        let request = wire::PartsRequest { job: job.0 };
        let reply = self.jobs().parts(request).await.map_err(|status| self.call_error(&status))?;
        Ok(convert_all(reply.into_inner().frames)?)
    }

    /// Returns the finished frames of a job, in ascending order.
    pub async fn frames(&self, job: JobId) -> Result<Vec<FrameRecord>, CallError> {
        self.request_frames(wire::FramesRequest { job: job.0, times: false }).await
    }

    /// Returns the finished frames of a job in ascending order, with the times of their attempts. An older coordinator leaves out
    /// the times.
    pub async fn frames_with_times(&self, job: JobId) -> Result<Vec<FrameRecord>, CallError> {
        self.request_frames(wire::FramesRequest { job: job.0, times: true }).await
    }

    async fn request_frames(&self, request: wire::FramesRequest) -> Result<Vec<FrameRecord>, CallError> {
        let reply = self.jobs().frames(request).await.map_err(|status| self.call_error(&status))?;
        Ok(convert_all(reply.into_inner().frames)?)
    }

    /// Returns the logs of a job's tasks for attempts reported since `since`, oldest first.
    pub async fn logs(&self, job: JobId, since: Tick) -> Result<Vec<LogRecord>, CallError> {
        let request = wire::LogsRequest { job: job.0, since: since.0 };
        let reply = self.jobs().logs(request).await.map_err(|status| self.call_error(&status))?;
        Ok(convert_all(reply.into_inner().logs)?)
    }

    /// Returns a job's shape and the usage of its attempts.
    pub async fn attempts(&self, job: JobId) -> Result<(JobShape, Attempts), CallError> {
        let request = wire::AttemptsRequest { job: job.0 };
        let reply = self.jobs().attempts(request).await.map_err(|status| self.call_error(&status))?;
        let (mut stream, mut shape, mut attempts) = (reply.into_inner(), None, Attempts::default());
        while let Some(part) = stream.message().await.map_err(|status| self.call_error(&status))? {
            match required("attempts.part", part.part)? {
                Part::Job(job) => shape = Some(job.try_into()?),
                Part::Attempts(page) => {
                    for record in page.attempts {
                        attempts.insert(record.try_into()?);
                    }
                }
            }
        }
        Ok((required("attempts.job", shape)?, attempts))
    }

    /// Returns a job as it was submitted.
    pub async fn spec(&self, job: JobId) -> Result<JobSpec, CallError> {
        let request = wire::AttemptsRequest { job: job.0 };
        let reply = self.jobs().attempts(request).await.map_err(|status| self.call_error(&status))?;
        // The spec comes before the attempts.
        let part = reply.into_inner().message().await.map_err(|status| self.call_error(&status))?;
        let Some(Part::Job(shape)) = part.and_then(|part| part.part) else {
            return Err(ConvertError::Missing { field: "attempts.job" }.into());
        };
        Ok(*JobShape::try_from(shape)?.spec)
    }

    /// Returns the connected workers in order of joining.
    pub async fn workers(&self) -> Result<Vec<WorkerStatus>, CallError> {
        Ok(self.all_workers().await?.connected)
    }

    /// Returns the connected workers and the former ones.
    pub async fn all_workers(&self) -> Result<WorkerList, CallError> {
        let reply =
            self.jobs().list_workers(wire::ListWorkersRequest {}).await.map_err(|status| self.call_error(&status))?;
        Ok(reply.into_inner().try_into()?)
    }

    /// Returns the farm usage of the owners' jobs, by month and owner.
    pub async fn usage(&self) -> Result<Vec<OwnerUsage>, CallError> {
        let reply = self.jobs().usage(wire::UsageRequest {}).await.map_err(|status| self.call_error(&status))?;
        Ok(convert_all(reply.into_inner().usage)?)
    }

    /// Stops or resumes dispatching tasks to workers; returns the affected sessions.
    pub async fn drain(&self, worker: WorkerSelector, drain: Drain) -> Result<Vec<WorkerId>, CallError> {
        let request = wire::DrainWorkersRequest::from((worker, drain));
        let reply = self.jobs().drain_workers(request).await.map_err(|status| self.call_error(&status))?;
        Ok(reply.into_inner().workers.into_iter().map(WorkerId).collect())
    }

    /// Writes a copy of the coordinator's log to `log`. Returns the artifacts that the log refers to and that the store has.
    pub async fn backup(&self, mut log: impl AsyncWrite + Unpin) -> Result<Vec<Artifact>, BackupError> {
        let reply = self.jobs().backup(wire::BackupRequest {}).await.map_err(|status| self.call_error(&status))?;
        let (mut stream, mut artifacts) = (reply.into_inner(), Vec::new());
        while let Some(part) = stream.message().await.map_err(|status| self.call_error(&status))? {
            match required("backup.part", part.part).map_err(CallError::from)? {
                BackupPart::Artifacts(some) => {
                    artifacts.extend(convert_all::<_, Artifact>(some.artifacts).map_err(CallError::from)?);
                }
                BackupPart::Log(piece) => log.write_all(&piece).await?,
            }
        }
        log.flush().await?;
        Ok(artifacts)
    }

    /// Returns those of `digests` that are not in the coordinator's store.
    pub async fn missing(&self, digests: &[Digest]) -> Result<Vec<Digest>, CallError> {
        let request = wire::MissingRequest { digests: digests.iter().map(digest_bytes).collect() };
        let reply = self.artifacts().missing(request).await.map_err(|status| self.call_error(&status))?;
        let digests = reply.into_inner().digests;
        Ok(digests.iter().map(|bytes| parse_digest("missing.digest", bytes)).collect::<Result<_, ConvertError>>()?)
    }

    /// Opens a worker's session.
    pub async fn session(&self, registration: Registration) -> Result<(SessionSender, SessionReceiver), CallError> {
        let (send, receive) = mpsc::channel(256);
        let sender = SessionSender(send);
        sender.send(FromWorker::Register(registration)).await;
        let mut client = WorkersClient::new(self.channel.clone()).max_decoding_message_size(MAX_ASSIGNMENT_SIZE);
        let messages = batch_ready(ReceiverStream::new(receive).map(wire::FromWorker::from));
        let reply = client.session(messages).await.map_err(|status| self.call_error(&status))?;
        Ok((sender, SessionReceiver { url: self.url().into(), stream: reply.into_inner(), pending: VecDeque::new() }))
    }
}

/// Formats an error and its causes on one line.
fn root_cause(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    causes.last().map_or_else(String::new, ToString::to_string)
}

/// A stream of a job's statuses.
#[derive(Debug)]
pub struct JobWatch {
    url: String,
    stream: Streaming<wire::JobStatus>,
}

impl JobWatch {
    /// Returns the next status; `None` after the job's last one.
    pub async fn next(&mut self) -> Result<Option<JobStatus>, CallError> {
        let status = self.stream.message().await.map_err(|status| from_status(&self.url, &status))?;
        Ok(status.map(JobStatus::try_from).transpose()?)
    }
}

/// The sending half of a worker's session. Clones share it. The session ends when all of them are dropped.
#[derive(Debug, Clone)]
pub struct SessionSender(mpsc::Sender<FromWorker>);

impl SessionSender {
    /// Sends a message and waits while the connection is full. After the session's end the message is lost, and the reader of
    /// [`SessionReceiver`] gets the end of the stream.
    pub async fn send(&self, message: FromWorker) {
        let _ = self.0.send(message).await;
    }
}

/// The receiving half of a worker's session.
#[derive(Debug)]
pub struct SessionReceiver {
    url: String,
    stream: Streaming<wire::ToWorker>,
    /// Messages received in the same batch as the one before.
    pending: VecDeque<wire::ToWorker>,
}

impl SessionReceiver {
    /// Returns the next message; `None` at the session's end.
    pub async fn next(&mut self) -> Result<Option<ToWorker>, CallError> {
        loop {
            if let Some(message) = self.pending.pop_front() {
                return Ok(Some(message.try_into()?));
            }
            let message = self.stream.message().await.map_err(|status| from_status(&self.url, &status))?;
            match message.map(Batch::split) {
                None => return Ok(None),
                Some(Ok(many)) => self.pending.extend(many),
                Some(Err(one)) => return Ok(Some(one.try_into()?)),
            }
        }
    }
}
