//! Access control: who may call which operation, and how often. The rules are the same for all protocols.

mod caller;
mod limits;
mod places;
mod rate;
mod trail;

use std::sync::Arc;
use std::time::Duration;

use femc_model::Refusal;
use femc_trust::{Audit, Revoked, Tokens};
use rustls_pki_types::CertificateDer;
use tokio::time::Instant;

use crate::operation::{Operation, Right};
use caller::Lists;
pub use caller::{Caller, Credential};
pub use limits::Limits;
pub use places::{Place, Places};
use rate::Rates;
pub use trail::{Outcome, Trail};

/// Identity of a caller for the limits.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Who {
    /// Name of a certificate or a token, or the address if the farm does not authenticate. `None`: not even the address is known.
    pub name: Option<String>,
    /// Number of the connection.
    pub connection: u64,
}

/// Credentials and address of a request.
#[derive(Debug, Clone, Copy, Default)]
pub struct Shown<'a> {
    /// Token, as text. It takes precedence. An empty token is invalid.
    pub token: Option<&'a str>,
    /// Certificate of the connection.
    pub certificate: Option<&'a CertificateDer<'a>>,
    /// Address without the port.
    pub place: Option<&'a str>,
}

/// A permitted request.
#[derive(Debug, Clone, Default)]
pub struct Granted {
    /// Caller. `None`: the farm does not authenticate, or the operation is public.
    pub caller: Option<Arc<Caller>>,
    /// Name of the caller for the limits.
    pub name: Option<String>,
    /// Time to wait before the request runs, because of the rate limit.
    pub wait: Duration,
}

/// Access check in front of all operations. Clones share the counters.
#[derive(Debug, Clone)]
pub struct Gate {
    /// `None`: the farm does not authenticate, and everyone who can reach the address may do everything.
    lists: Option<Lists>,
    rates: Rates,
    audit: Option<Audit>,
    limits: Limits,
}

impl Gate {
    /// Makes a gate. With `lists` (revoked identities, and tokens) the farm authenticates callers.
    pub fn new(lists: Option<(Option<Revoked>, Option<Tokens>)>, limits: Limits, audit: Option<Audit>) -> Self {
        let lists = lists.map(|(revoked, tokens)| Lists { revoked, tokens });
        Self { lists, rates: Rates::new(&limits), audit, limits }
    }

    /// Returns whether the farm authenticates callers.
    pub fn asks(&self) -> bool {
        self.lists.is_some()
    }

    /// Returns the limits.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Returns the audit log, which records changes and refusals.
    pub fn audit(&self) -> Option<&Audit> {
        self.audit.as_ref()
    }

    /// Starts the audit entry of a request.
    /// - `path`: name of the request in the entry, if the operation has no name.
    pub fn trail(&self, operation: Operation, path: &str, from: Option<String>) -> Trail {
        self.audit.as_ref().map_or_else(Trail::default, |_| Trail::new(operation, path, from))
    }

    /// Authenticates and authorizes a request, and applies the rate limit.
    pub fn check(&self, operation: Operation, shown: Shown<'_>, trail: &Trail) -> Result<Granted, Refusal> {
        let right = operation.right();
        let place = shown.place.map(str::to_owned);
        let Some(lists) = self.lists.as_ref().filter(|_| right != Right::Public) else {
            if self.lists.is_none() {
                trail.anybody();
            }
            let wait = self.turn(place.as_deref())?;
            return Ok(Granted { caller: None, name: place, wait });
        };
        // Failed authentications count against the address.
        let caller = lists.caller(shown).or_else(|message| {
            self.turn(place.as_deref())?;
            Err(Refusal::Unauthenticated { message })
        })?;
        trail.caller(&caller);
        let name = caller.holder.to_string();
        if let Some(refusal) = refused(&caller, right) {
            self.turn(Some(&name))?;
            return Err(refusal);
        }
        let wait = self.turn(Some(&name))?;
        Ok(Granted { caller: Some(Arc::new(caller)), name: Some(name), wait })
    }

    /// Returns the caller that this token would authenticate.
    pub fn holder(&self, token: &str) -> Result<Caller, Refusal> {
        let unknown = |message: String| Refusal::Unauthenticated { message };
        let lists =
            self.lists.as_ref().ok_or_else(|| unknown("this coordinator does not authenticate clients".into()))?;
        lists.caller(Shown { token: Some(token), ..Shown::default() }).map_err(unknown)
    }

    /// Applies the rate limit to a request without a route, and returns the time to wait.
    /// - `place`: address of the client, without the port.
    pub fn pace(&self, place: Option<&str>) -> Result<Duration, Refusal> {
        self.turn(place)
    }

    /// Applies the rate limit to a caller, and returns the time to wait.
    fn turn(&self, name: Option<&str>) -> Result<Duration, Refusal> {
        let Some(name) = name else { return Ok(Duration::ZERO) };
        let too_many =
            || Refusal::TooLarge { what: format!("calls per second from {name}"), limit: self.limits.rate.into() };
        self.rates.turn(name, Instant::now()).ok_or_else(too_many)
    }
}

fn refused(caller: &Caller, right: Right) -> Option<Refusal> {
    if !caller.still_counts() {
        Some(caller.revoked())
    } else if !right.is_of(&caller.holder) {
        Some(caller.forbidden(right.takes()))
    } else {
        None
    }
}
