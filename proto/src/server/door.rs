//! Admits connections. It limits their number in total and per address, and closes connections that make no allowed call.
//!
//! A connection that makes no allowed call within [`Limits::introduction`] is closed, whatever else it does: nothing, half a
//! handshake, or HTTP/2 frames that request nothing. After that, the keepalive of HTTP/2 detects dead connections.

use std::any::Any;
use std::collections::BTreeMap;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use femc_trust::{Audit, AuditEvent};
use rustls::pki_types::CertificateDer;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep};
use tonic::transport::server::{Connected, TcpConnectInfo};

use crate::net::Io;
use femc_service::Limits;

/// The client at the other end, as far as its connection identifies it.
#[derive(Debug, Clone)]
pub(super) struct Peer {
    /// Client's address; `None` if the connection is not TCP.
    pub(super) address: Option<SocketAddr>,
    /// Local address of the connection; `None` if the connection is not TCP.
    pub(super) reached: Option<SocketAddr>,
    /// Number of the connection, from 1.
    pub(super) number: u64,
    /// Client certificate from the TLS handshake.
    pub(super) certificate: Option<CertificateDer<'static>>,
    is_introduced: Arc<AtomicBool>,
    is_served: Arc<AtomicBool>,
}

impl Peer {
    /// Records that the client made a call that it may make. Its connection may stay open.
    pub(super) fn introduce(&self) {
        self.is_introduced.store(true, Ordering::Relaxed);
    }

    /// Records that the client got a public resource. Its end does not count as a refusal, but the connection's deadline remains.
    pub(super) fn serve(&self) {
        self.is_served.store(true, Ordering::Relaxed);
    }

    /// Checks that the client has requested something that it may have.
    fn is_heard(&self) -> bool {
        self.is_introduced.load(Ordering::Relaxed) || self.is_served.load(Ordering::Relaxed)
    }
}

/// Counter and gatekeeper of connections. Clones share the count.
#[derive(Debug, Clone)]
pub(super) struct Door {
    limits: Limits,
    audit: Option<Audit>,
    unheard: Unheard,
    inside: Arc<Mutex<Inside>>,
}

/// Treatment of connections that end without an allowed call.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unheard {
    /// They are recorded. With client certificates, a wrong one fails in the handshake, before there is a call to refuse.
    Noted,
    /// They are not recorded.
    Ignored,
}

#[derive(Debug, Default)]
struct Inside {
    all: usize,
    of: BTreeMap<Place, usize>,
    /// Number of connections so far.
    numbers: u64,
    warned: Option<Instant>,
}

/// Origin of a connection: an IPv4 address, or the network part (64 bits) of an IPv6 address.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Place(Option<IpAddr>);

impl Place {
    fn of(address: Option<SocketAddr>) -> Self {
        Self(address.map(|address| match address.ip().to_canonical() {
            IpAddr::V6(ip) => IpAddr::V6((u128::from(ip) >> 64 << 64).into()),
            v4 => v4,
        }))
    }
}

impl Door {
    /// Interval between two warnings.
    const WARNS: Duration = Duration::from_secs(10);

