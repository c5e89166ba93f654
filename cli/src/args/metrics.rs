use clap::Args;
use std::net::SocketAddr;

/// Address of a service's metrics page.
#[derive(Clone, Debug, Args)]
pub struct MetricsArgs {
    /// Serve /metrics (for Prometheus), /healthz and /readyz over HTTP on this port of 127.0.0.1, or on this address and port
    ///
    /// Serve /metrics (for Prometheus), /healthz and /readyz over HTTP on this port of 127.0.0.1, or on this address and port. The
    /// pages are not encrypted, and everybody who can reach them can read them. They contain numbers, but no names of jobs, owners
    /// or workers. Off by default, because several workers on one machine cannot share a default port.
    #[arg(long, value_name = "[ADDRESS:]PORT", value_parser = address)]
    pub metrics: Option<SocketAddr>,
}

fn address(text: &str) -> Result<SocketAddr, String> {
    let port = |text: &str| text.parse::<u16>().map(|port| SocketAddr::from(([127, 0, 0, 1], port))).ok();
    port(text)
        .or_else(|| text.parse().ok())
        .ok_or_else(|| "give a port, like 9464, or an address and a port, like 0.0.0.0:9464".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_alone_is_this_machine_s() {
        assert_eq!(address("9464").map(|it| it.to_string()), Ok("127.0.0.1:9464".to_owned()));
        assert_eq!(address("0.0.0.0:9464").map(|it| it.to_string()), Ok("0.0.0.0:9464".to_owned()));
        assert!(["", "70000", "here:1", "127.0.0.1"].iter().all(|text| address(text).is_err()));
    }
}
