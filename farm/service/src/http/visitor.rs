//! Who is at the other end, as far as the connection tells.

use std::net::SocketAddr;

use rustls_pki_types::CertificateDer;

/// A connection's other end.
#[derive(Debug, Clone, Default)]
pub struct Visitor {
    /// Its address, unless the connection is no TCP connection.
    pub address: Option<SocketAddr>,
    /// The address at which it has reached the server.
    pub reached: Option<SocketAddr>,
    /// Number of the connection.
    pub connection: u64,
    /// The certificate that it has shown.
    pub certificate: Option<CertificateDer<'static>>,
}

/// Found in the extensions of a response: the request was one that its visitor may make, and its connection may last.
#[derive(Debug, Clone, Copy)]
pub struct Introduced;

/// Found in the extensions of a response: the request was one that everybody may make, such as for a file of the page. Its visitor is
/// as unknown as before, and nothing was refused.
#[derive(Debug, Clone, Copy)]
pub struct Served;
