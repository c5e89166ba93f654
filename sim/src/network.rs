//! Connections of the simulated network, for the wire protocol.

use std::collections::{BTreeMap, BTreeSet};
use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use femc_proto::{Dial, Link};
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
const REFUSAL: Duration = Duration::from_millis(10);

/// Returns the address of a host.
pub(crate) fn url(host: &str) -> String {
    format!("http://{host}:{PORT}")
}

/// Reachable hosts.
#[derive(Debug, Default)]
pub(crate) struct Reach {
    listening: BTreeSet<String>,
    /// Hosts that are disconnected from the switch.
    cut: BTreeSet<String>,
}

impl Reach {
    pub(crate) fn cut(&mut self, host: String) {
        self.cut.insert(host);
    }

    pub(crate) fn mend(&mut self, host: &str) {
        self.cut.remove(host);
    }

    fn allows(&self, from: &str, to: &str) -> bool {
        let is_cut = (from == SWITCH && self.cut.contains(to)) || (to == SWITCH && self.cut.contains(from));
        self.listening.contains(to) && !is_cut
    }
}

/// Returns a connector of the host of this name. Connection attempts to unreachable hosts are refused here. The simulated network
/// would refuse them, too, but it would keep two kilobytes of each attempt forever.
pub(crate) fn dial(shared: &Shared, from: &str) -> Dial {
    let (shared, from) = (shared.clone(), from.to_owned());
    Dial::by(move |to, port| {
        let (shared, from) = (shared.clone(), from.clone());
        Box::pin(async move {
            if !shared.lock().reach.allows(&from, &to) {
                tokio::time::sleep(REFUSAL).await;
                return Err(io::ErrorKind::ConnectionRefused.into());
            }
            Ok(Link::new(Wire::of(TcpStream::connect((to.as_str(), port)).await?)))
        })
    })
}

/// A connection that breaks after a long silence. The simulated network does not retransmit, so the end of a connection whose last
/// message was lost would never be noticed.
#[derive(Debug)]
struct Wire {
    stream: TcpStream,
    silence: Pin<Box<Sleep>>,
}

impl Wire {
    /// Longer than any live host is silent.
    const SILENCE: Duration = Duration::from_secs(60);

    fn of(stream: TcpStream) -> Self {
        Self { stream, silence: Box::pin(tokio::time::sleep(Self::SILENCE)) }
    }
}

impl AsyncRead for Wire {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let read = Pin::new(&mut self.stream).poll_read(cx, buffer);
        if read.is_ready() {
            self.silence.as_mut().reset(Instant::now() + Self::SILENCE);
        } else if self.silence.as_mut().poll(cx).is_ready() {
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        read
    }
}

impl AsyncWrite for Wire {
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
pub(crate) async fn listen(shared: &Shared, host: &str) -> impl Stream<Item = io::Result<Link>> + Send + 'static {
    let listener = loop {
        match TcpListener::bind(("0.0.0.0", PORT)).await {
            Ok(listener) => break listener,
            Err(_) => tokio::time::sleep(Duration::from_millis(20)).await,
        }
    };
    shared.lock().reach.listening.insert(host.to_owned());
    let server = Server { life: Arc::default(), shared: shared.clone(), host: host.to_owned() };
    stream::unfold((listener, server, 0), |(listener, server, number)| async move {
        let link = listener
            .accept()
            .await
            .map(|(stream, _)| Link::new(Accepted { stream: Wire::of(stream), number, life: server.life.clone() }));
        Some((link, (listener, server, number + 1)))
    })
}

/// State of a server, with the wakers that wait for its end, by number. They are woken in that order, so runs are reproducible.
#[derive(Debug, Default)]
struct Life {
    is_over: bool,
    wakers: BTreeMap<u64, Waker>,
}

#[derive(Debug)]
struct Server {
    life: Arc<Mutex<Life>>,
    shared: Shared,
    host: String,
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.lock().reach.listening.remove(&self.host);
        let mut life = self.life.lock().unwrap_or_else(PoisonError::into_inner);
        life.is_over = true;
        std::mem::take(&mut life.wakers).into_values().for_each(Waker::wake);
    }
}

/// The server's end of a connection. Reading fails after the server has ended.
#[derive(Debug)]
struct Accepted {
    stream: Wire,
    number: u64,
    life: Arc<Mutex<Life>>,
}

impl Drop for Accepted {
    /// Removes the waker: it would keep the memory of its task, even after the task has ended.
    fn drop(&mut self) {
        self.life.lock().unwrap_or_else(PoisonError::into_inner).wakers.remove(&self.number);
    }
}

impl AsyncRead for Accepted {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let number = self.number;
        {
            let mut life = self.life.lock().unwrap_or_else(PoisonError::into_inner);
            if life.is_over {
                return Poll::Ready(Err(io::ErrorKind::ConnectionAborted.into()));
            }
            life.wakers.insert(number, cx.waker().clone());
        }
        Pin::new(&mut self.stream).poll_read(cx, buffer)
    }
}

impl AsyncWrite for Accepted {
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
