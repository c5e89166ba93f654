//! Metrics of a coordinator over its life, across changes of leadership, and the page that shows them.
//!
//! Present numbers of jobs, tasks and workers are requested from the actor when the page is read. Events are counted when they
//! happen. Labels have few values: never a job, an owner or a worker.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use femc_metrics::{Counter, Health, Histogram, Page, ProcessReport, Tally, write_process_metrics};
use femc_model::{Failure, LeaseEnding, RevokeReason, StageKind};
use femc_proto::{PROTOCOL, Traffic};
use femc_schedule::{Command, Fact, FarmStats, WorkerStanding};
use tokio::sync::{mpsc, oneshot};

use crate::disks::Disks;
use crate::leadership::Leadership;

/// Metrics of a coordinator. Clones share the counters.
#[derive(Debug, Clone, Default)]
pub struct Metrics(Arc<Inner>);

/// Channel to request the present numbers from an actor.
pub(crate) type FiguresRequests = mpsc::Sender<oneshot::Sender<CurrentFigures>>;

/// Present numbers.
#[derive(Debug)]
pub(crate) struct CurrentFigures {
    pub(crate) figures: FarmStats,
    /// Number of log records since the last snapshot.
    pub(crate) records: usize,
}

#[derive(Debug)]
struct Inner {
    /// Channel to the actor, while this coordinator leads.
    actor: Mutex<Option<FiguresRequests>>,
    /// Log file, if the log is a file.
    file: Mutex<Option<PathBuf>>,
    disks: Mutex<Option<Disks>>,
    /// Reason why nothing can be made durable at present.
    wait_reason: Mutex<Option<String>>,
    terms: Counter,
    sessions: Counter,
    done: Tally<&'static str>,
    attempts: Tally<&'static str>,
    failures: Tally<&'static str>,
    granted: Tally<&'static str>,
    revoked: Tally<&'static str>,
    appends: Histogram,
    appended: Counter,
    snapshots: Histogram,
    traffic: Traffic,
}

impl Default for Inner {
    fn default() -> Self {
        let latencies = || Histogram::new(Histogram::LATENCIES);
        Self {
            actor: Mutex::default(),
            file: Mutex::default(),
            disks: Mutex::default(),
            wait_reason: Mutex::default(),
            terms: Counter::default(),
            sessions: Counter::default(),
            done: Tally::with_keys(StageKind::ALL.map(StageKind::name)),
            attempts: Tally::with_keys(LeaseEnding::ALL.map(LeaseEnding::name)),
            failures: Tally::with_keys(Failure::CAUSES),
            granted: Tally::with_keys(["first", "second"]),
            revoked: Tally::with_keys(
                [RevokeReason::JobEnded, RevokeReason::Expired, RevokeReason::Done].map(revoke_reason_name),
            ),
            appends: latencies(),
            appended: Counter::default(),
            snapshots: latencies(),
            traffic: Traffic::default(),
        }
    }
}

impl Metrics {
    /// Time limit for the actor's answer. A healthy actor answers between two writes to the disk.
    const ACTOR_TIMEOUT: Duration = Duration::from_secs(5);

    pub(crate) fn traffic(&self) -> Traffic {
        self.0.traffic.clone()
    }

    pub(crate) fn set_log_file(&self, file: PathBuf) {
        *self.0.file.lock().unwrap_or_else(PoisonError::into_inner) = Some(file);
    }

    /// Notes that this coordinator leads from now on, and stores the channel to its actor.
    pub(crate) fn begin_term(&self, actor: FiguresRequests) {
        self.0.terms.add(1);
        *self.0.actor.lock().unwrap_or_else(PoisonError::into_inner) = Some(actor);
    }

    pub(crate) fn set_disks(&self, disks: Disks) {
        *self.0.disks.lock().unwrap_or_else(PoisonError::into_inner) = Some(disks);
    }

    /// Notes the reason why nothing can be made durable, or `None` when that is possible again.
    pub(crate) fn set_wait_reason(&self, reason: Option<String>) {
        *self.0.wait_reason.lock().unwrap_or_else(PoisonError::into_inner) = reason;
    }

    pub(crate) fn count_session(&self) {
        self.0.sessions.add(1);
    }

    /// Counts a batch of `bytes` that has become durable.
    pub(crate) fn count_append(&self, bytes: usize, took: Duration) {
        self.0.appends.observe(took);
        self.0.appended.add(bytes as u64);
    }

    pub(crate) fn count_snapshot(&self, took: Duration) {
        self.0.snapshots.observe(took);
    }

    /// Counts a failure that a worker reports.
    pub(crate) fn count_failure(&self, failure: &Failure) {
        self.0.failures.add(failure.cause(), 1);
    }

