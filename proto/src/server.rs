//! The server side, for the coordinator: it receives every call as a [`Call`] with a channel for the answer.

mod artifacts;
mod backup;
mod body_timeout;
mod collect;
mod connection_limiter;
mod guard;
mod handshake;
mod inputs;
mod jobs;
mod metrics;
mod promises;
mod traffic;
mod uploads;
mod workers;

use std::collections::VecDeque;
use std::future::Future;
use std::io;
use std::sync::Arc;

use femc_model::{FromWorker, Refusal, Registration, ToWorker};
use femc_service::{AuditEntry, Caller, Farm, Gate, Http, Limits, LoginTokens, Reply, Site, TransferSlots};
use femc_store::Store;
use femc_trust::{Audit, Identity, RevocationList, Tokens};
use tokio::sync::mpsc;
use tokio_stream::{Stream, StreamExt as _};
use tonic::transport::server::{Connected, Router};
use tonic::{Request, Streaming};
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;
use tower::layer::util::Stack;

use crate::batch::Batch as _;
use crate::convert::ConvertError;
use crate::error::ServeError;
use crate::net::Io;
use crate::{MAX_PIECE_SIZE, tls, wire};
pub use collect::{ArtifactTotals, CollectMode, CollectReport, MIN_GRACE};
use connection_limiter::{ConnectionLimiter, UnusedConnections};
use guard::Guard;
use handshake::{Connection, with_handshakes};
pub use metrics::serve_metrics;
use promises::Promises;
pub use traffic::Traffic;
use uploads::Uploads;
use wire::artifacts_server::ArtifactsServer;
use wire::jobs_server::JobsServer;
use wire::workers_server::WorkersServer;

/// A request that the coordinator answers asynchronously.
pub type Call = femc_service::Call<Session>;

/// A worker's session. It ends when `out` or `messages` is dropped.
#[derive(Debug)]
pub struct Session {
    /// Registration of the worker.
    pub registration: Registration,
    /// Messages from the worker.
    pub messages: WorkerMessages,
    /// Messages to the worker.
    pub out: mpsc::Sender<ToWorker>,
}

/// Messages of a worker after its registration.
#[derive(Debug)]
pub struct WorkerMessages {
    stream: Streaming<wire::FromWorker>,
    /// Messages received in the same batch as the one before.
    pending: VecDeque<wire::FromWorker>,
    caller: Option<Arc<Caller>>,
}

impl WorkerMessages {
    pub(crate) fn new(stream: Streaming<wire::FromWorker>, caller: Option<Arc<Caller>>) -> Self {
        Self { stream, pending: VecDeque::new(), caller }
    }

    /// Returns the next message; `None` at the end, also when the connection breaks or the worker's identity is revoked.
    pub async fn next(&mut self) -> Option<Result<FromWorker, ConvertError>> {
        loop {
            if self.caller.as_ref().is_some_and(|caller| !caller.is_valid()) {
                return None;
            }
            if let Some(message) = self.pending.pop_front() {
                return Some(message.try_into());
            }
            match self.stream.message().await.ok()??.split() {
                Ok(many) => self.pending.extend(many),
                Err(one) => return Some(one.try_into()),
            }
        }
    }
}

/// Server of the three services, health and reflection on one port.
#[derive(Debug, Clone)]
pub struct Server {
    /// Channel to the coordinator.
    farm: Farm<Session>,
    /// Artifact store.
    store: Store,
    uploads: Uploads,
    transfer_slots: TransferSlots,
    promises: Promises,
    /// Lock held during a garbage collection.
    collection_lock: Arc<tokio::sync::Mutex<()>>,
    /// The server's identity and access rules; `None`: connections are not encrypted, and everybody may do everything.
    access_control: Option<AccessControl>,
    traffic: Traffic,
    limits: Limits,
    audit: Option<Audit>,
    site: Site,
}

/// Middleware in front of the services; the outermost layer is at the end.
type Layers = Stack<Guard, Stack<Traffic, tower::layer::util::Identity>>;

/// Services with a health status. `""`, the server as a whole, has one too.
const SERVICES: [&str; 3] =
    [wire::jobs_server::SERVICE_NAME, wire::workers_server::SERVICE_NAME, wire::artifacts_server::SERVICE_NAME];

/// Access rules of a server with access control.
#[derive(Debug, Clone)]
pub struct AccessControl {
    /// The coordinator's identity: connections are encrypted, and clients with an identity of the same authority get the rights of
    /// their role. `None`: connections are not encrypted, and only tokens are accepted.
    pub identity: Option<Identity>,
    /// Revoked identities.
    pub revoked: Option<RevocationList>,
    /// Tokens of clients without an identity.
    pub tokens: Option<Tokens>,
    /// Tokens in addresses of pages: each signs in one browser. `None`: browsers sign in with tokens of the list.
    pub logins: Option<LoginTokens>,
}

impl Server {
    /// Creates a server that passes calls on to `calls` and keeps artifacts in `store`.
    pub fn new(calls: mpsc::Sender<Call>, store: Store) -> Self {
        let limits = Limits::default();
        Self {
            farm: Farm::new(calls),
            store,
            uploads: Uploads::default(),
            transfer_slots: TransferSlots::new(&limits),
            promises: Promises::default(),
            collection_lock: Arc::default(),
            access_control: None,
            traffic: Traffic::default(),
            limits,
            audit: None,
            site: Site::default(),
        }
    }

