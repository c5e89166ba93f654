//! The service `Jobs`.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use femc_model::{Control, Drain, JobId, JobSpec, JobStatus, Tick, WorkerSelector};
use femc_service::{Caller, JobList, JobShape};
use tokio::sync::{mpsc, watch};
use tokio_stream::Stream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

use super::{Call, Server, audit_entry, backup, inputs};
use crate::convert::required;
use crate::error::to_status;
use crate::wire;
use wire::attempts_reply::Part;

/// Interval between checks whether a watching caller is revoked.
const REVOCATION_CHECK_INTERVAL: Duration = Duration::from_secs(1);

type Answer<T> = Result<Response<T>, Status>;

#[tonic::async_trait]
impl wire::jobs_server::Jobs for Server {
    async fn submit(&self, request: Request<wire::SubmitRequest>) -> Answer<wire::SubmitReply> {
        let caller = request.extensions().get::<Arc<Caller>>().cloned();
        let trail = audit_entry(&request);
        let wire::SubmitRequest { job, key } = request.into_inner();
        let mut spec: Box<JobSpec> = Box::new(required("job", job)?.try_into()?);
        trail.set_action(&format!("{} frames of {}", spec.frames.len(), spec.name));
        if let Some(caller) = caller {
            // The owner is the caller, so that nobody uses another owner's share.
            spec.owner = caller.holder.name().to_owned();
        }
        inputs::check_scene(&self.store, &self.promises, &spec.bundle).await.map_err(|no| to_status(&no))?;
        let job = self.call(|reply| Call::Submit { key, spec, reply }).await?;
        trail.set_job(job);
        Ok(Response::new(wire::SubmitReply { job: job.0 }))
    }

    async fn list(&self, _: Request<wire::ListRequest>) -> Answer<wire::ListReply> {
        let JobList { jobs, warnings } = self.call(|reply| Call::List { reply }).await?;
        Ok(Response::new(wire::ListReply { jobs: jobs.into_iter().map(Into::into).collect(), warnings }))
    }

    async fn status(&self, request: Request<wire::StatusRequest>) -> Answer<wire::JobStatus> {
        let job = JobId(request.into_inner().job);
        Ok(Response::new(self.call(|reply| Call::Status { job, reply }).await?.into()))
    }

    type WatchStream = Pin<Box<dyn Stream<Item = Result<wire::JobStatus, Status>> + Send>>;

    async fn watch(&self, request: Request<wire::WatchRequest>) -> Answer<Self::WatchStream> {
        let caller = request.extensions().get::<Arc<Caller>>().cloned();
        let job = JobId(request.into_inner().job);
        let statuses = self.call(|reply| Call::Watch { job, reply }).await?;
        let (send, receive) = mpsc::channel(1);
        tokio::spawn(forward_statuses(caller, statuses, send));
        Ok(Response::new(Box::pin(ReceiverStream::new(receive))))
    }

    async fn control(&self, request: Request<wire::ControlRequest>) -> Answer<wire::ControlReply> {
        let caller = request.extensions().get::<Arc<Caller>>().cloned();
        let trail = audit_entry(&request);
        let wire::ControlRequest { job, control } = request.into_inner();
        let (job, control): (JobId, Control) = (JobId(job), required("control", control)?.try_into()?);
        trail.set_job(job);
        trail.set_action(&format!("{control:?}"));
        let steered = self.farm.control_job(&self.store, caller.as_deref(), job, control).await;
        steered.map_err(|no| to_status(&no))?;
        Ok(Response::new(wire::ControlReply {}))
    }

    async fn frames(&self, request: Request<wire::FramesRequest>) -> Answer<wire::FramesReply> {
        let wire::FramesRequest { job, times } = request.into_inner();
        let job = JobId(job);
        let frames = if times {
            self.farm.frames_with_times(job).await.map_err(|no| to_status(&no))?
        } else {
            self.call(|reply| Call::Frames { job, reply }).await?
        };
        Ok(Response::new(wire::FramesReply { frames: frames.into_iter().map(Into::into).collect() }))
    }

    async fn parts(&self, request: Request<wire::PartsRequest>) -> Answer<wire::PartsReply> {
        let job = JobId(request.into_inner().job);
        let frames = self.call(|reply| Call::Parts { job, reply }).await?;
        Ok(Response::new(wire::PartsReply { frames: frames.into_iter().map(Into::into).collect() }))
    }

