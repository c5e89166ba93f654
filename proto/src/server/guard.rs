//! Who may call what, and how often.

use std::fmt;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use femc_model::Refusal;
use femc_trust::{Audit, Fingerprint, Holder, Revoked, Role, TokenDigest, Tokens, holder_of};
use http::header::AUTHORIZATION;
use http::{Request, Response};
use tokio::time::Instant;
use tonic::Status;
use tonic::body::Body;
use tonic::transport::server::TlsConnectInfo;
use tower::{Layer, Service};

use super::door::Peer;
use super::punctual::Pace;
use super::rate::Rates;
use super::trail::Trail;
use super::{Entrance, Limits};
use crate::error::to_status;

/// Whoever is at the other end of a connection on which one says who one is.
#[derive(Debug, Clone)]
pub(crate) struct Caller {
    pub(crate) holder: Holder,
    pub(crate) credential: Credential,
    lists: Lists,
}

/// What somebody shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Credential {
    Certificate(Fingerprint),
    Token(TokenDigest),
}

impl fmt::Display for Credential {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Certificate(fingerprint) => write!(f, "certificate {fingerprint}"),
            Self::Token(digest) => write!(f, "token {digest}"),
        }
    }
}

/// The lists that say what counts.
#[derive(Debug, Clone)]
struct Lists {
    revoked: Option<Revoked>,
    tokens: Option<Tokens>,
}

impl Caller {
    /// Whether what it showed still counts.
    pub(crate) fn still_counts(&self) -> bool {
        match &self.credential {
            Credential::Certificate(own) => !self.lists.revoked.as_ref().is_some_and(|revoked| revoked.holds(own)),
            Credential::Token(digest) => {
                let holder = self.lists.tokens.as_ref().and_then(|tokens| tokens.holder_of(digest).ok());
                holder.is_some_and(|holder| holder == self.holder)
            }
        }
    }

    /// The refusal of whoever counts no more.
    pub(crate) fn revoked(&self) -> Status {
        self.forbidden("an identity that was not revoked")
    }

    /// The refusal of what takes more.
    pub(crate) fn forbidden(&self, takes: impl Into<String>) -> Status {
        to_status(&Refusal::Forbidden { who: self.holder.to_string(), takes: takes.into() })
    }
}

/// Who a caller is for the limits.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Who {
    /// Of a certificate or token, or the address where nobody is asked; `None`: not even that is known.
    pub(super) name: Option<String>,
    /// The connection's number.
    pub(super) connection: u64,
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

    /// What whoever is refused would have to be: a worker is never refused what workers may, and no user is told to be one.
    fn takes(self) -> String {
        match self {
            Self::Anybody => "an identity of this farm".into(),
            Self::Worker => "a worker".into(),
            Self::User(role) | Self::WorkerOrUser(role) => format!("a user of role {role}"),
        }
    }
}

/// Stands before all services.
#[derive(Debug, Clone)]
pub(super) struct Guard {
    /// `None`: whoever reaches the address may do everything.
    lists: Option<Lists>,
    rates: Rates,
    audit: Option<Audit>,
    limits: Limits,
}

impl Guard {
    pub(super) fn new(entrance: Option<&Entrance>, limits: Limits, audit: Option<Audit>) -> Self {
        let lists =
            entrance.map(|Entrance { revoked, tokens, .. }| Lists { revoked: revoked.clone(), tokens: tokens.clone() });
        Self { lists, rates: Rates::new(&limits), audit, limits }
    }

