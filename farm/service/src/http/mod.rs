//! HTTP interface with JSON, for programs and for the web page.
//!
//! A request is parsed to a [`Route`], which belongs to an [`Operation`](crate::Operation). The gate then decides as it does for
//! gRPC. After it, checks that concern browsers run: cookies, pages of other sites, and host names that lead elsewhere. Requests
//! from other sites are never accepted: there are no CORS headers, and a change needs a header that a form cannot send.

mod answer;
mod change;
mod download;
mod fault;
mod order;
mod pages;
mod range;
mod respond;
mod route;
mod site;
mod visitor;

use std::pin::{Pin, pin};
use std::sync::Arc;

use ::http::header::EXPECT;
use ::http::{HeaderMap, Method, Request, Response, Uri};
use bytes::Bytes;
use femc_store::Store;
use femc_trust::Audit;
use http_body_util::BodyExt as _;

use crate::access::{Gate, Granted, Limits, Outcome, Places, Shown, Trail, Who};
use crate::farm::Farm;
use crate::feed::Feed;
use crate::operation::Operation;
use crate::picture::{Draw, Pictures};
pub use answer::Body;
use fault::Fault;
use order::LastSorted;
pub use pages::Files;
use route::Route;
pub use visitor::{Introduced, Served, Visitor};

/// Content that is served in addition to the farm itself.
#[derive(Debug, Clone, Default)]
pub struct Site {
    /// Files of the web page. Without them, only JSON is served.
    pub files: Files,
    /// Engine build of this program, for display.
    pub engine: String,
    /// Function that draws frames. Without it, no pictures are served.
    pub draw: Option<Draw>,
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
    places: Places,
    /// Slots for requests that read pixels. A slot is held until all bytes are sent.
    large: Places,
    pictures: Pictures,
    sorted: LastSorted,
    gate: Gate,
    site: Site,
    is_encrypted: bool,
}

/// A request without its body.
struct Asked<'a> {
    method: &'a Method,
    uri: &'a Uri,
    headers: &'a HeaderMap,
}

impl Asked<'_> {
    /// Refuses headers that exceed the limit. Sizes are computed as in HTTP/2 (RFC 9113, 6.5.2): each header counts 32 bytes in
    /// addition to its name and value. Over HTTP/2, the transport refuses such headers before a request arrives here.
    fn within(&self, limit: u32) -> Result<(), Fault> {
        let of_headers = self.headers.iter().map(|(name, value)| name.as_str().len() + value.len() + 32);
        let of_uri = self.uri.path_and_query().map_or(0, |path| path.as_str().len());
        if of_headers.sum::<usize>() + of_uri <= limit as usize { Ok(()) } else { Err(Fault::Headers { limit }) }
    }
}