    /// Counts a command of the scheduler.
    pub(crate) fn on_command(&self, command: &Command) {
        match command {
            Command::Record(Fact::Done { task, .. }) => {
                self.0.done.add(task.stage.kind.name(), 1);
            }
            Command::Record(Fact::Failed { failure: failure @ Failure::Stalled { .. }, .. }) => {
                self.count_failure(failure);
            }
            Command::Record(Fact::WorkerDied { .. }) => self.0.failures.add("killed", 1),
            Command::RecordAttempt(attempt) => self.0.attempts.add(attempt.ending.name(), 1),
            Command::Assign { assignment, .. } => {
                let lease = if assignment.copy_of.is_some() { "second" } else { "first" };
                self.0.granted.add(lease, 1);
            }
            Command::Revoke { reason, .. } => self.0.revoked.add(revoke_reason_name(*reason), 1),
            Command::Record(_)
            | Command::Accept { .. }
            | Command::Refuse { .. }
            | Command::Dismiss { .. }
            | Command::Answer { .. }
            | Command::JobChanged(_)
            | Command::Discard(_) => {}
        }
    }

    /// Requests the present numbers; `None`: this coordinator does not lead, or its actor does not answer.
    async fn request_figures(&self) -> Option<CurrentFigures> {
        let actor = self.0.actor.lock().unwrap_or_else(PoisonError::into_inner).clone()?;
        let (reply, answer) = oneshot::channel();
        let ask = async {
            actor.send(reply).await.ok()?;
            answer.await.ok()
        };
        tokio::time::timeout(Self::ACTOR_TIMEOUT, ask).await.ok()?
    }

    /// Returns the health of the coordinator and its metrics page.
    pub async fn report(&self, leadership: &Leadership) -> ProcessReport {
        let now = match leadership {
            Leadership::Leader => self.request_figures().await,
            Leadership::Standby { .. } | Leadership::Disconnected { .. } => None,
        };
        let waits = self.0.wait_reason.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let disks = self.0.disks.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let short = disks.as_ref().and_then(Disks::refusal);
        let health = match (leadership, &now) {
            (Leadership::Leader, Some(_)) => match (&waits, short) {
                (Some(message), _) => Health::Waiting { message: message.clone() },
                (None, Some(no)) => Health::Degraded { message: no.to_string() },
                (None, None) => Health::Ready,
            },
            (Leadership::Leader, None) => {
                Health::Broken { message: "the coordinator's main task does not respond".into() }
            }
            (Leadership::Standby { leader: Some(leader) }, _) => {
                Health::Waiting { message: format!("standing by; the leader is {leader}") }
            }
            (Leadership::Standby { leader: None }, _) => Health::Waiting { message: "standing by".into() },
            (Leadership::Disconnected { message }, _) => Health::Waiting { message: message.clone() },
        };
        let mut page = Page::default();
        let version = env!("CARGO_PKG_VERSION");
        let labels = [("version", version), ("protocol", &*PROTOCOL.to_string()), ("role", "coordinator")];
        page.gauge("femc_build_info", "Version and role of this program; always 1.").labeled(&labels, 1.0);
        let leads = *leadership == Leadership::Leader;
        page.gauge("femc_leader", "1 if this coordinator is the leader, 0 if it is a standby.").value(u8::from(leads));
        page.counter("femc_leadership_terms_total", "Number of times that this coordinator became the leader.")
            .count(self.0.terms.get());
        if let Some(now) = &now {
            put_figures(&mut page, now);
        }
        self.put_counts(&mut page);
        self.put_log(&mut page);
        let help = "1 while the log waits for disk space and all work is suspended.";
        page.gauge("femc_log_waits_for_room", help).value(u8::from(waits.is_some()));
        let help = "Free bytes on the disks of the log and of the artifacts, if they are stored in folders.";
        let free = disks.iter().flat_map(Disks::free);
        page.gauge("femc_disk_free_bytes", help).each_label("holds", free);
        put_traffic(&mut page, &self.0.traffic);
        write_process_metrics(&mut page);
        ProcessReport { health, page: page.finish() }
    }

    fn put_counts(&self, page: &mut Page) {
        let Inner { sessions, done, attempts, failures, granted, revoked, .. } = &*self.0;
        page.counter("femc_tasks_done_total", "Accepted results, by kind of task.").each_label("stage", done.get());
        let help = "Ended attempts, by ending: done, failed, cancelled, revoked, lost.";
        page.counter("femc_attempts_total", help).each_label("ending", attempts.get());
        let help = "Failed tasks, by cause. store and resources (faults of the environment) and cancelled (given back) \
                    use up no attempt; killed: a worker died while computing the task.";
        page.counter("femc_task_failures_total", help).each_label("cause", failures.get());
        let help = "Granted leases. second: a late task was leased to another worker as well.";
        page.counter("femc_leases_granted_total", help).each_label("lease", granted.get());
        let help = "Revoked leases, by reason. expired: the worker was silent, the task made no progress, or its frame \
                    restarted.";
        page.counter("femc_leases_revoked_total", help).each_label("reason", revoked.get());
        page.counter("femc_sessions_total", "Sessions that workers started.").count(sessions.get());
    }

