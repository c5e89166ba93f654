//! A session with the coordinator, from registration to the end of the connection.

use std::collections::BTreeSet;
use std::future::Future;
use std::pin::Pin;
use std::sync::{Arc, mpsc};
use std::time::Duration;

use femc_fault::{Point, pass_point_async};
use femc_model::{
    Affinity, BoundedMap, Epoch, Failure, FromWorker, Intake, JobId, JobSpec, Phase, Registration, ResourceUsage,
    TaskKey, TaskLog, TaskResult, TaskUsage, ToWorker,
};
use femc_proto::{CallError, Client, SessionReceiver, SessionSender, UnreachableCause};
use tokio::sync::mpsc::UnboundedReceiver;
use tokio::task::JoinSet;
use tokio::time::{Instant, Interval, MissedTickBehavior};

use crate::availability::Availability;
use crate::claims::Claims;
use crate::config::{Config, StopBehavior};
use crate::meter::Meter;
use crate::outbox::Outbox;
use crate::task_table::{Task, TaskTable};
use crate::threads::UpcomingFrame;
use crate::upload::{UploadFailure, upload, upload_log};

/// Reason for the end of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SessionEnd {
    /// The coordinator ended the session or is gone.
    Lost,
    /// The worker was asked to stop.
    Stopped,
}

/// An uploaded result, or the reason why it was not uploaded.
type FinishedUpload = ((TaskKey, Epoch), Result<TaskResult, UploadFailure>, Option<TaskLog>, Option<ResourceUsage>);

/// The worker's side of a session.
pub(crate) struct Session<'a> {
    client: Client,
    table: &'a Arc<TaskTable>,
    outbox: &'a Outbox,
    upcoming_frames: &'a mpsc::Sender<UpcomingFrame>,
    finished: &'a mut UnboundedReceiver<(TaskKey, Epoch)>,
    config: &'a Config,
    /// Availability last reported to the coordinator.
    availability: Availability,
    /// Specs of the latest jobs; more of them than the coordinator relies on.
    jobs: BoundedMap<JobId, Arc<JobSpec>>,
    claims: Claims,
    /// Uploads in progress; they end with the session.
    uploads: JoinSet<FinishedUpload>,
    meter: &'a Meter,
    /// Usage of revoked leases, to be reported with the next heartbeat.
    usage: Vec<TaskUsage>,
    /// Results that are being uploaded or are reported, but not answered.
    sending: BTreeSet<(TaskKey, Epoch)>,
}

impl<'a> Session<'a> {
    /// Time limit for saying goodbye to the coordinator.
    const GOODBYE_TIMEOUT: Duration = Duration::from_millis(500);

