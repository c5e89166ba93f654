use clap::Args;
use std::net::SocketAddr;

/// Where a service shows how it is.
#[derive(Clone, Debug, Args)]
pub struct MetricsArgs {
    /// Show /metrics (for Prometheus), /healthz and /readyz over HTTP on this port of this machine; with an address, there
    ///
    /// Show /metrics (for Prometheus), /healthz and /readyz over HTTP on this port of this machine; with an address, there. Not
    /// encrypted, and open to whoever reaches it: it tells numbers, no names of jobs, owners or workers. Off without this:
    /// several workers of one machine could not share a port that nobody chose.
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
