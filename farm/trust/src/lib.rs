//! Who belongs to a farm: an authority of its own, the identities that it issues, and what each role may do.
//!
//! An [`Identity`] is one file: a certificate, its private key, and the authority's certificate, all PEM. Whose it is stands in
//! the certificate as a URI ([`Holder`]); the farm asks no directory. Transport is TLS with certificates on both sides; an
//! identity that got into wrong hands is revoked by its fingerprint. Who cannot have certificates comes with a [`Token`]. What
//! is done to a farm, and what is refused, stands in its [`Audit`].
#![deny(missing_docs)]

mod audit;
mod authority;
mod browser;
mod error;
mod holder;
mod identity;
mod reread;
mod revoked;
mod token;
mod tokens;
mod until;

pub use audit::{Audit, AuditEvent};
pub use authority::{Authority, COORDINATOR_HOST, Issue, Issued};
pub use browser::browser_fingerprint;
pub use error::TrustError;
pub use holder::{Holder, Role};
pub use identity::{Fingerprint, Identity, holder_of};
pub use revoked::Revoked;
pub use token::{Pass, Token, TokenDigest};
pub use tokens::{BadToken, TokenLine, Tokens};