    pub(crate) fn new(
        client: Client,
        table: &'a Arc<TaskTable>,
        outbox: &'a Outbox,
        upcoming_frames: &'a mpsc::Sender<UpcomingFrame>,
        finished: &'a mut UnboundedReceiver<(TaskKey, Epoch)>,
        config: &'a Config,
        meter: &'a Meter,
    ) -> Self {
        Self {
            client,
            table,
            outbox,
            upcoming_frames,
            finished,
            config,
            availability: Availability::Available,
            jobs: BoundedMap::new(4 * JobSpec::SESSION_SPECS),
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
    ) -> Result<SessionEnd, CallError> {
        let silent = || CallError::Unreachable {
            url: self.client.url().into(),
            message: format!("no message for {} s", Claims::WELCOME_TIMEOUT.as_secs()),
            cause: UnreachableCause::Connection,
        };
        let (out, mut incoming) = tokio::select! {
            biased;
            session = self.client.session(registration) => session?,
            () = &mut stop => return Ok(SessionEnd::Stopped),
            () = tokio::time::sleep(Claims::WELCOME_TIMEOUT) => return Err(silent()),
        };
        let mut heartbeat: Option<Interval> = None;
        // Deadline for the running tasks, set once the worker is asked to stop.
        let mut until: Option<Instant> = None;
        let end = loop {
            let draining = until.is_some();
            if draining && self.table.is_empty() {
                break Ok(SessionEnd::Stopped);
            }
            tokio::select! {
                biased;
                () = &mut stop, if !draining => {
                    let StopBehavior::Finish { within } = self.config.stop_behavior else { break Ok(SessionEnd::Stopped) };
                    until = Some(deadline_after(within));
                    out.send(FromWorker::Draining).await;
                    give_back(self.table.take_waiting(), &out).await;
                }
                () = wait_until(until) => {
                    tracing::warn!("grace period over: returning unfinished tasks");
                    break Ok(SessionEnd::Stopped);
                }
                () = wait_for_heartbeat(&mut heartbeat) => {
                    if !draining {
                        self.apply_working_hours(&out).await;
                    }
                    self.send_heartbeat(&out).await;
                }
                Some(key) = self.finished.recv() => self.start_upload(key),
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
                        self.config.metrics.on_connected();
                        self.config.journal.clear_death();
                        self.claims.on_welcome(lease);
                        let every = Duration::from_millis(pause.max(10));
                        let pulse = heartbeat.insert(tokio::time::interval(every));
                        pulse.set_missed_tick_behavior(MissedTickBehavior::Delay);
                        self.apply_working_hours(&out).await;
                    }
                    Ok(Some(ToWorker::Goodbye) | None) => break Ok(SessionEnd::Lost),
                    Ok(Some(message)) => self.handle_message(message, &out).await,
                    Err(error) => break Err(error),
                },
                // This branch is last, so that messages which have arrived meanwhile are read first.
                () = tokio::time::sleep_until(self.claims.session_deadline()) => {
                    tracing::warn!(url = self.client.url(), "coordinator is silent: the leases count as expired");
                    break Ok(SessionEnd::Lost);
                }
            }
        };
        // A worker that is asked to stop does not reconnect.
        let end = if until.is_some() { Ok(SessionEnd::Stopped) } else { end };
        if matches!(end, Ok(SessionEnd::Stopped)) {
            Self::return_tasks_and_close(self.table.clear(), out, incoming).await;
        }
        end
    }

    /// Reports to the coordinator when the worker's hours begin or end. At their end, waiting tasks are given back.
    async fn apply_working_hours(&mut self, out: &SessionSender) {
        let availability = self.config.working_hours.availability();
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
                give_back(self.table.take_waiting(), out).await;
            }
        }
    }

    /// Sends a heartbeat with the progress of the tasks.
    async fn send_heartbeat(&mut self, out: &SessionSender) {
        let now = Instant::now();
        let held = self.table.held();
        let claimed = held.iter().filter(|task| self.claims.holds(&task.key(), now));
        let tasks = claimed.map(|task| task.progress()).collect();
        let number = self.claims.next_heartbeat(now);
        out.send(FromWorker::Heartbeat { number, tasks, usage: std::mem::take(&mut self.usage) }).await;
    }

    async fn handle_message(&mut self, message: ToWorker, out: &SessionSender) {
        match message {
            ToWorker::Job { job, spec } => self.jobs.insert(job, Arc::from(spec)),
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
                let wants_frame = assignment.task.stage.kind.properties().affinity == Affinity::Frame;
                let is_ahead = wants_frame && !self.config.journal.is_careful();
                let ahead = is_ahead.then(|| {
                    let (spec, frame) = (spec.clone(), assignment.task.stage.frame);
                    UpcomingFrame { spec, frame, client: self.client.clone(), task }
                });
                self.claims.on_assigned(task, assignment.lease);
                self.table.put(Arc::new(Task::new(assignment, spec.clone(), self.client.clone(), self.meter)));
                // If that thread is gone, the worker is ending.
                ahead.into_iter().for_each(|ahead| drop(self.upcoming_frames.send(ahead)));
            }
            ToWorker::Renewed { heartbeat, leases, intake } => {
                self.claims.on_renewed(heartbeat, &leases);
                if intake == Intake::Drained {
                    give_back(self.table.take_waiting(), out).await;
                }
                // Send the results that an earlier session could not deliver, and those whose upload failed.
                leases.iter().for_each(|lease| self.start_upload((lease.task, lease.epoch)));
            }
            ToWorker::Revoke { task, epoch, reason } => {
                tracing::debug!(%task, ?reason, "the lease was revoked");
                let Some(held) = self.drop_lease((task, epoch)) else { return };
                self.config.metrics.on_revoked(&held);
                self.usage.extend(held.usage().map(|usage| TaskUsage { task, epoch, usage }));
            }
            ToWorker::Accepted { task, epoch } => {
                pass_point_async(Point::WorkerBeforeForget).await;
                self.drop_lease((task, epoch)).iter().for_each(|task| self.config.metrics.on_accepted(task));
            }
            ToWorker::Refused { task, epoch, refusal } => {
                tracing::info!(%task, %refusal, "report refused");
                self.drop_lease((task, epoch)).iter().for_each(|task| self.config.metrics.on_refused(task));
            }
            ToWorker::Welcome { .. } | ToWorker::Goodbye => {}
        }
    }

    /// Drops a task whose lease is over: it is done, reassigned or no longer wanted.
    fn drop_lease(&mut self, key: (TaskKey, Epoch)) -> Option<Arc<Task>> {
        self.claims.remove(&key);
        self.sending.remove(&key);
        self.outbox.remove_answered(self.table, &key)
    }

    /// Uploads a result's artifacts while the next task runs. If the lease may be over, nothing is uploaded until the coordinator
    /// says that the lease holds.
    fn start_upload(&mut self, key: (TaskKey, Epoch)) {
        let Some(task) = self.table.get(&key) else { return };
        if task.outcome().is_none() || !self.claims.holds(&key, Instant::now()) || !self.sending.insert(key) {
            return;
        }
        task.set_phase(Phase::Uploading);
        let client = self.client.clone();
        self.uploads.spawn(async move {
            pass_point_async(Point::WorkerBeforeUpload).await;
            let sent = match task.outcome() {
                Some(Ok(product)) => upload(&client, &task, product).await.map(|()| product.result.clone()),
                Some(Err(failure)) => Err(UploadFailure::Failed(failure.clone())),
                None => Err(UploadFailure::Retry),
            };
            let log = upload_log(&client, &task).await;
            pass_point_async(Point::WorkerAfterUpload).await;
            (key, sent, log, task.usage())
        });
    }

    /// Reports a result whose artifacts are in the store, if its lease still holds.
    async fn report(&mut self, (key, sent, log, usage): FinishedUpload, out: &SessionSender) {
        let (task, epoch) = key;
        if !self.claims.holds(&key, Instant::now()) {
            self.sending.remove(&key);
            return;
        }
        match sent {
            Ok(result) => {
                out.send(FromWorker::Completed { task, epoch, result, log, usage }).await;
                pass_point_async(Point::WorkerAfterReport).await;
            }
            Err(UploadFailure::Failed(failure)) => {
                out.send(FromWorker::Failed { task, epoch, failure, log, usage }).await;
            }
            Err(UploadFailure::Retry) => drop(self.sending.remove(&key)),
        }
    }

    /// Gives back all held tasks, so that the coordinator need not wait for the leases to expire.
    async fn return_tasks_and_close(held: Vec<Arc<Task>>, out: SessionSender, mut incoming: SessionReceiver) {
        give_back(held, &out).await;
        drop(out);
        let end = async { while let Ok(Some(_)) = incoming.next().await {} };
        let _ = tokio::time::timeout(Self::GOODBYE_TIMEOUT, end).await;
    }
}

/// Waits for the next heartbeat. Never returns before the coordinator has sent the heartbeat interval.
async fn wait_for_heartbeat(heartbeat: &mut Option<Interval>) {
    match heartbeat {
        Some(heartbeat) => drop(heartbeat.tick().await),
        None => std::future::pending().await,
    }
}

/// Returns the time `delay` from now, at most a year ahead so that the sum does not overflow.
fn deadline_after(delay: Duration) -> Instant {
    const YEAR: Duration = Duration::from_secs(31_536_000);
    Instant::now() + delay.min(YEAR)
}

/// Waits for the deadline; never returns without one.
async fn wait_until(until: Option<Instant>) {
    match until {
        Some(until) => tokio::time::sleep_until(until).await,
        None => std::future::pending().await,
    }
}

async fn give_back(tasks: Vec<Arc<Task>>, out: &SessionSender) {
    for held in tasks {
        let ((task, epoch), usage) = (held.key(), held.usage());
        out.send(FromWorker::Failed { task, epoch, failure: Failure::Cancelled, log: None, usage }).await;
    }
}
