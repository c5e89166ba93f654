//! Encryption: a coordinator shows a certificate of the farm's authority, and so does its client, or a token.

use std::error::Error;

use femc_trust::{COORDINATOR_HOST, Identity};
use rustls::AlertDescription as Alert;
use tonic::transport::{Certificate, ClientTlsConfig, ServerTlsConfig};

use crate::error::Why;

/// What a broken connection says about certificates.
pub(crate) fn why(error: &(dyn Error + 'static)) -> Why {
    let causes = std::iter::successors(Some(error), |&error| error.source());
    causes.filter_map(of_tls).map(of_certificates).find(|why| *why != Why::Away).unwrap_or_default()
}

/// An error of TLS, as it is or within one of input and output.
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