    pub(super) fn new(limits: Limits, audit: Option<Audit>, unheard: Unheard) -> Self {
        Self { limits, audit, unheard, inside: Arc::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Inside> {
        // A panic within the few lines under this lock leaves the state consistent.
        self.inside.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Admits the connection if there is room; otherwise closes it.
    pub(super) fn admit<C: Io + Connected>(&self, io: C) -> Option<Admitted<C>> {
        let info = io.connect_info();
        let tcp = (&info as &dyn Any).downcast_ref::<TcpConnectInfo>();
        let address = tcp.and_then(TcpConnectInfo::remote_addr);
        let reached = tcp.and_then(TcpConnectInfo::local_addr);
        let place = Place::of(address);
        let mut inside = self.lock();
        let of_place = inside.of.get(&place).copied().unwrap_or(0);
        // Connections without an address come from a simulation or from this process.
        let is_full_for_one = address.is_some() && of_place >= self.limits.connections_of_one;
        if is_full_for_one || inside.all >= self.limits.connections {
            self.turn_away(&mut inside, address);
            return None;
        }
        inside.all += 1;
        inside.numbers += 1;
        let number = inside.numbers;
        inside.of.insert(place, of_place + 1);
        let peer = Peer {
            address,
            reached,
            number,
            certificate: None,
            is_introduced: Arc::default(),
            is_served: Arc::default(),
        };
        let deadline = Some(Box::pin(tokio::time::sleep(self.limits.introduction)));
        let idle = Idle::new(self.limits.idle);
        let audit = self.audit.clone().filter(|_| self.unheard == Unheard::Noted);
        Some(Admitted { io, peer, deadline, idle, audit, _seat: Seat { inside: self.inside.clone(), place } })
    }

    fn turn_away(&self, inside: &mut Inside, address: Option<SocketAddr>) {
        if inside.warned.is_none_or(|warned| warned.elapsed() >= Self::WARNS) {
            inside.warned = Some(Instant::now());
            tracing::warn!(?address, all = inside.all, "too many connections; some are refused");
        }
        if let Some(audit) = &self.audit {
            audit.refused(connecting(address, "ResourceExhausted", "too many connections"));
        }
    }
}

fn connecting(address: Option<SocketAddr>, outcome: &str, why: &str) -> AuditEvent {
    AuditEvent {
        who: "unknown".into(),
        from: address.map(|address| address.ip().to_string()),
        call: "connect".into(),
        outcome: outcome.into(),
        why: Some(why.into()),
        ..AuditEvent::default()
    }
}

/// A counted connection.
#[derive(Debug)]
struct Seat {
    inside: Arc<Mutex<Inside>>,
    place: Place,
}

impl Drop for Seat {
    fn drop(&mut self) {
        let mut inside = self.inside.lock().unwrap_or_else(PoisonError::into_inner);
        inside.all -= 1;
        if let Some(count) = inside.of.get_mut(&self.place) {
            *count -= 1;
            if *count == 0 {
                inside.of.remove(&self.place);
            }
        }
    }
}

/// An admitted connection.
#[derive(Debug)]
pub(super) struct Admitted<C> {
    io: C,
    peer: Peer,
    /// Deadline for the first allowed call; `None` after it.
    deadline: Option<Pin<Box<Sleep>>>,
    idle: Idle,
    /// Audit record for a connection that ends without an allowed call.
    audit: Option<Audit>,
    _seat: Seat,
}

/// Idle timeout: closes a connection without traffic.
#[derive(Debug)]
struct Idle {
    limit: Duration,
    passed: Instant,
    /// Time of the next check for traffic.
    look: Pin<Box<Sleep>>,
}

impl Idle {
    fn new(limit: Duration) -> Self {
        Self { limit, passed: Instant::now(), look: Box::pin(tokio::time::sleep(limit)) }
    }

    /// Processes the outcome of a read or write.
    fn note<T>(&mut self, cx: &mut Context<'_>, polled: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if polled.is_ready() {
            self.passed = Instant::now();
            return polled;
        }
        while self.look.as_mut().poll(cx).is_ready() {
            let until = self.passed + self.limit;
            if until <= Instant::now() {
                return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
            }
            self.look.as_mut().reset(until);
        }
        Poll::Pending
    }
}

impl<C> Drop for Admitted<C> {
    fn drop(&mut self) {
        if let Some(audit) = self.audit.take().filter(|_| !self.peer.is_heard()) {
            let why = "the client sent no accepted certificate or made no permitted call";
            audit.refused(connecting(self.peer.address, "Closed", why));
        }
    }
}

impl<C> Connected for Admitted<C> {
    type ConnectInfo = Peer;

    fn connect_info(&self) -> Peer {
        self.peer.clone()
    }
}

impl<C: AsyncRead + Unpin> AsyncRead for Admitted<C> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        if self.deadline.is_some() && self.peer.is_introduced.load(Ordering::Relaxed) {
            self.deadline = None;
        }
        if self.deadline.as_mut().is_some_and(|deadline| deadline.as_mut().poll(cx).is_ready()) {
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        let read = Pin::new(&mut self.io).poll_read(cx, buffer);
        self.idle.note(cx, read)
    }
}

impl<C: AsyncWrite + Unpin> AsyncWrite for Admitted<C> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.io).poll_write(cx, bytes);
        self.idle.note(cx, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.io).poll_write_vectored(cx, bytes);
        self.idle.note(cx, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.io.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

    #[derive(Debug)]
    struct Far(tokio::io::DuplexStream, SocketAddr);

    impl AsyncRead for Far {
        fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
            Pin::new(&mut self.0).poll_read(cx, buffer)
        }
    }

    impl AsyncWrite for Far {
        fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
            Pin::new(&mut self.0).poll_write(cx, bytes)
        }

        fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
            Poll::Ready(Ok(()))
        }

        fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
            Poll::Ready(Ok(()))
        }
    }

    impl Connected for Far {
        type ConnectInfo = TcpConnectInfo;

        fn connect_info(&self) -> TcpConnectInfo {
            TcpConnectInfo { local_addr: None, remote_addr: Some(self.1) }
        }
    }

    fn far(address: &str) -> Far {
        // The other end stays silent forever.
        let (near, other) = tokio::io::duplex(64);
        std::mem::forget(other);
        Far(near, address.parse().unwrap())
    }

    #[tokio::test(start_paused = true)]
    async fn silent_connection_is_closed_and_introduced_one_needs_traffic() {
        let door = Door::new(Limits::default(), None, Unheard::Ignored);
        let mut silent = door.admit(far("10.0.0.1:1")).unwrap();
        let mut guest = door.admit(far("10.0.0.1:2")).unwrap();
        guest.connect_info().introduce();
        let error = silent.read_u8().await.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
        let stays = tokio::time::timeout(Duration::from_secs(45), guest.read_u8()).await;
        assert!(stays.is_err());
        guest.write_u8(1).await.unwrap();
        let stays = tokio::time::timeout(Duration::from_secs(45), guest.read_u8()).await;
        assert!(stays.is_err(), "something has passed");
        let error = guest.read_u8().await.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
    }

    #[tokio::test(start_paused = true)]
    async fn page_reader_is_not_audited_and_times_out_like_silent_one() {
        let folder = tempfile::tempdir().unwrap();
        let audit = Audit::open(&folder.path().join("audit.jsonl")).unwrap();
        let door = Door::new(Limits::default(), Some(audit.clone()), Unheard::Noted);
        let mut reader = door.admit(far("10.0.0.1:1")).unwrap();
        reader.connect_info().serve();
        assert_eq!(reader.read_u8().await.unwrap_err().kind(), io::ErrorKind::TimedOut);
        drop(reader);
        assert!(audit.latest(10).unwrap().is_empty());
        drop(door.admit(far("10.0.0.2:1")).unwrap());
        let lines = audit.latest(10).unwrap();
        assert_eq!((lines.len(), &lines[0]["from"], &lines[0]["outcome"]), (1, &"10.0.0.2".into(), &"Closed".into()));
    }

    #[tokio::test]
    async fn connections_are_limited_per_network_and_in_all_until_closed() {
        let limits = Limits { connections: 5, connections_of_one: 2, ..Limits::default() };
        let door = Door::new(limits, None, Unheard::Ignored);
        let mut inside: Vec<_> =
            ["[2001:db8::1]:1", "[2001:db8::2]:2"].map(|from| door.admit(far(from)).unwrap()).into();
        assert!(door.admit(far("[2001:db8::3]:1")).is_none(), "one network");
        inside.extend(["[2001:db8:0:1::1]:1", "10.0.0.1:1", "10.0.0.1:2"].map(|from| door.admit(far(from)).unwrap()));
        assert!(door.admit(far("10.0.0.2:1")).is_none(), "in all");
        inside.remove(0);
        assert!(door.admit(far("[::ffff:10.0.0.1]:3")).is_none(), "the same address in another form");
        inside.push(door.admit(far("10.0.0.2:1")).unwrap());
        inside.clear();
        let left = door.lock();
        assert_eq!((left.all, left.of.len()), (0, 0));
    }
}
