//! Actor of the coordinator: the tokio task that owns the scheduler and the log.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use femc_fault::{Point, pass_point, pass_point_async};
use femc_model::{Digest, Failure, FromWorker, JobId, Month, Refusal, Registration, Tick, ToWorker, WorkerId};
use femc_proto::{Call, Reply, Session};
use femc_queue::{Batch, Queue, Remedy};
use femc_schedule::{Command, Event, Fact, RequestId, Roster, Scheduler};
use femc_store::Store;
use jiff::Timestamp;
use jiff::tz::TimeZone;
use tokio::sync::{mpsc, oneshot};
use tokio::time::Instant;

use crate::announce::Announcer;
use crate::attempts::EndedAttempts;
use crate::clock::Clock;
use crate::config::{Config, CoordinatorError};
use crate::disks::Disks;
use crate::error_targets::ErrorTargets;
use crate::execute::WatchedJob;
use crate::full_log::{ActorInputs, PendingBatch};
use crate::janitor::Janitor;
use crate::metrics::{CurrentFigures, Metrics};
use crate::queries::Query;
use crate::roster::ROSTER_SUBJECT;
use crate::session::{self, WorkerSession};
use crate::worker_events::{artifact_missing, take_log, take_usage, to_event};

/// Event from the reader of a session.
#[derive(Debug)]
pub(crate) enum SessionEvent {
    /// A message of the worker.
    Message(Box<FromWorker>),
    /// The worker completed a task, but this artifact of the result is not in the store. The text is the store's message.
    ArtifactMissing(Box<FromWorker>, Digest, String),
    /// The session has ended.
    Ended,
}

/// Recipient of an answer of the scheduler.
#[derive(Debug)]
pub(crate) enum PendingReply {
    Submit(Reply<JobId>),
    Control(Reply<()>),
}

/// State of the actor: the shell around the scheduler.
pub(crate) struct Actor<Q> {
    pub(crate) scheduler: Scheduler,
    pub(crate) queue: Q,
    pub(crate) store: Store,
    pub(crate) clock: Clock,
    /// Unix time in milliseconds at which the farm's clock began. Set only if the date does not come from the machine.
    date_zero: Option<u64>,
    /// Month last passed to the scheduler.
    month: Option<Month>,
    pub(crate) workers: BTreeMap<WorkerId, WorkerSession>,
    /// Workers whose sessions have begun but have not been welcomed yet.
    to_welcome: Vec<WorkerId>,
    pub(crate) pending: BTreeMap<RequestId, PendingReply>,
    pub(crate) watched: BTreeMap<JobId, WatchedJob>,
    pub(crate) changed: BTreeSet<JobId>,
    /// Jobs with events since a feed last asked; `None` until a feed has asked.
    pub(crate) changed_since_feed: Option<BTreeSet<JobId>>,
    pub(crate) janitor: Janitor,
    /// Facts that the scheduler has applied but that are not durable yet, with the time of each.
    facts: Vec<(Tick, Fact)>,
    /// Ended attempts that are not durable yet.
    attempts: EndedAttempts,
    /// Target relative errors of the jobs' frames.
    pub(crate) targets: ErrorTargets,
    /// Roster of known workers, connected or not.
    pub(crate) roster: Roster,
    /// Whether the roster has changed since its last note.
    pub(crate) is_roster_dirty: bool,
    /// Time of the next roster note, if workers are connected.
    next_roster_note: Instant,
    /// Events raised while commands were executed, such as broken sessions.
    pub(crate) follow_up_events: VecDeque<Event>,
    pub(crate) queries: Vec<Query>,
    /// Received heartbeats without an answer, with their numbers.
    heartbeats: Vec<(WorkerId, u64)>,
    numbers: u64,
    /// Number of records since the last snapshot.
    records: usize,
    /// Number of records after which the next snapshot is due.
    snapshot_interval: usize,
    /// Earliest time of the next snapshot, after one failed for lack of space.
    next_snapshot: Instant,
    session_events: mpsc::Sender<(WorkerId, SessionEvent)>,
    pub(crate) session_inbox: mpsc::Receiver<(WorkerId, SessionEvent)>,
    /// Session events received while there was no space for the log.
    pub(crate) deferred: VecDeque<(WorkerId, SessionEvent)>,
    pub(crate) metrics: Metrics,
    /// Requests for metrics.
    pub(crate) metrics_requests: mpsc::Receiver<oneshot::Sender<CurrentFigures>>,
    pub(crate) announcer: Announcer,
    pub(crate) disks: Disks,
    /// Time of the last check of the disks.
    pub(crate) disks_checked: Instant,
}

