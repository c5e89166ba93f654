//! Metrics of the calls: their number, their latency, and the bytes transferred from and to the store.

use std::collections::BTreeMap;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Instant;

use femc_metrics::{Counter, Histogram, Tally};
use femc_service::Operation;
use http::{Request, Response};
use prost::Message as _;
use tonic::Code;
use tower::{Layer, Service};

use crate::wire;

/// Counters of a server's traffic. Clones share them.
#[derive(Debug, Clone)]
pub struct Traffic {
    /// Number of calls, by path and by the status at the start of the answer.
    pub calls: Tally<(String, &'static str)>,
    /// Time until the answer began, by path of the call.
    pub latencies: Arc<BTreeMap<String, Histogram>>,
    /// Number of HTTP requests, by name of the operation and status of the answer.
    pub requests: Tally<(&'static str, u16)>,
    /// Time until the answer to an HTTP request began, by name of the operation.
    pub request_latencies: Arc<BTreeMap<&'static str, Histogram>>,
    /// Artifact bytes received.
    pub received: Counter,
    /// Artifact bytes sent.
    pub sent: Counter,
}

/// Path that stands for all unknown calls, because clients can invent any number of paths.
const OTHER: &str = "other";

impl Default for Traffic {
    fn default() -> Self {
        let paths: Vec<String> = call_paths().into_iter().chain([OTHER.to_owned()]).collect();
        let histogram = |path: &String| (path.clone(), Histogram::new(Histogram::LATENCIES));
        let timed = |operation: &'static str| (operation, Histogram::new(Histogram::LATENCIES));
        Self {
            calls: Tally::with_keys(paths.iter().map(|path| (path.clone(), code_name(Code::Ok)))),
            latencies: Arc::new(paths.iter().map(histogram).collect()),
            requests: Tally::with_keys(Operation::HTTP.map(|operation| (operation.name(), 200))),
            request_latencies: Arc::new(Operation::HTTP.map(Operation::name).into_iter().map(timed).collect()),
            received: Counter::default(),
            sent: Counter::default(),
        }
    }
}

impl Traffic {
    fn record<B>(&self, path: &str, response: &Response<B>, begun: Instant) {
        if let Some(operation) = response.extensions().get::<Operation>() {
            self.requests.add((operation.name(), response.status().as_u16()), 1);
            if let Some(latencies) = self.request_latencies.get(operation.name()) {
                latencies.observe(begun.elapsed());
            }
            return;
        }
        let path = self.latencies.get_key_value(path).map_or(OTHER, |(path, _)| path);
        let code = response.headers().get("grpc-status").map_or(Code::Ok, |code| Code::from_bytes(code.as_bytes()));
        self.calls.add((path.to_owned(), code_name(code)), 1);
        if let Some(latencies) = self.latencies.get(path) {
            latencies.observe(begun.elapsed());
        }
    }
}

/// Returns the paths of the protocol's calls, such as `/femc.v1.Jobs/List`.
fn call_paths() -> Vec<String> {
    let set = prost_types::FileDescriptorSet::decode(wire::DESCRIPTORS).unwrap_or_default();
    let mut paths = Vec::new();
    for file in &set.file {
        for service in &file.service {
            let path = |call: &prost_types::MethodDescriptorProto| {
                format!("/{}.{}/{}", file.package(), service.name(), call.name())
            };
            paths.extend(service.method.iter().map(path));
        }
    }
    paths
}

/// Returns the code's name in gRPC.
fn code_name(code: Code) -> &'static str {
    match code {
        Code::Ok => "OK",
        Code::Cancelled => "CANCELLED",
        Code::Unknown => "UNKNOWN",
        Code::InvalidArgument => "INVALID_ARGUMENT",
        Code::DeadlineExceeded => "DEADLINE_EXCEEDED",
        Code::NotFound => "NOT_FOUND",
        Code::AlreadyExists => "ALREADY_EXISTS",
        Code::PermissionDenied => "PERMISSION_DENIED",
        Code::ResourceExhausted => "RESOURCE_EXHAUSTED",
        Code::FailedPrecondition => "FAILED_PRECONDITION",
        Code::Aborted => "ABORTED",
        Code::OutOfRange => "OUT_OF_RANGE",
        Code::Unimplemented => "UNIMPLEMENTED",
        Code::Internal => "INTERNAL",
        Code::Unavailable => "UNAVAILABLE",
        Code::DataLoss => "DATA_LOSS",
        Code::Unauthenticated => "UNAUTHENTICATED",
    }
}

impl<S> Layer<S> for Traffic {
    type Service = TrafficService<S>;

