//! Tests that spans reach a collector, with the ids of their jobs and tasks: cargo test -p femc --features otel --test suite otel
#![cfg(feature = "otel")]

use crate::common;
use crate::common::{TestFolder, start_coordinator, submit};
use opentelemetry_proto::tonic::collector::trace::v1::trace_service_server::{TraceService, TraceServiceServer};
use opentelemetry_proto::tonic::collector::trace::v1::{ExportTraceServiceRequest, ExportTraceServiceResponse};
use opentelemetry_proto::tonic::common::v1::any_value::Value;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use tonic::{Request, Response, Status};

/// Name and attributes of each span.
type Spans = Arc<Mutex<Vec<(String, BTreeMap<String, String>)>>>;

#[derive(Clone, Default)]
struct Collector(Spans);

#[tonic::async_trait]
impl TraceService for Collector {
    async fn export(
        &self,
        request: Request<ExportTraceServiceRequest>,
    ) -> Result<Response<ExportTraceServiceResponse>, Status> {
        for span in
            request.into_inner().resource_spans.into_iter().flat_map(|one| one.scope_spans).flat_map(|one| one.spans)
        {
            let text = |value: Option<Value>| match value {
                Some(Value::StringValue(text)) => text,
                Some(Value::IntValue(number)) => number.to_string(),
                other => format!("{other:?}"),
            };
            let attributes =
                span.attributes.into_iter().map(|pair| (pair.key, text(pair.value.and_then(|any| any.value))));
            self.0.lock().expect("nobody panicked").push((span.name, attributes.collect()));
        }
        Ok(Response::new(ExportTraceServiceResponse::default()))
    }
}

#[test]
fn the_spans_of_a_job_s_tasks_come_to_the_collector() {
    let collector = Collector::default();
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let listener = runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0")).expect("a port");
    let endpoint = format!("http://{}", listener.local_addr().expect("its address"));
    let incoming = tonic::transport::server::TcpIncoming::from(listener);
    let service = TraceServiceServer::new(collector.clone());
    runtime.spawn(tonic::transport::Server::builder().add_service(service).serve_with_incoming(incoming));

    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    let mut command = dir.command(&format!("worker --join {url} --threads 1 --idle-exit 700ms"));
    let mut worker = common::TestProcess::spawn(command.env("OTEL_EXPORTER_OTLP_ENDPOINT", endpoint));
    let job = submit(&dir, &url, "--spp 1 --frames 1");
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    worker.end().exits(0);

    let spans = collector.0.lock().expect("nobody panicked").clone();
    let tasks: Vec<&str> =
        spans.iter().filter(|(name, _)| name == "task").map(|(_, has)| has["task"].as_str()).collect();
    assert_eq!(tasks.len(), 5, "four tiles and the image: {spans:?}");
    assert!(tasks.contains(&"1/1.0/image.1/0"), "{tasks:?}");
    assert!(spans.iter().any(|(name, has)| name == "session" && has.contains_key("worker")), "{spans:?}");
}
