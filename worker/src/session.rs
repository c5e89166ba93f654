//! A session with the coordinator, from registration to the end of the connection.

use std::collections::BTreeSet;
use std::future::Future;
use std::pin::Pin;
use std::sync::{Arc, mpsc};
use std::time::Duration;

use femc_fault::{Point, pass_async};
use femc_model::{
    Epoch, Failure, FromWorker, Intake, JobId, JobSpec, Latest, Near, Phase, Registration, TaskKey, TaskLog,
    TaskResult, TaskUsage, ToWorker, Usage,
};
use femc_proto::{CallError, Client, Incoming, Outgoing, Why};
use tokio::sync::mpsc::UnboundedReceiver;
use tokio::task::JoinSet;
use tokio::time::{Instant, Interval, MissedTickBehavior};

use crate::availability::Availability;
use crate::claims::Claims;
use crate::config::{AtStop, Config};
use crate::meter::Meter;
use crate::outbox::Outbox;
use crate::table::{Table, Task};
use crate::threads::Ahead;
use crate::upload::{NotSent, upload, upload_log};

/// Reason for the end of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum End {
    /// The coordinator ended the session or is gone.
    Lost,
    /// The worker was asked to stop.
    Stopped,
}

/// An uploaded result, or the reason why it was not uploaded.
type Sent = ((TaskKey, Epoch), Result<TaskResult, NotSent>, Option<TaskLog>, Option<Usage>);

/// The worker's side of a session.
pub(crate) struct Session<'a> {
    client: Client,
    table: &'a Arc<Table>,
    outbox: &'a Outbox,
    ahead: &'a mpsc::Sender<Ahead>,
    finished: &'a mut UnboundedReceiver<(TaskKey, Epoch)>,
    config: &'a Config,
    /// Availability last reported to the coordinator.
    availability: Availability,
    /// Specs of the latest jobs; more of them than the coordinator relies on.
    jobs: Latest<JobId, Arc<JobSpec>>,
    claims: Claims,
    /// Uploads in progress; they end with the session.
    uploads: JoinSet<Sent>,
    meter: &'a Meter,
    /// Usage of revoked leases, to be reported with the next heartbeat.
    usage: Vec<TaskUsage>,
    /// Results that are being uploaded or are reported, but not answered.
    sending: BTreeSet<(TaskKey, Epoch)>,
}

impl<'a> Session<'a> {
    /// Time limit for saying goodbye to the coordinator.
    const FAREWELL: Duration = Duration::from_millis(500);

    pub(crate) fn new(
        client: Client,
        table: &'a Arc<Table>,
        outbox: &'a Outbox,
        ahead: &'a mpsc::Sender<Ahead>,
        finished: &'a mut UnboundedReceiver<(TaskKey, Epoch)>,
        config: &'a Config,
        meter: &'a Meter,
    ) -> Self {
        Self {
            client,
            table,
            outbox,
            ahead,
            finished,
            config,
            availability: Availability::Available,
            jobs: Latest::new(4 * JobSpec::SESSION_SPECS),
            claims: Claims::new(Instant::now()),
            uploads: JoinSet::new(),
            meter,
            usage: Vec::new(),
            sending: BTreeSet::new(),
        }
    }

