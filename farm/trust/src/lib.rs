//! Authentication and authorization in a farm: its own certificate authority, the identities that it issues, and the permissions of
//! each role.
//!
//! An [`Identity`] is one file: a certificate, its private key, and the authority's certificate, all in PEM. The certificate
//! contains the holder's name as a URI ([`Holder`]), so the farm needs no directory of users. Connections use TLS with certificates
//! on both sides. A leaked identity is revoked by its fingerprint. Clients without a certificate use a [`Token`]. All actions on a
//! farm, performed or refused, are recorded in its [`Audit`] log.
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
