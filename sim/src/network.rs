//! Connections of the simulated network, for the wire protocol.

use std::collections::{BTreeMap, BTreeSet};
use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use femc_proto::{ByteStream, Dialer};
use futures_util::stream::{self, Stream};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep};
use turmoil::net::{TcpListener, TcpStream};

use crate::shared::Shared;

/// Port of every server.
pub(crate) const PORT: u16 = 7878;

/// Host through which workers reach the leading coordinator.
pub(crate) const SWITCH: &str = "switch";

/// Duration of a refused connection attempt.
const REFUSAL_DELAY: Duration = Duration::from_millis(10);

/// Returns the address of a host.
pub(crate) fn url(host: &str) -> String {
    format!("http://{host}:{PORT}")
}

/// Reachable hosts.
#[derive(Debug, Default)]
pub(crate) struct Reachability {
    listening: BTreeSet<String>,
    /// Hosts that are disconnected from the switch.
    disconnected: BTreeSet<String>,
}

impl Reachability {
    pub(crate) fn disconnect(&mut self, host: String) {
        self.disconnected.insert(host);
    }

    pub(crate) fn reconnect(&mut self, host: &str) {
        self.disconnected.remove(host);
    }

    fn allows(&self, from: &str, to: &str) -> bool {
        let is_cut =
            (from == SWITCH && self.disconnected.contains(to)) || (to == SWITCH && self.disconnected.contains(from));
        self.listening.contains(to) && !is_cut
    }
}

/// Returns a connector of the host of this name. Connection attempts to unreachable hosts are refused here. The simulated network
/// would refuse them, too, but it would keep two kilobytes of each attempt forever.
pub(crate) fn dialer(shared: &Shared, from: &str) -> Dialer {
    let (shared, from) = (shared.clone(), from.to_owned());
    Dialer::from_fn(move |to, port| {
        let (shared, from) = (shared.clone(), from.clone());
        Box::pin(async move {
            if !shared.lock().reachability.allows(&from, &to) {
                tokio::time::sleep(REFUSAL_DELAY).await;
                return Err(io::ErrorKind::ConnectionRefused.into());
            }
            Ok(ByteStream::new(TimedStream::new(TcpStream::connect((to.as_str(), port)).await?)))
        })
    })
}

/// A connection that breaks after a long silence. The simulated network does not retransmit, so the end of a connection whose last
/// message was lost would never be noticed.
#[derive(Debug)]
struct TimedStream {
    stream: TcpStream,
    timer: Pin<Box<Sleep>>,
}

impl TimedStream {
    /// Longer than any live host is silent.
    const MAX_SILENCE: Duration = Duration::from_secs(60);

    fn new(stream: TcpStream) -> Self {
        Self { stream, timer: Box::pin(tokio::time::sleep(Self::MAX_SILENCE)) }
    }
}

impl AsyncRead for TimedStream {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let read = Pin::new(&mut self.stream).poll_read(cx, buffer);
        if read.is_ready() {
            self.timer.as_mut().reset(Instant::now() + Self::MAX_SILENCE);
        } else if self.timer.as_mut().poll(cx).is_ready() {
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        read
    }
}

impl AsyncWrite for TimedStream {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}

/// Listens on the current host, which has this name. Dropping the stream ends its connections. Waits until the port is free: its
/// previous owner may still be closing.
pub(crate) async fn listen(shared: &Shared, host: &str) -> impl Stream<Item = io::Result<ByteStream>> + Send + 'static {
    let listener = loop {
        match TcpListener::bind(("0.0.0.0", PORT)).await {
            Ok(listener) => break listener,
            Err(_) => tokio::time::sleep(Duration::from_millis(20)).await,
        }
    };
    shared.lock().reachability.listening.insert(host.to_owned());
    let server = Server { state: Arc::default(), shared: shared.clone(), host: host.to_owned() };
    stream::unfold((listener, server, 0), |(listener, server, number)| async move {
        let link = listener.accept().await.map(|(stream, _)| {
            ByteStream::new(ServerStream { stream: TimedStream::new(stream), number, state: server.state.clone() })
        });
        Some((link, (listener, server, number + 1)))
    })
}

/// State of a server, with the wakers that wait for its end, by number. They are woken in that order, so runs are reproducible.
#[derive(Debug, Default)]
struct ServerState {
    is_over: bool,
    wakers: BTreeMap<u64, Waker>,
}

#[derive(Debug)]
struct Server {
    state: Arc<Mutex<ServerState>>,
    shared: Shared,
    host: String,
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.lock().reachability.listening.remove(&self.host);
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.is_over = true;
        std::mem::take(&mut state.wakers).into_values().for_each(Waker::wake);
    }
}

/// The server's end of a connection. Reading fails after the server has ended.
#[derive(Debug)]
struct ServerStream {
    stream: TimedStream,
    number: u64,
    state: Arc<Mutex<ServerState>>,
}

impl Drop for ServerStream {
    /// Removes the waker: it would keep the memory of its task, even after the task has ended.
    fn drop(&mut self) {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).wakers.remove(&self.number);
    }
}

impl AsyncRead for ServerStream {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let number = self.number;
        {
            let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            if state.is_over {
                return Poll::Ready(Err(io::ErrorKind::ConnectionAborted.into()));
            }
            state.wakers.insert(number, cx.waker().clone());
        }
        Pin::new(&mut self.stream).poll_read(cx, buffer)
    }
}

impl AsyncWrite for ServerStream {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}