    /// Works until the session or the worker ends. When the session is lost, running tasks continue, and results are kept for the
    /// next session.
    pub(crate) async fn run<S: Future<Output = ()>>(
        mut self,
        registration: Registration,
        mut stop: Pin<&mut S>,
    ) -> Result<End, CallError> {
        let silent = || CallError::Unreachable {
            url: self.client.url().into(),
            message: format!("no message for {} s", Claims::INTRODUCTION.as_secs()),
            why: Why::Away,
        };
        let (out, mut incoming) = tokio::select! {
            biased;
            session = self.client.session(registration) => session?,
            () = &mut stop => return Ok(End::Stopped),
            () = tokio::time::sleep(Claims::INTRODUCTION) => return Err(silent()),
        };
        let mut heartbeat: Option<Interval> = None;
        // Deadline for the running tasks, set once the worker is asked to stop.
        let mut until: Option<Instant> = None;
        let end = loop {
            let draining = until.is_some();
            if draining && self.table.is_empty() {
                break Ok(End::Stopped);
            }
            tokio::select! {
                biased;
                () = &mut stop, if !draining => {
                    let AtStop::Finish { within } = self.config.at_stop else { break Ok(End::Stopped) };
                    until = Some(later(within));
                    out.send(FromWorker::Draining).await;
                    give_back(self.table.clear_line(), &out).await;
                }
                () = at(until) => {
                    tracing::warn!("grace period over: returning unfinished tasks");
                    break Ok(End::Stopped);
                }
                () = next(&mut heartbeat) => {
                    if !draining {
                        self.apply_hours(&out).await;
                    }
                    self.beat(&out).await;
                }
                Some(key) = self.finished.recv() => self.send(key),
                Some(sent) = self.uploads.join_next(), if !self.uploads.is_empty() => {
                    // An upload that panicked or was aborted has nothing to report.
                    if let Ok(sent) = sent {
                        self.report(sent, &out).await;
                    }
                }
                message = incoming.next() => match message {
                    Ok(Some(ToWorker::Welcome { worker, heartbeat: pause, lease })) => {
                        tracing::Span::current().record("worker", worker.0);
                        tracing::info!(url = self.client.url(), "joined");
                        self.config.metrics.connected();
                        self.config.journal.death_reported();
                        self.claims.welcomed(lease);
                        let every = Duration::from_millis(pause.max(10));
                        let pulse = heartbeat.insert(tokio::time::interval(every));
                        pulse.set_missed_tick_behavior(MissedTickBehavior::Delay);
                        self.apply_hours(&out).await;
                    }
                    Ok(Some(ToWorker::Goodbye) | None) => break Ok(End::Lost),
                    Ok(Some(message)) => self.hear(message, &out).await,
                    Err(error) => break Err(error),
                },
                // This branch is last, so that messages which have arrived meanwhile are read first.
                () = tokio::time::sleep_until(self.claims.end()) => {
                    tracing::warn!(url = self.client.url(), "coordinator is silent: the leases count as expired");
                    break Ok(End::Lost);
                }
            }
        };
        // A worker that is asked to stop does not reconnect.
        let end = if until.is_some() { Ok(End::Stopped) } else { end };
        if matches!(end, Ok(End::Stopped)) {
            Self::farewell(self.table.clear(), out, incoming).await;
        }
        end
    }

    /// Reports to the coordinator when the worker's hours begin or end. At their end, waiting tasks are given back.
    async fn apply_hours(&mut self, out: &Outgoing) {
        let availability = self.config.shift.now();
        if availability == self.availability {
            return;
        }
        self.availability = availability;
        match availability {
            Availability::Available => {
                tracing::info!("on duty");
                out.send(FromWorker::Available).await;
            }
            Availability::Off => {
                tracing::info!("off duty: finishing running tasks");
                out.send(FromWorker::Draining).await;
                give_back(self.table.clear_line(), out).await;
            }
        }
    }

    /// Sends a heartbeat with the progress of the tasks.
    async fn beat(&mut self, out: &Outgoing) {
        let now = Instant::now();
        let held = self.table.held();
        let claimed = held.iter().filter(|task| self.claims.holds(&task.key(), now));
        let tasks = claimed.map(|task| task.progress()).collect();
        let number = self.claims.beat(now);
        out.send(FromWorker::Heartbeat { number, tasks, usage: std::mem::take(&mut self.usage) }).await;
    }

    async fn hear(&mut self, message: ToWorker, out: &Outgoing) {
        match message {
            ToWorker::Job { job, spec } => self.jobs.put(job, Arc::from(spec)),
            ToWorker::Assign(assignment) => {
                let Some(spec) = self.jobs.get(&assignment.task.job) else {
                    let (task, job) = (assignment.task, assignment.task.job);
                    tracing::warn!(%task, "assignment for job {job}, whose spec this worker never received");
                    return;
                };
                let task = (assignment.task, assignment.epoch);
                if self.availability == Availability::Off {
                    // The coordinator assigned this task before it received the notice.
                    let failure = Failure::Cancelled;
                    let (task, epoch) = task;
                    return out.send(FromWorker::Failed { task, epoch, failure, log: None, usage: None }).await;
                }
                let wants_frame = assignment.task.stage.kind.row().near == Near::Frame;
                let is_ahead = wants_frame && !self.config.journal.is_careful();
                let ahead = is_ahead.then(|| {
                    let (spec, frame) = (spec.clone(), assignment.task.stage.frame);
                    Ahead { spec, frame, client: self.client.clone(), task }
                });
                self.claims.assigned(task, assignment.lease);
                self.table.put(Arc::new(Task::new(assignment, spec.clone(), self.client.clone(), self.meter)));
                // If that thread is gone, the worker is ending.
                ahead.into_iter().for_each(|ahead| drop(self.ahead.send(ahead)));
            }
            ToWorker::Renewed { heartbeat, leases, intake } => {
                self.claims.renewed(heartbeat, &leases);
                if intake == Intake::Drained {
                    give_back(self.table.clear_line(), out).await;
                }
                // Send the results that an earlier session could not deliver, and those whose upload failed.
                leases.iter().for_each(|lease| self.send((lease.task, lease.epoch)));
            }
            ToWorker::Revoke { task, epoch, reason } => {
                tracing::debug!(%task, ?reason, "the lease was revoked");
                let Some(held) = self.forget((task, epoch)) else { return };
                self.config.metrics.revoked(&held);
                self.usage.extend(held.usage().map(|usage| TaskUsage { task, epoch, usage }));
            }
            ToWorker::Accepted { task, epoch } => {
                pass_async(Point::WorkerBeforeForget).await;
                self.forget((task, epoch)).iter().for_each(|task| self.config.metrics.accepted(task));
            }
            ToWorker::Refused { task, epoch, refusal } => {
                tracing::info!(%task, %refusal, "report refused");
                self.forget((task, epoch)).iter().for_each(|task| self.config.metrics.refused(task));
            }
            ToWorker::Welcome { .. } | ToWorker::Goodbye => {}
        }
    }

