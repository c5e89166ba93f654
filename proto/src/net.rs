//! The network layer: connections over TCP or over a simulated network.

use std::fmt;
use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use femc_trust::{Identity, TokenFile};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tonic::transport::server::Connected;

/// A bidirectional byte stream.
pub trait Io: AsyncRead + AsyncWrite + Send + Unpin + 'static {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin + 'static> Io for T {}

/// One end of a connection.
pub struct ByteStream(Box<dyn Io>);

impl ByteStream {
    /// Wraps a byte stream.
    pub fn new(io: impl Io) -> Self {
        Self(Box::new(io))
    }
}

impl fmt::Debug for ByteStream {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Link")
    }
}

impl AsyncRead for ByteStream {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_read(cx, buffer)
    }
}

impl AsyncWrite for ByteStream {
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

impl Connected for ByteStream {
    type ConnectInfo = ();

    fn connect_info(&self) {}
}

/// A connection being established.
pub type DialFuture = Pin<Box<dyn Future<Output = io::Result<ByteStream>> + Send>>;

type DialFn = dyn Fn(String, u16) -> DialFuture + Send + Sync;

/// The way in which a client connects to a coordinator, and its identity or token.
#[derive(Clone, Default)]
pub struct Dialer {
    pub(crate) dial_fn: Option<Arc<DialFn>>,
    pub(crate) identity: Option<Arc<Identity>>,
    pub(crate) token_file: Option<Arc<TokenFile>>,
}

impl Dialer {
    /// Creates a dialer for TCP.
    pub fn tcp() -> Self {
        Self::default()
    }

    /// Creates a dialer that calls `dial` with host and port.
    pub fn from_fn(dial: impl Fn(String, u16) -> DialFuture + Send + Sync + 'static) -> Self {
        Self { dial_fn: Some(Arc::new(dial)), ..Self::default() }
    }

    /// Adds an identity, which addresses that begin with `https://` require.
    pub fn with_identity(self, identity: Identity) -> Self {
        Self { identity: Some(Arc::new(identity)), ..self }
    }

    /// Adds a token. It is only sent where nobody else can read it: over encrypted connections or within this machine.
    pub fn with_token(self, token_file: TokenFile) -> Self {
        Self { token_file: Some(Arc::new(token_file)), ..self }
    }
}

impl fmt::Debug for Dialer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let way = if self.dial_fn.is_none() { "tcp" } else { "another way" };
        f.debug_struct("Dial")
            .field("way", &way)
            .field("identity", &self.identity)
            .field("pass", &self.token_file)
            .finish()
    }
}
