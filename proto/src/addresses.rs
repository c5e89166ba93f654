//! The addresses of a farm's coordinators. One of them leads and answers.
//!
//! A client connects to the first address that accepts a connection. When the connection breaks, the client continues with the
//! address after it, so the failed one is tried last. In this way a client finds the leader again by itself. The price is refused
//! connections at the standby coordinators.

use std::io;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use tokio::net::TcpStream;
use tonic::transport::Uri;

use crate::error::CallError;
use crate::net::{ByteStream, Dialer};

/// One or more addresses, and the one in use.
#[derive(Debug)]
pub(crate) struct Addresses {
    all: Vec<Uri>,
    urls: Vec<String>,
    current: AtomicUsize,
}

impl Addresses {
    /// Connection timeout per address, if there are several.
    const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);

    /// Parses a comma-separated list.
    pub(crate) fn parse(list: &str) -> Result<Self, CallError> {
        let no_address = |message: String| CallError::Address { url: list.into(), message };
        let urls: Vec<String> = list.split(',').map(|url| url.trim().to_owned()).collect();
        let mut all = Vec::new();
        for url in &urls {
            let uri: Uri = url.parse().map_err(|error| no_address(format!("`{url}`: {error}")))?;
            if !matches!(uri.scheme_str(), Some("http" | "https")) || uri.host().is_none() {
                return Err(no_address(format!("`{url}` does not begin with http:// or https://")));
            }
            all.push(uri);
        }
        if all.windows(2).any(|pair| pair[0].scheme() != pair[1].scheme()) {
            return Err(no_address("all addresses must begin with http://, or all with https://".into()));
        }
        // Start with the last, because the address after the one in use is tried first.
        let used = AtomicUsize::new(all.len() - 1);
        Ok(Self { all, urls, current: used })
    }

    pub(crate) fn count(&self) -> usize {
        self.all.len()
    }

    /// Returns the first address, for APIs that need an address in advance.
    pub(crate) fn first(&self) -> Uri {
        self.all[0].clone()
    }

    /// Returns the host and port of the first address.
    pub(crate) fn first_host_port(&self) -> (String, u16) {
        self.host_port(&self.all[0])
    }

    fn host_port(&self, uri: &Uri) -> (String, u16) {
        let host = uri.host().unwrap_or_default().trim_start_matches('[').trim_end_matches(']').to_owned();
        (host, uri.port_u16().unwrap_or(if self.are_encrypted() { 443 } else { 80 }))
    }

    /// Checks that connections are encrypted.
    pub(crate) fn are_encrypted(&self) -> bool {
        self.all[0].scheme_str() == Some("https")
    }

    /// Returns the first URL, as it was given, that is not on this machine.
    pub(crate) fn first_remote_url(&self) -> Option<&str> {
        let is_here = |uri: &Uri| {
            let host = uri.host().unwrap_or_default().trim_start_matches('[').trim_end_matches(']');
            host == "localhost" || host.parse().is_ok_and(|ip: IpAddr| ip.is_loopback())
        };
        self.all.iter().position(|uri| !is_here(uri)).map(|at| &*self.urls[at])
    }

    /// Returns the address in use.
    pub(crate) fn current_url(&self) -> &str {
        &self.urls[self.current.load(Ordering::Relaxed)]
    }

    /// Returns all addresses as they were given.
    pub(crate) fn list(&self) -> String {
        self.urls.join(",")
    }

    /// Connects to the first address that accepts, starting after the address in use.
    pub(crate) async fn connect(self: Arc<Self>, dial: Dialer) -> io::Result<ByteStream> {
        let mut faults = Vec::new();
        let begin = self.current.load(Ordering::Relaxed) + 1;
        for at in (begin..begin + self.count()).map(|at| at % self.count()) {
            let uri = &self.all[at];
            let (host, port) = self.host_port(uri);
            let link = async {
                match &dial.dial_fn {
                    Some(dial) => dial(host, port).await,
                    None => tcp(host, port).await,
                }
            };
            match tokio::time::timeout(Self::CONNECT_TIMEOUT, link).await {
                Ok(Ok(link)) => {
                    self.current.store(at, Ordering::Relaxed);
                    return Ok(link);
                }
                Ok(Err(error)) => faults.push(error.to_string()),
                Err(_) => faults.push("no answer".into()),
            }
        }
        faults.dedup();
        Err(io::Error::other(faults.join("; ")))
    }
}

async fn tcp(host: String, port: u16) -> io::Result<ByteStream> {
    let stream = TcpStream::connect((host, port)).await?;
    stream.set_nodelay(true)?;
    Ok(ByteStream::new(stream))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_is_addresses_with_commas_between() {
        let addresses = Addresses::parse("http://one:7878, http://two:7879").unwrap();
        assert_eq!(addresses.list(), "http://one:7878,http://two:7879");
        assert_eq!(addresses.count(), 2);
        for wrong in [
            "127.0.0.1:7878",
            "farm",
            "http://one,",
            ",",
            "http://one,two:7878",
            "http://one,http://a b",
            "http://one,ftp://two",
            "http://one,https://two",
        ] {
            assert!(matches!(Addresses::parse(wrong), Err(CallError::Address { .. })), "{wrong}");
        }
    }

    #[test]
    fn what_is_not_this_machine_is_known_by_its_address() {
        let beyond = |list: &str| Addresses::parse(list).unwrap().first_remote_url().map(str::to_owned);
        assert_eq!(beyond("http://127.0.0.1:7878,http://[::1]:7878,http://localhost:1,http://127.9.9.9"), None);
        for far in [
            "http://10.0.0.1:7878",
            "http://farm",
            "http://localhost.farm.lan",
            "http://[fe80::1]",
            "http://127.0.0.1.nip.io",
        ] {
            assert_eq!(beyond(&format!("http://localhost,{far}")), Some(far.to_owned()));
        }
    }

    #[tokio::test]
    async fn broken_connection_is_replaced_by_next_accepting_address() {
        let dial = Dialer::from_fn(|host, _| {
            Box::pin(async move {
                match host.as_str() {
                    "down" => Err(io::Error::other("refused")),
                    _ => Ok(ByteStream::new(tokio::io::empty())),
                }
            })
        });
        let addresses = Arc::new(Addresses::parse("http://down,http://one,http://two").unwrap());
        let mut used = Vec::new();
        for _ in 0..3 {
            addresses.clone().connect(dial.clone()).await.unwrap();
            used.push(addresses.current_url().to_owned());
        }
        assert_eq!(used, ["http://one", "http://two", "http://one"]);
        let down = Arc::new(Addresses::parse("http://down,http://down").unwrap());
        assert_eq!(down.connect(dial).await.unwrap_err().to_string(), "refused");
    }
}
