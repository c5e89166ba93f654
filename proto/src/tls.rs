//! Encryption: the coordinator presents a certificate of the farm's authority. The client presents one too, or a token.

use std::error::Error;
use std::sync::Arc;

use femc_trust::{COORDINATOR_HOST, Identity};
use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::server::WebPkiClientVerifier;
use rustls::{AlertDescription as Alert, RootCertStore, ServerConfig};
use tonic::transport::{Certificate, ClientTlsConfig};

use crate::error::{IdentityError, UnreachableCause};

/// Returns the cause of a broken connection, if it is about certificates.
pub(crate) fn unreachable_cause(error: &(dyn Error + 'static)) -> UnreachableCause {
    let causes = std::iter::successors(Some(error), |&error| error.source());
    causes
        .filter_map(tls_error)
        .map(certificate_cause)
        .find(|why| *why != UnreachableCause::Connection)
        .unwrap_or_default()
}

/// Returns a TLS error, also one within an I/O error.
fn tls_error<'a>(error: &'a (dyn Error + 'static)) -> Option<&'a rustls::Error> {
    let within = || error.downcast_ref::<std::io::Error>()?.get_ref()?.downcast_ref();
    error.downcast_ref().or_else(within)
}

fn certificate_cause(error: &rustls::Error) -> UnreachableCause {
    match error {
        rustls::Error::InvalidCertificate(_) => UnreachableCause::ServerCertificate,
        rustls::Error::AlertReceived(
            Alert::UnknownCA
            | Alert::BadCertificate
            | Alert::UnsupportedCertificate
            | Alert::CertificateRevoked
            | Alert::CertificateExpired
            | Alert::CertificateUnknown
            | Alert::CertificateRequired
            | Alert::AccessDenied
            | Alert::DecryptError,
        ) => UnreachableCause::ClientCertificate,
        _ => UnreachableCause::Connection,
    }
}

/// Credentials that a server demands from its clients.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ClientAuth {
    /// A certificate of the same authority.
    Certificate,
    /// A certificate of the same authority, or none; then each call needs a token.
    CertificateOrToken,
}

fn tls_identity(identity: &Identity) -> tonic::transport::Identity {
    tonic::transport::Identity::from_pem(identity.certificate(), identity.key())
}

/// Creates a client configuration that trusts every coordinator certificate of this authority, whatever the address.
pub(crate) fn client_config_without_certificate(authority: &str) -> ClientTlsConfig {
    ClientTlsConfig::new().ca_certificate(Certificate::from_pem(authority)).domain_name(COORDINATOR_HOST)
}

/// Creates a client configuration like [`client_config_without_certificate`] that also presents the client's certificate.
pub(crate) fn client_config(identity: &Identity) -> ClientTlsConfig {
    client_config_without_certificate(identity.authority()).identity(tls_identity(identity))
}

/// Protocols that a coordinator speaks over TLS, the preferred one first. gRPC needs HTTP/2; other programs may use either.
const PROTOCOLS: [&[u8]; 2] = [b"h2", b"http/1.1"];

/// Creates a server configuration that accepts certificates of the same authority.
pub(crate) fn server_config(identity: &Identity, auth: ClientAuth) -> Result<ServerConfig, IdentityError> {
    let certificate = |pem: &str| CertificateDer::from_pem_slice(pem.as_bytes());
    let provider = Arc::new(ring::default_provider());
    let mut authority = RootCertStore::empty();
    authority.add(certificate(identity.authority())?)?;
    let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(authority), provider.clone());
    let verifier = match auth {
        ClientAuth::Certificate => verifier,
        ClientAuth::CertificateOrToken => verifier.allow_unauthenticated(),
    };
    let config = ServerConfig::builder_with_provider(provider).with_safe_default_protocol_versions()?;
    let key = PrivateKeyDer::from_pem_slice(identity.key().as_bytes())?;
    let own = vec![certificate(identity.certificate())?];
    let mut config = config.with_client_cert_verifier(verifier.build()?).with_single_cert(own, key)?;
    config.alpn_protocols = PROTOCOLS.map(<[u8]>::to_vec).to_vec();
    Ok(config)
}
