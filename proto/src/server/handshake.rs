//! Encryption of incoming connections.
//!
//! This module does the handshakes instead of tonic. tonic would offer HTTP/2 alone, and its protocol list refuses programs that
//! speak HTTP/1.1 over TLS.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use rustls::ServerConfig;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::task::JoinSet;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;
use tokio_stream::{Stream, StreamExt as _};
use tonic::transport::server::Connected;

use super::connection_limiter::{AdmittedConnection, Peer};
use crate::net::Io;

/// An admitted connection; encrypted if the coordinator has an identity.
pub(super) enum Connection<C> {
    Plain(AdmittedConnection<C>),
    Encrypted(Box<TlsStream<AdmittedConnection<C>>>),
}

/// Returns the connections, each after its handshake. A failed handshake ends only its own connection. The deadline of
/// [`AdmittedConnection`] ends a handshake that takes too long. Unfinished handshakes are dropped with the stream.
/// - `config`: TLS settings; `None` leaves connections unencrypted.
pub(super) fn with_handshakes<C: Io + Connected>(
    incoming: impl Stream<Item = io::Result<AdmittedConnection<C>>>,
    config: Option<Arc<ServerConfig>>,
) -> impl Stream<Item = io::Result<Connection<C>>> {
    let state = (Box::pin(incoming), config.map(TlsAcceptor::from), JoinSet::new(), IncomingState::Open);
    futures_util::stream::unfold(state, |(mut incoming, acceptor, mut handshakes, mut incoming_state)| async move {
        let next = loop {
            tokio::select! {
                accepted = incoming.next(), if incoming_state == IncomingState::Open => match (accepted, &acceptor) {
                    (None, _) => incoming_state = IncomingState::Ended,
                    (Some(Err(error)), _) => break Err(error),
                    (Some(Ok(io)), None) => break Ok(Connection::Plain(io)),
                    (Some(Ok(io)), Some(acceptor)) => {
                        handshakes.spawn(acceptor.accept(io));
                    }
                },
                Some(done) = handshakes.join_next() => match done {
                    Ok(Ok(stream)) => break Ok(Connection::Encrypted(Box::new(stream))),
                    Ok(Err(error)) => tracing::debug!(%error, "a TLS handshake failed"),
                    Err(error) => tracing::debug!(%error, "a TLS handshake ended"),
                },
                else => return None,
            }
        };
        Some((next, (incoming, acceptor, handshakes, incoming_state)))
    })
}

/// State of the stream of incoming connections.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum IncomingState {
    Open,
    Ended,
}

impl<C: Connected> Connected for Connection<C> {
    type ConnectInfo = Peer;

    fn connect_info(&self) -> Peer {
        match self {
            Self::Plain(io) => io.connect_info(),
            Self::Encrypted(stream) => {
                let (io, session) = stream.get_ref();
                let mut peer = io.connect_info();
                peer.certificate = session.peer_certificates().and_then(<[_]>::first).cloned();
                peer
            }
        }
    }
}

impl<C: AsyncRead + AsyncWrite + Unpin> AsyncRead for Connection<C> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        match &mut *self {
            Self::Plain(io) => Pin::new(io).poll_read(cx, buffer),
            Self::Encrypted(stream) => Pin::new(stream).poll_read(cx, buffer),
        }
    }
}

impl<C: AsyncRead + AsyncWrite + Unpin> AsyncWrite for Connection<C> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        match &mut *self {
            Self::Plain(io) => Pin::new(io).poll_write(cx, bytes),
            Self::Encrypted(stream) => Pin::new(stream).poll_write(cx, bytes),
        }
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        match &mut *self {
            Self::Plain(io) => Pin::new(io).poll_write_vectored(cx, bytes),
            Self::Encrypted(stream) => Pin::new(stream).poll_write_vectored(cx, bytes),
        }
    }

    fn is_write_vectored(&self) -> bool {
        match self {
            Self::Plain(io) => io.is_write_vectored(),
            Self::Encrypted(stream) => stream.is_write_vectored(),
        }
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        match &mut *self {
            Self::Plain(io) => Pin::new(io).poll_flush(cx),
            Self::Encrypted(stream) => Pin::new(stream).poll_flush(cx),
        }
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        match &mut *self {
            Self::Plain(io) => Pin::new(io).poll_shutdown(cx),
            Self::Encrypted(stream) => Pin::new(stream).poll_shutdown(cx),
        }
    }
}
