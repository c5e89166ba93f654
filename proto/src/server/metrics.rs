//! The metrics page of a process, on a port of its own: `/metrics`, `/healthz` and `/readyz`. No client can block the process.

use std::convert::Infallible;
use std::time::Duration;

use femc_metrics::{Health, ProcessReport, process_start_time};
use femc_service::Limits;
use http::header::{CONTENT_TYPE, HeaderValue};
use http::{Method, Request, Response, StatusCode};
use tokio::net::TcpListener;
use tokio_stream::StreamExt as _;
use tonic::body::Body;
use tonic::transport::server::TcpIncoming;
use tower::service_fn;

use super::connection_limiter::{ConnectionLimiter, Peer, UnusedConnections};
use super::transport;
use crate::error::ServeError;

/// Maximum number of connections; further ones are closed.
const CONNECTIONS: usize = 32;
/// Maximum duration of a connection. A client that is too slow must ask again.
const CONNECTION_TIMEOUT: Duration = Duration::from_secs(60);

/// Serves the results of `report` until this future is dropped: `/metrics` returns the page, `/healthz` returns 503 if the process
/// is broken, `/readyz` returns 503 if it waits or is broken. Connections are not encrypted, and everybody may read the page.
///
/// # Errors
/// If the transport fails.
pub async fn serve_metrics<R>(
    listener: TcpListener,
    report: impl Fn() -> R + Clone + Send + 'static,
) -> Result<(), ServeError>
where
    R: Future<Output = ProcessReport> + Send,
{
    process_start_time();
    let limits = Limits { connections: CONNECTIONS, connections_per_address: CONNECTIONS, ..Limits::default() };
    let limiter = ConnectionLimiter::new(limits, None, UnusedConnections::Ignored);
    let incoming = TcpIncoming::from(listener).filter_map(move |io| io.map(|io| limiter.admit(io)).transpose());
    let pages = service_fn(move |request: Request<Body>| {
        let report = report.clone();
        async move {
            if let Some(peer) = request.extensions().get::<Peer>() {
                peer.mark_introduced();
            }
            Ok::<_, Infallible>(answer(request.method(), request.uri().path(), report).await)
        }
    });
    let transport = transport(&limits).max_connection_age(CONNECTION_TIMEOUT).max_connection_age_grace(Duration::ZERO);
    Ok(transport.serve_with_incoming(pages, incoming).await?)
}

async fn answer<R>(method: &Method, path: &str, report: impl Fn() -> R) -> Response<String>
where
    R: Future<Output = ProcessReport>,
{
    if !matches!(*method, Method::GET | Method::HEAD) {
        return text(StatusCode::METHOD_NOT_ALLOWED, "use GET or HEAD\n".into());
    }
    match path {
        "/metrics" => {
            let mut response = text(StatusCode::OK, report().await.page);
            let kind = HeaderValue::from_static("text/plain; version=0.0.4; charset=utf-8");
            response.headers_mut().insert(CONTENT_TYPE, kind);
            response
        }
        "/healthz" => match report().await.health {
            Health::Ready => text(StatusCode::OK, "ok\n".into()),
            Health::Degraded { message } | Health::Waiting { message } => {
                text(StatusCode::OK, format!("ok: {message}\n"))
            }
            Health::Broken { message } => text(StatusCode::SERVICE_UNAVAILABLE, format!("broken: {message}\n")),
        },
        "/readyz" => match report().await.health {
            Health::Ready => text(StatusCode::OK, "ready\n".into()),
            Health::Degraded { message } => text(StatusCode::OK, format!("ready: {message}\n")),
            Health::Waiting { message } | Health::Broken { message } => {
                text(StatusCode::SERVICE_UNAVAILABLE, format!("not ready: {message}\n"))
            }
        },
        _ => text(StatusCode::NOT_FOUND, "unknown path: use /metrics, /healthz or /readyz\n".into()),
    }
}

fn text(status: StatusCode, text: String) -> Response<String> {
    let mut response = Response::new(text);
    *response.status_mut() = status;
    response.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static("text/plain; charset=utf-8"));
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn standby_is_healthy_but_not_ready_and_broken_is_neither() {
        let status = async |path: &str, health: Health| {
            let report = || std::future::ready(ProcessReport { health: health.clone(), page: "page\n".into() });
            answer(&Method::GET, path, report).await.status().as_u16()
        };
        let waits = Health::Waiting { message: "standing by".into() };
        let broken = Health::Broken { message: "the log".into() };
        let strained = Health::Degraded { message: "no new jobs".into() };
        let all = [(Health::Ready, 200, 200), (strained, 200, 200), (waits, 200, 503), (broken, 503, 503)];
        for (health, healthz, readyz) in all {
            assert_eq!(status("/healthz", health.clone()).await, healthz);
            assert_eq!(status("/readyz", health.clone()).await, readyz);
            assert_eq!(status("/metrics", health).await, 200, "metrics are most wanted when something is broken");
        }
        assert_eq!(status("/", Health::Ready).await, 404);
    }
}
