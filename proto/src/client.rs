//! What a program that is not the coordinator uses: ask, fetch, and be a worker.

use std::time::Duration;

use femc_model::{
    Control, Digest, FrameRecord, FromWorker, JobId, JobSpec, JobStatus, Registration, ToWorker, WorkerStatus,
};
use hyper_util::rt::TokioIo;
use tokio::sync::mpsc;
use tokio_stream::StreamExt as _;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;
use tonic::transport::{Channel, Endpoint, Uri};

use crate::convert::{ConvertError, digest, digest_bytes, each};
use crate::error::{CallError, from_status};
use crate::net::Dial;
use crate::{MESSAGE, PIECE, wire};
use wire::artifacts_client::ArtifactsClient;
use wire::jobs_client::JobsClient;
use wire::workers_client::WorkersClient;

/// A connection to a coordinator; clones share it. It mends itself when the coordinator comes back.
#[derive(Debug, Clone)]
pub struct Client {
    url: String,
    channel: Channel,
}

impl Client {
    /// Connects to `url`, such as `http://127.0.0.1:7878`.
    pub async fn connect(url: &str) -> Result<Self, CallError> {
        Self::connect_by(&Dial::tcp(), url).await
    }

    /// The same over another network.
    pub async fn connect_by(dial: &Dial, url: &str) -> Result<Self, CallError> {
        let address = |error: tonic::transport::Error| CallError::Address { url: url.into(), message: chain(&error) };
        let endpoint = Endpoint::from_shared(url.to_owned())
            .map_err(address)?
            .connect_timeout(Duration::from_secs(5))
            .http2_keep_alive_interval(Duration::from_secs(10))
            .keep_alive_timeout(Duration::from_secs(10))
            .initial_stream_window_size(4 << 20)
            .initial_connection_window_size(16 << 20);
        let unreachable = |error| CallError::Unreachable { url: url.into(), message: chain(&error) };
        let channel = match &dial.0 {
            None => endpoint.connect().await,
            Some(dial) => {
                let dial = dial.clone();
                let connector = tower::service_fn(move |to: Uri| {
                    let link = dial(to.host().unwrap_or_default().to_owned(), to.port_u16().unwrap_or(80));
                    async move { link.await.map(TokioIo::new) }
                });
                endpoint.connect_with_connector(connector).await
            }
        };
        Ok(Self { url: url.into(), channel: channel.map_err(unreachable)? })
    }

    /// The coordinator's address.
    pub fn url(&self) -> &str {
        &self.url
    }

    fn jobs(&self) -> JobsClient<Channel> {
        JobsClient::new(self.channel.clone()).max_decoding_message_size(MESSAGE)
    }

    pub(crate) fn artifacts(&self) -> ArtifactsClient<Channel> {
        ArtifactsClient::new(self.channel.clone()).max_decoding_message_size(2 * PIECE)
    }

    pub(crate) fn error(&self, status: &tonic::Status) -> CallError {
        from_status(&self.url, status)
    }

    /// Queues a job; a second submission with the same key gives the same job.
    pub async fn submit(&self, key: Option<String>, spec: JobSpec) -> Result<JobId, CallError> {
        let request = wire::SubmitRequest { job: Some(spec.into()), key };
        let reply = self.jobs().submit(request).await.map_err(|status| self.error(&status))?;
        Ok(JobId(reply.into_inner().job))
    }

    /// Every job.
    pub async fn list(&self) -> Result<Vec<JobStatus>, CallError> {
        let reply = self.jobs().list(wire::ListRequest {}).await.map_err(|status| self.error(&status))?;
        Ok(each(reply.into_inner().jobs)?)
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
        Ok(Watch { url: self.url.clone(), stream: reply.into_inner() })
    }

    /// Pauses, resumes, cancels, retries, changes the priority.
    pub async fn control(&self, job: JobId, control: Control) -> Result<(), CallError> {
        let request = wire::ControlRequest { job: job.0, control: Some(control.into()) };
        self.jobs().control(request).await.map_err(|status| self.error(&status))?;
        Ok(())
    }

    /// The finished frames of a job, ascending.
    pub async fn frames(&self, job: JobId) -> Result<Vec<FrameRecord>, CallError> {
        let request = wire::FramesRequest { job: job.0 };
        let reply = self.jobs().frames(request).await.map_err(|status| self.error(&status))?;
        Ok(each(reply.into_inner().frames)?)
    }

    /// The workers that are there.
    pub async fn workers(&self) -> Result<Vec<WorkerStatus>, CallError> {
        let reply =
            self.jobs().list_workers(wire::ListWorkersRequest {}).await.map_err(|status| self.error(&status))?;
        Ok(each(reply.into_inner().workers)?)
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
        let mut client = WorkersClient::new(self.channel.clone()).max_decoding_message_size(MESSAGE);
        let words = ReceiverStream::new(receive).map(wire::FromWorker::from);
        let reply = client.session(words).await.map_err(|status| self.error(&status))?;
        Ok((outgoing, Incoming { url: self.url.clone(), stream: reply.into_inner() }))
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
}

impl Incoming {
    /// The next message; `None` at the session's end.
    pub async fn next(&mut self) -> Result<Option<ToWorker>, CallError> {
        let message = self.stream.message().await.map_err(|status| from_status(&self.url, &status))?;
        Ok(message.map(ToWorker::try_from).transpose()?)
    }
}
