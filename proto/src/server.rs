//! What the coordinator uses: every call comes to it as a [`Call`] with a place for the answer.

mod artifacts;
mod backup;
mod collect;
mod door;
mod guard;
mod inputs;
mod jobs;
mod promised;
mod punctual;
mod secure;
mod traffic;
mod uploads;
mod workers;

use std::collections::VecDeque;
use std::future::Future;
use std::io;
use std::sync::Arc;

use femc_model::{FromWorker, Refusal, Registration, ToWorker};
use femc_service::{Caller, Farm, Gate, Http, Limits, Places, Reply, Site, Trail};
use femc_store::Store;
use femc_trust::{Audit, Identity, Revoked, Tokens};
use tokio::sync::mpsc;
use tokio_stream::{Stream, StreamExt as _};
use tonic::transport::server::{Connected, Router};
use tonic::{Request, Streaming};
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;
use tower::layer::util::Stack;

use crate::convert::ConvertError;
use crate::error::ServeError;
use crate::many::Many as _;
use crate::net::Io;
use crate::{PIECE, tls, wire};
pub use collect::{CollectMode, Collected, LEAST_GRACE, Volume};
use door::{Door, Unheard};
use guard::Guard;
use promised::Promised;
use secure::{Connection, secured};
pub use traffic::Traffic;
use uploads::Uploads;
use wire::artifacts_server::ArtifactsServer;
use wire::jobs_server::JobsServer;
use wire::workers_server::WorkersServer;

/// A request, to be answered in its own time.
pub type Call = femc_service::Call<Session>;

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
    /// The way to the coordinator.
    farm: Farm<Session>,
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
    site: Site,
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
            farm: Farm::new(calls),
            store,
            uploads: Uploads::default(),
            places: Places::new(&limits),
            promised: Promised::default(),
            collecting: Arc::default(),
            entrance: None,
            traffic: Traffic::default(),
            limits,
            audit: None,
            site: Site::default(),
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

    /// Shows browsers this.
    pub fn showing(self, site: Site) -> Self {
        Self { site, ..self }
    }

    /// Serves the connections that come in until `stop` comes, then until the open calls have ended.
    pub async fn serve<C: Io + Connected>(
        self,
        incoming: impl Stream<Item = io::Result<C>>,
        stop: impl Future<Output = ()>,
    ) -> Result<(), ServeError> {
        let incoming = self.connections(incoming)?;
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
        let incoming = self.connections(incoming)?;
        Ok(self.router().await?.0.serve_with_incoming(incoming).await?)
    }

    /// The connections that are let in, after their handshakes.
    fn connections<C: Io + Connected, I: Stream<Item = io::Result<C>>>(
        &self,
        incoming: I,
    ) -> Result<impl Stream<Item = io::Result<Connection<C>>> + use<C, I>, ServeError> {
        let tls = match &self.entrance {
            Some(Entrance { identity: Some(identity), tokens, .. }) => {
                let clients = if tokens.is_some() { tls::Clients::MayShowTokens } else { tls::Clients::ShowIdentities };
                Some(Arc::new(tls::server(identity, clients)?))
            }
            _ => None,
        };
        let is_encrypted = self.entrance.as_ref().is_some_and(|entrance| entrance.identity.is_some());
        let unheard = if is_encrypted { Unheard::Noted } else { Unheard::Ignored };
        let door = Door::new(self.limits, self.audit.clone(), unheard);
        let admitted = incoming.filter_map(move |io| io.map(|io| door.admit(io)).transpose());
        Ok(secured(admitted, tls))
    }

    async fn router(self) -> Result<(Router<Layers>, HealthReporter), ServeError> {
        let (reporter, health) = tonic_health::server::health_reporter();
        for service in SERVICES {
            reporter.set_service_status(service, ServingStatus::Serving).await;
        }
        let reflection = tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(wire::DESCRIPTORS)
            .build_v1()?;
        let builder = tonic::transport::Server::builder();
        let limits = self.limits;
        let is_encrypted = self.entrance.as_ref().is_some_and(|entrance| entrance.identity.is_some());
        let lists = self.entrance.as_ref().map(|Entrance { revoked, tokens, .. }| (revoked.clone(), tokens.clone()));
        let gate = Gate::new(lists, limits, self.audit.clone());
        let (store, places) = (self.store.clone(), self.places.clone());
        let http = Http::new(self.farm.clone(), store, places, gate.clone(), self.site.clone(), is_encrypted);
        let router = builder
            .accept_http1(true)
            .layer(self.traffic.clone())
            .layer(Guard::new(gate, http))
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
        self.farm.ask(call).await
    }
}

/// What the call that this request makes leaves in the audit record.
fn trail<T>(request: &Request<T>) -> Trail {
    request.extensions().get().cloned().unwrap_or_default()
}
