//! Metrics page of a service.

use crate::exit::{Failure, failed};
use crate::output::Printer;
use femc_metrics::ProcessReport;
use femc_proto::serve_metrics;
use std::net::SocketAddr;
use tokio::net::TcpListener;

/// Serves the metrics of `report` at `address`, if there is one, until the end of the runtime.
pub async fn start_page<R>(
    address: Option<SocketAddr>,
    report: impl Fn() -> R + Clone + Send + Sync + 'static,
    printer: Printer,
) -> Result<(), Failure>
where
    R: Future<Output = ProcessReport> + Send + 'static,
{
    let Some(address) = address else { return Ok(()) };
    let fault = |error| failed(format!("--metrics {address}: {error}; give another port"));
    let listener = TcpListener::bind(address).await.map_err(fault)?;
    let address = listener.local_addr().map_err(fault)?;
    printer.note(format!("metrics on http://{address}/metrics"));
    tokio::spawn(serve_metrics(listener, report));
    Ok(())
}