impl<Q: Queue> Actor<Q> {
    /// Maximum number of messages that are made durable together.
    const BATCH: usize = 1024;
    /// Interval between two checks of deadlines and watchers.
    const TIMER_INTERVAL: Duration = Duration::from_millis(100);
    /// Delay of the timer after which the loop is considered stalled. No worker's message was processed in this time.
    const STALL_THRESHOLD: Duration = Duration::from_millis(500);
    /// Interval between two roster notes. After a crash, the times of last contact are this accurate.
    const ROSTER_INTERVAL: Duration = Duration::from_secs(60);
    /// Delay before a snapshot that failed for lack of space is retried.
    const SNAPSHOT_RETRY_DELAY: Duration = Duration::from_secs(10);

    pub(crate) fn new(
        scheduler: Scheduler,
        queue: Q,
        store: Store,
        records: usize,
        roster: Roster,
        metrics_requests: mpsc::Receiver<oneshot::Sender<CurrentFigures>>,
        config: &Config,
    ) -> Self {
        let (session_events, heard) = mpsc::channel(4 * Self::BATCH);
        let disks = Disks::new(config);
        config.metrics.set_disks(disks.clone());
        // Clears the reason left from an earlier term.
        config.metrics.set_wait_reason(None);
        Self {
            clock: Clock::new(scheduler.ledger().now(), config.time.clone()),
            date_zero: config.scheduler.clock_zero,
            month: None,
            scheduler,
            queue,
            store,
            workers: BTreeMap::new(),
            to_welcome: Vec::new(),
            pending: BTreeMap::new(),
            watched: BTreeMap::new(),
            changed: BTreeSet::new(),
            changed_since_feed: None,
            janitor: Janitor::default(),
            facts: Vec::new(),
            attempts: EndedAttempts::default(),
            targets: ErrorTargets::default(),
            roster,
            is_roster_dirty: false,
            next_roster_note: Instant::now() + Self::ROSTER_INTERVAL,
            follow_up_events: VecDeque::new(),
            queries: Vec::new(),
            heartbeats: Vec::new(),
            numbers: 0,
            records,
            snapshot_interval: config.snapshot_interval,
            next_snapshot: Instant::now(),
            session_events,
            session_inbox: heard,
            deferred: VecDeque::new(),
            metrics: config.metrics.clone(),
            metrics_requests,
            announcer: Announcer::new(config.announce.clone()),
            disks,
            disks_checked: Instant::now(),
        }
    }

    /// Runs until `stop`'s sender is dropped, or the log fails.
    pub(crate) async fn run(mut self, mut inputs: ActorInputs) -> Result<(), CoordinatorError> {
        let mut timer = tokio::time::interval(Self::TIMER_INTERVAL);
        timer.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut commands = Vec::new();
        self.announce_all();
        loop {
            tokio::select! {
                biased;
                _ = inputs.stop.changed() => break,
                due = timer.tick() => {
                    if due.elapsed() > Self::STALL_THRESHOLD {
                        tracing::warn!(
                            seconds = due.elapsed().as_secs_f64(),
                            "delayed; messages of workers are processed first"
                        );
                        self.handle_event(Event::CoordinatorStalled, &mut commands);
                    }
                    self.update_month(&mut commands);
                    self.handle_event(Event::Elapsed, &mut commands);
                    self.run_maintenance(&mut commands, &mut inputs).await?;
                }
                // These events are older than the others, so they are processed first.
                () = std::future::ready(()), if !self.follow_up_events.is_empty() || !self.deferred.is_empty() => {}
                Some((worker, event)) = self.session_inbox.recv() => self.handle_session_event(worker, event, &mut commands),
                Some(call) = inputs.calls.recv() => self.handle_call(call, &mut commands),
                Some(watcher) = self.metrics_requests.recv() => self.send_figures(watcher),
                Some((job, ended)) = self.announcer.announced.recv() => {
                    self.handle_event(Event::Announced { job, ended }, &mut commands);
                }
            }
            for _ in 0..Self::BATCH {
                if let Some(event) = self.follow_up_events.pop_front() {
                    self.handle_event(event, &mut commands);
                } else if let Some((worker, event)) = self.deferred.pop_front() {
                    self.handle_session_event(worker, event, &mut commands);
                } else if let Ok((worker, event)) = self.session_inbox.try_recv() {
                    self.handle_session_event(worker, event, &mut commands);
                } else if let Ok(call) = inputs.calls.try_recv() {
                    self.handle_call(call, &mut commands);
                } else {
                    break;
                }
            }
            self.commit(&mut commands, &mut inputs).await?;
        }
        self.send_goodbyes();
        self.save_roster().await;
        Ok(self.queue.close().await?)
    }

