//! Admits connections. It limits their number in total and per address, and closes connections that make no allowed call.
//!
//! A connection that makes no allowed call within [`Limits::authentication_timeout`] is closed, whatever else it does: nothing,
//! half a handshake, or HTTP/2 frames that request nothing. After that, the keepalive of HTTP/2 detects dead connections.

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
    pub(super) local_address: Option<SocketAddr>,
    /// Number of the connection, from 1.
    pub(super) number: u64,
    /// Client certificate from the TLS handshake.
    pub(super) certificate: Option<CertificateDer<'static>>,
    is_introduced: Arc<AtomicBool>,
    is_served: Arc<AtomicBool>,
}

impl Peer {
    /// Records that the client made a call that it may make. Its connection may stay open.
    pub(super) fn mark_introduced(&self) {
        self.is_introduced.store(true, Ordering::Relaxed);
    }

    /// Records that the client got a public resource. Its end does not count as a refusal, but the connection's deadline remains.
    pub(super) fn mark_served(&self) {
        self.is_served.store(true, Ordering::Relaxed);
    }

    /// Checks that the client has requested something that it may have.
    fn made_allowed_request(&self) -> bool {
        self.is_introduced.load(Ordering::Relaxed) || self.is_served.load(Ordering::Relaxed)
    }
}

/// Counter and gatekeeper of connections. Clones share the count.
#[derive(Debug, Clone)]
pub(super) struct ConnectionLimiter {
    limits: Limits,
    audit: Option<Audit>,
    unused: UnusedConnections,
    counts: Arc<Mutex<ConnectionCounts>>,
}

/// Treatment of connections that end without an allowed call.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum UnusedConnections {
    /// They are recorded. With client certificates, a wrong one fails in the handshake, before there is a call to refuse.
    Audited,
    /// They are not recorded.
    Ignored,
}

#[derive(Debug, Default)]
struct ConnectionCounts {
    total: usize,
    by_origin: BTreeMap<Origin, usize>,
    /// Number of connections so far.
    numbers: u64,
    last_warning: Option<Instant>,
}

/// Origin of a connection: an IPv4 address, or the network part (64 bits) of an IPv6 address.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Origin(Option<IpAddr>);

impl Origin {
    fn from_address(address: Option<SocketAddr>) -> Self {
        Self(address.map(|address| match address.ip().to_canonical() {
            IpAddr::V6(ip) => IpAddr::V6((u128::from(ip) >> 64 << 64).into()),
            v4 => v4,
        }))
    }
}

impl ConnectionLimiter {
    /// Interval between two warnings.
    const WARNING_INTERVAL: Duration = Duration::from_secs(10);

    pub(super) fn new(limits: Limits, audit: Option<Audit>, unused: UnusedConnections) -> Self {
        Self { limits, audit, unused, counts: Arc::default() }
    }

    fn lock(&self) -> MutexGuard<'_, ConnectionCounts> {
        // A panic within the few lines under this lock leaves the state consistent.
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Admits the connection if there is room; otherwise closes it.
    pub(super) fn admit<C: Io + Connected>(&self, io: C) -> Option<AdmittedConnection<C>> {
        let info = io.connect_info();
        let tcp = (&info as &dyn Any).downcast_ref::<TcpConnectInfo>();
        let address = tcp.and_then(TcpConnectInfo::remote_addr);
        let local_address = tcp.and_then(TcpConnectInfo::local_addr);
        let origin = Origin::from_address(address);
        let mut counts = self.lock();
        let of_origin = counts.by_origin.get(&origin).copied().unwrap_or(0);
        // Connections without an address come from a simulation or from this process.
        let is_full_for_one = address.is_some() && of_origin >= self.limits.connections_per_address;
        if is_full_for_one || counts.total >= self.limits.connections {
            self.reject(&mut counts, address);
            return None;
        }
        counts.total += 1;
        counts.numbers += 1;
        let number = counts.numbers;
        counts.by_origin.insert(origin, of_origin + 1);
        let peer = Peer {
            address,
            local_address,
            number,
            certificate: None,
            is_introduced: Arc::default(),
            is_served: Arc::default(),
        };
        let deadline = Some(Box::pin(tokio::time::sleep(self.limits.authentication_timeout)));
        let idle = IdleTimeout::new(self.limits.idle);
        let audit = self.audit.clone().filter(|_| self.unused == UnusedConnections::Audited);
        Some(AdmittedConnection {
            io,
            peer,
            deadline,
            idle,
            audit,
            _slot: ConnectionSlot { counts: self.counts.clone(), origin },
        })
    }

    fn reject(&self, counts: &mut ConnectionCounts, address: Option<SocketAddr>) {
        if counts.last_warning.is_none_or(|warned| warned.elapsed() >= Self::WARNING_INTERVAL) {
            counts.last_warning = Some(Instant::now());
            tracing::warn!(?address, all = counts.total, "too many connections; some are refused");
        }
        if let Some(audit) = &self.audit {
            audit.record_refusal(connect_event(address, "ResourceExhausted", "too many connections"));
        }
    }
}

