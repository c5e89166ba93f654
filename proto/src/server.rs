//! What the coordinator uses: every call comes to it as a [`Call`] with a place for the answer.

mod artifacts;
mod backup;
mod collect;
mod door;
mod guard;
mod inputs;
mod jobs;
mod places;
mod promised;
mod punctual;
mod rate;
mod traffic;
mod trail;
mod uploads;
mod workers;

use std::collections::VecDeque;
use std::future::Future;
use std::io;
use std::sync::Arc;

use femc_model::{
    AttemptRecord, Control, Cut, Digest, Drain, FrameParts, FrameRecord, FromWorker, JobId, JobSpec, JobStatus,
    LogRecord, Refusal, Registration, Tick, ToWorker, WorkerId, WorkerName, WorkerStatus,
};
use femc_store::Store;
use femc_trust::{Audit, Identity, Revoked, Tokens};
use tokio::sync::{mpsc, oneshot, watch};
use tokio_stream::{Stream, StreamExt as _};
use tonic::Streaming;
use tonic::transport::server::{Connected, Router};
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;
use tower::layer::util::Stack;

use crate::convert::ConvertError;
use crate::error::ServeError;
use crate::limits::Limits;
use crate::many::Many as _;
use crate::net::Io;
use crate::{PIECE, tls, wire};
pub use backup::Backup;
pub use collect::{CollectMode, Collected, LEAST_GRACE, References, Volume};
use door::{Admitted, Door, Unheard};
use guard::{Caller, Guard};
use places::Places;
use promised::Promised;
pub use traffic::Traffic;
use uploads::Uploads;
use wire::artifacts_server::ArtifactsServer;
use wire::jobs_server::JobsServer;
use wire::workers_server::WorkersServer;

/// What a job is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct JobShape {
    /// Specification of the job, as submitted.
    pub spec: Box<JobSpec>,
    /// How its tasks are cut.
    pub cut: Cut,
}

/// Some of a job's attempts.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AttemptPage {
    /// In the order in which they ended; see [`femc_model::Attempts`].
    pub attempts: Vec<AttemptRecord>,
    /// Where the next page begins; `None`: there is none.
    pub next: Option<u64>,
}

/// Where an answer goes.
pub type Reply<T> = oneshot::Sender<Result<T, Refusal>>;

/// What there is.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Listing {
    /// In order of submission.
    pub jobs: Vec<JobStatus>,
    /// What somebody should look after, for people.
    pub warnings: Vec<String>,
}

/// A request, to be answered in its own time.
#[derive(Debug)]
pub enum Call {
    /// Queue a job.
    Submit {
        /// A second submission with this key is the same job.
        key: Option<String>,
        /// The job.
        spec: Box<JobSpec>,
        /// Its number.
        reply: Reply<JobId>,
    },
    /// Every job.
    List {
        /// Status of all jobs.
        reply: Reply<Listing>,
    },
    /// One job.
    Status {
        /// The job.
        job: JobId,
        /// Status of the job at this moment.
        reply: Reply<JobStatus>,
    },
    /// One job, as it changes.
    Watch {
        /// The job.
        job: JobId,
        /// Its status now and later; closed after its end.
        reply: Reply<watch::Receiver<JobStatus>>,
    },
    /// Steer a job.
    Control {
        /// The job.
        job: JobId,
        /// What is done to the job.
        control: Control,
        /// Sent when the control is durable.
        reply: Reply<()>,
    },
    /// What there is of a job's frames in work.
    Parts {
        /// The job.
        job: JobId,
        /// Answer, in ascending order of frames.
        reply: Reply<Vec<FrameParts>>,
    },
    /// The finished frames of a job.
    Frames {
        /// The job.
        job: JobId,
        /// Answer, in ascending order of frames.
        reply: Reply<Vec<FrameRecord>>,
    },
    /// What workers wrote down while they did the job's tasks.
    Logs {
        /// The job.
        job: JobId,
        /// Of attempts reported then or later.
        since: Tick,
        /// Records, oldest first.
        reply: Reply<Vec<LogRecord>>,
    },
    /// What a job is made of.
    Shape {
        /// The job.
        job: JobId,
        /// Specification of the job and its cut into tasks.
        reply: Reply<JobShape>,
    },
    /// What the attempts at a job's tasks took.
    Attempts {
        /// The job.
        job: JobId,
        /// 0, or the `next` of the page before.
        from: u64,
        /// In the order in which they ended.
        reply: Reply<AttemptPage>,
    },
    /// The workers that are there.
    Workers {
        /// In order of joining.
        reply: Reply<Vec<WorkerStatus>>,
    },
    /// Give workers no more tasks, or tasks again.
    Drain {
        /// Name of the worker.
        worker: WorkerName,
        /// Whether the drain begins or ends.
        drain: Drain,
        /// The sessions that it was done to, when it is durable.
        reply: Reply<Vec<WorkerId>>,
    },
    /// What all jobs refer to.
    References {
        /// Sent when all earlier calls are durable.
        reply: Reply<References>,
    },
    /// A copy of the log, and what it refers to.
    Backup {
        /// Sent when all earlier calls are durable.
        reply: Reply<Backup>,
    },
    /// An artifact that somebody wanted is not in the store, or was damaged and is removed.
    Lost {
        /// Digest of the artifact.
        digest: Digest,
        /// Sent when all that follows from the loss is durable.
        reply: Reply<()>,
    },
    /// A worker has come.
    Session(Box<Session>),
}

