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
mod expiration;
mod holder;
mod identity;
mod reload;
mod revocation;
mod token;
mod tokens;

pub use audit::{Audit, AuditEvent};
pub use authority::{Authority, COORDINATOR_HOST, CertificateRequest, IssuedCertificate};
pub use browser::browser_fingerprint;
pub use error::TrustError;
pub use holder::{Holder, Role};
pub use identity::{Fingerprint, Identity, certificate_holder};
pub use revocation::RevocationList;
pub use token::{Token, TokenDigest, TokenFile};
pub use tokens::{BadToken, TokenLine, Tokens};
