//! Access control in front of all services. It maps each gRPC call to an operation and checks it. Requests that are not gRPC go to
//! the HTTP side, which uses the same gate.

use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use femc_model::Refusal;
use femc_service::{
    AuditEntry, CallerKey, ConnectedClient, Gate, Http, Operation, Outcome, PermittedResponse, PresentedCredentials,
    PublicResponse,
};
use http::header::{AUTHORIZATION, CONTENT_TYPE};
use http::{Request, Response};
use tonic::body::Body;
use tonic::{Code, Status};
use tower::{Layer, Service};

use super::Session;
use super::body_timeout::BodyTimeout;
use super::connection_limiter::Peer;
use crate::error::to_status;

/// Returns the operation of a gRPC call by its path. Calls that are not listed here require an admin.
fn operation(path: &str) -> Operation {
    let Some((service, call)) = path.trim_start_matches('/').split_once('/') else { return Operation::Other };
    match (service, call) {
        ("femc.v1.Jobs", "Submit") => Operation::Submit,
        ("femc.v1.Jobs", "List") => Operation::List,
        ("femc.v1.Jobs", "Status") => Operation::Status,
        ("femc.v1.Jobs", "Watch") => Operation::Watch,
        ("femc.v1.Jobs", "Control") => Operation::Control,
        ("femc.v1.Jobs", "Frames") => Operation::Frames,
        ("femc.v1.Jobs", "Parts") => Operation::Parts,
        ("femc.v1.Jobs", "Logs") => Operation::Logs,
        ("femc.v1.Jobs", "Attempts") => Operation::Attempts,
        ("femc.v1.Jobs", "Usage") => Operation::Usage,
        ("femc.v1.Jobs", "ListWorkers") => Operation::ListWorkers,
        ("femc.v1.Jobs", "DrainWorkers") => Operation::DrainWorkers,
        ("femc.v1.Jobs", "Backup") => Operation::Backup,
        ("femc.v1.Workers", "Session") => Operation::Session,
        ("femc.v1.Artifacts", "Get") => Operation::Get,
        ("femc.v1.Artifacts", "Missing") => Operation::Missing,
        ("femc.v1.Artifacts", "Offer") => Operation::Offer,
        ("femc.v1.Artifacts", "Put") => Operation::Put,
        ("femc.v1.Artifacts", "Collect") => Operation::Collect,
        ("grpc.health.v1.Health" | "grpc.reflection.v1.ServerReflection", _) => Operation::Health,
        _ => Operation::Other,
    }
}

/// Access control in front of all services.
#[derive(Debug, Clone)]
pub(super) struct Guard {
    gate: Gate,
    http: Http<Session>,
}

impl Guard {
    pub(super) fn new(gate: Gate, http: Http<Session>) -> Self {
        Self { gate, http }
    }

    /// Checks the call and attaches its caller, its [`CallerKey`] and its [`AuditEntry`]. Returns how long a call that exceeds its
    /// rate must wait.
    fn check<B>(&self, request: &mut Request<B>) -> Result<Duration, Refusal> {
        let peer = request.extensions().get::<Peer>().cloned();
        let address = peer.as_ref().and_then(|peer| peer.address);
        let path = request.uri().path();
        let operation = operation(path);
        let trail = self.gate.audit_entry(operation, call_name(path), address.map(|address| address.to_string()));
        request.extensions_mut().insert(trail.clone());
        let place = address.map(|address| address.ip().to_string());
        // A header that is not a bearer token counts as a wrong token.
        let bearer = |header: &http::HeaderValue| -> String {
            let token = header.to_str().ok().and_then(|text| text.strip_prefix("Bearer "));
            token.unwrap_or_default().to_owned()
        };
        let token = request.headers().get(AUTHORIZATION).map(bearer);
        let certificate = peer.as_ref().and_then(|peer| peer.certificate.as_ref());
        let credentials = PresentedCredentials { token: token.as_deref(), certificate, address: place.as_deref() };
        let granted = self.gate.check(operation, credentials, &trail)?;
        if let Some(caller) = granted.caller {
            request.extensions_mut().insert(caller);
        }
        let connection = peer.as_ref().map_or(0, |peer| peer.number);
        request.extensions_mut().insert(CallerKey { name: granted.name, connection });
        if let Some(peer) = peer {
            peer.mark_introduced();
        }
        Ok(granted.wait)
    }