    /// Sets the access rules; `None` disables access control.
    pub fn with_access_control(self, access_control: Option<AccessControl>) -> Self {
        Self { access_control, ..self }
    }

    /// Sets the counters of the traffic. Several servers may share them.
    pub fn with_traffic(self, traffic: Traffic) -> Self {
        Self { traffic, ..self }
    }

    /// Sets the limits for clients.
    pub fn with_limits(self, limits: Limits) -> Self {
        Self { limits, transfer_slots: TransferSlots::new(&limits), ..self }
    }

    /// Sets the audit record for changes and refusals.
    pub fn with_audit(self, audit: Option<Audit>) -> Self {
        Self { audit, ..self }
    }

    /// Sets the web pages for browsers.
    pub fn with_site(self, site: Site) -> Self {
        Self { site, ..self }
    }

    /// Serves the incoming connections until `stop` completes, then until the open calls have ended.
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

    /// Serves forever. Dropping the future closes the connections.
    pub async fn serve_forever<C: Io + Connected>(
        self,
        incoming: impl Stream<Item = io::Result<C>>,
    ) -> Result<(), ServeError> {
        let incoming = self.connections(incoming)?;
        Ok(self.router().await?.0.serve_with_incoming(incoming).await?)
    }

    /// Returns the admitted connections after their TLS handshakes.
    fn connections<C: Io + Connected, I: Stream<Item = io::Result<C>>>(
        &self,
        incoming: I,
    ) -> Result<impl Stream<Item = io::Result<Connection<C>>> + use<C, I>, ServeError> {
        let tls = match &self.access_control {
            Some(AccessControl { identity: Some(identity), tokens, .. }) => {
                let auth =
                    if tokens.is_some() { tls::ClientAuth::CertificateOrToken } else { tls::ClientAuth::Certificate };
                Some(Arc::new(tls::server_config(identity, auth)?))
            }
            _ => None,
        };
        let is_encrypted = self.access_control.as_ref().is_some_and(|access| access.identity.is_some());
        let unused = if is_encrypted { UnusedConnections::Audited } else { UnusedConnections::Ignored };
        let limiter = ConnectionLimiter::new(self.limits, self.audit.clone(), unused);
        let admitted = incoming.filter_map(move |io| io.map(|io| limiter.admit(io)).transpose());
        Ok(with_handshakes(admitted, tls))
    }

    async fn router(self) -> Result<(Router<Layers>, HealthReporter), ServeError> {
        let (reporter, health) = tonic_health::server::health_reporter();
        for service in SERVICES {
            reporter.set_service_status(service, ServingStatus::Serving).await;
        }
        let reflection = tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(wire::DESCRIPTORS)
            .build_v1()?;
        let limits = self.limits;
        let is_encrypted = self.access_control.as_ref().is_some_and(|access| access.identity.is_some());
        let lists =
            self.access_control.as_ref().map(|AccessControl { revoked, tokens, .. }| (revoked.clone(), tokens.clone()));
        let logins = self.access_control.as_ref().and_then(|access| access.logins.clone());
        let gate = Gate::new(lists, limits, self.audit.clone()).with_logins(logins);
        let (store, slots) = (self.store.clone(), self.transfer_slots.clone());
        let http = Http::new(self.farm.clone(), store, slots, gate.clone(), self.site.clone(), is_encrypted);
        let router = transport(&limits)
            .layer(self.traffic.clone())
            .layer(Guard::new(gate, http))
            .add_service(health)
            .add_service(reflection)
            .add_service(JobsServer::new(self.clone()).max_decoding_message_size(limits.message))
            .add_service(WorkersServer::new(self.clone()).max_decoding_message_size(limits.message))
            .add_service(ArtifactsServer::new(self).max_decoding_message_size(2 * MAX_PIECE_SIZE));
        Ok((router, reporter))
    }

    /// Passes a call on to the coordinator and waits for its answer.
    async fn call<T>(&self, call: impl FnOnce(Reply<T>) -> Call) -> Result<T, tonic::Status> {
        self.call_raw(call).await.map_err(|refusal| crate::error::to_status(&refusal))
    }

    /// Passes a call on like [`Self::call`], for callers that need the refusal itself.
    async fn call_raw<T>(&self, call: impl FnOnce(Reply<T>) -> Call) -> Result<T, Refusal> {
        self.farm.call(call).await
    }
}

/// Returns the transport of all servers: HTTP/1.1 and HTTP/2 with these limits.
fn transport(limits: &Limits) -> tonic::transport::Server {
    tonic::transport::Server::builder()
        .accept_http1(true)
        .http2_keepalive_interval(Some(limits.keep_alive_interval))
        .http2_keepalive_timeout(Some(limits.keep_alive_timeout))
        .http2_max_header_list_size(limits.headers)
        .http2_max_pending_accept_reset_streams(Some(limits.resets))
        .max_concurrent_streams(limits.streams)
        .initial_stream_window_size(limits.stream_window)
        .initial_connection_window_size(limits.connection_window)
}

/// Returns the audit trail of this request's call.
fn audit_entry<T>(request: &Request<T>) -> AuditEntry {
    request.extensions().get().cloned().unwrap_or_default()
}
