//! A leader's heartbeats, and its own check that it still leads.
//!
//! Heartbeats have their own connection, so that a long write or a busy scheduler does not look like a dead leader. A leader gives
//! up by its own clock before others may replace it: it measures from the time when a heartbeat was sent, the others from the time
//! when it was received.

use std::time::Duration;

use sqlx::postgres::PgConnection;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep_until, timeout};

use super::database::{Commit, Database};
use crate::QueueError;

const HEARTBEAT: &str = "UPDATE femc.leader SET seen = clock_timestamp() WHERE epoch = $1";

/// Result of the last heartbeat.
#[derive(Debug, Clone, Copy)]
enum Leadership {
    /// This process led at this time, and leads until the allowed silence has passed.
    Leads(Instant),
    /// Another coordinator leads.
    Deposed,
}

/// A task that sends heartbeats until it is dropped.
#[derive(Debug)]
pub(super) struct HeartbeatTask {
    database: Database,
    epoch: i64,
    silence: Duration,
    leadership: watch::Receiver<Leadership>,
    task: JoinHandle<()>,
}

impl Drop for HeartbeatTask {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl HeartbeatTask {
    /// Maximum time between two heartbeats.
    const MAX_INTERVAL: Duration = Duration::from_secs(1);

    /// Starts the heartbeats.
    /// - `since`: time at which this process requested the leadership that it now has.
    pub(super) fn start(database: Database, epoch: i64, since: Instant, silence: Duration) -> Self {
        let (sender, standing) = watch::channel(Leadership::Leads(since));
        let beating = tokio::spawn(send_heartbeats(database.clone(), epoch, silence, sender));
        Self { database, epoch, silence, leadership: standing, task: beating }
    }

    /// Fails if this process does not lead, or cannot be sure that it does.
    pub(super) fn check(&self) -> Result<(), QueueError> {
        match *self.leadership.borrow() {
            Leadership::Leads(since) if since.elapsed() < self.silence => Ok(()),
            Leadership::Leads(_) => Err(self.no_answer_error()),
            Leadership::Deposed => Err(QueueError::Deposed { epoch: self.epoch }),
        }
    }

    /// Waits until [`Self::check`] would fail, and returns its error.
    pub(super) async fn until_doubtful(&mut self) -> QueueError {
        loop {
            let until = match *self.leadership.borrow_and_update() {
                Leadership::Leads(since) => since + self.silence,
                Leadership::Deposed => return QueueError::Deposed { epoch: self.epoch },
            };
            tokio::select! {
                biased;
                Ok(()) = self.leadership.changed() => {}
                () = sleep_until(until) => return self.no_answer_error(),
            }
        }
    }

    fn no_answer_error(&self) -> QueueError {
        self.database.unreachable_error(format!("no answer for {:.1} s", self.silence.as_secs_f64()))
    }
}

async fn send_heartbeats(database: Database, epoch: i64, silence: Duration, sender: watch::Sender<Leadership>) {
    let pause = (silence / 4).min(HeartbeatTask::MAX_INTERVAL);
    let mut connection: Option<PgConnection> = None;
    loop {
        let requested = Instant::now();
        let heartbeat = async {
            let mut open = match connection.take() {
                Some(open) => open,
                None => database.connect(Commit::Fleeting).await?,
            };
            let updated = sqlx::query(HEARTBEAT).bind(epoch).execute(&mut open).await;
            let updated = updated.map_err(|error| database.map_sql_error(&error))?.rows_affected();
            Ok::<_, QueueError>((open, updated))
        };
        match timeout(silence, heartbeat).await {
            Ok(Ok((open, 1))) => {
                connection = Some(open);
                sender.send_replace(Leadership::Leads(requested));
            }
            Ok(Ok(_)) => {
                sender.send_replace(Leadership::Deposed);
                return;
            }
            Ok(Err(error)) => tracing::debug!(%error, "the leader's heartbeat failed"),
            Err(_) => tracing::debug!("the leader's heartbeat timed out"),
        }
        sleep_until(requested + pause).await;
    }
}
