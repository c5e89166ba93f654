//! Waiting while there is no space for the log. Facts that are not durable are kept and not acknowledged.
//!
//! The coordinator's clock is stopped, as it is while the coordinator is down, so that no lease expires and no task seems to stall.
//! Heartbeats are answered with the lease times at which the clock stopped, so workers continue to compute. Their other messages
//! are deferred, up to a limit; beyond it, workers wait. Clients are asked to retry. So the amount of kept data is bounded, and
//! when there is space again everything resumes.

use femc_model::{FromWorker, Refusal, WorkerId};
use femc_proto::{Call, References, Reply};
use femc_queue::{Batch, Queue, QueueError, Remedy};
use femc_schedule::Command;
use tokio::sync::{mpsc, watch};
use tokio::time::Duration;

use crate::actor::{Actor, PendingReply, SessionEvent};
use crate::config::CoordinatorError;
use crate::roster::ROSTER_SUBJECT;

/// Inputs of the actor: calls, and the stop signal.
#[derive(Debug)]
pub(crate) struct ActorInputs {
    pub(crate) calls: mpsc::Receiver<Call>,
    pub(crate) stop: watch::Receiver<()>,
}

/// Batch that is not durable yet.
pub(crate) struct PendingBatch<'a> {
    pub(crate) batch: Batch<'a>,
    /// Commands that result from the batch.
    pub(crate) commands: &'a [Command],
}

impl<Q: Queue> Actor<Q> {
    /// Pause between two attempts to write.
    const RETRY_INTERVAL: Duration = Duration::from_millis(500);
    /// Maximum number of deferred session events.
    const MAX_DEFERRED: usize = 4096;

    /// Appends the batch, as soon as there is space.
    pub(crate) async fn append_when_possible(
        &mut self,
        pending: PendingBatch<'_>,
        inputs: &mut ActorInputs,
    ) -> Result<(), CoordinatorError> {
        let mut waits = false;
        loop {
            match self.queue.append(pending.batch).await {
                Err(error) if error.remedy() == Remedy::FreeSpace => {
                    if !waits {
                        tracing::error!(%error, "waiting for disk space; new requests are refused, nothing is lost");
                        self.clock.stop();
                        self.metrics.set_wait_reason(Some(error.to_string()));
                        self.refuse_waiting_callers(&error, pending.commands);
                    }
                    waits = true;
                    self.serve_while_full(error, &pending, inputs).await?;
                }
                appended => {
                    if waits {
                        tracing::info!("disk space is available again; work resumes");
                        self.clock.resume();
                        self.metrics.set_wait_reason(None);
                    }
                    return Ok(appended?);
                }
            }
        }
    }

    /// Refuses the callers that wait for an answer of these commands, with the reason. Their requests take effect all the same when
    /// there is space. This is safe: a submission with a key can be repeated, and so can a control.
    fn refuse_waiting_callers(&mut self, error: &QueueError, commands: &[Command]) {
        for command in commands {
            let Command::Answer { request, answer: Ok(_) } = command else { continue };
            let no = || Refusal::Unavailable {
                message: format!("{error}; the request takes effect as soon as there is space"),
            };
            match self.pending.remove(request) {
                Some(PendingReply::Submit(reply)) => refuse(reply, no()),
                Some(PendingReply::Control(reply)) => refuse(reply, no()),
                None => {}
            }
        }
    }

    /// Serves workers and callers for one pause.
    async fn serve_while_full(
        &mut self,
        error: QueueError,
        pending: &PendingBatch<'_>,
        inputs: &mut ActorInputs,
    ) -> Result<(), CoordinatorError> {
        let mut pause = std::pin::pin!(tokio::time::sleep(Self::RETRY_INTERVAL));
        loop {
            self.queue.check()?;
            self.disks.check_in_background(&mut self.disks_checked);
            tokio::select! {
                biased;
                _ = inputs.stop.changed() => return Err(error.into()),
                () = &mut pause => return Ok(()),
                Some((worker, event)) = self.session_inbox.recv(), if self.deferred.len() < Self::MAX_DEFERRED => {
                    self.defer(worker, event);
                }
                Some(call) = inputs.calls.recv() => self.refuse_call(call, &error, pending),
                Some(watcher) = self.metrics_requests.recv() => self.send_figures(watcher),
            }
        }
    }

    /// Answers a heartbeat. Defers all other events.
    fn defer(&mut self, worker: WorkerId, event: SessionEvent) {
        if let SessionEvent::Message(said) = &event
            && let FromWorker::Heartbeat { number, usage, .. } = &**said
        {
            self.answer_heartbeat(worker, *number, self.clock.now());
            if usage.is_empty() {
                return;
            }
        }
        self.deferred.push_back((worker, event));
    }

    /// Refuses a call, except for [`Call::References`] where possible. The answer is lost if the caller has disconnected.
    fn refuse_call(&self, call: Call, error: &QueueError, pending: &PendingBatch<'_>) {
        let no = || Refusal::Unavailable {
            message: format!("{error}; nothing is lost, and work resumes as soon as there is space"),
        };
        match call {
            Call::Submit { key, reply, .. } if self.is_known_key(key.as_deref()) => refuse(reply, no()),
            Call::Submit { reply, .. } => {
                let refusal = self.disks.refusal().unwrap_or(Refusal::NoRoom { place: "the log".into(), free: 0 });
                drop(reply.send(Err(refusal)));
            }
            // Garbage collection can make space, so this call is answered. Facts that are not durable yet may have released
            // artifacts that the log still names, so these are added.
            Call::References { reply } if pending.batch.forgotten.iter().all(|subject| *subject == ROSTER_SUBJECT) => {
                let References { mut artifacts, scenes } = self.references();
                let released = pending.commands.iter().flat_map(|command| match command {
                    Command::Discard(digests) => digests.as_slice(),
                    _ => &[],
                });
                artifacts.extend(released);
                drop(reply.send(Ok(References { artifacts, scenes })));
            }
            // The worker reconnects later with its results.
            Call::Session(session) => drop(session),
            Call::Control { reply, .. } => refuse(reply, no()),
            Call::List { reply } => refuse(reply, no()),
            Call::Changes { reply, .. } => refuse(reply, no()),
            Call::Status { reply, .. } => refuse(reply, no()),
            Call::Watch { reply, .. } => refuse(reply, no()),
            Call::Parts { reply, .. } => refuse(reply, no()),
            Call::Producer { reply, .. } => refuse(reply, no()),
            Call::Frames { reply, .. } => refuse(reply, no()),
            Call::Drain { reply, .. } => refuse(reply, no()),
            Call::Logs { reply, .. } => refuse(reply, no()),
            Call::Shape { reply, .. } => refuse(reply, no()),
            Call::FrameTable { reply, .. } => refuse(reply, no()),
            Call::Tasks { reply, .. } => refuse(reply, no()),
            Call::Attempts { reply, .. } => refuse(reply, no()),
            Call::Workers { reply } => refuse(reply, no()),
            Call::Usage { reply } => refuse(reply, no()),
            Call::ArtifactLost { reply, .. } => refuse(reply, no()),
            Call::References { reply } => refuse(reply, no()),
            Call::Backup { reply } => refuse(reply, no()),
        }
    }
}

fn refuse<T>(reply: Reply<T>, refusal: Refusal) {
    drop(reply.send(Err(refusal)));
}
