//! A client for attacks, which only does what the test asks for.

use std::net::{Ipv4Addr, SocketAddr};
use std::time::Duration;

use bytes::Bytes;
use h2::SendStream;
use h2::client::{ResponseFuture, SendRequest};
use tokio::io::AsyncReadExt as _;
use tokio::net::{TcpSocket, TcpStream};

/// Timeout that is longer than every timeout of the coordinator.
pub const CLOSE_TIMEOUT: Duration = Duration::from_secs(60);

/// Connects from an attacker's address.
pub async fn connect_from(from: Ipv4Addr, address: &str) -> std::io::Result<TcpStream> {
    let socket = TcpSocket::new_v4()?;
    socket.set_reuseaddr(true)?;
    socket.bind(SocketAddr::from((from, 0)))?;
    socket.connect(address.parse().expect("an address")).await
}

/// Connects from 127.0.0.2.
pub async fn connect(address: &str) -> TcpStream {
    connect_from(Ipv4Addr::new(127, 0, 0, 2), address).await.expect("a connection")
}

/// Waits until the other side closes, and ignores data before that.
pub async fn wait_until_closed(stream: &mut TcpStream) {
    let mut bytes = [0; 1 << 12];
    let end = async { while stream.read(&mut bytes).await.is_ok_and(|count| count > 0) {} };
    tokio::time::timeout(CLOSE_TIMEOUT, end).await.expect("the connection is closed");
}

/// An HTTP/2 connection whose frames are handled until this value is dropped.
pub struct Peer {
    pub calls: SendRequest<Bytes>,
    connection: tokio::task::JoinHandle<()>,
}

impl Peer {
    pub async fn connect(address: &str) -> Self {
        Self::from_stream(connect(address).await).await
    }

    pub async fn from_stream(stream: TcpStream) -> Self {
        let (calls, connection) = h2::client::Builder::new().handshake(stream).await.expect("HTTP/2");
        let connection = tokio::spawn(async move {
            // The attack itself checks how the connection ends.
            let _ = connection.await;
        });
        Self { calls, connection }
    }

    /// Stops answering, as if the machine had stopped.
    pub fn stop(&self) {
        self.connection.abort();
    }

    /// Begins a call.
    pub async fn begin(&mut self, call: &str) -> Result<(ResponseFuture, SendStream<Bytes>), h2::Error> {
        let request = http::Request::post(format!("http://farm/femc.v1.{call}"))
            .header("content-type", "application/grpc")
            .header("te", "trailers")
            .body(())
            .expect("a request");
        std::future::poll_fn(|context| self.calls.poll_ready(context)).await?;
        self.calls.send_request(request, false)
    }

    /// Makes a whole call with these bytes. Returns how it ended.
    pub async fn call(&mut self, call: &str, body: Bytes) -> String {
        let (response, mut send) = match self.begin(call).await {
            Ok(begun) => begun,
            Err(error) => return format!("closed: {error}"),
        };
        // The call may be refused before all bytes are sent.
        let _ = send.send_data(body, true);
        outcome(response).await
    }
}

/// Returns a message with its prefix of five bytes.
pub fn message(body: &[u8]) -> Bytes {
    announced(body.len() as u32, body)
}

/// Returns a message whose prefix announces any given length.
pub fn announced(length: u32, body: &[u8]) -> Bytes {
    [&[0], &length.to_be_bytes()[..], body].concat().into()
}

/// Returns gRPC's code and message, or how the stream was closed.
pub async fn outcome(response: ResponseFuture) -> String {
    let answer = tokio::time::timeout(CLOSE_TIMEOUT, response).await.expect("an answer");
    let response = match answer {
        Ok(response) => response,
        Err(error) => return format!("closed: {error}"),
    };
    let text = |map: &http::HeaderMap, name: &str| {
        map.get(name).map(|value| String::from_utf8_lossy(value.as_bytes()).replace("%20", " "))
    };
    let status_line = |map: &http::HeaderMap| {
        Some(format!("status {}: {}", text(map, "grpc-status")?, text(map, "grpc-message").unwrap_or_default()))
    };
    if let Some(status) = status_line(response.headers()) {
        return status;
    }
    let status = response.status();
    let mut body = response.into_body();
    while let Some(Ok(piece)) = body.data().await {
        let _ = body.flow_control().release_capacity(piece.len());
    }
    let trailers = body.trailers().await.ok().flatten().unwrap_or_default();
    status_line(&trailers).unwrap_or_else(|| format!("HTTP {status}"))
}
