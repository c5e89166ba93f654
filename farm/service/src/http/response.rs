//! Responses, and the headers that protect all of them in browsers.

use std::convert::Infallible;
use std::io;

use ::http::header::{
    CACHE_CONTROL, CONTENT_LENGTH, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG, HeaderName, HeaderValue,
    REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS, X_FRAME_OPTIONS,
};
use ::http::{Response, StatusCode};
use bytes::Bytes;
use futures_util::stream::unfold;
use futures_util::{Stream, StreamExt as _};
use http_body::Frame;
use http_body_util::combinators::UnsyncBoxBody;
use http_body_util::{BodyExt as _, Full, StreamBody};
use serde::Serialize;

/// Body of a response.
pub type Body = UnsyncBoxBody<Bytes, io::Error>;

/// Scripts, styles and images come from the coordinator only. Inline scripts and styles are forbidden, and no site may embed the
/// page in a frame.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; \
    media-src 'self'; connect-src 'self'; font-src 'self'; worker-src 'self'; manifest-src 'self'; form-action 'self'; base-uri 'none'; \
    frame-ancestors 'none'";

/// Adds the headers that every response has.
pub(super) fn protect(response: &mut Response<Body>) {
    let headers = response.headers_mut();
    for (name, value) in [
        (CONTENT_SECURITY_POLICY, POLICY),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (X_FRAME_OPTIONS, "DENY"),
        (REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    headers.entry(CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
}

/// Makes a response with these bytes and this media type.
pub(super) fn bytes(status: StatusCode, kind: &'static str, bytes: impl Into<Bytes>) -> Response<Body> {
    let mut response = Response::new(full(bytes.into()));
    *response.status_mut() = status;
    response.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    response
}

/// Like [`bytes()`], for large content: `guard` is dropped when all bytes are sent or the client has disconnected.
pub(super) fn large_bytes<T: Send + 'static>(kind: &'static str, bytes: Bytes, guard: T) -> Response<Body> {
    /// Maximum size in bytes of a piece of the body.
    const PIECE: usize = 256 << 10;
    let length = bytes.len();
    let pieces = unfold((bytes, guard), |(mut rest, held)| async move {
        if rest.is_empty() {
            return None;
        }
        let piece = rest.split_to(rest.len().min(PIECE));
        Some((Ok(Frame::data(piece)), (rest, held)))
    });
    let mut response = Response::new(StreamBody::new(pieces).boxed_unsync());
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    headers.insert(CONTENT_LENGTH, length.into());
    response
}

/// Makes a response whose body is sent piece by piece. An error in it aborts the connection or the stream, so that the client does
/// not take a part for the whole.
/// - `length`: total number of bytes.
pub(super) fn stream(
    status: StatusCode,
    length: u64,
    pieces: impl Stream<Item = io::Result<Bytes>> + Send + 'static,
) -> Response<Body> {
    let mut response = Response::new(StreamBody::new(pieces.map(|piece| piece.map(Frame::data))).boxed_unsync());
    *response.status_mut() = status;
    response.headers_mut().insert(CONTENT_LENGTH, length.into());
    response
}

/// Adds the tag of a private answer that the client must check before it uses its copy.
pub(super) fn tag(response: &mut Response<Body>, tag: &str) {
    let headers = response.headers_mut();
    // A hexadecimal digest is always a valid header value.
    if let Ok(tag) = HeaderValue::try_from(format!("\"{tag}\"")) {
        headers.insert(ETAG, tag);
    }
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("private, no-cache"));
}

fn full(bytes: Bytes) -> Body {
    Full::new(bytes).map_err(|never| match never {}).boxed_unsync()
}

/// Makes a response without a body.
pub(super) fn empty(status: StatusCode) -> Response<Body> {
    let mut response = Response::new(full(Bytes::new()));
    *response.status_mut() = status;
    response
}

/// Makes a JSON response.
pub(super) fn json<T: Serialize>(value: &T) -> Response<Body> {
    json_with(StatusCode::OK, value)
}

/// Makes a JSON response with this status.
pub(super) fn json_with<T: Serialize>(status: StatusCode, value: &T) -> Response<Body> {
    match serde_json::to_vec(value) {
        Ok(text) => bytes(status, "application/json", text),
        Err(error) => bytes(StatusCode::INTERNAL_SERVER_ERROR, "text/plain; charset=utf-8", error.to_string()),
    }
}

/// Makes a page that shows only a message, for users with a browser.
pub(super) fn message_page(status: StatusCode, message: &str, help: &str) -> Response<Body> {
    let page = format!(
        "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\"><title>femc</title>\n<h1>femc</h1>\n<p>{}</p>\n<p>{}</p>\n\
         <p><a href=\"/\">back</a></p>\n</html>\n",
        escaped(message),
        escaped(help)
    );
    bytes(status, "text/html; charset=utf-8", page)
}

/// Escapes text for HTML.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Makes a response of server-sent events.
pub(super) fn events(events: impl Stream<Item = Result<Bytes, Infallible>> + Send + 'static) -> Response<Body> {
    let body = StreamBody::new(events.map(|event| event.map(Frame::data).map_err(|never| match never {})));
    let mut response = Response::new(body.boxed_unsync());
    response.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static("text/event-stream"));
    response
}
