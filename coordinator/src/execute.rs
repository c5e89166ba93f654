//! Execution of the scheduler's commands: messages to workers, and status updates for watchers.

use femc_fault::{Point, pass_point};
use femc_model::{Assignment, JobId, JobNotes, JobSpec, JobStatus, Refusal, Tick, ToWorker, WorkerId};
use femc_queue::Queue;
use femc_schedule::{Answer, Command, Event, RequestId};
use tokio::sync::watch;

use crate::actor::{Actor, PendingReply};

/// A watched job.
#[derive(Debug)]
pub(crate) struct WatchedJob {
    statuses: watch::Sender<JobStatus>,
    last_sent: Tick,
}

impl<Q: Queue> Actor<Q> {
    /// Minimum time in milliseconds between two status updates of a job.
    const MIN_STATUS_INTERVAL: u64 = 50;

    /// Executes the commands, after their facts are durable.
    pub(crate) fn execute(&mut self, commands: &mut Vec<Command>) {
        for command in commands.drain(..) {
            match command {
                // These were stored before.
                Command::Record(_) | Command::RecordAttempt(_) => {}
                Command::Assign { worker, assignment } => self.assign(worker, assignment),
                Command::Revoke { worker, task, epoch, reason } => {
                    self.send_to_worker(worker, ToWorker::Revoke { task, epoch, reason });
                }
                Command::Accept { worker, task, epoch } => {
                    self.send_to_worker(worker, ToWorker::Accepted { task, epoch });
                }
                Command::Refuse { worker, task, epoch, refusal } => {
                    tracing::info!(job = task.job.0, %task, worker = worker.0, %refusal, "report refused");
                    self.send_to_worker(worker, ToWorker::Refused { task, epoch, refusal });
                }
                Command::Dismiss { worker } => drop(self.workers.remove(&worker)),
                Command::Answer { request, answer } => self.send_reply(request, answer),
                Command::JobChanged(job) => {
                    let concerned = self.scheduler.affected_jobs(job);
                    if let Some(touched) = &mut self.changed_since_feed {
                        touched.extend(&concerned);
                    }
                    self.changed.extend(concerned);
                    self.announce(job);
                }
                Command::Discard(digests) => self.janitor.push(self.clock.now(), digests),
            }
        }
        self.notify_watchers();
    }

    pub(crate) fn welcome(&mut self, worker: WorkerId) {
        let femc_schedule::Config { heartbeat, lease, .. } = *self.scheduler.config();
        self.send_to_worker(worker, ToWorker::Welcome { worker, heartbeat, lease });
    }

    fn assign(&mut self, worker: WorkerId, assignment: Assignment) {
        let job = assignment.task.job;
        let is_known = self.workers.get(&worker).is_none_or(|known| known.jobs.get(&job).is_some());
        if !is_known && let Some(spec) = self.scheduler.spec(job).cloned() {
            self.workers.entry(worker).and_modify(|known| known.jobs.insert(job, ()));
            // Workers do not need the notes, and their URL may be a secret.
            let spec = Box::new(JobSpec { notes: JobNotes::default(), ..spec });
            self.send_to_worker(worker, ToWorker::Job { job, spec });
        }
        self.send_to_worker(worker, ToWorker::Assign(assignment));
    }

    /// Sends a message to a worker. A worker that does not read, or is gone, loses its session.
    pub(crate) fn send_to_worker(&mut self, worker: WorkerId, message: ToWorker) {
        let Some(known) = self.workers.get(&worker) else { return };
        if known.out.try_send(message).is_err() {
            self.workers.remove(&worker);
            self.follow_up_events.push_back(Event::Left { worker });
        }
    }

    fn send_reply(&mut self, request: RequestId, answer: Result<Answer, Refusal>) {
        // The send fails if the caller has disconnected. This is ignored.
        match self.pending.remove(&request) {
            Some(PendingReply::Submit(reply)) => {
                let job = |answer| match answer {
                    Answer::Submitted(job) | Answer::Controlled(job) => job,
                };
                if let Ok(Answer::Submitted(job)) = &answer {
                    tracing::info!(job = job.0, "job submitted");
                }
                pass_point(Point::CoordinatorBeforeAnswer);
                drop(reply.send(answer.map(job)));
            }
            Some(PendingReply::Control(reply)) => drop(reply.send(answer.map(|_| ()))),
            None => {}
        }
    }

    /// Returns a receiver of a job's present and future status.
    pub(crate) fn watch(&mut self, job: JobId) -> Result<watch::Receiver<JobStatus>, Refusal> {
        let now = self.clock.now();
        let status = self.targets.status(&self.scheduler, job, now)?;
        if let Some(watched) = self.watched.get(&job) {
            watched.statuses.send_replace(status);
            return Ok(watched.statuses.subscribe());
        }
        let (statuses, receiver) = watch::channel(status);
        self.watched.insert(job, WatchedJob { statuses, last_sent: now });
        Ok(receiver)
    }

    /// Sends the statuses of changed jobs, at a limited rate. The end of a job is sent at once.
    fn notify_watchers(&mut self) {
        let now = self.clock.now();
        let (scheduler, watched, targets) = (&self.scheduler, &mut self.watched, &mut self.targets);
        self.changed.retain(|&job| {
            let Some(watched) = watched.get_mut(&job) else { return false };
            let is_due = now.since(watched.last_sent) >= Self::MIN_STATUS_INTERVAL;
            if !is_due && !scheduler.has_ended(job) {
                return true;
            }
            if let Ok(status) = targets.status(scheduler, job, now) {
                watched.send(status, now);
            }
            false
        });
    }

    /// Sends statuses in which only time has changed: samples per second, and seconds.
    pub(crate) fn refresh_watched(&mut self) {
        let now = self.clock.now();
        let (scheduler, targets) = (&self.scheduler, &mut self.targets);
        self.watched.retain(|&job, watched| {
            let Ok(status) = targets.status(scheduler, job, now) else { return false };
            if now.since(watched.last_sent) >= 4 * Self::MIN_STATUS_INTERVAL && !status.state.has_ended() {
                watched.send(status, now);
            }
            watched.statuses.receiver_count() > 0
        });
    }

    pub(crate) fn send_goodbyes(&mut self) {
        for worker in std::mem::take(&mut self.workers).into_values() {
            // A worker that does not read sees a closed session instead.
            let _ = worker.out.try_send(ToWorker::Goodbye);
        }
    }
}

impl WatchedJob {
    fn send(&mut self, status: JobStatus, now: Tick) {
        self.last_sent = now;
        self.statuses.send_if_modified(|old| {
            let is_new = *old != status;
            *old = status;
            is_new
        });
    }
}
