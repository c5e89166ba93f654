//! Encryption: a coordinator shows a certificate of the farm's authority, and so does its client, or a token.

use femc_trust::{COORDINATOR_HOST, Identity};
use tonic::transport::{Certificate, ClientTlsConfig, ServerTlsConfig};

/// What clients of a server show.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Clients {
    /// A certificate of the same authority.
    ShowIdentities,
    /// That, or nothing: then a token comes with each call.
    MayShowTokens,
}

fn own(identity: &Identity) -> tonic::transport::Identity {
    tonic::transport::Identity::from_pem(identity.certificate(), identity.key())
}

/// Believes whoever shows a coordinator's certificate of this authority, whatever address it is reached at.
pub(crate) fn known_by(authority: &str) -> ClientTlsConfig {
    ClientTlsConfig::new().ca_certificate(Certificate::from_pem(authority)).domain_name(COORDINATOR_HOST)
}

/// The same, and shows its own.
pub(crate) fn client(identity: &Identity) -> ClientTlsConfig {
    known_by(identity.authority()).identity(own(identity))
}

/// Lets in whoever shows a certificate of the same authority.
pub(crate) fn server(identity: &Identity, clients: Clients) -> ServerTlsConfig {
    let authority = Certificate::from_pem(identity.authority());
    ServerTlsConfig::new()
        .identity(own(identity))
        .client_ca_root(authority)
        .client_auth_optional(clients == Clients::MayShowTokens)
}