    fn layer(&self, inner: S) -> TrafficService<S> {
        TrafficService { traffic: self.clone(), inner }
    }
}

/// A service whose calls are counted.
#[derive(Debug, Clone)]
pub struct TrafficService<S> {
    traffic: Traffic,
    inner: S,
}

impl<S, A, B> Service<Request<A>> for TrafficService<S>
where
    S: Service<Request<A>, Response = Response<B>>,
    S::Future: Send + 'static,
{
    type Response = S::Response;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<S::Response, S::Error>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, request: Request<A>) -> Self::Future {
        let (traffic, path, begun) = (self.traffic.clone(), request.uri().path().to_owned(), Instant::now());
        let answer = self.inner.call(request);
        Box::pin(async move {
            let response = answer.await?;
            traffic.record(&path, &response, begun);
            Ok(response)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_protocol_call_has_its_name_and_unknown_ones_share_one() {
        let traffic = Traffic::default();
        let answer = |code: &str| {
            let response = Response::builder().header("grpc-status", code).body(());
            response.expect("a response")
        };
        traffic.record("/femc.v1.Jobs/List", &Response::new(()), Instant::now());
        traffic.record("/femc.v1.Jobs/List", &answer("7"), Instant::now());
        traffic.record("/femc.v1.Jobs/Lisp", &answer("12"), Instant::now());
        traffic.record("/what/ever", &answer("12"), Instant::now());
        let calls: BTreeMap<(String, &str), u64> = traffic.calls.get().into_iter().collect();
        let count = |path: &str, code| calls.get(&(path.to_owned(), code)).copied();
        assert_eq!(count("/femc.v1.Jobs/List", "OK"), Some(1));
        assert_eq!(count("/femc.v1.Jobs/List", "PERMISSION_DENIED"), Some(1));
        assert_eq!(count("other", "UNIMPLEMENTED"), Some(2));
        assert_eq!(count("/femc.v1.Artifacts/Put", "OK"), Some(0), "there before the first");
        assert!(!calls.keys().any(|(path, _)| path.contains("Lisp")));
    }

    #[test]
    fn http_requests_count_by_operation_not_as_calls() {
        let traffic = Traffic::default();
        let calls = traffic.calls.get();
        let answer = |operation: Operation, status: u16| {
            let response = Response::builder().status(status).extension(operation).body(());
            response.expect("a response")
        };
        for (path, operation, status) in [
            ("/api/v1/jobs", Operation::List, 200),
            ("/api/v1/jobs/9", Operation::Status, 404),
            ("/api/v1/made/up", Operation::Other, 404),
            ("/api/v1/made/up/otherwise", Operation::Other, 404),
        ] {
            traffic.record(path, &answer(operation, status), Instant::now());
        }
        assert_eq!(traffic.calls.get(), calls, "none of them is a call");
        let requests: BTreeMap<(&str, u16), u64> = traffic.requests.get().into_iter().collect();
        let count = |operation, status| requests.get(&(operation, status)).copied();
        assert_eq!(
            (count("Jobs/List", 200), count("Jobs/Status", 200), count("Jobs/Status", 404)),
            (Some(1), Some(0), Some(1))
        );
        assert_eq!(count("other", 404), Some(2));
    }
}