impl<S: Send + 'static> Http<S> {
    /// Makes the interface of a farm behind a gate.
    /// - `places`: slots for large downloads.
    /// - `is_encrypted`: whether connections are encrypted. Then cookies are sent over encrypted connections only.
    pub fn new(farm: Farm<S>, store: Store, places: Places, gate: Gate, site: Site, is_encrypted: bool) -> Self {
        let feed = Feed::new(farm.clone());
        let few = Limits { transfers: 4, transfers_of_caller: 2, transfers_of_connection: 2, ..*gate.limits() };
        let large = Places::new(&few);
        let pictures = Pictures::new(site.draw, store.clone());
        Self(Arc::new(Inner {
            farm,
            feed,
            store,
            places,
            large,
            pictures,
            sorted: LastSorted::default(),
            gate,
            site,
            is_encrypted,
        }))
    }

    /// Answers any request. The response has its [`Operation`] among its extensions, for metrics.
    pub async fn serve<B>(&self, request: Request<B>, visitor: Visitor) -> Response<Body>
    where
        B: http_body::Body<Data = Bytes> + Send,
        B::Error: std::fmt::Display,
    {
        let (head, body) = request.into_parts();
        let mut body = pin!(body);
        let asked = Asked { method: &head.method, uri: &head.uri, headers: &head.headers };
        let route = asked.within(self.0.gate.limits().headers).and_then(|()| Route::of(&asked));
        let operation = route.as_ref().map_or(Operation::Other, Route::operation);
        let trail = self.0.gate.trail(operation, asked.uri.path(), visitor.address.map(|it| it.to_string()));
        let answered = match route {
            // Requests without a route are answered without authentication, subject to the rate limit.
            Err(fault) => Err(self.nowhere(fault, &visitor).await),
            Ok(route) => self.pass(route, &asked, body.as_mut(), &visitor, &trail).await,
        };
        let mut response = match answered {
            Ok(response) => {
                self.note(&trail, Outcome::Done, "ok", "");
                response
            }
            Err(fault) => {
                self.note(&trail, fault.outcome(), fault.code(), &fault.to_string());
                self.discard(&asked, body).await;
                fault.response(&asked)
            }
        };
        answer::protect(&mut response);
        response.extensions_mut().insert(operation);
        response
    }

    /// Reads and drops the rest of a refused request's body. If the connection or the stream were closed while the client still
    /// sends, the client would see a transport error instead of the response.
    async fn discard<B>(&self, asked: &Asked<'_>, mut body: Pin<&mut B>)
    where
        B: http_body::Body<Data = Bytes> + Send,
    {
        /// Maximum number of bytes read in this way. A client that announces more is answered at once.
        const MOST: usize = 8 << 20;
        // The client waits for the response before it sends the body.
        let is_held_back = asked.headers.contains_key(EXPECT);
        if is_held_back || body.size_hint().lower() > MOST as u64 {
            return;
        }
        let read = async {
            let mut rest = MOST;
            while let Some(Ok(frame)) = body.frame().await {
                let Some(left) = rest.checked_sub(frame.data_ref().map_or(0, Bytes::len)) else { break };
                rest = left;
            }
        };
        // A slower client loses the response, as does any client whose request is late.
        let _ = tokio::time::timeout(self.0.gate.limits().patience, read).await;
    }

    async fn nowhere(&self, fault: Fault, visitor: &Visitor) -> Fault {
        let place = visitor.address.map(|address| address.ip().to_string());
        match self.0.gate.pace(place.as_deref()) {
            Ok(wait) => {
                tokio::time::sleep(wait).await;
                fault
            }
            Err(refusal) => refusal.into(),
        }
    }

    /// Checks a request, and runs it if it is permitted.
    async fn pass<B>(
        &self,
        route: Route,
        asked: &Asked<'_>,
        body: Pin<&mut B>,
        visitor: &Visitor,
        trail: &Trail,
    ) -> Result<Response<Body>, Fault>
    where
        B: http_body::Body<Data = Bytes> + Send,
        B::Error: std::fmt::Display,
    {
        let gate = &self.0.gate;
        let place = visitor.address.map(|address| address.ip().to_string());
        let token = site::token(asked.headers)?;
        let shown = Shown { token, certificate: visitor.certificate.as_ref(), place: place.as_deref() };
        let granted = gate.check(route.operation(), shown, trail)?;
        site::check(&route, asked, visitor, gate.asks())?;
        let Granted { caller, name, wait } = granted;
        let who = Who { name, connection: visitor.connection };
        if !wait.is_zero() {
            tokio::time::sleep(wait).await;
        }
        let is_known = caller.is_some() || !gate.asks();
        let mut response = self.respond(route, asked, body, caller, who, trail).await?;
        if is_known {
            response.extensions_mut().insert(Introduced);
        } else {
            response.extensions_mut().insert(Served);
        }
        Ok(response)
    }

    fn note(&self, trail: &Trail, outcome: Outcome, code: &str, why: &str) {
        let audit: Option<&Audit> = self.0.gate.audit();
        if let Some(audit) = audit {
            trail.end(audit, outcome, code, why);
        }
    }
}
