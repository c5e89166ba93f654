//! Who may call what.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use femc_model::Refusal;
use femc_trust::{Fingerprint, Holder, Revoked, Role, holder_of};
use http::{Request, Response};
use tonic::Status;
use tonic::body::Body;
use tonic::transport::server::{TcpConnectInfo, TlsConnectInfo};
use tower::{Layer, Service};

use crate::error::to_status;

/// Whoever is at the other end of an encrypted connection.
#[derive(Debug, Clone)]
pub(crate) struct Caller {
    pub(crate) holder: Holder,
    fingerprint: Fingerprint,
    revoked: Option<Revoked>,
}

impl Caller {
    /// Whether its certificate still counts.
    pub(crate) fn still_counts(&self) -> bool {
        !self.revoked.as_ref().is_some_and(|revoked| revoked.holds(&self.fingerprint))
    }

    /// The refusal of what takes more.
    pub(crate) fn forbidden(&self, takes: impl Into<String>) -> Status {
        to_status(&Refusal::Forbidden { who: self.holder.to_string(), takes: takes.into() })
    }
}

/// What a call takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Right {
    /// Any identity of the farm.
    Anybody,
    /// A worker.
    Worker,
    /// A user of this role or a higher one.
    User(Role),
    /// A worker, or a user of this role or a higher one.
    WorkerOrUser(Role),
}

impl Right {
    /// Of a call by its path; what is not named here takes an admin.
    fn of(path: &str) -> Self {
        let Some((service, call)) = path.trim_start_matches('/').split_once('/') else {
            return Self::User(Role::Admin);
        };
        match (service, call) {
            ("femc.v1.Workers", "Session") => Self::Worker,
            (
                "femc.v1.Jobs",
                "List" | "Status" | "Watch" | "Frames" | "Parts" | "Logs" | "Attempts" | "ListWorkers",
            ) => Self::User(Role::Viewer),
            // Whose job it is decides the call itself.
            ("femc.v1.Jobs", "Submit" | "Control") => Self::User(Role::Submitter),
            ("femc.v1.Jobs", "DrainWorkers") => Self::User(Role::Operator),
            ("femc.v1.Artifacts", "Get" | "Missing") => Self::WorkerOrUser(Role::Viewer),
            ("femc.v1.Artifacts", "Offer" | "Put") => Self::WorkerOrUser(Role::Submitter),
            ("grpc.health.v1.Health" | "grpc.reflection.v1.ServerReflection", _) => Self::Anybody,
            _ => Self::User(Role::Admin),
        }
    }

    fn is_of(self, holder: &Holder) -> bool {
        match (self, holder) {
            (Self::Anybody, _) | (Self::Worker | Self::WorkerOrUser(_), Holder::Worker { .. }) => true,
            (Self::User(least) | Self::WorkerOrUser(least), Holder::User { role, .. }) => *role >= least,
            (Self::Worker | Self::User(_) | Self::WorkerOrUser(_), _) => false,
        }
    }

    fn takes(self) -> String {
        match self {
            Self::Anybody => "an identity of this farm".into(),
            Self::Worker => "a worker".into(),
            Self::User(role) => format!("a user of role {role}"),
            Self::WorkerOrUser(role) => format!("a worker, or a user of role {role}"),
        }
    }
}

/// Stands before all services of an encrypted server.
#[derive(Debug, Clone, Default)]
pub(super) enum Guard {
    /// Connections are not encrypted: whoever reaches the address may do everything.
    #[default]
    Open,
    /// Certificates are asked for, and these count no more.
    Checks(Option<Revoked>),
}

impl Guard {
    /// Lets the request through, with its [`Caller`].
    fn check<B>(&self, request: &mut Request<B>) -> Result<(), Status> {
        let Self::Checks(revoked) = self else { return Ok(()) };
        let unknown = |what: &str| Status::unauthenticated(format!("the certificate {what}"));
        let certificates =
            request.extensions().get::<TlsConnectInfo<TcpConnectInfo>>().and_then(|info| info.peer_certs());
        let own = certificates.as_deref().and_then(|all| all.first()).ok_or_else(|| unknown("is missing"))?;
        let holder = holder_of(own).map_err(|error| unknown(&error.to_string()))?;
        let caller = Caller { holder, fingerprint: Fingerprint::of(own), revoked: revoked.clone() };
        if !caller.still_counts() {
            return Err(caller.forbidden("an identity that was not revoked"));
        }
        let right = Right::of(request.uri().path());
        if !right.is_of(&caller.holder) {
            return Err(caller.forbidden(right.takes()));
        }
        request.extensions_mut().insert(Arc::new(caller));
        Ok(())
    }
}

impl<S> Layer<S> for Guard {
    type Service = Guarded<S>;

    fn layer(&self, inner: S) -> Guarded<S> {
        Guarded { guard: self.clone(), inner }
    }
}

/// A service behind the guard.
#[derive(Debug, Clone)]
pub(super) struct Guarded<S> {
    guard: Guard,
    inner: S,
}

impl<S, B> Service<Request<B>> for Guarded<S>
where
    S: Service<Request<B>, Response = Response<Body>>,
    S::Future: Send + 'static,
    S::Error: Send + 'static,
{
    type Response = S::Response;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<S::Response, S::Error>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, mut request: Request<B>) -> Self::Future {
        match self.guard.check(&mut request) {
            Ok(()) => Box::pin(self.inner.call(request)),
            Err(status) => Box::pin(async move { Ok(status.into_http()) }),
        }
    }
}

#[cfg(test)]
mod documented;
#[cfg(test)]
mod tests;
