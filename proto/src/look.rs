//! Probes an address that does not answer like a coordinator, so that the error says what is wrong.

use std::time::Duration;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::addresses::Addresses;

/// Result of a probe.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Found {
    /// The connection fails: it is refused or times out, or the address does not exist.
    Nobody {
        /// Error of the operating system.
        message: String,
    },
    /// A server that speaks unencrypted HTTP/2, like a coordinator without an identity.
    Open,
    /// A server that speaks TLS, like a coordinator with an identity.
    Encrypted,
    /// A server that accepts connections but sends nothing: a stopped process, or a forwarder without a target.
    Silent,
    /// A server of another protocol.
    Other,
}

/// Timeout for accepting the connection, and for the first bytes.
const PATIENCE: Duration = Duration::from_secs(2);

/// First bytes of an HTTP/2 client: the preface and empty settings.
const GREETING: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";

/// Probes `url`, one address, over TCP: sends the first bytes of HTTP/2 and reads the first bytes of the answer.
pub async fn look(url: &str) -> Found {
    let nobody = |message: String| Found::Nobody { message };
    let Ok(addresses) = Addresses::parse(url) else { return nobody("invalid address".into()) };
    let connecting = tokio::time::timeout(PATIENCE, TcpStream::connect(addresses.first_place()));
    let mut stream = match connecting.await {
        Ok(Ok(stream)) => stream,
        Ok(Err(error)) => return nobody(error.to_string()),
        Err(_) => return nobody("no answer".into()),
    };
    let mut answer = Vec::new();
    let talk = async {
        stream.write_all(GREETING).await?;
        while answer.len() < 4 && stream.read_buf(&mut answer).await? > 0 {}
        std::io::Result::Ok(())
    };
    // After a timeout or an error, the bytes received so far still count.
    let _ = tokio::time::timeout(PATIENCE, talk).await;
    match answer[..] {
        // A TLS record: an alert or part of a handshake.
        [0x15 | 0x16, 3, ..] => Found::Encrypted,
        // A SETTINGS frame.
        [_, _, _, 4, ..] => Found::Open,
        [] => Found::Silent,
        _ => Found::Other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::net::TcpListener;

    /// Starts a server that answers everything with these bytes.
    async fn says(bytes: &'static [u8]) -> String {
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
            (&b"\0\0\x06\x04\0\0\0\0\0"[..], Found::Open),
            (b"\x15\x03\x03\0\x02\x02\x32", Found::Encrypted),
            (b"HTTP/1.1 400 Bad Request\r\n\r\n", Found::Other),
            (b"", Found::Silent),
        ] {
            assert_eq!(look(&says(bytes).await).await, found);
        }
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        assert_eq!(look(&url).await, Found::Silent, "the system takes connections for who is stopped");
        drop(listener);
        assert!(matches!(look(&url).await, Found::Nobody { .. }));
    }
}