    async fn logs(&self, request: Request<wire::LogsRequest>) -> Answer<wire::LogsReply> {
        let wire::LogsRequest { job, since } = request.into_inner();
        let (job, since) = (JobId(job), Tick(since));
        let logs = self.call(|reply| Call::Logs { job, since, reply }).await?;
        Ok(Response::new(wire::LogsReply { logs: logs.into_iter().map(Into::into).collect() }))
    }

    type AttemptsStream = Pin<Box<dyn Stream<Item = Result<wire::AttemptsReply, Status>> + Send>>;

    async fn attempts(&self, request: Request<wire::AttemptsRequest>) -> Answer<Self::AttemptsStream> {
        let job = JobId(request.into_inner().job);
        let shape = self.call(|reply| Call::Shape { job, reply }).await?;
        let (send, receive) = mpsc::channel(1);
        tokio::spawn(send_attempt_pages(self.clone(), job, shape, send));
        Ok(Response::new(Box::pin(ReceiverStream::new(receive))))
    }

    type BackupStream = Pin<Box<dyn Stream<Item = Result<wire::BackupReply, Status>> + Send>>;

    async fn backup(&self, _: Request<wire::BackupRequest>) -> Answer<Self::BackupStream> {
        let backup = self.call(|reply| Call::Backup { reply }).await?;
        let (send, receive) = mpsc::channel(1);
        tokio::spawn(backup::send(self.store.clone(), backup, send));
        Ok(Response::new(Box::pin(ReceiverStream::new(receive))))
    }

    async fn list_workers(&self, _: Request<wire::ListWorkersRequest>) -> Answer<wire::ListWorkersReply> {
        let workers = self.call(|reply| Call::Workers { reply }).await?;
        Ok(Response::new(workers.into()))
    }

    async fn usage(&self, _: Request<wire::UsageRequest>) -> Answer<wire::UsageReply> {
        let usage = self.call(|reply| Call::Usage { reply }).await?;
        Ok(Response::new(wire::UsageReply { usage: usage.into_iter().map(Into::into).collect() }))
    }

    async fn drain_workers(&self, request: Request<wire::DrainWorkersRequest>) -> Answer<wire::DrainWorkersReply> {
        let trail = audit_entry(&request);
        let (worker, drain): (WorkerSelector, Drain) = request.into_inner().try_into()?;
        trail.set_action(&format!("{drain:?} {worker}"));
        let workers = self.call(|reply| Call::Drain { worker, drain, reply }).await?;
        Ok(Response::new(wire::DrainWorkersReply { workers: workers.into_iter().map(|worker| worker.0).collect() }))
    }
}

/// Waits until the caller is revoked.
async fn wait_until_revoked(caller: Option<&Caller>) -> Status {
    let Some(caller) = caller else { return std::future::pending().await };
    while caller.is_valid() {
        tokio::time::sleep(REVOCATION_CHECK_INTERVAL).await;
    }
    to_status(&caller.revoked_refusal())
}

/// Sends a job's shape and its attempts page by page, as fast as the client reads.
async fn send_attempt_pages(
    server: Server,
    job: JobId,
    shape: JobShape,
    send: mpsc::Sender<Result<wire::AttemptsReply, Status>>,
) {
    let mut part = Part::Job(shape.into());
    let mut from = Some(0);
    loop {
        if send.send(Ok(wire::AttemptsReply { part: Some(part) })).await.is_err() {
            return;
        }
        let Some(at) = from else { return };
        match server.call(|reply| Call::Attempts { job, from: at, reply }).await {
            Ok(page) => {
                let attempts = page.attempts.into_iter().map(Into::into).collect();
                part = Part::Attempts(wire::AttemptRecords { attempts });
                from = page.next;
            }
            // If the client is gone, the error is not needed.
            Err(status) => return drop(send.send(Err(status)).await),
        }
    }
}

/// Sends the newest status whenever there is one. A slow client misses some in between, but never the last. A revoked caller gets
/// no more.
async fn forward_statuses(
    caller: Option<Arc<Caller>>,
    mut statuses: watch::Receiver<JobStatus>,
    send: mpsc::Sender<Result<wire::JobStatus, Status>>,
) {
    loop {
        let status = statuses.borrow_and_update().clone();
        let has_ended = status.state.has_ended();
        if send.send(Ok(status.into())).await.is_err() || has_ended {
            return;
        }
        tokio::select! {
            biased;
            changed = statuses.changed() => if changed.is_err() { return },
            () = send.closed() => return,
            revoked = wait_until_revoked(caller.as_deref()) => return drop(send.send(Err(revoked)).await),
        }
        if let Some(caller) = caller.as_ref().filter(|caller| !caller.is_valid()) {
            return drop(send.send(Err(to_status(&caller.revoked_refusal()))).await);
        }
    }
}
