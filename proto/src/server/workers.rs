//! The service `Workers`.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use femc_model::FromWorker;
use femc_service::Caller;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tokio_stream::{Stream, StreamExt as _};
use tonic::{Request, Response, Status, Streaming};

use super::{Call, Server, Session, WorkerMessages, audit_entry};
use crate::batch::batch_ready;
use crate::wire;

/// Number of messages that may wait for a slow worker before its session is ended.
const MAX_QUEUED_MESSAGES: usize = 1024;

/// Time limit for the first message of a new session.
const REGISTRATION_TIMEOUT: Duration = Duration::from_secs(10);

#[tonic::async_trait]
impl wire::workers_server::Workers for Server {
    type SessionStream = Pin<Box<dyn Stream<Item = Result<wire::ToWorker, Status>> + Send>>;

    async fn session(
        &self,
        request: Request<Streaming<wire::FromWorker>>,
    ) -> Result<Response<Self::SessionStream>, Status> {
        let caller = request.extensions().get::<Arc<Caller>>().cloned();
        let trail = audit_entry(&request);
        let mut messages = request.into_inner();
        let first = tokio::time::timeout(REGISTRATION_TIMEOUT, messages.message()).await;
        let first = first.map_err(|_| Status::deadline_exceeded("the worker did not register"))??;
        let first = first.ok_or_else(|| Status::invalid_argument("the worker did not register"))?;
        let FromWorker::Register(registration) = FromWorker::try_from(first)? else {
            return Err(Status::invalid_argument("the first message must register the worker"));
        };
        trail.set_action(&format!("worker {}", registration.name));
        let (out, receive) = mpsc::channel(MAX_QUEUED_MESSAGES);
        let session = Session { registration, messages: WorkerMessages::new(messages, caller), out };
        if !self.farm.send(Call::Session(Box::new(session))).await {
            return Err(Status::unavailable("the coordinator is stopping"));
        }
        Ok(Response::new(Box::pin(batch_ready(ReceiverStream::new(receive).map(Into::into)).map(Ok))))
    }
}