    /// Answers a request for metrics.
    pub(crate) fn send_figures(&mut self, reply: oneshot::Sender<CurrentFigures>) {
        let figures = self.scheduler.stats(self.clock.now());
        // The send fails if the watcher is gone. This is ignored.
        let _ = reply.send(CurrentFigures { figures, records: self.records });
    }

    /// Passes `event` to the scheduler and collects the resulting commands and facts.
    fn handle_event(&mut self, event: Event, commands: &mut Vec<Command>) {
        let (now, first) = (self.clock.now(), commands.len());
        self.scheduler.handle_into(event, now, commands);
        commands[first..].iter().for_each(|command| self.metrics.on_command(command));
        for command in commands.extract_if(first.., |command| command.is_for_log()) {
            match command {
                Command::Record(fact) => {
                    self.attempts.on_fact(&fact);
                    self.targets.on_fact(&fact);
                    self.facts.push((now, fact));
                }
                Command::RecordAttempt(attempt) => self.attempts.put(*attempt),
                _ => {}
            }
        }
    }

    /// Processes the log and the usage that are part of a report.
    fn process_log_and_usage(&mut self, worker: WorkerId, message: &mut FromWorker, commands: &mut Vec<Command>) {
        if let Some(event) = take_log(worker, message) {
            self.handle_event(event, commands);
        }
        for usage in take_usage(message) {
            self.handle_event(Event::Usage { worker, usage }, commands);
        }
    }

    fn handle_session_event(&mut self, worker: WorkerId, session_event: SessionEvent, commands: &mut Vec<Command>) {
        let event = match session_event {
            SessionEvent::Ended => return self.end_session(worker, commands),
            // The coordinator has ended this session.
            _ if !self.workers.contains_key(&worker) => return,
            SessionEvent::Message(mut message) => {
                match &*message {
                    FromWorker::Heartbeat { number, .. } => self.heartbeats.push((worker, *number)),
                    FromWorker::Failed { failure, .. } => self.metrics.count_failure(failure),
                    FromWorker::Register(_)
                    | FromWorker::Completed { .. }
                    | FromWorker::Draining
                    | FromWorker::Available => {}
                }
                self.process_log_and_usage(worker, &mut message, commands);
                to_event(worker, *message)
            }
            SessionEvent::ArtifactMissing(mut report, artifact, message) => {
                self.process_log_and_usage(worker, &mut report, commands);
                self.metrics.count_failure(&Failure::Store { message: message.clone() });
                artifact_missing(worker, &report, artifact, message)
            }
        };
        if let Some(event) = event {
            self.handle_event(event, commands);
        }
    }

    /// Returns the calendar date: Unix time in milliseconds. In a simulation it follows the simulated clock.
    fn date(&self) -> Option<u64> {
        if let Some(zero) = self.date_zero {
            return Some(zero.saturating_add(self.clock.now().0));
        }
        let date = SystemTime::now().duration_since(UNIX_EPOCH).ok()?;
        u64::try_from(date.as_millis()).ok()
    }

    /// Passes the current month to the scheduler, which sums usage by month.
    fn update_month(&mut self, commands: &mut Vec<Command>) {
        let date = self.date().and_then(|date| Timestamp::from_millisecond(i64::try_from(date).ok()?).ok());
        let date = date.map(|date| date.to_zoned(TimeZone::UTC).date());
        let month = date.and_then(|date| Month::new(date.year().try_into().ok()?, date.month().try_into().ok()?));
        if let Some(month) = month.filter(|month| self.month != Some(*month)) {
            self.month = Some(month);
            self.handle_event(Event::Month(month), commands);
        }
    }

