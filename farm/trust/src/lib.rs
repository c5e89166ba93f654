//! Who belongs to a farm: an authority of its own, the identities that it issues, and what each role may do.
//!
//! An [`Identity`] is one file: a certificate, its private key, and the authority's certificate, all PEM. Whose it is stands in
//! the certificate as a URI ([`Holder`]); the farm asks no directory. Transport is TLS with certificates on both sides; an
//! identity that got into wrong hands is revoked by its fingerprint.
#![deny(missing_docs)]

mod authority;
mod error;
mod holder;
mod identity;
mod revoked;

pub use authority::{Authority, COORDINATOR_HOST, Issue, Issued};
pub use error::TrustError;
pub use holder::{Holder, Role};
pub use identity::{Fingerprint, Identity, holder_of};
pub use revoked::Revoked;
