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

const BEAT: &str = "UPDATE femc.leader SET seen = clock_timestamp() WHERE epoch = $1";

/// Result of the last heartbeat.
#[derive(Debug, Clone, Copy)]
enum Standing {
    /// This process led at this time, and leads until the allowed silence has passed.
    Leads(Instant),
    /// Another coordinator leads.
    Deposed,
}

/// A task that sends heartbeats until it is dropped.
#[derive(Debug)]
pub(super) struct Pulse {
    database: Database,
    epoch: i64,
    silence: Duration,
    standing: watch::Receiver<Standing>,
    beating: JoinHandle<()>,
}

impl Drop for Pulse {
    fn drop(&mut self) {
        self.beating.abort();
    }
}

impl Pulse {
    /// Maximum time between two heartbeats.
    const LONGEST: Duration = Duration::from_secs(1);

    /// Starts the heartbeats.
    /// - `since`: time at which this process requested the leadership that it now has.
    pub(super) fn start(database: Database, epoch: i64, since: Instant, silence: Duration) -> Self {
        let (tell, standing) = watch::channel(Standing::Leads(since));
        let beating = tokio::spawn(beat(database.clone(), epoch, silence, tell));
        Self { database, epoch, silence, standing, beating }
    }

    /// Fails if this process does not lead, or cannot be sure that it does.
    pub(super) fn check(&self) -> Result<(), QueueError> {
        match *self.standing.borrow() {
            Standing::Leads(since) if since.elapsed() < self.silence => Ok(()),
            Standing::Leads(_) => Err(self.lost()),
            Standing::Deposed => Err(QueueError::Deposed { epoch: self.epoch }),
        }
    }

    /// Waits until [`Self::check`] would fail, and returns its error.
    pub(super) async fn doubt(&mut self) -> QueueError {
        loop {
            let until = match *self.standing.borrow_and_update() {
                Standing::Leads(since) => since + self.silence,
                Standing::Deposed => return QueueError::Deposed { epoch: self.epoch },
            };
            tokio::select! {
                biased;
                Ok(()) = self.standing.changed() => {}
                () = sleep_until(until) => return self.lost(),
            }
        }
    }

    fn lost(&self) -> QueueError {
        self.database.away(format!("no answer for {:.1} s", self.silence.as_secs_f64()))
    }
}

async fn beat(database: Database, epoch: i64, silence: Duration, tell: watch::Sender<Standing>) {
    let pause = (silence / 4).min(Pulse::LONGEST);
    let mut connection: Option<PgConnection> = None;
    loop {
        let asked = Instant::now();
        let sign = async {
            let mut open = match connection.take() {
                Some(open) => open,
                None => database.connect(Commit::Fleeting).await?,
            };
            let beaten = sqlx::query(BEAT).bind(epoch).execute(&mut open).await;
            let beaten = beaten.map_err(|error| database.map_sql_error(&error))?.rows_affected();
            Ok::<_, QueueError>((open, beaten))
        };
        match timeout(silence, sign).await {
            Ok(Ok((open, 1))) => {
                connection = Some(open);
                tell.send_replace(Standing::Leads(asked));
            }
            Ok(Ok(_)) => {
                tell.send_replace(Standing::Deposed);
                return;
            }
            Ok(Err(error)) => tracing::debug!(%error, "the leader's heartbeat failed"),
            Err(_) => tracing::debug!("the leader's heartbeat timed out"),
        }
        sleep_until(asked + pause).await;
    }
}