/// A worker's session. It ends when `out` is dropped, or when `messages` does.
#[derive(Debug)]
pub struct Session {
    /// Registration of the worker.
    pub registration: Registration,
    /// Messages from the worker.
    pub messages: WorkerMessages,
    /// Messages to the worker.
    pub out: mpsc::Sender<ToWorker>,
}

/// What a worker says after it registered.
#[derive(Debug)]
pub struct WorkerMessages {
    stream: Streaming<wire::FromWorker>,
    /// Came together with the one before.
    waiting: VecDeque<wire::FromWorker>,
    caller: Option<Arc<Caller>>,
}

impl WorkerMessages {
    pub(crate) fn new(stream: Streaming<wire::FromWorker>, caller: Option<Arc<Caller>>) -> Self {
        Self { stream, waiting: VecDeque::new(), caller }
    }

    /// The next message; `None` at the end, also when the connection broke or the worker's identity counts no more.
    pub async fn next(&mut self) -> Option<Result<FromWorker, ConvertError>> {
        loop {
            if self.caller.as_ref().is_some_and(|caller| !caller.still_counts()) {
                return None;
            }
            if let Some(message) = self.waiting.pop_front() {
                return Some(message.try_into());
            }
            match self.stream.message().await.ok()??.split() {
                Ok(many) => self.waiting.extend(many),
                Err(one) => return Some(one.try_into()),
            }
        }
    }
}

/// The three services, health and reflection on one port.
#[derive(Debug, Clone)]
pub struct Server {
    /// Queue of calls to the coordinator.
    calls: mpsc::Sender<Call>,
    /// Store of the artifacts.
    store: Store,
    uploads: Uploads,
    places: Places,
    promised: Promised,
    /// Held while garbage is collected.
    collecting: Arc<tokio::sync::Mutex<()>>,
    /// Who it is and whom it lets in; `None`: connections are not encrypted, and everybody may do everything.
    entrance: Option<Entrance>,
    traffic: Traffic,
    limits: Limits,
    audit: Option<Audit>,
}

/// What stands before the services, the first at the end.
type Layers = Stack<Guard, Stack<Traffic, tower::layer::util::Identity>>;

/// The services whose health is told; also told is that of `""`, the server as a whole.
const SERVICES: [&str; 3] =
    [wire::jobs_server::SERVICE_NAME, wire::workers_server::SERVICE_NAME, wire::artifacts_server::SERVICE_NAME];

/// The door of a server that lets in only those it knows.
#[derive(Debug, Clone)]
pub struct Entrance {
    /// A coordinator's: connections are encrypted, and whoever shows an identity of the same authority is let in, and may do
    /// what its role may. `None`: connections are not encrypted, and only tokens count.
    pub identity: Option<Identity>,
    /// Identities that count no more.
    pub revoked: Option<Revoked>,
    /// Who may come with a token instead of an identity.
    pub tokens: Option<Tokens>,
}

impl Server {
    /// Passes calls on to `calls`; artifacts live in `store`.
    pub fn new(calls: mpsc::Sender<Call>, store: Store) -> Self {
        let limits = Limits::default();
        Self {
            calls,
            store,
            uploads: Uploads::default(),
            places: Places::new(&limits),
            promised: Promised::default(),
            collecting: Arc::default(),
            entrance: None,
            traffic: Traffic::default(),
            limits,
            audit: None,
        }
    }

