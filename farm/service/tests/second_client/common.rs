//! Requests without a network, and random numbers.

use bytes::Bytes;
use femc_model::{JobId, JobNotes, JobState, JobStatus};
use femc_service::{Body, ConnectedClient, Farm, Gate, Http, Limits, Site, TransferSlots};
use femc_store::Store;
use http::header::{CONTENT_TYPE, ETAG, HeaderName};
use http::{Request, Response};
use http_body_util::{BodyExt as _, Full};

/// Random numbers of a seed (SplitMix64).
pub struct Random(pub u64);

impl Random {
    pub fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % end as u64) as usize
    }

    pub fn pick<'a, T>(&mut self, all: &'a [T]) -> &'a T {
        &all[self.below(all.len())]
    }
}

/// An answer as a client sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    pub status: u16,
    /// Tag without quotes; empty: none.
    pub tag: String,
    pub kind: String,
    pub body: Bytes,
}

impl Answer {
    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }
}

/// Makes the HTTP interface of a farm.
pub fn serve(farm: Farm<()>, store: Store, gate: Gate, site: Site) -> Http<()> {
    let slots = TransferSlots::new(gate.limits());
    Http::new(farm, store, slots, gate, site, false)
}

/// Limits that no test reaches.
pub fn wide_limits() -> Limits {
    Limits { rate: 1_000_000, transfers: 64, transfers_per_connection: 64, ..Limits::default() }
}

/// Makes the gate of a farm without authentication.
pub fn open_gate() -> Gate {
    Gate::new(None, wide_limits(), None)
}

/// Sends a request without a body, and returns the response before its body is read.
pub async fn send(http: &Http<()>, line: &str, headers: &[(HeaderName, &str)]) -> Response<Body> {
    send_body(http, line, headers, "").await
}

async fn send_body(http: &Http<()>, line: &str, headers: &[(HeaderName, &str)], body: &'static str) -> Response<Body> {
    let (method, path) = line.split_once(' ').expect("a method and a path");
    let mut request = Request::builder().method(method).uri(path);
    for (name, value) in headers {
        request = request.header(name, *value);
    }
    let request = request.body(Full::new(Bytes::from_static(body.as_bytes()))).expect("a request");
    http.serve(request, ConnectedClient::default()).await
}

/// Sends a request and returns its whole answer.
pub async fn ask(http: &Http<()>, line: &str, headers: &[(HeaderName, &str)]) -> Answer {
    answer(send(http, line, headers).await).await
}

/// Sends a change of the farm as JSON, and returns its whole answer.
pub async fn post(http: &Http<()>, path: &str, authorization: (HeaderName, &str), body: &'static str) -> Answer {
    let own = (HeaderName::from_static("x-femc"), "1");
    let headers = [authorization, own, (CONTENT_TYPE, "application/json")];
    answer(send_body(http, &format!("POST {path}"), &headers, body).await).await
}

async fn answer(response: Response<Body>) -> Answer {
    let header = |name: HeaderName| {
        let value = response.headers().get(name).map(|value| value.to_str().expect("text").to_owned());
        value.unwrap_or_default()
    };
    let (tag, kind) = (header(ETAG).trim_matches('"').to_owned(), header(CONTENT_TYPE));
    let status = response.status().as_u16();
    let body = response.into_body().collect().await.expect("a body").to_bytes();
    Answer { status, tag, kind, body }
}

/// Makes the status of a job.
pub fn job_status(job: JobId, priority: u8, state: JobState) -> JobStatus {
    JobStatus {
        job,
        name: "drive".into(),
        owner: "ann".into(),
        scene: "drive.mgf".into(),
        notes: JobNotes::default(),
        priority,
        state,
        failure: None,
        frames_total: 1,
        frames_done: 0,
        frames_failed: 0,
        active: Vec::new(),
        workers: 0,
        samples_done: 0,
        samples_planned: 0,
        samples_per_second: 0.0,
        bad_samples: 0,
        relative_error: None,
        blocks: None,
        worst_frame: None,
        error_target: None,
        seconds: 0.0,
        quarantined: Vec::new(),
        stale_messages: 0,
        copies: 0,
        waits: Vec::new(),
        submitted: None,
        submitted_date: None,
    }
}
