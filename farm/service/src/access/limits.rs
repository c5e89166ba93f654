//! What a server lets its peers have.

use std::time::Duration;

/// How much one peer, and all of them, may have at a time. Beyond each there is a clear refusal, or a closed connection where
/// nobody has been introduced yet; none costs memory without bound.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Most bytes of a message of the services `Jobs` and `Workers`: 8 MiB. Of `Artifacts` it is two pieces.
    pub message: usize,
    /// Most bytes of a call's headers: 16 KiB.
    pub headers: u32,
    /// Connections in all: 4096.
    pub connections: usize,
    /// Connections of one address, or of one IPv6 network of 64 bits: 512.
    pub connections_of_one: usize,
    /// From connecting to the first call that is allowed, with all handshakes: 10 s.
    pub introduction: Duration,
    /// Who is silent for so long is asked for a sign of life: 10 s.
    pub silence: Duration,
    /// And has so long for the answer: 10 s.
    pub answer: Duration,
    /// A connection on which nothing passes for so long is closed: 60 s. HTTP/2 has signs of life, HTTP/1 and who does not read have none.
    pub idle: Duration,
    /// Calls that are open on one connection: 256.
    pub streams: u32,
    /// Calls that a connection may begin and take back before they have been looked at: 32; then it is closed.
    pub resets: usize,
    /// A request must be whole within this time, and an upload must get on: 30 s.
    pub patience: Duration,
    /// Bytes of a call that may be on their way before it reads them: 4 MiB.
    pub stream_window: u32,
    /// The same of a connection: 16 MiB.
    pub connection_window: u32,
    /// Calls a second of one caller, on average: 10 000. What comes faster waits its turn, up to a second, and is refused beyond.
    pub rate: u32,
    /// Calls that one caller may make at once: 10 000.
    pub burst: u32,
    /// Uploads and downloads at a time, each of which may have 8 MiB in memory: 128. Others wait.
    pub transfers: usize,
    /// Of one caller: 48.
    pub transfers_of_caller: usize,
    /// On one connection: 16. A machine that stops holds up these until its connection is given up, and no other of its owner's.
    pub transfers_of_connection: usize,
}

impl Limits {
    /// Most bytes of a message of the services `Jobs` and `Workers`, by default.
    pub const MESSAGE: usize = 8 << 20;
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            message: Self::MESSAGE,
            headers: 16 << 10,
            connections: 4096,
            connections_of_one: 512,
            introduction: Duration::from_secs(10),
            silence: Duration::from_secs(10),
            answer: Duration::from_secs(10),
            idle: Duration::from_secs(60),
            streams: 256,
            resets: 32,
            patience: Duration::from_secs(30),
            stream_window: 4 << 20,
            connection_window: 16 << 20,
            rate: 10_000,
            burst: 10_000,
            transfers: 128,
            transfers_of_caller: 48,
            transfers_of_connection: 16,
        }
    }
}
