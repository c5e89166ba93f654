//! Connections of the simulated network in the terms of the wire.

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

/// Every server's port.
pub(crate) const PORT: u16 = 7878;

/// Through which the workers reach the coordinator that leads.
pub(crate) const SWITCH: &str = "switch";

/// A refusal takes so long.
const REFUSAL: Duration = Duration::from_millis(10);

/// The address of a host.
pub(crate) fn url(host: &str) -> String {
    format!("http://{host}:{PORT}")
}

/// Who can be reached.
#[derive(Debug, Default)]
pub(crate) struct Reach {
    listening: BTreeSet<String>,
    /// Hosts between which and the switch nothing goes.
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

/// Connects from the host of this name. The simulated network would refuse what leads nowhere, too, but keep two kilobytes of
/// each such attempt for ever: those do not get as far.
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

/// A connection that breaks when nothing has come for long: the simulated network sends nothing again, so the end of one whose
/// last word was lost would never be heard.
#[derive(Debug)]
struct Wire {
    stream: TcpStream,
    silence: Pin<Box<Sleep>>,
}

impl Wire {
    /// Longer than anybody who is there is silent.
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

/// Listens on the current host, which has this name; the connections end when this is dropped. Waits for the port: what held
/// it before may still be on its way out.
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

/// Whether the server is there, and those who wait for its end, by number: woken in that order, always the same.
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

/// A server's end of a connection: nothing more comes when the server is gone.
#[derive(Debug)]
struct Accepted {
    stream: Wire,
    number: u64,
    life: Arc<Mutex<Life>>,
}

impl Drop for Accepted {
    /// A waker keeps the memory of its task, also of one that has ended.
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