fn connect_event(address: Option<SocketAddr>, outcome: &str, why: &str) -> AuditEvent {
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
struct ConnectionSlot {
    counts: Arc<Mutex<ConnectionCounts>>,
    origin: Origin,
}

impl Drop for ConnectionSlot {
    fn drop(&mut self) {
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        counts.total -= 1;
        if let Some(count) = counts.by_origin.get_mut(&self.origin) {
            *count -= 1;
            if *count == 0 {
                counts.by_origin.remove(&self.origin);
            }
        }
    }
}

/// An admitted connection.
#[derive(Debug)]
pub(super) struct AdmittedConnection<C> {
    io: C,
    peer: Peer,
    /// Deadline for the first allowed call; `None` after it.
    deadline: Option<Pin<Box<Sleep>>>,
    idle: IdleTimeout,
    /// Audit record for a connection that ends without an allowed call.
    audit: Option<Audit>,
    _slot: ConnectionSlot,
}

/// Idle timeout: closes a connection without traffic.
#[derive(Debug)]
struct IdleTimeout {
    limit: Duration,
    last_traffic: Instant,
    /// Time of the next check for traffic.
    timer: Pin<Box<Sleep>>,
}

impl IdleTimeout {
    fn new(limit: Duration) -> Self {
        Self { limit, last_traffic: Instant::now(), timer: Box::pin(tokio::time::sleep(limit)) }
    }

    /// Processes the outcome of a read or write.
    fn observe<T>(&mut self, cx: &mut Context<'_>, polled: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if polled.is_ready() {
            self.last_traffic = Instant::now();
            return polled;
        }
        while self.timer.as_mut().poll(cx).is_ready() {
            let deadline = self.last_traffic + self.limit;
            if deadline <= Instant::now() {
                return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
            }
            self.timer.as_mut().reset(deadline);
        }
        Poll::Pending
    }
}

impl<C> Drop for AdmittedConnection<C> {
    fn drop(&mut self) {
        if let Some(audit) = self.audit.take().filter(|_| !self.peer.made_allowed_request()) {
            let why = "the client sent no accepted certificate or made no permitted call";
            audit.record_refusal(connect_event(self.peer.address, "Closed", why));
        }
    }
}

impl<C> Connected for AdmittedConnection<C> {
    type ConnectInfo = Peer;

    fn connect_info(&self) -> Peer {
        self.peer.clone()
    }
}

impl<C: AsyncRead + Unpin> AsyncRead for AdmittedConnection<C> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        if self.deadline.is_some() && self.peer.is_introduced.load(Ordering::Relaxed) {
            self.deadline = None;
        }
        if self.deadline.as_mut().is_some_and(|deadline| deadline.as_mut().poll(cx).is_ready()) {
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        let read = Pin::new(&mut self.io).poll_read(cx, buffer);
        self.idle.observe(cx, read)
    }
}

impl<C: AsyncWrite + Unpin> AsyncWrite for AdmittedConnection<C> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.io).poll_write(cx, bytes);
        self.idle.observe(cx, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.io).poll_write_vectored(cx, bytes);
        self.idle.observe(cx, written)
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
    struct TestStream(tokio::io::DuplexStream, SocketAddr);

    impl AsyncRead for TestStream {
        fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
            Pin::new(&mut self.0).poll_read(cx, buffer)
        }
    }

    impl AsyncWrite for TestStream {
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

    impl Connected for TestStream {
        type ConnectInfo = TcpConnectInfo;

        fn connect_info(&self) -> TcpConnectInfo {
            TcpConnectInfo { local_addr: None, remote_addr: Some(self.1) }
        }
    }

    fn stream_from(address: &str) -> TestStream {
        // The other end stays silent forever.
        let (near, other) = tokio::io::duplex(64);
        std::mem::forget(other);
        TestStream(near, address.parse().unwrap())
    }

    #[tokio::test(start_paused = true)]
    async fn silent_connection_is_closed_and_introduced_one_needs_traffic() {
        let limiter = ConnectionLimiter::new(Limits::default(), None, UnusedConnections::Ignored);
        let mut silent = limiter.admit(stream_from("10.0.0.1:1")).unwrap();
        let mut guest = limiter.admit(stream_from("10.0.0.1:2")).unwrap();
        guest.connect_info().mark_introduced();
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
        let limiter = ConnectionLimiter::new(Limits::default(), Some(audit.clone()), UnusedConnections::Audited);
        let mut reader = limiter.admit(stream_from("10.0.0.1:1")).unwrap();
        reader.connect_info().mark_served();
        assert_eq!(reader.read_u8().await.unwrap_err().kind(), io::ErrorKind::TimedOut);
        drop(reader);
        assert!(audit.latest(10).unwrap().is_empty());
        drop(limiter.admit(stream_from("10.0.0.2:1")).unwrap());
        let lines = audit.latest(10).unwrap();
        assert_eq!((lines.len(), &lines[0]["from"], &lines[0]["outcome"]), (1, &"10.0.0.2".into(), &"Closed".into()));
    }

    #[tokio::test]
    async fn connections_are_limited_per_network_and_in_all_until_closed() {
        let limits = Limits { connections: 5, connections_per_address: 2, ..Limits::default() };
        let limiter = ConnectionLimiter::new(limits, None, UnusedConnections::Ignored);
        let mut admitted: Vec<_> =
            ["[2001:db8::1]:1", "[2001:db8::2]:2"].map(|from| limiter.admit(stream_from(from)).unwrap()).into();
        assert!(limiter.admit(stream_from("[2001:db8::3]:1")).is_none(), "one network");
        admitted.extend(
            ["[2001:db8:0:1::1]:1", "10.0.0.1:1", "10.0.0.1:2"].map(|from| limiter.admit(stream_from(from)).unwrap()),
        );
        assert!(limiter.admit(stream_from("10.0.0.2:1")).is_none(), "in all");
        admitted.remove(0);
        assert!(limiter.admit(stream_from("[::ffff:10.0.0.1]:3")).is_none(), "the same address in another form");
        admitted.push(limiter.admit(stream_from("10.0.0.2:1")).unwrap());
        admitted.clear();
        let counts = limiter.lock();
        assert_eq!((counts.total, counts.by_origin.len()), (0, 0));
    }
}
