//! Authenticated callers.

use std::fmt;

use femc_model::Refusal;
use femc_trust::{Fingerprint, Holder, RevocationList, Role, TokenDigest, Tokens, certificate_holder};

use super::PresentedCredentials;

/// An authenticated caller.
#[derive(Debug, Clone)]
pub struct Caller {
    /// Identity of the caller.
    pub holder: Holder,
    /// Credential that identified the caller.
    pub credential: Credential,
    lists: CredentialLists,
}

/// Kind of credential.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Credential {
    /// Fingerprint of a certificate.
    Certificate(Fingerprint),
    /// Digest of a token.
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

/// Lists that decide which credentials are valid.
#[derive(Debug, Clone)]
pub(super) struct CredentialLists {
    pub(super) revoked: Option<RevocationList>,
    pub(super) tokens: Option<Tokens>,
}

impl CredentialLists {
    /// Returns the caller of a request. A token takes precedence over a certificate.
    pub(super) fn authenticate(&self, presented: PresentedCredentials<'_>) -> Result<Caller, String> {
        let caller = |(holder, credential)| Caller { holder, credential, lists: self.clone() };
        if let Some(token) = presented.token {
            let tokens = self.tokens.as_ref().ok_or("this coordinator does not accept tokens")?;
            let (holder, digest) = tokens.holder(token).map_err(|error| error.to_string())?;
            return Ok(caller((holder, Credential::Token(digest))));
        }
        let Some(own) = presented.certificate else {
            return Err(match &self.tokens {
                Some(_) => "the client sent neither a certificate nor a token".into(),
                None => "the client sent no certificate".into(),
            });
        };
        let holder = certificate_holder(own).map_err(|error| error.to_string())?;
        Ok(caller((holder, Credential::Certificate(Fingerprint::from_certificate(own)))))
    }
}

impl Caller {
    /// Returns whether the credential is still valid.
    pub fn is_valid(&self) -> bool {
        match &self.credential {
            Credential::Certificate(own) => !self.lists.revoked.as_ref().is_some_and(|revoked| revoked.contains(own)),
            Credential::Token(digest) => {
                let holder = self.lists.tokens.as_ref().and_then(|tokens| tokens.holder_by_digest(digest).ok());
                holder.is_some_and(|holder| holder == self.holder)
            }
        }
    }

    /// Returns the role, if the caller is a user.
    pub fn role(&self) -> Option<Role> {
        match &self.holder {
            Holder::User { role, .. } => Some(*role),
            Holder::Worker { .. } | Holder::Coordinator { .. } => None,
        }
    }

    /// Returns the refusal for a revoked credential.
    pub fn revoked_refusal(&self) -> Refusal {
        self.forbidden("an identity that is not revoked")
    }

    /// Returns the refusal for an operation that needs the right `required`.
    pub fn forbidden(&self, required: impl Into<String>) -> Refusal {
        Refusal::Forbidden { who: self.holder.to_string(), takes: required.into() }
    }

    /// Checks that the caller may control a job of `owner`. Submitters may control their own jobs; other jobs need an operator.
    pub fn check_may_control(&self, owner: &str) -> Result<(), Refusal> {
        match &self.holder {
            Holder::User { role: Role::Operator | Role::Admin, .. } => Ok(()),
            Holder::User { name, .. } if name == owner => Ok(()),
            Holder::User { .. } | Holder::Worker { .. } | Holder::Coordinator { .. } => {
                Err(self.forbidden("the job's owner, or a user of role operator"))
            }
        }
    }
}
