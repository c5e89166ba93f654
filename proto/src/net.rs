//! The network layer: connections over TCP or over a simulated network.

use std::fmt;
use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use femc_trust::{Identity, Pass};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tonic::transport::server::Connected;

/// A bidirectional byte stream.
pub trait Io: AsyncRead + AsyncWrite + Send + Unpin + 'static {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin + 'static> Io for T {}

/// One end of a connection.
pub struct Link(Box<dyn Io>);

impl Link {
    /// Wraps a byte stream.
    pub fn new(io: impl Io) -> Self {
        Self(Box::new(io))
    }
}

impl fmt::Debug for Link {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Link")
    }
}

impl AsyncRead for Link {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_read(cx, buffer)
    }
}

impl AsyncWrite for Link {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.0).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_shutdown(cx)
    }
}

impl Connected for Link {
    type ConnectInfo = ();

    fn connect_info(&self) {}
}

/// A connection being established.
pub type Dialing = Pin<Box<dyn Future<Output = io::Result<Link>> + Send>>;

type Way = dyn Fn(String, u16) -> Dialing + Send + Sync;

/// The way in which a client connects to a coordinator, and its identity or token.
#[derive(Clone, Default)]
pub struct Dial {
    pub(crate) way: Option<Arc<Way>>,
    pub(crate) identity: Option<Arc<Identity>>,
    pub(crate) pass: Option<Arc<Pass>>,
}

impl Dial {
    /// Creates a dialer for TCP.
    pub fn tcp() -> Self {
        Self::default()
    }

    /// Creates a dialer that calls `dial` with host and port.
    pub fn by(dial: impl Fn(String, u16) -> Dialing + Send + Sync + 'static) -> Self {
        Self { way: Some(Arc::new(dial)), ..Self::default() }
    }

    /// Adds an identity, which addresses that begin with `https://` require.
    pub fn with(self, identity: Identity) -> Self {
        Self { identity: Some(Arc::new(identity)), ..self }
    }

    /// Adds a token. It is only sent where nobody else can read it: over encrypted connections or within this machine.
    pub fn bearing(self, pass: Pass) -> Self {
        Self { pass: Some(Arc::new(pass)), ..self }
    }
}

impl fmt::Debug for Dial {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let way = if self.way.is_none() { "tcp" } else { "another way" };
        f.debug_struct("Dial").field("way", &way).field("identity", &self.identity).field("pass", &self.pass).finish()
    }
}