    /// Lets the request through, with its [`Caller`], its [`Who`] and its [`Trail`]; after so long, if it came too early.
    fn check<B>(&self, request: &mut Request<B>) -> Result<Duration, Status> {
        let peer = request.extensions().get::<Peer>().cloned();
        let address = peer.as_ref().and_then(|peer| peer.address);
        let trail = self.audit.as_ref().map_or_else(Trail::default, |_| {
            Trail::new(request.uri().path(), address.map(|address| address.to_string()))
        });
        request.extensions_mut().insert(trail.clone());
        let place = address.map(|address| address.ip().to_string());
        let name = match &self.lists {
            None => {
                trail.anybody();
                place
            }
            Some(lists) => {
                // Whoever guesses is counted by address.
                let caller = caller(lists, request).or_else(|message| {
                    self.turn(place.as_deref())?;
                    Err(to_status(&Refusal::Unauthenticated { message }))
                })?;
                trail.caller(&caller);
                let name = caller.holder.to_string();
                if let Some(status) = refused(&caller, Right::of(request.uri().path())) {
                    self.turn(Some(&name))?;
                    return Err(status);
                }
                request.extensions_mut().insert(Arc::new(caller));
                Some(name)
            }
        };
        let wait = self.turn(name.as_deref())?;
        let connection = peer.as_ref().map_or(0, |peer| peer.number);
        request.extensions_mut().insert(Who { name, connection });
        if let Some(peer) = peer {
            peer.introduce();
        }
        Ok(wait)
    }

    /// When a call is this caller's turn.
    fn turn(&self, name: Option<&str>) -> Result<Duration, Status> {
        let Some(name) = name else { return Ok(Duration::ZERO) };
        let too_many =
            || Refusal::TooLarge { what: format!("calls a second of {name}"), limit: self.limits.rate.into() };
        self.rates.turn(name, Instant::now()).ok_or_else(|| to_status(&too_many()))
    }
}

fn refused(caller: &Caller, right: Right) -> Option<Status> {
    if !caller.still_counts() {
        Some(caller.revoked())
    } else if !right.is_of(&caller.holder) {
        Some(caller.forbidden(right.takes()))
    } else {
        None
    }
}

/// Whose request it is: a token goes first.
fn caller<B>(lists: &Lists, request: &Request<B>) -> Result<Caller, String> {
    let caller = |(holder, credential)| Caller { holder, credential, lists: lists.clone() };
    if let Some(header) = request.headers().get(AUTHORIZATION) {
        let tokens = lists.tokens.as_ref().ok_or("this coordinator takes no tokens")?;
        let token = header.to_str().ok().and_then(|text| text.strip_prefix("Bearer ")).unwrap_or_default();
        let (holder, digest) = tokens.holder(token).map_err(|error| error.to_string())?;
        return Ok(caller((holder, Credential::Token(digest))));
    }
    let certificates = request.extensions().get::<TlsConnectInfo<Peer>>().and_then(|info| info.peer_certs());
    let Some(own) = certificates.as_deref().and_then(|all| all.first()) else {
        return Err(match &lists.tokens {
            Some(_) => "neither a certificate nor a token was shown".into(),
            None => "no certificate was shown".into(),
        });
    };
    let holder = holder_of(own).map_err(|error| error.to_string())?;
    Ok(caller((holder, Credential::Certificate(Fingerprint::of(own)))))
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

impl<S> Service<Request<Body>> for Guarded<S>
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
        let checked = self.guard.check(&mut request);
        let trail = request.extensions().get::<Trail>().cloned().unwrap_or_default();
        let audit = self.guard.audit.clone();
        let (pace, patience) = (Pace::of(request.uri().path()), self.guard.limits.patience);
        // The one that is ready is used, and its copy waits for the next call.
        let next = self.inner.clone();
        let mut inner = std::mem::replace(&mut self.inner, next);
        Box::pin(async move {
            let response = match checked {
                Ok(wait) => {
                    if !wait.is_zero() {
                        tokio::time::sleep(wait).await;
                    }
                    inner.call(request.map(|body| pace.hold(body, patience))).await?
                }
                Err(status) => status.into_http(),
            };
            if let Some(audit) = audit {
                trail.end(&audit, &response);
            }
            Ok(response)
        })
    }
}

#[cfg(test)]
mod documented;
#[cfg(test)]
mod tests;
