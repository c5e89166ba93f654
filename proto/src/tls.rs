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

use crate::error::{IdentityError, Why};

/// Returns the cause of a broken connection, if it is about certificates.
pub(crate) fn why(error: &(dyn Error + 'static)) -> Why {
    let causes = std::iter::successors(Some(error), |&error| error.source());
    causes.filter_map(of_tls).map(of_certificates).find(|why| *why != Why::Away).unwrap_or_default()
}

/// Returns a TLS error, also one within an I/O error.
fn of_tls<'a>(error: &'a (dyn Error + 'static)) -> Option<&'a rustls::Error> {
    let within = || error.downcast_ref::<std::io::Error>()?.get_ref()?.downcast_ref();
    error.downcast_ref().or_else(within)
}

fn of_certificates(error: &rustls::Error) -> Why {
    match error {
        rustls::Error::InvalidCertificate(_) => Why::TheirCertificate,
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
        ) => Why::OurCertificate,
        _ => Why::Away,
    }
}

/// Credentials that a server demands from its clients.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Clients {
    /// A certificate of the same authority.
    ShowIdentities,
    /// A certificate of the same authority, or none; then each call needs a token.
    MayShowTokens,
}

fn own(identity: &Identity) -> tonic::transport::Identity {
    tonic::transport::Identity::from_pem(identity.certificate(), identity.key())
}

/// Creates a client configuration that trusts every coordinator certificate of this authority, whatever the address.
pub(crate) fn known_by(authority: &str) -> ClientTlsConfig {
    ClientTlsConfig::new().ca_certificate(Certificate::from_pem(authority)).domain_name(COORDINATOR_HOST)
}

/// Creates a client configuration like [`known_by`] that also presents the client's certificate.
pub(crate) fn client(identity: &Identity) -> ClientTlsConfig {
    known_by(identity.authority()).identity(own(identity))
}

/// Protocols that a coordinator speaks over TLS, the preferred one first. gRPC needs HTTP/2; other programs may use either.
const PROTOCOLS: [&[u8]; 2] = [b"h2", b"http/1.1"];

/// Creates a server configuration that accepts certificates of the same authority.
pub(crate) fn server(identity: &Identity, clients: Clients) -> Result<ServerConfig, IdentityError> {
    let certificate = |pem: &str| CertificateDer::from_pem_slice(pem.as_bytes());
    let provider = Arc::new(ring::default_provider());
    let mut authority = RootCertStore::empty();
    authority.add(certificate(identity.authority())?)?;
    let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(authority), provider.clone());
    let verifier = match clients {
        Clients::ShowIdentities => verifier,
        Clients::MayShowTokens => verifier.allow_unauthenticated(),
    };
    let config = ServerConfig::builder_with_provider(provider).with_safe_default_protocol_versions()?;
    let key = PrivateKeyDer::from_pem_slice(identity.key().as_bytes())?;
    let own = vec![certificate(identity.certificate())?];
    let mut config = config.with_client_cert_verifier(verifier.build()?).with_single_cert(own, key)?;
    config.alpn_protocols = PROTOCOLS.map(<[u8]>::to_vec).to_vec();
    Ok(config)
}
