//! Resource limits of a server.

use std::time::Duration;

/// Limits per peer, and for all peers together. Beyond a limit the server answers with a clear refusal, or closes the connection if
/// the peer is not authenticated yet. No limit can be exceeded at the cost of unbounded memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Maximum size in bytes of a message of the services `Jobs` and `Workers`: 8 MiB. For `Artifacts` the limit is two pieces.
    pub message: usize,
    /// Maximum size in bytes of a call's headers: 16 KiB.
    pub headers: u32,
    /// Maximum number of connections in total: 4096.
    pub connections: usize,
    /// Maximum number of connections from one address, or from one IPv6 network of 64 bits: 512.
    pub connections_per_address: usize,
    /// Time from the connection to the first permitted call, including all handshakes: 10 s.
    pub authentication_timeout: Duration,
    /// Silence after which a peer is asked for a keep-alive: 10 s.
    pub keep_alive_interval: Duration,
    /// Time limit for the answer to a keep-alive request: 10 s.
    pub keep_alive_timeout: Duration,
    /// Time after which a connection without traffic is closed: 60 s. HTTP/2 has keep-alives; HTTP/1, and clients that do not read,
    /// have none.
    pub idle: Duration,
    /// Maximum number of open calls on one connection: 256.
    pub streams: u32,
    /// Maximum number of calls that a connection may start and reset before they are processed: 32. Beyond it, the connection is
    /// closed.
    pub resets: usize,
    /// Time in which a request must be complete, and an upload must make progress: 30 s.
    pub request_timeout: Duration,
    /// Flow-control window of a call in bytes: 4 MiB may be in flight before the call reads them.
    pub stream_window: u32,
    /// Flow-control window of a connection in bytes: 16 MiB.
    pub connection_window: u32,
    /// Average calls per second of one caller: 10 000. Faster calls are delayed by up to a second, and refused beyond that.
    pub rate: u32,
    /// Number of calls that one caller may make at once: 10 000.
    pub burst: u32,
    /// Maximum number of concurrent uploads and downloads: 128. Each may use 8 MiB of memory. Others wait.
    pub transfers: usize,
    /// Maximum number of concurrent transfers of one caller: 48.
    pub transfers_per_caller: usize,
    /// Maximum number of concurrent transfers on one connection: 16. A stalled machine blocks only these until its connection is
    /// closed, and does not block the other machines of its owner.
    pub transfers_per_connection: usize,
}

impl Limits {
    /// Default of [`Self::message`]: the maximum size in bytes of a message of the services `Jobs` and `Workers`.
    pub const MESSAGE: usize = 8 << 20;
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            message: Self::MESSAGE,
            headers: 16 << 10,
            connections: 4096,
            connections_per_address: 512,
            authentication_timeout: Duration::from_secs(10),
            keep_alive_interval: Duration::from_secs(10),
            keep_alive_timeout: Duration::from_secs(10),
            idle: Duration::from_secs(60),
            streams: 256,
            resets: 32,
            request_timeout: Duration::from_secs(30),
            stream_window: 4 << 20,
            connection_window: 16 << 20,
            rate: 10_000,
            burst: 10_000,
            transfers: 128,
            transfers_per_caller: 48,
            transfers_per_connection: 16,
        }
    }
}