    fn audit_outcome<B>(&self, trail: &AuditEntry, response: &Response<B>) {
        let Some(audit) = self.gate.audit() else { return };
        let status = Status::from_header_map(response.headers());
        let code = status.as_ref().map_or(Code::Ok, Status::code);
        let outcome = match code {
            Code::Ok => Outcome::Done,
            Code::Unauthenticated | Code::PermissionDenied | Code::ResourceExhausted => Outcome::Refused,
            _ => Outcome::Failed,
        };
        trail.write(audit, outcome, &format!("{code:?}"), status.as_ref().map_or("", Status::message));
    }
}

/// Returns the call's name in the audit record.
fn call_name(path: &str) -> &str {
    path.trim_start_matches('/').trim_start_matches("femc.v1.")
}

/// Checks that a request is a gRPC call.
fn is_grpc<B>(request: &Request<B>) -> bool {
    let kind = request.headers().get(CONTENT_TYPE);
    kind.is_some_and(|kind| kind.as_bytes().starts_with(b"application/grpc"))
}

/// Returns the client of a request, for the HTTP side.
fn connected_client<B>(request: &Request<B>) -> (ConnectedClient, Option<Peer>) {
    let peer = request.extensions().get::<Peer>().cloned();
    let certificate = peer.as_ref().and_then(|peer| peer.certificate.clone());
    let address = peer.as_ref().and_then(|peer| peer.address);
    let reached = peer.as_ref().and_then(|peer| peer.local_address);
    let connection = peer.as_ref().map_or(0, |peer| peer.number);
    (ConnectedClient { address, local_address: reached, connection, certificate }, peer)
}

impl<S> Layer<S> for Guard {
    type Service = GuardService<S>;

    fn layer(&self, inner: S) -> GuardService<S> {
        GuardService { guard: self.clone(), inner }
    }
}

/// A service behind the guard.
#[derive(Debug, Clone)]
pub(super) struct GuardService<S> {
    guard: Guard,
    inner: S,
}

impl<S> Service<Request<Body>> for GuardService<S>
where
    S: Service<Request<Body>, Response = Response<Body>> + Clone + Send + 'static,
    S::Future: Send + 'static,
    S::Error: Send + 'static,
{
    type Response = S::Response;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<S::Response, S::Error>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, mut request: Request<Body>) -> Self::Future {
        if !is_grpc(&request) {
            let (http, (visitor, peer)) = (self.guard.http.clone(), connected_client(&request));
            return Box::pin(async move {
                let response = http.serve(request, visitor).await;
                let has = |is_there: bool| peer.as_ref().filter(|_| is_there);
                if let Some(peer) = has(response.extensions().get::<PermittedResponse>().is_some()) {
                    peer.mark_introduced();
                } else if let Some(peer) = has(response.extensions().get::<PublicResponse>().is_some()) {
                    peer.mark_served();
                }
                Ok(response.map(Body::new))
            });
        }
        let checked = self.guard.check(&mut request);
        let trail = request.extensions().get::<AuditEntry>().cloned().unwrap_or_default();
        let guard = self.guard.clone();
        let (body_timeout, timeout) =
            (BodyTimeout::from_path(request.uri().path()), self.guard.gate.limits().request_timeout);
        // Use the service that is ready, and leave a copy for the next call.
        let next = self.inner.clone();
        let mut inner = std::mem::replace(&mut self.inner, next);
        Box::pin(async move {
            let response = match checked {
                Ok(wait) => {
                    if !wait.is_zero() {
                        tokio::time::sleep(wait).await;
                    }
                    inner.call(request.map(|body| body_timeout.wrap(body, timeout))).await?
                }
                Err(refusal) => to_status(&refusal).into_http(),
            };
            guard.audit_outcome(&trail, &response);
            Ok(response)
        })
    }
}

#[cfg(test)]
mod documented;
#[cfg(test)]
mod tests;