    /// Lets in only those who belong, if there is an entrance.
    pub fn behind(self, entrance: Option<Entrance>) -> Self {
        Self { entrance, ..self }
    }

    /// Counted by `traffic`, over several servers if it is the same one.
    pub fn counted(self, traffic: Traffic) -> Self {
        Self { traffic, ..self }
    }

    /// Lets its peers have so much.
    pub fn within(self, limits: Limits) -> Self {
        Self { limits, places: Places::new(&limits), ..self }
    }

    /// Notes changes and refusals there.
    pub fn noting(self, audit: Option<Audit>) -> Self {
        Self { audit, ..self }
    }

    /// Serves the connections that come in until `stop` comes, then until the open calls have ended.
    pub async fn serve<C: Io + Connected>(
        self,
        incoming: impl Stream<Item = io::Result<C>>,
        stop: impl Future<Output = ()>,
    ) -> Result<(), ServeError> {
        let incoming = self.admitted(incoming);
        let (router, health) = self.router().await?;
        let stop = async move {
            stop.await;
            for service in SERVICES.into_iter().chain([""]) {
                health.set_service_status(service, ServingStatus::NotServing).await;
            }
        };
        Ok(router.serve_with_incoming_shutdown(incoming, stop).await?)
    }

    /// Serves for ever: who drops this ends the connections himself.
    pub async fn serve_on<C: Io + Connected>(
        self,
        incoming: impl Stream<Item = io::Result<C>>,
    ) -> Result<(), ServeError> {
        let incoming = self.admitted(incoming);
        Ok(self.router().await?.0.serve_with_incoming(incoming).await?)
    }

    fn admitted<C: Io + Connected, I: Stream<Item = io::Result<C>>>(
        &self,
        incoming: I,
    ) -> impl Stream<Item = io::Result<Admitted<C>>> + use<C, I> {
        let is_encrypted = self.entrance.as_ref().is_some_and(|entrance| entrance.identity.is_some());
        let unheard = if is_encrypted { Unheard::Noted } else { Unheard::Ignored };
        let door = Door::new(self.limits, self.audit.clone(), unheard);
        incoming.filter_map(move |io| io.map(|io| door.admit(io)).transpose())
    }

    async fn router(self) -> Result<(Router<Layers>, HealthReporter), ServeError> {
        let (reporter, health) = tonic_health::server::health_reporter();
        for service in SERVICES {
            reporter.set_service_status(service, ServingStatus::Serving).await;
        }
        let reflection = tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(wire::DESCRIPTORS)
            .build_v1()?;
        let mut builder = tonic::transport::Server::builder();
        if let Some(Entrance { identity: Some(identity), tokens, .. }) = &self.entrance {
            let clients = if tokens.is_some() { tls::Clients::MayShowTokens } else { tls::Clients::ShowIdentities };
            builder = builder.tls_config(tls::server(identity, clients))?;
        }
        let limits = self.limits;
        let router = builder
            .layer(self.traffic.clone())
            .layer(Guard::new(self.entrance.as_ref(), limits, self.audit.clone()))
            .http2_keepalive_interval(Some(limits.silence))
            .http2_keepalive_timeout(Some(limits.answer))
            .http2_max_header_list_size(limits.headers)
            .http2_max_pending_accept_reset_streams(Some(limits.resets))
            .max_concurrent_streams(limits.streams)
            .initial_stream_window_size(limits.stream_window)
            .initial_connection_window_size(limits.connection_window)
            .add_service(health)
            .add_service(reflection)
            .add_service(JobsServer::new(self.clone()).max_decoding_message_size(limits.message))
            .add_service(WorkersServer::new(self.clone()).max_decoding_message_size(limits.message))
            .add_service(ArtifactsServer::new(self).max_decoding_message_size(2 * PIECE));
        Ok((router, reporter))
    }

    /// Passes a call on and waits for its answer.
    async fn ask<T>(&self, call: impl FnOnce(Reply<T>) -> Call) -> Result<T, tonic::Status> {
        self.question(call).await.map_err(|refusal| crate::error::to_status(&refusal))
    }

    /// The same for those who decide by the refusal.
    async fn question<T>(&self, call: impl FnOnce(Reply<T>) -> Call) -> Result<T, Refusal> {
        let stopping = || Refusal::Unavailable { message: "the coordinator is stopping".into() };
        let (reply, answer) = oneshot::channel();
        self.calls.send(call(reply)).await.map_err(|_| stopping())?;
        answer.await.map_err(|_| stopping())?
    }
}
