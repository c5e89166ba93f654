//! Metrics page of a service.

use crate::exit::{Failure, failed};
use crate::output::Say;
use femc_metrics::{Report, serve};
use std::net::SocketAddr;
use tokio::net::TcpListener;

/// Serves the metrics of `report` at `address`, if there is one, until the end of the runtime.
pub async fn show<R>(
    address: Option<SocketAddr>,
    report: impl Fn() -> R + Clone + Send + Sync + 'static,
    say: Say,
) -> Result<(), Failure>
where
    R: Future<Output = Report> + Send + 'static,
{
    let Some(address) = address else { return Ok(()) };
    let fault = |error| failed(format!("--metrics {address}: {error}; give another port"));
    let listener = TcpListener::bind(address).await.map_err(fault)?;
    let address = listener.local_addr().map_err(fault)?;
    say.note(format!("metrics on http://{address}/metrics"));
    tokio::spawn(serve(listener, report));
    Ok(())
}
