//! HTTP and TLS for `object_store`, with hyper and rustls only, which the farm needs anyway.
//!
//! The default transport of `object_store` is reqwest. It costs a third more of a cold build than this file, and its root
//! certificates have a license that `deny.toml` does not allow. The disadvantage of this transport: no proxies.

use std::error::Error;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use async_trait::async_trait;
use bytes::Bytes;
use hyper::body::{Body, Frame, Incoming, SizeHint};
use hyper_rustls::{HttpsConnector, HttpsConnectorBuilder};
use hyper_util::client::legacy::{Client, connect};
use hyper_util::rt::{TokioExecutor, TokioTimer};
use object_store::ClientOptions;
use object_store::client::{
    ClientConfigKey, HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpRequestBody, HttpResponse,
    HttpResponseBody, HttpService,
};
use tokio::time::{Instant, Sleep};

/// Timeout for establishing a connection.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// Timeout until an answer begins; this includes the time to send a part of an upload.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(60);
/// Timeout between two pieces of an answer.
const READ_TIMEOUT: Duration = Duration::from_secs(20);

/// Factory of HTTP clients.
#[derive(Debug)]
pub(super) struct HttpsConnectorFactory;

impl HttpConnector for HttpsConnectorFactory {
    fn connect(&self, options: &ClientOptions) -> object_store::Result<HttpClient> {
        let is_plain = options.get_config_value(&ClientConfigKey::AllowHttp).is_some_and(|value| value == "true");
        let connector = https_connector(if is_plain { PlaintextPolicy::Allowed } else { PlaintextPolicy::Refused });
        let connector = connector.map_err(|source| object_store::Error::Generic { store: "TLS", source })?;
        let client = Client::builder(TokioExecutor::new()).pool_timer(TokioTimer::new()).build(connector);
        Ok(HttpClient::new(Service { client }))
    }
}

/// Policy for connections without encryption.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlaintextPolicy {
    /// `http:` and `https:`.
    Allowed,
    /// `https:` only.
    Refused,
}

/// Returns a connector over TCP and TLS for hyper's client, with the machine's root certificates.
///
/// # Errors
/// The machine has no root certificates and plain connections are refused; or TLS cannot be set up.
pub fn https_connector(
    policy: PlaintextPolicy,
) -> Result<HttpsConnector<connect::HttpConnector>, Box<dyn Error + Send + Sync>> {
    let mut tcp = connect::HttpConnector::new();
    tcp.set_connect_timeout(Some(CONNECT_TIMEOUT));
    tcp.set_nodelay(true);
    tcp.enforce_http(false);
    let provider = rustls::crypto::ring::default_provider();
    Ok(match (HttpsConnectorBuilder::new().with_provider_and_native_roots(provider), policy) {
        (Ok(tls), PlaintextPolicy::Allowed) => tls.https_or_http().enable_http1().wrap_connector(tcp),
        (Ok(tls), PlaintextPolicy::Refused) => tls.https_only().enable_http1().wrap_connector(tcp),
        // Without root certificates, a machine can still connect to servers without TLS.
        (Err(_), PlaintextPolicy::Allowed) => without_roots()?.https_or_http().enable_http1().wrap_connector(tcp),
        (Err(error), PlaintextPolicy::Refused) => return Err(error.into()),
    })
}

type Builder = HttpsConnectorBuilder<hyper_rustls::builderstates::WantsSchemes>;

fn without_roots() -> Result<Builder, rustls::Error> {
    let config = rustls::ClientConfig::builder_with_provider(rustls::crypto::ring::default_provider().into())
        .with_safe_default_protocol_versions()?;
    let roots = rustls::RootCertStore::empty();
    Ok(HttpsConnectorBuilder::new().with_tls_config(config.with_root_certificates(roots).with_no_client_auth()))
}

#[derive(Debug)]
struct Service {
    client: Client<HttpsConnector<connect::HttpConnector>, HttpRequestBody>,
}

#[async_trait]
impl HttpService for Service {
    async fn call(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        let answer = tokio::time::timeout(RESPONSE_TIMEOUT, self.client.request(request)).await;
        let answer = answer.map_err(|late| HttpError::new(HttpErrorKind::Timeout, late))?;
        let (head, body) = answer.map_err(|error| HttpError::new(kind(&error), error))?.into_parts();
        Ok(HttpResponse::from_parts(head, HttpResponseBody::new(TimeoutBody::new(body))))
    }
}

fn kind(error: &hyper_util::client::legacy::Error) -> HttpErrorKind {
    if error.is_connect() {
        return HttpErrorKind::Connect;
    }
    let cause = error.source().and_then(|cause| cause.downcast_ref::<hyper::Error>());
    cause.map_or(HttpErrorKind::Interrupted, transfer_error_kind)
}

fn transfer_error_kind(error: &hyper::Error) -> HttpErrorKind {
    if error.is_timeout() {
        HttpErrorKind::Timeout
    } else if error.is_canceled() || error.is_closed() || error.is_incomplete_message() {
        HttpErrorKind::Request
    } else {
        HttpErrorKind::Interrupted
    }
}

/// A body that fails when no data arrives for [`READ_TIMEOUT`].
struct TimeoutBody {
    body: Incoming,
    idle_timer: Pin<Box<Sleep>>,
}

impl TimeoutBody {
    fn new(body: Incoming) -> Self {
        Self { body, idle_timer: Box::pin(tokio::time::sleep(READ_TIMEOUT)) }
    }
}

impl Body for TimeoutBody {
    type Data = Bytes;
    type Error = HttpError;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, HttpError>>> {
        if let Poll::Ready(frame) = Pin::new(&mut self.body).poll_frame(cx) {
            self.idle_timer.as_mut().reset(Instant::now() + READ_TIMEOUT);
            return Poll::Ready(
                frame.map(|frame| frame.map_err(|error| HttpError::new(transfer_error_kind(&error), error))),
            );
        }
        let late = || std::io::Error::new(std::io::ErrorKind::TimedOut, "the response stopped before its end");
        self.idle_timer.as_mut().poll(cx).map(|()| Some(Err(HttpError::new(HttpErrorKind::Timeout, late()))))
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use tokio::net::TcpListener;

    use super::*;

    #[tokio::test]
    async fn unencrypted_connection_needs_explicit_permission() {
        let server = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}/", server.local_addr().unwrap());
        for is_allowed in [false, true] {
            // A machine without root certificates refuses already here.
            let Ok(client) = HttpsConnectorFactory.connect(&ClientOptions::new().with_allow_http(is_allowed)) else {
                continue;
            };
            let request = hyper::Request::get(&url).body(HttpRequestBody::empty()).unwrap();
            let reached = tokio::select! {
                biased;
                answer = client.execute(request) => { answer.unwrap_err(); false }
                link = server.accept() => link.is_ok(),
            };
            assert_eq!(reached, is_allowed);
        }
    }
}