    fn handle_call(&mut self, call: Call, commands: &mut Vec<Command>) {
        match call {
            Call::Submit { key, reply, .. }
                if !self.is_known_key(key.as_deref())
                    && let Some(no) = self.disks.refusal() =>
            {
                drop(reply.send(Err(no)));
            }
            Call::Submit { spec, reply, .. } if let Err(no) = self.announcer.config().check(&spec.notes) => {
                drop(reply.send(Err(no)));
            }
            Call::Submit { key, spec, reply } => {
                let request = self.register_request(PendingReply::Submit(reply));
                let date = self.date();
                self.handle_event(Event::Submitted { request, key, spec, date }, commands);
            }
            Call::Control { job, control, reply } => {
                let request = self.register_request(PendingReply::Control(reply));
                self.handle_event(Event::Controlled { request, job, control }, commands);
            }
            Call::Session(session) => self.start_session(*session, commands),
            Call::Changes { scope: news, reply } => self.queries.push(Query::Changes(news, reply)),
            Call::List { reply } => self.queries.push(Query::List(reply)),
            Call::Status { job, reply } => self.queries.push(Query::Status(job, reply)),
            Call::Watch { job, reply } => self.queries.push(Query::Watch(job, reply)),
            Call::Parts { job, reply } => self.queries.push(Query::Parts(job, reply)),
            Call::Producer { job, digest, reply } => self.queries.push(Query::Producer(job, digest, reply)),
            Call::Frames { job, reply } => self.queries.push(Query::Frames(job, reply)),
            Call::Drain { worker, drain, reply } => {
                let workers = self.scheduler.select_workers(&worker);
                for &worker in &workers {
                    self.handle_event(Event::Drained { worker, drain }, commands);
                }
                let nobody = || Refusal::NoSuchWorker { worker: worker.to_string() };
                let answer = if workers.is_empty() { Err(nobody()) } else { Ok(workers) };
                self.queries.push(Query::Drained(answer, reply));
            }
            Call::ArtifactLost { digest, reply } => {
                self.handle_event(Event::ArtifactLost { digest }, commands);
                self.queries.push(Query::Done(reply));
            }
            Call::Logs { job, since, reply } => self.queries.push(Query::Logs(job, since, reply)),
            Call::Shape { job, reply } => self.queries.push(Query::Shape(job, reply)),
            Call::FrameTable { job, reply } => self.queries.push(Query::FrameTable(job, reply)),
            Call::Tasks { job, filter, from, count, reply } => {
                self.queries.push(Query::Tasks(job, filter, from, count, reply));
            }
            Call::Attempts { job, from, reply } => self.queries.push(Query::Attempts(job, from, reply)),
            Call::Workers { reply } => self.queries.push(Query::Workers(reply)),
            Call::Usage { reply } => self.queries.push(Query::Usage(reply)),
            Call::References { reply } => self.queries.push(Query::References(reply)),
            Call::Backup { reply } => self.queries.push(Query::Backup(reply)),
        }
    }

    fn number(&mut self) -> u64 {
        self.numbers += 1;
        self.numbers
    }

    fn register_request(&mut self, pending: PendingReply) -> RequestId {
        let request = RequestId(self.number());
        self.pending.insert(request, pending);
        request
    }

    fn start_session(&mut self, session: Session, commands: &mut Vec<Command>) {
        pass_point(Point::CoordinatorBeforeJoin);
        let Session { registration, messages, out } = session;
        let worker = self.add_session(registration, out, commands);
        tokio::spawn(session::forward_messages(worker, messages, self.store.clone(), self.session_events.clone()));
    }

    /// Adds a session, and returns its number. If the number was used before, the earlier session has ended: its last event has been
    /// processed, and no command is pending for it.
    fn add_session(
        &mut self,
        registration: Registration,
        out: mpsc::Sender<ToWorker>,
        commands: &mut Vec<Command>,
    ) -> WorkerId {
        let worker = self.roster.join(&registration.name);
        tracing::info!(
            worker = worker.0,
            name = registration.name,
            threads = registration.threads,
            engine = registration.engine,
            "worker joined"
        );
        self.metrics.count_session();
        self.workers.insert(worker, WorkerSession::new(out));
        self.to_welcome.push(worker);
        self.handle_event(Event::Joined { worker, registration }, commands);
        self.update_roster();
        worker
    }

    /// Ends a session after its last event, and frees its number. Another session may get the number before the pending commands
    /// are executed, so those for this session are dropped.
    fn end_session(&mut self, worker: WorkerId, commands: &mut Vec<Command>) {
        if self.workers.contains_key(&worker) {
            self.update_roster();
            self.workers.remove(&worker);
            tracing::info!(worker = worker.0, "worker left");
            self.handle_event(Event::Left { worker }, commands);
        }
        commands.retain(|command| command.worker() != Some(worker));
        self.heartbeats.retain(|(other, _)| *other != worker);
        self.to_welcome.retain(|other| *other != worker);
        self.roster.leave(worker);
    }

