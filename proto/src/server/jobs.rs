//! The service `Jobs`.

use std::pin::Pin;
use std::sync::Arc;

use femc_model::{JobId, JobSpec, JobStatus, Tick};
use femc_trust::{Holder, Role};
use tokio::sync::{mpsc, watch};
use tokio_stream::Stream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

use super::{Call, Caller, JobShape, Server, backup, inputs};
use crate::convert::need;
use crate::error::to_status;
use crate::wire;
use wire::attempts_reply::Part;

type Answer<T> = Result<Response<T>, Status>;

#[tonic::async_trait]
impl wire::jobs_server::Jobs for Server {
    async fn submit(&self, request: Request<wire::SubmitRequest>) -> Answer<wire::SubmitReply> {
        let caller = request.extensions().get::<Arc<Caller>>().cloned();
        let wire::SubmitRequest { job, key } = request.into_inner();
        let mut spec: Box<JobSpec> = Box::new(need("job", job)?.try_into()?);
        if let Some(caller) = caller {
            // Nobody spends another's share.
            spec.owner = caller.holder.name().to_owned();
        }
        inputs::check(&self.store, &self.promised, &spec.bundle).await.map_err(|no| to_status(&no))?;
        let JobId(job) = self.ask(|reply| Call::Submit { key, spec, reply }).await?;
        Ok(Response::new(wire::SubmitReply { job }))
    }

    async fn list(&self, _: Request<wire::ListRequest>) -> Answer<wire::ListReply> {
        let jobs = self.ask(|reply| Call::List { reply }).await?;
        Ok(Response::new(wire::ListReply { jobs: jobs.into_iter().map(Into::into).collect() }))
    }

    async fn status(&self, request: Request<wire::StatusRequest>) -> Answer<wire::JobStatus> {
        let job = JobId(request.into_inner().job);
        Ok(Response::new(self.ask(|reply| Call::Status { job, reply }).await?.into()))
    }

    type WatchStream = Pin<Box<dyn Stream<Item = Result<wire::JobStatus, Status>> + Send>>;

    async fn watch(&self, request: Request<wire::WatchRequest>) -> Answer<Self::WatchStream> {
        let job = JobId(request.into_inner().job);
        let statuses = self.ask(|reply| Call::Watch { job, reply }).await?;
        let (send, receive) = mpsc::channel(1);
        tokio::spawn(forward(statuses, send));
        Ok(Response::new(Box::pin(ReceiverStream::new(receive))))
    }

    async fn control(&self, request: Request<wire::ControlRequest>) -> Answer<wire::ControlReply> {
        let caller = request.extensions().get::<Arc<Caller>>().cloned();
        let wire::ControlRequest { job, control } = request.into_inner();
        let (job, control) = (JobId(job), need("control", control)?.try_into()?);
        if let Some(caller) = caller {
            self.may_steer(&caller, job).await?;
        }
        self.ask(|reply| Call::Control { job, control, reply }).await?;
        Ok(Response::new(wire::ControlReply {}))
    }

    async fn frames(&self, request: Request<wire::FramesRequest>) -> Answer<wire::FramesReply> {
        let job = JobId(request.into_inner().job);
        let frames = self.ask(|reply| Call::Frames { job, reply }).await?;
        Ok(Response::new(wire::FramesReply { frames: frames.into_iter().map(Into::into).collect() }))
    }

    async fn parts(&self, request: Request<wire::PartsRequest>) -> Answer<wire::PartsReply> {
        let job = JobId(request.into_inner().job);
        let frames = self.ask(|reply| Call::Parts { job, reply }).await?;
        Ok(Response::new(wire::PartsReply { frames: frames.into_iter().map(Into::into).collect() }))
    }

    async fn logs(&self, request: Request<wire::LogsRequest>) -> Answer<wire::LogsReply> {
        let wire::LogsRequest { job, since } = request.into_inner();
        let (job, since) = (JobId(job), Tick(since));
        let logs = self.ask(|reply| Call::Logs { job, since, reply }).await?;
        Ok(Response::new(wire::LogsReply { logs: logs.into_iter().map(Into::into).collect() }))
    }

    type AttemptsStream = Pin<Box<dyn Stream<Item = Result<wire::AttemptsReply, Status>> + Send>>;

    async fn attempts(&self, request: Request<wire::AttemptsRequest>) -> Answer<Self::AttemptsStream> {
        let job = JobId(request.into_inner().job);
        let shape = self.ask(|reply| Call::Shape { job, reply }).await?;
        let (send, receive) = mpsc::channel(1);
        tokio::spawn(pages(self.clone(), job, shape, send));
        Ok(Response::new(Box::pin(ReceiverStream::new(receive))))
    }

    type BackupStream = Pin<Box<dyn Stream<Item = Result<wire::BackupReply, Status>> + Send>>;

    async fn backup(&self, _: Request<wire::BackupRequest>) -> Answer<Self::BackupStream> {
        let backup = self.ask(|reply| Call::Backup { reply }).await?;
        let (send, receive) = mpsc::channel(1);
        tokio::spawn(backup::send(self.store.clone(), backup, send));
        Ok(Response::new(Box::pin(ReceiverStream::new(receive))))
    }

    async fn list_workers(&self, _: Request<wire::ListWorkersRequest>) -> Answer<wire::ListWorkersReply> {
        let workers = self.ask(|reply| Call::Workers { reply }).await?;
        Ok(Response::new(wire::ListWorkersReply { workers: workers.into_iter().map(Into::into).collect() }))
    }

    async fn drain_workers(&self, request: Request<wire::DrainWorkersRequest>) -> Answer<wire::DrainWorkersReply> {
        let (worker, drain) = request.into_inner().try_into()?;
        let workers = self.ask(|reply| Call::Drain { worker, drain, reply }).await?;
        Ok(Response::new(wire::DrainWorkersReply { workers: workers.into_iter().map(|worker| worker.0).collect() }))
    }
}

impl Server {
    /// A submitter steers jobs of its own, others need an operator.
    async fn may_steer(&self, caller: &Caller, job: JobId) -> Result<(), Status> {
        match &caller.holder {
            Holder::User { role: Role::Operator | Role::Admin, .. } => Ok(()),
            Holder::User { name, .. } if self.ask(|reply| Call::Status { job, reply }).await?.owner == *name => Ok(()),
            Holder::User { .. } | Holder::Worker { .. } | Holder::Coordinator { .. } => {
                Err(caller.forbidden("the job's owner, or a user of role operator"))
            }
        }
    }
}

/// Sends what a job is made of and its attempts, page by page, as fast as the listener reads.
async fn pages(server: Server, job: JobId, shape: JobShape, send: mpsc::Sender<Result<wire::AttemptsReply, Status>>) {
    let mut part = Part::Job(shape.into());
    let mut from = Some(0);
    loop {
        if send.send(Ok(wire::AttemptsReply { part: Some(part) })).await.is_err() {
            return;
        }
        let Some(at) = from else { return };
        match server.ask(|reply| Call::Attempts { job, from: at, reply }).await {
            Ok(page) => {
                let attempts = page.attempts.into_iter().map(Into::into).collect();
                part = Part::Attempts(wire::AttemptRecords { attempts });
                from = page.next;
            }
            // Who does not listen any more need not hear it.
            Err(status) => return drop(send.send(Err(status)).await),
        }
    }
}

/// Sends the newest status whenever there is one; a slow listener misses the ones between, never the last.
async fn forward(mut statuses: watch::Receiver<JobStatus>, send: mpsc::Sender<Result<wire::JobStatus, Status>>) {
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
        }
    }
}
