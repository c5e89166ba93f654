//! Who may ask for what, and how often: the same for every way that leads to the farm.

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

/// Who a caller is for the limits.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Who {
    /// Of a certificate or token, or the address where nobody is asked; `None`: not even that is known.
    pub name: Option<String>,
    /// The connection's number.
    pub connection: u64,
}

/// What somebody shows of himself with a request.
#[derive(Debug, Clone, Copy, Default)]
pub struct Shown<'a> {
    /// The token, as text; it goes first. An empty one is a wrong one.
    pub token: Option<&'a str>,
    /// The certificate of the connection.
    pub certificate: Option<&'a CertificateDer<'a>>,
    /// The address, without the port.
    pub place: Option<&'a str>,
}

/// A request that may pass.
#[derive(Debug, Clone, Default)]
pub struct Granted {
    /// Whose it is; `None`: nobody is asked, or the operation is for everybody.
    pub caller: Option<Arc<Caller>>,
    /// Whose it is for the limits.
    pub name: Option<String>,
    /// It came so much too early.
    pub wait: Duration,
}

/// Stands before all operations; clones share what they count.
#[derive(Debug, Clone)]
pub struct Gate {
    /// `None`: whoever reaches the address may do everything.
    lists: Option<Lists>,
    rates: Rates,
    audit: Option<Audit>,
    limits: Limits,
}

impl Gate {
    /// For a farm that asks who somebody is, if there are `lists` of it: identities that count no more, and tokens.
    pub fn new(lists: Option<(Option<Revoked>, Option<Tokens>)>, limits: Limits, audit: Option<Audit>) -> Self {
        let lists = lists.map(|(revoked, tokens)| Lists { revoked, tokens });
        Self { lists, rates: Rates::new(&limits), audit, limits }
    }

    /// Whether it asks who somebody is.
    pub fn asks(&self) -> bool {
        self.lists.is_some()
    }

    /// The limits of a request.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Where changes and refusals are noted.
    pub fn audit(&self) -> Option<&Audit> {
        self.audit.as_ref()
    }

    /// What the request leaves in the record.
    /// - `path`: its name there, where the operation has none.
    pub fn trail(&self, operation: Operation, path: &str, from: Option<String>) -> Trail {
        self.audit.as_ref().map_or_else(Trail::default, |_| Trail::new(operation, path, from))
    }

    /// Lets somebody through, or says why not.
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
        // Whoever guesses is counted by address.
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

    /// Who would be let in with this token.
    pub fn holder(&self, token: &str) -> Result<Caller, Refusal> {
        let unknown = |message: String| Refusal::Unauthenticated { message };
        let lists = self.lists.as_ref().ok_or_else(|| unknown("this coordinator asks nobody who he is".into()))?;
        lists.caller(Shown { token: Some(token), ..Shown::default() }).map_err(unknown)
    }

    /// When a request that asks for nothing there is may be answered.
    /// - `place`: the address that it came from, without the port.
    pub fn pace(&self, place: Option<&str>) -> Result<Duration, Refusal> {
        self.turn(place)
    }

    /// When a request is this caller's turn.
    fn turn(&self, name: Option<&str>) -> Result<Duration, Refusal> {
        let Some(name) = name else { return Ok(Duration::ZERO) };
        let too_many =
            || Refusal::TooLarge { what: format!("calls a second of {name}"), limit: self.limits.rate.into() };
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
