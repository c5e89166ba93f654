//! Tests of standard gRPC services, for programs that do not know femc: health checks and reflection.

use std::time::Duration;

use femc_coordinator::{Config, Coordinator};
use tokio_stream::StreamExt as _;
use tonic::transport::Channel;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use tonic_health::pb::{HealthCheckRequest, HealthCheckResponse};
use tonic_reflection::pb::v1::ServerReflectionRequest;
use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;

async fn channel(url: String) -> Channel {
    Channel::from_shared(url).unwrap().connect().await.unwrap()
}

#[tokio::test]
async fn a_coordinator_serves_until_it_stops_and_says_so() {
    let farm = Coordinator::start(Config::default()).await.unwrap();
    let mut health = HealthClient::new(channel(farm.url()).await);
    for service in ["", "femc.v1.Jobs", "femc.v1.Workers", "femc.v1.Artifacts"] {
        let request = HealthCheckRequest { service: service.into() };
        let answer = health.check(request).await.unwrap().into_inner();
        assert_eq!(answer.status(), ServingStatus::Serving, "{service}");
    }
    let request = HealthCheckRequest { service: "femc.v1.Jobs".into() };
    let mut watch = health.watch(request).await.unwrap().into_inner();
    let status = async |watch: &mut tonic::Streaming<HealthCheckResponse>| {
        let next = tokio::time::timeout(Duration::from_secs(20), watch.next()).await.unwrap();
        next.unwrap().unwrap().status()
    };
    assert_eq!(status(&mut watch).await, ServingStatus::Serving);
    let stopped = tokio::spawn(farm.stop());
    assert_eq!(status(&mut watch).await, ServingStatus::NotServing, "it says so before the connection ends");
    stopped.await.unwrap().unwrap();
}

#[tokio::test]
async fn a_coordinator_tells_what_it_understands() {
    let farm = Coordinator::start(Config::default()).await.unwrap();
    let mut reflection = ServerReflectionClient::new(channel(farm.url()).await);
    let asks =
        [MessageRequest::ListServices(String::new()), MessageRequest::FileContainingSymbol("femc.v1.Jobs".into())];
    let asks = asks.map(|ask| ServerReflectionRequest { host: String::new(), message_request: Some(ask) });
    let mut answers = reflection.server_reflection_info(tokio_stream::iter(asks)).await.unwrap().into_inner();
    let mut answer = async || answers.message().await.unwrap().unwrap().message_response.unwrap();
    let MessageResponse::ListServicesResponse(list) = answer().await else { panic!("no list") };
    let names: Vec<&str> = list.service.iter().map(|service| service.name.as_str()).collect();
    assert!(
        ["femc.v1.Jobs", "femc.v1.Workers", "femc.v1.Artifacts"].iter().all(|name| names.contains(name)),
        "{names:?}"
    );
    let MessageResponse::FileDescriptorResponse(file) = answer().await else { panic!("no file") };
    let text = String::from_utf8_lossy(&file.file_descriptor_proto[0]).into_owned();
    assert!(text.contains("DrainWorkers"), "the file itself");
}
