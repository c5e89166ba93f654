//! `/metrics`, `/healthz` and `/readyz` over HTTP: small answers to few clients. No client can block the process.

use std::convert::Infallible;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use http_body_util::Full;
use hyper::body::Incoming;
use hyper::header::{CONTENT_TYPE, HeaderValue};
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;

use crate::process;

/// Health of a process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Health {
    /// The process works.
    Ready,
    /// The process works, but refuses some requests.
    Degraded {
        /// Refused service, and the reason.
        message: String,
    },
    /// The process is healthy and waits for something, like a standby.
    Waiting {
        /// Reason for the wait.
        message: String,
    },
    /// The process does not work and must be restarted.
    Broken {
        /// Part that fails, and its error.
        message: String,
    },
}

/// Health and metrics of a process.
#[derive(Debug)]
pub struct ProcessReport {
    /// Health of the process.
    pub health: Health,
    /// Page of metrics.
    pub page: String,
}

/// Maximum number of simultaneous connections; further ones wait.
const CONNECTIONS: usize = 32;
/// Timeout for reading a request's header.
const HEADER_TIMEOUT: Duration = Duration::from_secs(5);
/// Maximum duration of a connection.
const CONNECTION_TIMEOUT: Duration = Duration::from_secs(60);

/// Serves the results of `report` until this future is dropped: `/metrics` returns the page, `/healthz` returns 503 if the process
/// is broken, `/readyz` returns 503 if it waits or is broken.
pub async fn serve_metrics<R>(listener: TcpListener, report: impl Fn() -> R + Clone + Send + Sync + 'static)
where
    R: Future<Output = ProcessReport> + Send,
{
    process::start_time();
    let places = Arc::new(Semaphore::new(CONNECTIONS));
    loop {
        let Ok(place) = places.clone().acquire_owned().await else { return };
        match listener.accept().await {
            Ok((stream, _)) => {
                let report = report.clone();
                tokio::spawn(async move {
                    // A client that is too slow must ask again.
                    let _ = tokio::time::timeout(CONNECTION_TIMEOUT, connection(stream, report)).await;
                    drop(place);
                });
            }
            Err(error) => {
                tracing::warn!(%error, "cannot accept a connection for metrics");
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
}

async fn connection<R>(stream: TcpStream, report: impl Fn() -> R + Clone + Send + Sync + 'static)
where
    R: Future<Output = ProcessReport> + Send,
{
    let service = service_fn(move |request: Request<Incoming>| {
        let report = report.clone();
        async move { Ok::<_, Infallible>(answer(request.method(), request.uri().path(), report).await) }
    });
    let served = hyper::server::conn::http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEADER_TIMEOUT)
        .keep_alive(false)
        .serve_connection(TokioIo::new(stream), service)
        .await;
    if let Err(error) = served {
        tracing::debug!(%error, "a connection for metrics failed");
    }
}

async fn answer<R>(method: &Method, path: &str, report: impl Fn() -> R) -> Response<Full<Bytes>>
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

fn text(status: StatusCode, text: String) -> Response<Full<Bytes>> {
    let mut response = Response::new(Full::new(Bytes::from(text)));
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
