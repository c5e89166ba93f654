//! Encryption: both sides show a certificate of the farm's authority.

use femc_trust::{COORDINATOR_HOST, Identity};
use tonic::transport::{Certificate, ClientTlsConfig, ServerTlsConfig};

fn own(identity: &Identity) -> tonic::transport::Identity {
    tonic::transport::Identity::from_pem(identity.certificate(), identity.key())
}

/// Believes whoever shows a coordinator's certificate of the same authority, whatever address it is reached at.
pub(crate) fn client(identity: &Identity) -> ClientTlsConfig {
    let authority = Certificate::from_pem(identity.authority());
    ClientTlsConfig::new().ca_certificate(authority).identity(own(identity)).domain_name(COORDINATOR_HOST)
}

/// Lets in whoever shows a certificate of the same authority.
pub(crate) fn server(identity: &Identity) -> ServerTlsConfig {
    ServerTlsConfig::new().identity(own(identity)).client_ca_root(Certificate::from_pem(identity.authority()))
}
