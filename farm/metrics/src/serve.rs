//! `/metrics`, `/healthz` and `/readyz` over HTTP: small answers to few callers, none of whom can hold the process up.

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

/// How a process is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Health {
    /// It does what it is for.
    Ready,
    /// It does what it is for, but not for all.
    Strained {
        /// What it does not do, and why.
        message: String,
    },
    /// It is well, and waits for something.
    Waits {
        /// For what.
        message: String,
    },
    /// It does not do what it should: start it anew.
    Broken {
        /// Part that fails, and its error.
        message: String,
    },
}

/// What a process says about itself.
#[derive(Debug)]
pub struct Report {
    /// Health of the process.
    pub health: Health,
    /// Its page of metrics.
    pub page: String,
}

/// Connections at a time; more wait.
const CONNECTIONS: usize = 32;
/// How long a request may take to come.
const PATIENCE: Duration = Duration::from_secs(5);
/// How long a connection may live.
const LIFE: Duration = Duration::from_secs(60);

/// Answers with what `report` says, until it is dropped: `/metrics` with the page, `/healthz` with 503 where the process is
/// broken, `/readyz` with 503 unless it is ready.
pub async fn serve<R>(listener: TcpListener, report: impl Fn() -> R + Clone + Send + Sync + 'static)
where
    R: Future<Output = Report> + Send,
{
    process::start();
    let places = Arc::new(Semaphore::new(CONNECTIONS));
    loop {
        let Ok(place) = places.clone().acquire_owned().await else { return };
        match listener.accept().await {
            Ok((stream, _)) => {
                let report = report.clone();
                tokio::spawn(async move {
                    // Who is too slow asks again.
                    let _ = tokio::time::timeout(LIFE, connection(stream, report)).await;
                    drop(place);
                });
            }
            Err(error) => {
                tracing::warn!(%error, "a connection for metrics was not taken");
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
}

async fn connection<R>(stream: TcpStream, report: impl Fn() -> R + Clone + Send + Sync + 'static)
where
    R: Future<Output = Report> + Send,
{
    let service = service_fn(move |request: Request<Incoming>| {
        let report = report.clone();
        async move { Ok::<_, Infallible>(answer(request.method(), request.uri().path(), report).await) }
    });
    let served = hyper::server::conn::http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(PATIENCE)
        .keep_alive(false)
        .serve_connection(TokioIo::new(stream), service)
        .await;
    if let Err(error) = served {
        tracing::debug!(%error, "a connection for metrics broke");
    }
}

async fn answer<R>(method: &Method, path: &str, report: impl Fn() -> R) -> Response<Full<Bytes>>
where
    R: Future<Output = Report>,
{
    if !matches!(*method, Method::GET | Method::HEAD) {
        return text(StatusCode::METHOD_NOT_ALLOWED, "only GET and HEAD\n".into());
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
            Health::Strained { message } | Health::Waits { message } => {
                text(StatusCode::OK, format!("ok: {message}\n"))
            }
            Health::Broken { message } => text(StatusCode::SERVICE_UNAVAILABLE, format!("broken: {message}\n")),
        },
        "/readyz" => match report().await.health {
            Health::Ready => text(StatusCode::OK, "ready\n".into()),
            Health::Strained { message } => text(StatusCode::OK, format!("ready: {message}\n")),
            Health::Waits { message } | Health::Broken { message } => {
                text(StatusCode::SERVICE_UNAVAILABLE, format!("not ready: {message}\n"))
            }
        },
        _ => text(StatusCode::NOT_FOUND, "there are /metrics, /healthz and /readyz\n".into()),
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
    async fn a_standby_is_healthy_and_not_ready_and_what_is_broken_is_neither() {
        let status = async |path: &str, health: Health| {
            let report = || std::future::ready(Report { health: health.clone(), page: "page\n".into() });
            answer(&Method::GET, path, report).await.status().as_u16()
        };
        let waits = Health::Waits { message: "standing by".into() };
        let broken = Health::Broken { message: "the log".into() };
        let strained = Health::Strained { message: "no new jobs".into() };
        let all = [(Health::Ready, 200, 200), (strained, 200, 200), (waits, 200, 503), (broken, 503, 503)];
        for (health, healthz, readyz) in all {
            assert_eq!(status("/healthz", health.clone()).await, healthz);
            assert_eq!(status("/readyz", health.clone()).await, readyz);
            assert_eq!(status("/metrics", health).await, 200, "metrics are most wanted when something is broken");
        }
        assert_eq!(status("/", Health::Ready).await, 404);
    }
}
