//! HTTP interface with JSON, for programs and for the web page.
//!
//! A request is parsed to a [`Route`], which belongs to an [`Operation`](crate::Operation). The gate then decides as it does for
//! gRPC. After it, checks that concern browsers run: cookies, pages of other sites, and host names that lead elsewhere. Requests
//! from other sites are never accepted: there are no CORS headers, and a change needs a header that a form cannot send.

mod change;
mod connected_client;
mod download;
mod error;
mod handlers;
mod light;
mod order;
mod pages;
mod range;
mod response;
mod route;
mod site;

use std::pin::{Pin, pin};
use std::sync::Arc;

use ::http::header::{EXPECT, IF_NONE_MATCH};
use ::http::{HeaderMap, Method, Request, Response, Uri};
use bytes::Bytes;
use femc_store::Store;
use femc_trust::Audit;
use http_body_util::BodyExt as _;

use crate::access::{AccessGrant, AuditEntry, CallerKey, Gate, Limits, Outcome, PresentedCredentials, TransferSlots};
use crate::farm::Farm;
use crate::feed::Feed;
use crate::light::{LightFile, LightViews, OpenLight};
use crate::operation::Operation;
use crate::picture::{ComparePictures, DrawPicture, Pictures};
pub use connected_client::{ConnectedClient, PermittedResponse, PublicResponse};
use error::HttpError;
use order::SortedTasksCache;
pub use pages::PageFiles;
pub use response::Body;
use route::Route;

/// Content that is served in addition to the farm itself.
#[derive(Debug, Clone, Default)]
pub struct Site {
    /// Files of the web page. Without them, only JSON is served.
    pub files: PageFiles,
    /// Engine build of this program, for display.
    pub engine: String,
    /// Function that draws frames. Without it, no pictures are served.
    pub draw: Option<DrawPicture>,
    /// Function that compares two frames. Without it, no comparisons are served.
    pub compare: Option<ComparePictures>,
    /// Function that decodes light statistics. Without it, no recorded light is served.
    pub open_light: Option<OpenLight>,
    /// Files with light statistics that are served beside the farm.
    pub light_files: Vec<LightFile>,
}

/// HTTP interface of a farm.
#[derive(Debug)]
pub struct Http<S>(Arc<Inner<S>>);

impl<S> Clone for Http<S> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

#[derive(Debug)]
struct Inner<S> {
    farm: Farm<S>,
    feed: Feed<S>,
    store: Store,
    transfer_slots: TransferSlots,
    /// Slots for requests that read pixels. A slot is held until all bytes are sent.
    pixel_slots: TransferSlots,
    pictures: Pictures,
    light: LightViews,
    sorted_tasks: SortedTasksCache,
    gate: Gate,
    site: Site,
    is_encrypted: bool,
}

/// A request without its body.
struct RequestHead<'a> {
    method: &'a Method,
    uri: &'a Uri,
    headers: &'a HeaderMap,
}

impl<'a> RequestHead<'a> {
    /// Returns the tag of the answer that the client has.
    fn known_tag(&self) -> Option<&'a str> {
        let tag = self.headers.get(IF_NONE_MATCH)?.to_str().ok()?;
        Some(tag.trim_start_matches("W/").trim_matches('"'))
    }

    /// Refuses headers that exceed the limit. Sizes are computed as in HTTP/2 (RFC 9113, 6.5.2): each header counts 32 bytes in
    /// addition to its name and value. Over HTTP/2, the transport refuses such headers before a request arrives here.
    fn check_header_size(&self, limit: u32) -> Result<(), HttpError> {
        let of_headers = self.headers.iter().map(|(name, value)| name.as_str().len() + value.len() + 32);
        let of_uri = self.uri.path_and_query().map_or(0, |path| path.as_str().len());
        if of_headers.sum::<usize>() + of_uri <= limit as usize {
            Ok(())
        } else {
            Err(HttpError::HeadersTooLarge { limit })
        }
    }
}

