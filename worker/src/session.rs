//! One session with the coordinator, from registration to the end of the connection.

use std::collections::BTreeMap;
use std::future::Future;
use std::pin::Pin;
use std::sync::{Arc, mpsc};
use std::time::Duration;

use femc_model::{Epoch, Failure, FromWorker, JobId, JobSpec, Phase, Registration, TaskKey, ToWorker, Work};
use femc_proto::{CallError, Client, Incoming, Outgoing};
use tokio::sync::mpsc::UnboundedReceiver;

use crate::config::AtStop;
use crate::execute::Product;
use crate::fetch;
use crate::table::{Table, Task};
use crate::threads::{Ahead, Finished};

/// Why a session ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum End {
    /// The coordinator ended it, or is gone.
    Lost,
    /// The worker was told to stop.
    Stopped,
}

/// The worker's part of a session.
pub(crate) struct Session<'a> {
    pub(crate) client: Client,
    pub(crate) table: &'a Arc<Table>,
    pub(crate) ahead: &'a mpsc::Sender<Ahead>,
    pub(crate) finished: &'a mut UnboundedReceiver<Finished>,
    at_stop: AtStop,
    jobs: BTreeMap<JobId, Arc<JobSpec>>,
}

impl<'a> Session<'a> {
    /// How long the coordinator may take to hear of the end.
    const FAREWELL: Duration = Duration::from_millis(500);

    pub(crate) fn new(
        client: Client,
        table: &'a Arc<Table>,
        ahead: &'a mpsc::Sender<Ahead>,
        finished: &'a mut UnboundedReceiver<Finished>,
        at_stop: AtStop,
    ) -> Self {
        Self { client, table, ahead, finished, at_stop, jobs: BTreeMap::new() }
    }

    /// Works until the session or the worker ends. When the session is lost, what runs goes on, and results are kept for the
    /// next one.
    pub(crate) async fn run<S: Future<Output = ()>>(
        mut self,
        registration: Registration,
        mut stop: Pin<&mut S>,
    ) -> Result<End, CallError> {
        let (out, mut incoming) = tokio::select! {
            biased;
            session = self.client.session(registration) => session?,
            () = &mut stop => return Ok(End::Stopped),
        };
        let mut heartbeat = tokio::time::interval(Duration::from_millis(500));
        heartbeat.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut draining = false;
        let end = loop {
            if draining && self.table.is_empty() {
                break Ok(End::Stopped);
            }
            tokio::select! {
                biased;
                () = &mut stop, if !draining => {
                    if self.at_stop == AtStop::GiveBack {
                        break Ok(End::Stopped);
                    }
                    draining = true;
                    out.send(FromWorker::Draining).await;
                    give_back(self.table.clear_line(), &out).await;
                }
                _ = heartbeat.tick() => out.send(FromWorker::Heartbeat(self.table.progress())).await,
                Some((key, outcome)) = self.finished.recv() => {
                    // Of a lease that is over, nobody wants to hear.
                    if let Some(task) = self.table.get(&key) {
                        task.settle(outcome);
                        self.send(task, &out);
                    }
                }
                message = incoming.next() => match message {
                    Ok(Some(ToWorker::Welcome { worker, heartbeat: pause })) => {
                        tracing::info!(%worker, url = self.client.url(), "joined");
                        // Results that an earlier session did not get rid of.
                        let kept = self.table.held().into_iter().filter(|task| task.outcome().is_some());
                        kept.for_each(|task| self.send(task, &out));
                        heartbeat = tokio::time::interval(Duration::from_millis(pause.max(10)));
                        heartbeat.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
                    }
                    Ok(Some(ToWorker::Goodbye) | None) => break Ok(End::Lost),
                    Ok(Some(message)) => self.hear(message),
                    Err(error) => break Err(error),
                },
            }
        };
        // Once asked to stop it does not look for the coordinator again.
        let end = if draining { Ok(End::Stopped) } else { end };
        if matches!(end, Ok(End::Stopped)) {
            Self::farewell(self.table.clear(), out, incoming).await;
        }
        end
    }

    fn hear(&mut self, message: ToWorker) {
        match message {
            ToWorker::Job { job, spec } => drop(self.jobs.insert(job, Arc::from(spec))),
            ToWorker::Assign(assignment) => {
                let Some(spec) = self.jobs.get(&assignment.task.job) else {
                    tracing::warn!(task = %assignment.task, "a task of a job that was not told");
                    return;
                };
                if let Work::Render { .. } = assignment.work {
                    let (spec, frame) = (spec.clone(), assignment.task.stage.frame);
                    // Without its thread the worker is ending.
                    let _ = self.ahead.send(Ahead { spec, frame, client: self.client.clone() });
                }
                self.table.put(Arc::new(Task::new(assignment, spec.clone(), self.client.clone())));
            }
            ToWorker::Revoke { task, epoch, reason } => {
                tracing::debug!(%task, ?reason, "lease taken back");
                self.table.drop_task(&(task, epoch));
            }
            ToWorker::Accepted { task, epoch } => self.table.drop_task(&(task, epoch)),
            ToWorker::Refused { task, epoch, refusal } => {
                tracing::info!(%task, %refusal, "report refused");
                self.table.drop_task(&(task, epoch));
            }
            ToWorker::Welcome { .. } | ToWorker::Goodbye => {}
        }
    }

    /// Sends a result's artefacts and then the result, while the next task runs.
    fn send(&self, done: Arc<Task>, out: &Outgoing) {
        let (client, out) = (self.client.clone(), out.clone());
        tokio::spawn(async move {
            let Some(outcome) = done.outcome() else { return };
            let (task, epoch) = done.key();
            done.enter(Phase::Uploading);
            let sent = match outcome {
                Ok(product) => upload(&client, product).await.map(|()| product.result.clone()),
                Err(failure) => Err(failure.clone()),
            };
            out.send(match sent {
                Ok(result) => FromWorker::Completed { task, epoch, result },
                Err(failure) => FromWorker::Failed { task, epoch, failure },
            })
            .await;
        });
    }

    /// Gives back what is held, so that nobody waits for deadlines.
    async fn farewell(held: Vec<(TaskKey, Epoch)>, out: Outgoing, mut incoming: Incoming) {
        give_back(held, &out).await;
        drop(out);
        let end = async { while let Ok(Some(_)) = incoming.next().await {} };
        let _ = tokio::time::timeout(Self::FAREWELL, end).await;
    }
}

async fn give_back(tasks: Vec<(TaskKey, Epoch)>, out: &Outgoing) {
    for (task, epoch) in tasks {
        out.send(FromWorker::Failed { task, epoch, failure: Failure::Cancelled }).await;
    }
}

async fn upload(client: &Client, product: &Product) -> Result<(), Failure> {
    for bytes in &product.artefacts {
        client.put(bytes.clone()).await.map_err(|error| fetch::failure(&error))?;
    }
    Ok(())
}
