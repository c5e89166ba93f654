//! Client of a connection, as far as the connection identifies it.

use std::net::SocketAddr;

use rustls_pki_types::CertificateDer;

/// Client of a connection.
#[derive(Debug, Clone, Default)]
pub struct ConnectedClient {
    /// Address of the client; `None` if the connection is not TCP.
    pub address: Option<SocketAddr>,
    /// Server address that the client connected to.
    pub local_address: Option<SocketAddr>,
    /// Number of the connection.
    pub connection: u64,
    /// Certificate that the client presented.
    pub certificate: Option<CertificateDer<'static>>,
}

/// Response extension: the request was permitted for its caller, so the connection may stay open.
#[derive(Debug, Clone, Copy)]
pub struct PermittedResponse;

/// Response extension: the request was public, such as for a file of the page. The client remains unauthenticated, and nothing was
/// refused.
#[derive(Debug, Clone, Copy)]
pub struct PublicResponse;
