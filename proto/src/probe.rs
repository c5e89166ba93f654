//! Probes an address that does not answer like a coordinator, so that the error says what is wrong.

use std::time::Duration;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::addresses::Addresses;

/// Result of a probe.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ProbeResult {
    /// The connection fails: it is refused or times out, or the address does not exist.
    Unreachable {
        /// Error of the operating system.
        message: String,
    },
    /// A server that speaks unencrypted HTTP/2, like a coordinator without an identity.
    PlainHttp2,
    /// A server that speaks TLS, like a coordinator with an identity.
    Tls,
    /// A server that accepts connections but sends nothing: a stopped process, or a forwarder without a target.
    Silent,
    /// A server of another protocol.
    OtherProtocol,
}

/// Timeout for accepting the connection, and for the first bytes.
const TIMEOUT: Duration = Duration::from_secs(2);

/// First bytes of an HTTP/2 client: the preface and empty settings.
const HTTP2_PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";

/// Probes `url`, one address, over TCP: sends the first bytes of HTTP/2 and reads the first bytes of the answer.
pub async fn probe_address(url: &str) -> ProbeResult {
    let unreachable = |message: String| ProbeResult::Unreachable { message };
    let Ok(addresses) = Addresses::parse(url) else { return unreachable("invalid address".into()) };
    let connecting = tokio::time::timeout(TIMEOUT, TcpStream::connect(addresses.first_host_port()));
    let mut stream = match connecting.await {
        Ok(Ok(stream)) => stream,
        Ok(Err(error)) => return unreachable(error.to_string()),
        Err(_) => return unreachable("no answer".into()),
    };
    let mut answer = Vec::new();
    let talk = async {
        stream.write_all(HTTP2_PREFACE).await?;
        while answer.len() < 4 && stream.read_buf(&mut answer).await? > 0 {}
        std::io::Result::Ok(())
    };
    // After a timeout or an error, the bytes received so far still count.
    let _ = tokio::time::timeout(TIMEOUT, talk).await;
    match answer[..] {
        // A TLS record: an alert or part of a handshake.
        [0x15 | 0x16, 3, ..] => ProbeResult::Tls,
        // A SETTINGS frame.
        [_, _, _, 4, ..] => ProbeResult::PlainHttp2,
        [] => ProbeResult::Silent,
        _ => ProbeResult::OtherProtocol,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::net::TcpListener;

    /// Starts a server that answers everything with these bytes.
    async fn serve_bytes(bytes: &'static [u8]) -> String {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        tokio::spawn(async move {
            let (mut stream, _) = listener.accept().await.unwrap();
            let _ = stream.read(&mut [0; 64]).await;
            stream.write_all(bytes).await.unwrap();
        });
        url
    }

    #[tokio::test]
    async fn whoever_is_there_is_known_by_the_first_words() {
        for (bytes, found) in [
            (&b"\0\0\x06\x04\0\0\0\0\0"[..], ProbeResult::PlainHttp2),
            (b"\x15\x03\x03\0\x02\x02\x32", ProbeResult::Tls),
            (b"HTTP/1.1 400 Bad Request\r\n\r\n", ProbeResult::OtherProtocol),
            (b"", ProbeResult::Silent),
        ] {
            assert_eq!(probe_address(&serve_bytes(bytes).await).await, found);
        }
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        assert_eq!(probe_address(&url).await, ProbeResult::Silent, "the system takes connections for who is stopped");
        drop(listener);
        assert!(matches!(probe_address(&url).await, ProbeResult::Unreachable { .. }));
    }
}
