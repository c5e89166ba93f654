//! Access control: who may call which operation, and how often. The rules are the same for all protocols.

mod audit_entry;
mod caller;
mod limits;
mod login_tokens;
mod rate;
mod transfer_slots;

use std::sync::Arc;
use std::time::Duration;

use femc_model::Refusal;
use femc_trust::{Audit, RevocationList, Tokens};
use rustls_pki_types::CertificateDer;
use tokio::time::Instant;

use crate::operation::{Operation, Right};
pub use audit_entry::{AuditEntry, Outcome};
use caller::CredentialLists;
pub use caller::{Caller, Credential};
pub use limits::Limits;
pub use login_tokens::LoginTokens;
use rate::RateLimiter;
pub use transfer_slots::{TransferSlot, TransferSlots};

/// Identity of a caller for the limits.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct CallerKey {
    /// Name of a certificate or a token, or the address if the farm does not authenticate. `None`: not even the address is known.
    pub name: Option<String>,
    /// Number of the connection.
    pub connection: u64,
}

/// Credentials and address of a request.
#[derive(Debug, Clone, Copy, Default)]
pub struct PresentedCredentials<'a> {
    /// Token, as text. It takes precedence. An empty token is invalid.
    pub token: Option<&'a str>,
    /// Certificate of the connection.
    pub certificate: Option<&'a CertificateDer<'a>>,
    /// Address without the port.
    pub address: Option<&'a str>,
}

/// A permitted request.
#[derive(Debug, Clone, Default)]
pub struct AccessGrant {
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
    lists: Option<CredentialLists>,
    /// Tokens in addresses of pages.
    logins: Option<LoginTokens>,
    rates: RateLimiter,
    audit: Option<Audit>,
    limits: Limits,
}

impl Gate {
    /// Makes a gate. With `lists` (revoked identities, and tokens) the farm authenticates callers.
    pub fn new(lists: Option<(Option<RevocationList>, Option<Tokens>)>, limits: Limits, audit: Option<Audit>) -> Self {
        let lists = lists.map(|(revoked, tokens)| CredentialLists { revoked, tokens });
        Self { lists, logins: None, rates: RateLimiter::new(&limits), audit, limits }
    }

    /// Accepts tokens in addresses of pages, each of them once.
    #[must_use]
    pub fn with_logins(self, logins: Option<LoginTokens>) -> Self {
        Self { logins, ..self }
    }

    /// Returns whether the farm authenticates callers.
    pub fn requires_authentication(&self) -> bool {
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
    pub fn audit_entry(&self, operation: Operation, path: &str, from: Option<String>) -> AuditEntry {
        self.audit.as_ref().map_or_else(AuditEntry::default, |_| AuditEntry::new(operation, path, from))
    }

    /// Authenticates and authorizes a request, and applies the rate limit.
    pub fn check(
        &self,
        operation: Operation,
        presented: PresentedCredentials<'_>,
        entry: &AuditEntry,
    ) -> Result<AccessGrant, Refusal> {
        let right = operation.right();
        let address = presented.address.map(str::to_owned);
        let Some(lists) = self.lists.as_ref().filter(|_| right != Right::Public) else {
            if self.lists.is_none() {
                entry.set_unauthenticated();
            }
            let wait = self.limit_rate(address.as_deref())?;
            return Ok(AccessGrant { caller: None, name: address, wait });
        };
        // Failed authentications count against the address.
        let caller = lists.authenticate(presented).or_else(|message| {
            self.limit_rate(address.as_deref())?;
            Err(Refusal::Unauthenticated { message })
        })?;
        entry.set_caller(&caller);
        let name = caller.holder.to_string();
        if let Some(refusal) = check_right(&caller, right) {
            self.limit_rate(Some(&name))?;
            return Err(refusal);
        }
        let wait = self.limit_rate(Some(&name))?;
        Ok(AccessGrant { caller: Some(Arc::new(caller)), name: Some(name), wait })
    }

    /// Returns the tokens in addresses of pages.
    pub(crate) fn logins(&self) -> Option<&LoginTokens> {
        self.logins.as_ref()
    }

    /// Returns the caller that this token would authenticate.
    pub fn caller_of_token(&self, token: &str) -> Result<Caller, Refusal> {
        let unknown = |message: String| Refusal::Unauthenticated { message };
        let lists =
            self.lists.as_ref().ok_or_else(|| unknown("this coordinator does not authenticate clients".into()))?;
        lists
            .authenticate(PresentedCredentials { token: Some(token), ..PresentedCredentials::default() })
            .map_err(unknown)
    }

    /// Applies the rate limit to a request without a route, and returns the time to wait.
    /// - `address`: address of the client, without the port.
    pub fn limit_address_rate(&self, address: Option<&str>) -> Result<Duration, Refusal> {
        self.limit_rate(address)
    }

    /// Applies the rate limit to a caller, and returns the time to wait.
    fn limit_rate(&self, name: Option<&str>) -> Result<Duration, Refusal> {
        let Some(name) = name else { return Ok(Duration::ZERO) };
        let too_many =
            || Refusal::TooLarge { what: format!("calls per second from {name}"), limit: self.limits.rate.into() };
        self.rates.delay(name, Instant::now()).ok_or_else(too_many)
    }
}

fn check_right(caller: &Caller, right: Right) -> Option<Refusal> {
    if !caller.is_valid() {
        Some(caller.revoked_refusal())
    } else if !right.is_held_by(&caller.holder) {
        Some(caller.forbidden(right.required_holder()))
    } else {
        None
    }
}