    /// Drops a task whose lease is over: it is done, reassigned or no longer wanted.
    fn forget(&mut self, key: (TaskKey, Epoch)) -> Option<Arc<Task>> {
        self.claims.forget(&key);
        self.sending.remove(&key);
        self.outbox.answered(self.table, &key)
    }

    /// Uploads a result's artifacts while the next task runs. If the lease may be over, nothing is uploaded until the coordinator
    /// says that the lease holds.
    fn send(&mut self, key: (TaskKey, Epoch)) {
        let Some(task) = self.table.get(&key) else { return };
        if task.outcome().is_none() || !self.claims.holds(&key, Instant::now()) || !self.sending.insert(key) {
            return;
        }
        task.enter(Phase::Uploading);
        let client = self.client.clone();
        self.uploads.spawn(async move {
            pass_async(Point::WorkerBeforeUpload).await;
            let sent = match task.outcome() {
                Some(Ok(product)) => upload(&client, &task, product).await.map(|()| product.result.clone()),
                Some(Err(failure)) => Err(NotSent::Failed(failure.clone())),
                None => Err(NotSent::Later),
            };
            let log = upload_log(&client, &task).await;
            pass_async(Point::WorkerAfterUpload).await;
            (key, sent, log, task.usage())
        });
    }

    /// Reports a result whose artifacts are in the store, if its lease still holds.
    async fn report(&mut self, (key, sent, log, usage): Sent, out: &Outgoing) {
        let (task, epoch) = key;
        if !self.claims.holds(&key, Instant::now()) {
            self.sending.remove(&key);
            return;
        }
        match sent {
            Ok(result) => {
                out.send(FromWorker::Completed { task, epoch, result, log, usage }).await;
                pass_async(Point::WorkerAfterReport).await;
            }
            Err(NotSent::Failed(failure)) => {
                out.send(FromWorker::Failed { task, epoch, failure, log, usage }).await;
            }
            Err(NotSent::Later) => drop(self.sending.remove(&key)),
        }
    }

    /// Gives back all held tasks, so that the coordinator need not wait for the leases to expire.
    async fn farewell(held: Vec<Arc<Task>>, out: Outgoing, mut incoming: Incoming) {
        give_back(held, &out).await;
        drop(out);
        let end = async { while let Ok(Some(_)) = incoming.next().await {} };
        let _ = tokio::time::timeout(Self::FAREWELL, end).await;
    }
}

/// Waits for the next heartbeat. Never returns before the coordinator has sent the heartbeat interval.
async fn next(heartbeat: &mut Option<Interval>) {
    match heartbeat {
        Some(heartbeat) => drop(heartbeat.tick().await),
        None => std::future::pending().await,
    }
}

/// Returns the time `than_now` from now, at most a year ahead so that the sum does not overflow.
fn later(than_now: Duration) -> Instant {
    const YEAR: Duration = Duration::from_secs(31_536_000);
    Instant::now() + than_now.min(YEAR)
}

/// Waits for the deadline; never returns without one.
async fn at(until: Option<Instant>) {
    match until {
        Some(until) => tokio::time::sleep_until(until).await,
        None => std::future::pending().await,
    }
}

async fn give_back(tasks: Vec<Arc<Task>>, out: &Outgoing) {
    for held in tasks {
        let ((task, epoch), usage) = (held.key(), held.usage());
        out.send(FromWorker::Failed { task, epoch, failure: Failure::Cancelled, log: None, usage }).await;
    }
}