    /// Returns whether a job was submitted with this key.
    pub(crate) fn is_known_key(&self, key: Option<&str>) -> bool {
        key.is_some_and(|key| self.scheduler.ledger().job_of_key(key).is_some())
    }

    /// Makes the facts durable, then executes and clears the commands, then answers calls. A coordinator that has lost leadership
    /// sends nothing.
    pub(crate) async fn commit(
        &mut self,
        commands: &mut Vec<Command>,
        inputs: &mut ActorInputs,
    ) -> Result<(), CoordinatorError> {
        if self.facts.is_empty() && self.attempts.is_empty() && !self.is_roster_dirty {
            self.queue.check()?;
        } else {
            let records = self.facts.drain(..).map(|(now, fact)| fact.encode(now)).collect::<Result<Vec<_>, _>>()?;
            // Fault points are counted only for batches with records of jobs, because workers join and leave at random times.
            let is_of_jobs = !records.is_empty() || !self.attempts.is_empty();
            if is_of_jobs {
                pass_point_async(Point::CoordinatorBeforeAppend).await;
            }
            let (mut notes, mut forgotten) = self.attempts.take()?;
            if std::mem::take(&mut self.is_roster_dirty) {
                notes.push(self.roster_note()?);
                forgotten.push(ROSTER_SUBJECT);
            }
            let begun = Instant::now();
            let batch = Batch { records: &records, notes: &notes, forgotten: &forgotten };
            self.append_when_possible(PendingBatch { batch, commands }, inputs).await?;
            self.metrics.count_append(records.iter().map(Vec::len).sum(), begun.elapsed());
            if is_of_jobs {
                pass_point_async(Point::CoordinatorAfterAppend).await;
            }
            self.records += records.len();
        }
        // Reports of dead processes in their registrations are durable now.
        for worker in std::mem::take(&mut self.to_welcome) {
            self.welcome(worker);
        }
        self.execute(commands);
        self.answer_heartbeats();
        self.answer_queries().await
    }

    /// Answers the heartbeats. This happens after the commands, so that an assignment that arrives after the answer was made after
    /// the heartbeat was sent.
    fn answer_heartbeats(&mut self) {
        let now = self.clock.now();
        for (worker, heartbeat) in std::mem::take(&mut self.heartbeats) {
            self.answer_heartbeat(worker, heartbeat, now);
        }
    }

    pub(crate) fn answer_heartbeat(&mut self, worker: WorkerId, heartbeat: u64, now: Tick) {
        let (leases, intake) = (self.scheduler.leases(worker, now), self.scheduler.intake(worker));
        self.send_to_worker(worker, ToWorker::Renewed { heartbeat, leases, intake });
    }

    /// Does periodic work: updates watchers, removes unneeded artifacts, makes snapshots.
    async fn run_maintenance(
        &mut self,
        commands: &mut Vec<Command>,
        inputs: &mut ActorInputs,
    ) -> Result<(), CoordinatorError> {
        self.queue.check()?;
        self.refresh_watched();
        if Instant::now() >= self.next_roster_note {
            self.next_roster_note = Instant::now() + Self::ROSTER_INTERVAL;
            if !self.workers.is_empty() {
                self.update_roster();
            }
        }
        self.sweep(commands, inputs).await?;
        self.disks.check_in_background(&mut self.disks_checked);
        if self.records >= self.snapshot_interval && Instant::now() >= self.next_snapshot {
            // The snapshot already includes the facts of these commands.
            self.commit(commands, inputs).await?;
            let state = self.scheduler.ledger().encode()?;
            pass_point_async(Point::CoordinatorBeforeSnapshot).await;
            let begun = Instant::now();
            match self.queue.snapshot(&state).await {
                Err(error) if error.remedy() == Remedy::FreeSpace => {
                    tracing::warn!(%error, "no space for a snapshot; the log grows until there is space");
                    self.next_snapshot = Instant::now() + Self::SNAPSHOT_RETRY_DELAY;
                    return Ok(());
                }
                made => made?,
            }
            self.metrics.count_snapshot(begun.elapsed());
            pass_point_async(Point::CoordinatorAfterSnapshot).await;
            self.records = 0;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
