//! Delivery of messages over HTTP.

use std::error::Error;
use std::time::Duration;

use bytes::Bytes;
use femc_store::PlaintextPolicy;
use http::header::{CONTENT_TYPE, USER_AGENT};
use http::{Request, StatusCode};
use http_body_util::Full;
use hyper_rustls::HttpsConnector;
use hyper_util::client::legacy::{Client, connect};
use hyper_util::rt::{TokioExecutor, TokioTimer};
use tokio::sync::{OnceCell, Semaphore};
use tokio::time::Instant;
use url::Url;

use super::signature::NotifyKey;
use super::unix_seconds;

type HttpsClient = Client<HttpsConnector<connect::HttpConnector>, Full<Bytes>>;

/// Posts messages, with retries. Redirects are not followed, because they could lead to URLs that no prefix permits.
#[derive(Debug)]
pub(super) struct Poster {
    key: Option<NotifyKey>,
    /// HTTP client. It is made for the first message, because that reads the machine's root certificates.
    client: OnceCell<HttpsClient>,
    send_permits: Semaphore,
}

/// Outcome of one attempt to send a message.
enum DeliveryOutcome {
    Accepted,
    /// The receiver wants no more messages.
    Gone,
    Retry(String),
}

impl Poster {
    /// Maximum number of messages that are sent at the same time.
    const MAX_CONCURRENT: usize = 16;
    /// Time limit for a response.
    const RESPONSE_TIMEOUT: Duration = Duration::from_secs(15);
    /// Pause before the second attempt. Later pauses double.
    const FIRST_PAUSE: Duration = Duration::from_secs(1);
    const MAX_PAUSE: Duration = Duration::from_secs(300);
    /// Time after which a message that was never accepted is given up.
    const MAX_AGE: Duration = Duration::from_secs(24 * 3600);

    pub(super) fn new(key: Option<NotifyKey>) -> Self {
        Self { key, client: OnceCell::new(), send_permits: Semaphore::new(Self::MAX_CONCURRENT) }
    }

    /// Posts a message until it is accepted or given up.
    pub(super) async fn post(&self, url: &Url, id: &str, body: &str) {
        let (begun, mut pause) = (Instant::now(), Self::FIRST_PAUSE);
        let server = url.origin().ascii_serialization();
        loop {
            match self.send(url, id, body).await {
                DeliveryOutcome::Accepted => return tracing::info!(message = id, server, "notified"),
                DeliveryOutcome::Gone => {
                    return tracing::warn!(
                        message = id,
                        server,
                        "notification failed: the address no longer exists (410)"
                    );
                }
                DeliveryOutcome::Retry(fault) if begun.elapsed() + pause > Self::MAX_AGE => {
                    return tracing::error!(
                        message = id,
                        server,
                        "notification failed for a day, no more retries: {fault}"
                    );
                }
                DeliveryOutcome::Retry(fault) => {
                    tracing::warn!(
                        message = id,
                        server,
                        again_seconds = pause.as_secs(),
                        "notification failed, will retry: {fault}"
                    );
                }
            }
            tokio::time::sleep(pause).await;
            pause = (2 * pause).min(Self::MAX_PAUSE);
        }
    }

    async fn send(&self, url: &Url, id: &str, body: &str) -> DeliveryOutcome {
        let Ok(_place) = self.send_permits.acquire().await else { return DeliveryOutcome::Gone };
        let client = match self.client.get_or_try_init(|| async { client() }).await {
            Ok(client) => client,
            Err(fault) => return DeliveryOutcome::Retry(fault),
        };
        let now = unix_seconds();
        let mut request = Request::post(url.as_str())
            .header(CONTENT_TYPE, "application/json")
            .header(USER_AGENT, concat!("femc/", env!("CARGO_PKG_VERSION")))
            .header("webhook-id", id)
            .header("webhook-timestamp", now);
        if let Some(key) = &self.key {
            request = request.header("webhook-signature", key.sign(id, now, body));
        }
        let request = match request.body(Full::new(Bytes::copy_from_slice(body.as_bytes()))) {
            Ok(request) => request,
            Err(error) => return DeliveryOutcome::Retry(error.to_string()),
        };
        match tokio::time::timeout(Self::RESPONSE_TIMEOUT, client.request(request)).await {
            Err(_) => DeliveryOutcome::Retry(format!("no answer within {} s", Self::RESPONSE_TIMEOUT.as_secs())),
            Ok(Err(error)) => DeliveryOutcome::Retry(chain(&error)),
            Ok(Ok(answer)) if answer.status().is_success() => DeliveryOutcome::Accepted,
            Ok(Ok(answer)) if answer.status() == StatusCode::GONE => DeliveryOutcome::Gone,
            Ok(Ok(answer)) => DeliveryOutcome::Retry(format!("the server answered {}", answer.status())),
        }
    }
}

fn client() -> Result<HttpsClient, String> {
    let connector = femc_store::https_connector(PlaintextPolicy::Allowed).map_err(|error| error.to_string())?;
    Ok(Client::builder(TokioExecutor::new()).pool_timer(TokioTimer::new()).build(connector))
}

/// Formats an error with its causes.
fn chain(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text += &format!(": {error}");
        cause = error.source();
    }
    text
}
