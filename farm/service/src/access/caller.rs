//! Whoever is at the other end of a connection on which one says who one is.

use std::fmt;

use femc_model::Refusal;
use femc_trust::{Fingerprint, Holder, Revoked, Role, TokenDigest, Tokens, holder_of};

use super::Shown;

/// Somebody that the farm knows.
#[derive(Debug, Clone)]
pub struct Caller {
    /// Who it is.
    pub holder: Holder,
    /// By what it is known.
    pub credential: Credential,
    lists: Lists,
}

/// What somebody shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Credential {
    /// A certificate.
    Certificate(Fingerprint),
    /// A token.
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
pub(super) struct Lists {
    pub(super) revoked: Option<Revoked>,
    pub(super) tokens: Option<Tokens>,
}

impl Lists {
    /// Whose request it is: a token goes first.
    pub(super) fn caller(&self, shown: Shown<'_>) -> Result<Caller, String> {
        let caller = |(holder, credential)| Caller { holder, credential, lists: self.clone() };
        if let Some(token) = shown.token {
            let tokens = self.tokens.as_ref().ok_or("this coordinator takes no tokens")?;
            let (holder, digest) = tokens.holder(token).map_err(|error| error.to_string())?;
            return Ok(caller((holder, Credential::Token(digest))));
        }
        let Some(own) = shown.certificate else {
            return Err(match &self.tokens {
                Some(_) => "neither a certificate nor a token was shown".into(),
                None => "no certificate was shown".into(),
            });
        };
        let holder = holder_of(own).map_err(|error| error.to_string())?;
        Ok(caller((holder, Credential::Certificate(Fingerprint::of(own)))))
    }
}

impl Caller {
    /// Whether what it showed still counts.
    pub fn still_counts(&self) -> bool {
        match &self.credential {
            Credential::Certificate(own) => !self.lists.revoked.as_ref().is_some_and(|revoked| revoked.holds(own)),
            Credential::Token(digest) => {
                let holder = self.lists.tokens.as_ref().and_then(|tokens| tokens.holder_of(digest).ok());
                holder.is_some_and(|holder| holder == self.holder)
            }
        }
    }

    /// Its role, if it is a user.
    pub fn role(&self) -> Option<Role> {
        match &self.holder {
            Holder::User { role, .. } => Some(*role),
            Holder::Worker { .. } | Holder::Coordinator { .. } => None,
        }
    }

    /// The refusal of whoever counts no more.
    pub fn revoked(&self) -> Refusal {
        self.forbidden("an identity that was not revoked")
    }

    /// The refusal of what takes more.
    pub fn forbidden(&self, takes: impl Into<String>) -> Refusal {
        Refusal::Forbidden { who: self.holder.to_string(), takes: takes.into() }
    }

    /// Refuses to steer what belongs to `owner`: a submitter steers jobs of its own, others need an operator.
    pub fn may_steer(&self, owner: &str) -> Result<(), Refusal> {
        match &self.holder {
            Holder::User { role: Role::Operator | Role::Admin, .. } => Ok(()),
            Holder::User { name, .. } if name == owner => Ok(()),
            Holder::User { .. } | Holder::Worker { .. } | Holder::Coordinator { .. } => {
                Err(self.forbidden("the job's owner, or a user of role operator"))
            }
        }
    }
}
