//! Telling others that a job has ended: a message to the URL that the job names, and a command of this machine.
//!
//! Both happen at least once for each end, also where the coordinator dies in between: the log says which ends are announced. A
//! message is JSON, signed as [Standard Webhooks](https://www.standardwebhooks.com) has it, and sent again until it is taken. A
//! command is not repeated when it fails.

mod post;
mod run;
mod signature;
mod target;

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
pub use target::{PrefixError, UrlPrefix};

/// Listeners to the ends of jobs: URLs that jobs may name, and a command.
#[derive(Debug, Clone, Default)]
pub struct Announce {
    /// URLs that jobs may name begin with one of these; none: jobs may name no URL.
    pub allowed: Vec<UrlPrefix>,
    /// Key of the signatures; `None`: messages are not signed.
    pub key: Option<NotifyKey>,
    /// Command for the shell, run at each end of a job.
    pub on_end: Option<String>,
}

impl Announce {
    /// Refuses notes whose URL no prefix allows.
    pub(crate) fn check(&self, notes: &JobNotes) -> Result<(), Refusal> {
        let Some(url) = &notes.notify else { return Ok(()) };
        let allowed = target::allowed(&self.allowed, url).map(drop);
        allowed.map_err(|message| Refusal::Invalid { field: "notify".into(), message })
    }
}

/// The message that a job has ended.
#[derive(Serialize)]
struct Message {
    /// `job.done`, `job.failed` or `job.cancelled`.
    r#type: &'static str,
    /// Date of the end, RFC 3339.
    timestamp: String,
    /// The job, as `femc status --json` has it.
    data: JobJson,
}

/// An end to be told.
#[derive(Debug, Clone)]
struct End {
    job: JobId,
    ended: Tick,
    /// Name of the message: the same for each repetition.
    id: String,
    status: JobStatus,
    body: Arc<str>,
}

/// The coordinator's announcements under way.
#[derive(Debug)]
pub(crate) struct Announcer {
    config: Arc<Announce>,
    poster: Arc<Poster>,
    /// Places for commands.
    commands: Arc<Semaphore>,
    under_way: BTreeSet<(JobId, Tick)>,
    tell: mpsc::Sender<(JobId, Tick)>,
    /// Ends that are announced: their message was taken or given up, and their command has run.
    pub(crate) told: mpsc::Receiver<(JobId, Tick)>,
}

impl Announcer {
    /// Most commands that run at a time.
    const COMMANDS: usize = 4;

    pub(crate) fn new(config: Announce) -> Self {
        let (tell, told) = mpsc::channel(64);
        let poster = Arc::new(Poster::new(config.key.clone()));
        let commands = Arc::new(Semaphore::new(Self::COMMANDS));
        Self { config: Arc::new(config), poster, commands, under_way: BTreeSet::new(), tell, told }
    }

    pub(crate) fn config(&self) -> &Announce {
        &self.config
    }

    /// Whether somebody is to be told of the end of a job with these notes.
    fn has_listeners(&self, notes: &JobNotes) -> bool {
        notes.notify.is_some() || self.config.on_end.is_some()
    }

    /// Begins to tell of an end.
    fn begin(&self, end: End) {
        let (config, poster, commands) = (self.config.clone(), self.poster.clone(), self.commands.clone());
        let tell = self.tell.clone();
        tokio::spawn(async move {
            let posted = async {
                let Some(url) = &end.status.notes.notify else { return };
                match target::allowed(&config.allowed, url) {
                    Ok(url) => poster.post(&url, &end.id, &end.body).await,
                    // Allowed when the job was submitted.
                    Err(message) => {
                        tracing::warn!(job = end.job.0, "the message about the job's end is not sent: {message}");
                    }
                }
            };
            let ran = async {
                let Some(command) = &config.on_end else { return };
                if let Ok(_place) = commands.acquire().await {
                    run::run(command, &end.status, &end.body).await;
                }
            };
            tokio::join!(posted, ran);
            // The coordinator is gone: the next one tells it again.
            let _ = tell.send((end.job, end.ended)).await;
        });
    }
}

impl<Q: Queue> Actor<Q> {
    /// Tells of a job's end, if it has one that is to be told and is not being told.
    pub(crate) fn announce(&mut self, job: JobId) {
        let Some(ended) = self.scheduler.end_to_announce(job) else { return };
        let scheduler = &self.scheduler;
        self.announcer.under_way.retain(|(job, ended)| scheduler.end_to_announce(*job) == Some(*ended));
        if !self.announcer.under_way.insert((job, ended)) {
            return;
        }
        if !self.scheduler.spec(job).is_some_and(|spec| self.announcer.has_listeners(&spec.notes)) {
            self.echoes.push_back(Event::Announced { job, ended });
            return;
        }
        let Ok(status) = self.scheduler.status(job, self.clock.now()) else { return };
        match end(job, ended, status) {
            Ok(end) => self.announcer.begin(end),
            Err(error) => {
                tracing::error!(job = job.0, %error, "the job's end is not announced");
                self.echoes.push_back(Event::Announced { job, ended });
            }
        }
    }

    /// Tells of the ends that the coordinator before has not told of.
    pub(crate) fn announce_all(&mut self) {
        for (job, _) in self.scheduler.ends_to_announce() {
            self.announce(job);
        }
    }
}

fn end(job: JobId, ended: Tick, status: JobStatus) -> Result<End, serde_json::Error> {
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
    Ok(End { job, ended, id: format!("femc-{job}-{}", ended.0), status, body })
}

/// Seconds since 1970, as the header of a message has it.
fn unix_seconds() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).as_ref().map_or(0, Duration::as_secs)
}