    fn put_log(&self, page: &mut Page) {
        let Inner { appends, appended, snapshots, file, .. } = &*self.0;
        let help = "Time to make a batch of the log durable, in seconds.";
        page.histogram("femc_log_append_seconds", help).labeled(&[], appends);
        page.counter("femc_log_appended_bytes_total", "Bytes of records written to the log.").count(appended.get());
        let help = "Time to replace the log with a snapshot, in seconds.";
        page.histogram("femc_log_snapshot_seconds", help).labeled(&[], snapshots);
        let file = file.lock().unwrap_or_else(PoisonError::into_inner).clone();
        if let Some(file) = file {
            let size = |end: &str| {
                let mut name = file.clone().into_os_string();
                name.push(end);
                std::fs::metadata(name).map_or(0, |file| file.len())
            };
            let help = "Size of the log file and of SQLite's write-ahead log, in bytes.";
            page.gauge("femc_log_file_bytes", help).count(size("") + size("-wal"));
        }
    }
}

fn put_figures(page: &mut Page, CurrentFigures { figures, records }: &CurrentFigures) {
    let FarmStats { jobs, ready, leased, quarantined, samples_left, workers, threads, used, stale_messages } = figures;
    let jobs = jobs.iter().map(|&(state, count)| (state.name(), count));
    page.gauge("femc_jobs", "Jobs, by state.").each_label("state", jobs);
    let by_stage = |counts: &[(StageKind, u64)]| -> Vec<(&str, u64)> {
        counts.iter().map(|&(kind, count)| (kind.name(), count)).collect()
    };
    let help = "Backlog: tasks that a worker could start now. Each sample chunk of a tile counts; \
                a lease may cover several chunks.";
    page.gauge("femc_tasks_ready", help).each_label("stage", by_stage(ready));
    page.gauge("femc_tasks_leased", "Leases that workers hold.").each_label("stage", by_stage(leased));
    page.gauge("femc_tasks_quarantined", "Tasks that used up their attempts; `femc retry` retries them.")
        .count(*quarantined);
    let help = "Upper bound of the pixel samples that frames of running jobs still need.";
    page.gauge("femc_samples_left", help).count(*samples_left);
    let workers = workers.iter().map(|&(standing, count)| (worker_standing(standing), count));
    page.gauge("femc_workers", "Current workers, by whether they receive tasks.").each_label("state", workers);
    page.gauge("femc_threads", "Render threads of these workers.").count(*threads);
    let help = "Seconds of workers charged to owners; each moment of a worker counts once.";
    page.counter("femc_worker_seconds_used_total", help).labeled(&[], *used as f64 / 1000.0);
    let help = "Messages of workers that were refused because their lease was no longer valid.";
    page.counter("femc_stale_messages_total", help).count(*stale_messages);
    let help = "Records of the log since the latest snapshot; a restart reads them.";
    page.gauge("femc_log_records", help).count(*records as u64);
}

fn put_traffic(page: &mut Page, traffic: &Traffic) {
    let Traffic { calls, latencies, requests, request_latencies, received, sent } = traffic;
    let help = "Calls, by method and by the status at the beginning of the response.";
    let family = page.counter("femc_rpc_calls_total", help);
    calls.get().iter().fold(family, |family, ((method, code), count)| {
        family.labeled(&[("method", method), ("code", code)], *count as f64)
    });
    let help = "Time until the response to a call began, in seconds.";
    let family = page.histogram("femc_rpc_seconds", help);
    latencies.iter().fold(family, |family, (method, histogram)| family.labeled(&[("method", method)], histogram));
    let help = "HTTP requests, by operation and status of the response.";
    let family = page.counter("femc_http_requests_total", help);
    requests.get().iter().fold(family, |family, ((operation, status), count)| {
        family.labeled(&[("operation", operation), ("status", &status.to_string())], *count as f64)
    });
    let help = "Time until the response to an HTTP request began, in seconds.";
    let family = page.histogram("femc_http_seconds", help);
    request_latencies.iter().fold(family, |family, (operation, it)| family.labeled(&[("operation", operation)], it));
    page.counter("femc_store_received_bytes_total", "Bytes of artifacts received.").count(received.get());
    page.counter("femc_store_sent_bytes_total", "Bytes of artifacts sent.").count(sent.get());
}

fn revoke_reason_name(reason: RevokeReason) -> &'static str {
    match reason {
        RevokeReason::JobEnded => "job_ended",
        RevokeReason::Expired => "expired",
        RevokeReason::Done => "done",
    }
}

fn worker_standing(standing: WorkerStanding) -> &'static str {
    match standing {
        WorkerStanding::Busy => "busy",
        WorkerStanding::Idle => "idle",
        WorkerStanding::Unfit => "resting",
        WorkerStanding::Off => "off",
        WorkerStanding::Drained => "drained",
    }
}
