//! What is at an address that does not answer as a coordinator does: so that people hear what is wrong, and not only that something is.

use std::time::Duration;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::addresses::Addresses;

/// What was found at an address.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Found {
    /// Nobody takes connections there, or there is no such place.
    Nobody {
        /// Error of the operating system.
        message: String,
    },
    /// Somebody who speaks HTTP/2 in the open, as a coordinator without an identity does.
    Open,
    /// Somebody who speaks TLS, as a coordinator with an identity does.
    Encrypted,
    /// Somebody who takes connections and says nothing: it is stopped, or passes on what nobody takes at its other end.
    Silent,
    /// Somebody who speaks otherwise.
    Other,
}

/// How long somebody may take to take the connection, and to say something.
const PATIENCE: Duration = Duration::from_secs(2);

/// What a client of HTTP/2 says first: the preface and its settings, none.
const GREETING: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";

/// Looks who is at `url`: one address, over TCP. Sends the first words of HTTP/2 and reads the first of the answer.
pub async fn look(url: &str) -> Found {
    let nobody = |message: String| Found::Nobody { message };
    let Ok(addresses) = Addresses::parse(url) else { return nobody("it is no address".into()) };
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
    // Who says nothing, or breaks off, has still said what he has said.
    let _ = tokio::time::timeout(PATIENCE, talk).await;
    match answer[..] {
        // A record of TLS, an alert or part of a handshake.
        [0x15 | 0x16, 3, ..] => Found::Encrypted,
        // A frame of settings.
        [_, _, _, 4, ..] => Found::Open,
        [] => Found::Silent,
        _ => Found::Other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::net::TcpListener;

    /// Somebody who answers everything with these bytes.
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
