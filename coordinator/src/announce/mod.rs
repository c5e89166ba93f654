//! Notifications that a job has ended: a message to the URL in the job, and a command on this machine.
//!
//! Both are delivered at least once for each end, even if the coordinator dies in between: the log records which ends are
//! announced. A message is JSON, signed as specified by [Standard Webhooks](https://www.standardwebhooks.com), and is resent until
//! the receiver accepts it. A failed command is not repeated.

mod post;
mod run;
mod signature;
mod url_prefix;

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use femc_model::{JobId, JobNotes, JobState, JobStatus, Refusal, Tick};
use femc_queue::Queue;
use femc_schedule::Event;
use femc_service::view::JobJson;
use jiff::Timestamp;
use serde::Serialize;
use tokio::sync::{Semaphore, mpsc};

use crate::actor::Actor;
use post::Poster;
pub use signature::{KeyError, NotifyKey};
pub use url_prefix::{PrefixError, UrlPrefix};

/// Configuration of notifications: URLs that jobs may name, and a command.
#[derive(Debug, Clone, Default)]
pub struct NotifyConfig {
    /// Permitted prefixes of the URLs that jobs may name. Empty: jobs may name no URL.
    pub allowed: Vec<UrlPrefix>,
    /// Key that signs the messages; `None`: messages are not signed.
    pub key: Option<NotifyKey>,
    /// Shell command that runs at each end of a job.
    pub on_end: Option<String>,
}

impl NotifyConfig {
    /// Refuses notes with a URL that no prefix permits.
    pub(crate) fn check(&self, notes: &JobNotes) -> Result<(), Refusal> {
        let Some(url) = &notes.notify else { return Ok(()) };
        let allowed = url_prefix::check_url(&self.allowed, url).map(drop);
        allowed.map_err(|message| Refusal::Invalid { field: "notify".into(), message })
    }
}

/// Message that a job has ended.
#[derive(Serialize)]
struct Message {
    /// `job.done`, `job.failed` or `job.cancelled`.
    r#type: &'static str,
    /// Time at which the message was made, RFC 3339.
    timestamp: String,
    /// The job, in the form of `femc status --json`.
    data: JobJson,
}

/// End of a job that must be announced.
#[derive(Debug, Clone)]
struct JobEnd {
    job: JobId,
    ended: Tick,
    /// Id of the message, equal for all its repetitions.
    id: String,
    status: JobStatus,
    body: Arc<str>,
}

/// Announcements in progress.
#[derive(Debug)]
pub(crate) struct Announcer {
    config: Arc<NotifyConfig>,
    poster: Arc<Poster>,
    /// Slots for commands.
    commands: Arc<Semaphore>,
    in_progress: BTreeSet<(JobId, Tick)>,
    announced_sender: mpsc::Sender<(JobId, Tick)>,
    /// Announced ends: the message was accepted or given up, and the command has run.
    pub(crate) announced: mpsc::Receiver<(JobId, Tick)>,
}

impl Announcer {
    /// Maximum number of commands that run at the same time.
    const MAX_CONCURRENT_COMMANDS: usize = 4;

    pub(crate) fn new(config: NotifyConfig) -> Self {
        let (tell, told) = mpsc::channel(64);
        let poster = Arc::new(Poster::new(config.key.clone()));
        let commands = Arc::new(Semaphore::new(Self::MAX_CONCURRENT_COMMANDS));
        Self {
            config: Arc::new(config),
            poster,
            commands,
            in_progress: BTreeSet::new(),
            announced_sender: tell,
            announced: told,
        }
    }

    pub(crate) fn config(&self) -> &NotifyConfig {
        &self.config
    }

    /// Returns whether the end of a job with these notes must be announced to anyone.
    fn has_listeners(&self, notes: &JobNotes) -> bool {
        notes.notify.is_some() || self.config.on_end.is_some()
    }

    /// Starts the announcement of an end.
    fn start(&self, end: JobEnd) {
        let (config, poster, commands) = (self.config.clone(), self.poster.clone(), self.commands.clone());
        let tell = self.announced_sender.clone();
        tokio::spawn(async move {
            let posted = async {
                let Some(url) = &end.status.notes.notify else { return };
                match url_prefix::check_url(&config.allowed, url) {
                    Ok(url) => poster.post(&url, &end.id, &end.body).await,
                    // The URL was permitted when the job was submitted.
                    Err(message) => {
                        tracing::warn!(job = end.job.0, "cannot send the message about the job's end: {message}");
                    }
                }
            };
            let ran = async {
                let Some(command) = &config.on_end else { return };
                if let Ok(_place) = commands.acquire().await {
                    run::run_command(command, &end.status, &end.body).await;
                }
            };
            tokio::join!(posted, ran);
            // The send fails if the coordinator has stopped. Then the next coordinator announces the end again.
            let _ = tell.send((end.job, end.ended)).await;
        });
    }
}

impl<Q: Queue> Actor<Q> {
    /// Announces the end of a job, unless it is announced already or in progress.
    pub(crate) fn announce(&mut self, job: JobId) {
        let Some(ended) = self.scheduler.end_to_announce(job) else { return };
        let scheduler = &self.scheduler;
        self.announcer.in_progress.retain(|(job, ended)| scheduler.end_to_announce(*job) == Some(*ended));
        if !self.announcer.in_progress.insert((job, ended)) {
            return;
        }
        if !self.scheduler.spec(job).is_some_and(|spec| self.announcer.has_listeners(&spec.notes)) {
            self.follow_up_events.push_back(Event::Announced { job, ended });
            return;
        }
        let Ok(status) = self.scheduler.status(job, self.clock.now()) else { return };
        match job_end(job, ended, status) {
            Ok(end) => self.announcer.start(end),
            Err(error) => {
                tracing::error!(job = job.0, %error, "cannot announce the job's end");
                self.follow_up_events.push_back(Event::Announced { job, ended });
            }
        }
    }

    /// Announces the ends that the previous coordinator has not announced.
    pub(crate) fn announce_all(&mut self) {
        for (job, _) in self.scheduler.ends_to_announce() {
            self.announce(job);
        }
    }
}

fn job_end(job: JobId, ended: Tick, status: JobStatus) -> Result<JobEnd, serde_json::Error> {
    let message = Message {
        r#type: match status.state {
            JobState::Failed => "job.failed",
            JobState::Cancelled => "job.cancelled",
            JobState::Done | JobState::Queued | JobState::Running | JobState::Paused => "job.done",
        },
        timestamp: Timestamp::now().to_string(),
        data: JobJson::from(&status),
    };
    let body = serde_json::to_string(&message)?.into();
    Ok(JobEnd { job, ended, id: format!("femc-{job}-{}", ended.0), status, body })
}

/// Returns the Unix time in seconds, for the header of a message.
fn unix_seconds() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).as_ref().map_or(0, Duration::as_secs)
}