impl<S: Send + 'static> Http<S> {
    /// Makes the interface of a farm behind a gate.
    /// - `transfer_slots`: slots for large downloads.
    /// - `is_encrypted`: whether connections are encrypted. Then cookies are sent over encrypted connections only.
    pub fn new(
        farm: Farm<S>,
        store: Store,
        transfer_slots: TransferSlots,
        gate: Gate,
        site: Site,
        is_encrypted: bool,
    ) -> Self {
        let feed = Feed::new(farm.clone());
        let few = Limits { transfers: 4, transfers_per_caller: 2, transfers_per_connection: 2, ..*gate.limits() };
        let large = TransferSlots::new(&few);
        let pictures = Pictures::new(site.draw, site.compare, store.clone());
        let light_limits =
            Limits { transfers: 8, transfers_per_caller: 2, transfers_per_connection: 2, ..*gate.limits() };
        let light_slots = TransferSlots::new(&light_limits);
        let light = LightViews::new(site.open_light, site.light_files.clone(), store.clone(), light_slots);
        Self(Arc::new(Inner {
            farm,
            feed,
            store,
            transfer_slots,
            pixel_slots: large,
            pictures,
            light,
            sorted_tasks: SortedTasksCache::default(),
            gate,
            site,
            is_encrypted,
        }))
    }

    /// Answers any request. The response has its [`Operation`] among its extensions, for metrics.
    pub async fn serve<B>(&self, request: Request<B>, client: ConnectedClient) -> Response<Body>
    where
        B: http_body::Body<Data = Bytes> + Send,
        B::Error: std::fmt::Display,
    {
        let (head, body) = request.into_parts();
        let mut body = pin!(body);
        let request_head = RequestHead { method: &head.method, uri: &head.uri, headers: &head.headers };
        let route =
            request_head.check_header_size(self.0.gate.limits().headers).and_then(|()| Route::parse(&request_head));
        let operation = route.as_ref().map_or(Operation::Other, Route::operation);
        let audit_entry =
            self.0.gate.audit_entry(operation, request_head.uri.path(), client.address.map(|it| it.to_string()));
        let answered = match route {
            // Requests without a route are answered without authentication, subject to the rate limit.
            Err(fault) => Err(self.rate_limited_error(fault, &client).await),
            Ok(route) => self.authorize_and_run(route, &request_head, body.as_mut(), &client, &audit_entry).await,
        };
        let mut response = match answered {
            Ok(response) => {
                self.write_audit_entry(&audit_entry, Outcome::Done, "ok", "");
                response
            }
            Err(fault) => {
                self.write_audit_entry(&audit_entry, fault.outcome(), fault.code(), &fault.to_string());
                self.discard(&request_head, body).await;
                fault.response(&request_head)
            }
        };
        response::protect(&mut response);
        response.extensions_mut().insert(operation);
        response
    }

    /// Reads and drops the rest of a refused request's body. If the connection or the stream were closed while the client still
    /// sends, the client would see a transport error instead of the response.
    async fn discard<B>(&self, request_head: &RequestHead<'_>, mut body: Pin<&mut B>)
    where
        B: http_body::Body<Data = Bytes> + Send,
    {
        /// Maximum number of bytes read in this way. A client that announces more is answered at once.
        const MAX_DISCARDED_BYTES: usize = 8 << 20;
        // The client waits for the response before it sends the body.
        let is_held_back = request_head.headers.contains_key(EXPECT);
        if is_held_back || body.size_hint().lower() > MAX_DISCARDED_BYTES as u64 {
            return;
        }
        let read = async {
            let mut rest = MAX_DISCARDED_BYTES;
            while let Some(Ok(frame)) = body.frame().await {
                let Some(left) = rest.checked_sub(frame.data_ref().map_or(0, Bytes::len)) else { break };
                rest = left;
            }
        };
        // A slower client loses the response, as does any client whose request is late.
        let _ = tokio::time::timeout(self.0.gate.limits().request_timeout, read).await;
    }

    async fn rate_limited_error(&self, error: HttpError, visitor: &ConnectedClient) -> HttpError {
        let address = visitor.address.map(|address| address.ip().to_string());
        match self.0.gate.limit_address_rate(address.as_deref()) {
            Ok(wait) => {
                tokio::time::sleep(wait).await;
                error
            }
            Err(refusal) => refusal.into(),
        }
    }

    /// Checks a request, and runs it if it is permitted.
    async fn authorize_and_run<B>(
        &self,
        route: Route,
        request_head: &RequestHead<'_>,
        body: Pin<&mut B>,
        client: &ConnectedClient,
        audit_entry: &AuditEntry,
    ) -> Result<Response<Body>, HttpError>
    where
        B: http_body::Body<Data = Bytes> + Send,
        B::Error: std::fmt::Display,
    {
        let gate = &self.0.gate;
        let address = client.address.map(|address| address.ip().to_string());
        let token = site::token(request_head)?;
        let shown =
            PresentedCredentials { token, certificate: client.certificate.as_ref(), address: address.as_deref() };
        let granted = gate.check(route.operation(), shown, audit_entry)?;
        site::check(&route, request_head, client, gate.requires_authentication())?;
        let AccessGrant { caller, name, wait } = granted;
        let caller_key = CallerKey { name, connection: client.connection };
        if !wait.is_zero() {
            tokio::time::sleep(wait).await;
        }
        let is_known = caller.is_some() || !gate.requires_authentication();
        let mut response = self.respond(route, request_head, body, caller, caller_key, audit_entry).await?;
        if is_known {
            response.extensions_mut().insert(PermittedResponse);
        } else {
            response.extensions_mut().insert(PublicResponse);
        }
        Ok(response)
    }

    fn write_audit_entry(&self, audit_entry: &AuditEntry, outcome: Outcome, code: &str, message: &str) {
        let audit: Option<&Audit> = self.0.gate.audit();
        if let Some(audit) = audit {
            audit_entry.write(audit, outcome, code, message);
        }
    }
}
