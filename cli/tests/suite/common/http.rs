//! HTTP requests to services.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::Duration;

use femc_metrics::testing::Samples;

/// Returns a port that was free a moment ago.
pub fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    listener.local_addr().expect("its address").port()
}

/// Returns status and body; `None`: there is no answer.
pub fn get(port: u16, path: &str) -> Option<(u16, String)> {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).ok()?;
    stream.set_read_timeout(Some(Duration::from_secs(20))).ok()?;
    write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").ok()?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).ok()?;
    let (head, body) = answer.split_once("\r\n\r\n")?;
    Some((head.split_whitespace().nth(1)?.parse().ok()?, body.to_owned()))
}

/// Returns the metrics page, parsed strictly.
#[track_caller]
pub fn metrics(port: u16) -> Samples {
    let (status, page) = get(port, "/metrics").expect("an answer");
    assert_eq!(status, 200);
    Samples::parse(&page).unwrap_or_else(|fault| panic!("{fault}\n{page}"))
}

/// An HTTP answer.
pub struct Answer {
    pub status: u16,
    /// Header lines, with names in lower case.
    pub head: Vec<(String, String)>,
    pub body: Vec<u8>,
}

impl Answer {
    /// Returns the value of a header; empty: there is none.
    pub fn header(&self, name: &str) -> &str {
        self.head.iter().find(|(known, _)| known == name).map_or("", |(_, value)| value)
    }

    #[track_caller]
    pub fn json(&self) -> serde_json::Value {
        let text = String::from_utf8_lossy(&self.body);
        serde_json::from_slice(&self.body).unwrap_or_else(|error| panic!("{}: {error}: {text}", self.status))
    }

    /// Returns the error code of a refusal.
    #[track_caller]
    pub fn code(&self) -> String {
        self.json()["error"]["code"].as_str().expect("a code").to_owned()
    }
}

/// Sends raw request bytes, which must ask for the end of the connection, and reads the answer.
pub fn send(address: &str, request: &[u8]) -> Answer {
    let mut stream = TcpStream::connect(address).expect("a connection");
    stream.set_read_timeout(Some(Duration::from_secs(40))).expect("a timeout");
    // The request may be refused before all bytes are sent.
    let _ = stream.write_all(request);
    let mut bytes = Vec::new();
    let mut piece = [0; 1 << 14];
    while let Ok(count @ 1..) = stream.read(&mut piece) {
        bytes.extend(&piece[..count]);
    }
    let end = bytes.windows(4).position(|four| four == b"\r\n\r\n").expect("a head");
    let text = String::from_utf8_lossy(&bytes[..end]).into_owned();
    let mut lines = text.lines();
    let status = lines.next().and_then(|line| line.split_whitespace().nth(1)?.parse().ok()).expect("a status");
    let head = lines.filter_map(|line| line.split_once(": ")).map(|(a, b)| (a.to_ascii_lowercase(), b.to_owned()));
    Answer { status, head: head.collect(), body: bytes[end + 4..].to_vec() }
}

/// Sends a request with this first line, these header lines and this body.
pub fn send_request(address: &str, line: &str, head: &[&str], body: &str) -> Answer {
    let host =
        if head.iter().any(|line| line.starts_with("Host:")) { String::new() } else { format!("Host: {address}\r\n") };
    let lines: String = head.iter().map(|line| format!("{line}\r\n")).collect();
    let length = body.len();
    let request =
        format!("{line} HTTP/1.1\r\n{host}{lines}Content-Length: {length}\r\nConnection: close\r\n\r\n{body}");
    send(address, request.as_bytes())
}

/// Headers of a request that changes something.
pub const CHANGE: [&str; 2] = ["Content-Type: application/json", "X-Femc: 1"];

/// Parses a half float that is finite and not subnormal, or 0.
pub fn half_float(bytes: [u8; 2]) -> f32 {
    let bits = u16::from_le_bytes(bytes);
    let (sign, exponent, mantissa) = (bits >> 15, i32::from(bits >> 10 & 31), f32::from(bits & 1023));
    let size = if exponent == 0 {
        mantissa / 1024.0 * 2f32.powi(-14)
    } else {
        (1.0 + mantissa / 1024.0) * 2f32.powi(exponent - 15)
    };
    if sign == 1 { -size } else { size }
}
