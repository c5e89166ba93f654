//! Leader election: a standby waits until this coordinator leads.

use std::time::Duration;

use sqlx::Row as _;
use sqlx::postgres::PgConnection;
use tokio::time::Instant;

use super::database::{Commit, Database};
use super::heartbeat::HeartbeatTask;
use super::{Postgres, schema};
use crate::{LossPolicy, QueueError};

/// Key of the advisory lock that the leader holds on its writing connection: the letters `femc`.
const LOCK: i64 = 0x6665_6d63;

/// Takes the lock and the next epoch in one statement: a coordinator that freezes has either both or neither.
const TAKE_LEAD: &str = "
    WITH lock AS MATERIALIZED (SELECT pg_try_advisory_lock($1) AS had)
    UPDATE femc.leader SET epoch = epoch + 1, url = $2, backend = pg_backend_pid(), seen = clock_timestamp()
    FROM lock WHERE lock.had RETURNING epoch";

/// Returns the leader, if there is one: the holder of the lock that also has the epoch. Terminates the leader's connection, and
/// with it the lock, if its last heartbeat is more than `$2` seconds old.
const FIND_LEADER: &str = "
    SELECT leader.url, leader.epoch, CASE
        WHEN leader.seen < clock_timestamp() - make_interval(secs => $2)
        THEN pg_terminate_backend(held.pid) ELSE false END
    FROM femc.leader JOIN pg_locks held ON held.pid = leader.backend AND held.granted
        AND held.locktype = 'advisory'
        AND held.database = (SELECT oid FROM pg_database WHERE datname = current_database())
        AND held.classid = 0 AND held.objid = $1::bigint::oid AND held.objsubid = 1";

/// The leading coordinator, as recorded in the database.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Leader {
    /// Address of the coordinator.
    pub url: String,
    /// Number of the leadership; grows with each new leader.
    pub epoch: i64,
}

/// A coordinator that waits to become the leader.
#[derive(Debug)]
pub struct Standby {
    database: Database,
    connection: PgConnection,
    url: String,
    silence: Duration,
    loss_policy: LossPolicy,
}

impl Standby {
    /// Time between two attempts to take the leadership.
    const POLL_INTERVAL: Duration = Duration::from_millis(200);

    /// Connects, and creates the tables if they are missing.
    /// - `url`: address of this coordinator when it leads.
    /// - `silence`: a leader without a heartbeat for this time is replaced; all coordinators of a farm should use the same value.
    pub async fn open(database: Database, url: String, silence: Duration) -> Result<Self, QueueError> {
        let mut connection = database.connect(Commit::Durable).await?;
        schema::prepare(&database, &mut connection).await?;
        Ok(Self { database, connection, url, silence, loss_policy: LossPolicy::Refuse })
    }

    /// Sets the policy for a log that lacks acknowledged records. By default it is refused.
    pub fn with_loss_policy(self, loss: LossPolicy) -> Self {
        Self { loss_policy: loss, ..self }
    }

    /// Waits until this coordinator leads. Calls `on_leader_change` with the current leader, first and after every change.
    pub async fn wait_for_lead(
        mut self,
        mut on_leader_change: impl FnMut(Leader) + Send,
    ) -> Result<Postgres, QueueError> {
        let mut known = None;
        loop {
            let requested = Instant::now();
            if let Some(epoch) = self.try_take_lead().await? {
                let Self { database, connection, silence, loss_policy: loss, .. } = self;
                let pulse = HeartbeatTask::start(database.clone(), epoch, requested, silence);
                return Ok(Postgres {
                    database,
                    connection,
                    heartbeat: pulse,
                    epoch,
                    loss_policy: loss,
                    next_sequence: 1,
                });
            }
            if let Some(leader) = self.find_leader().await?
                && known.as_ref() != Some(&leader)
            {
                known = Some(leader.clone());
                on_leader_change(leader);
            }
            tokio::time::sleep(Self::POLL_INTERVAL).await;
        }
    }

    async fn try_take_lead(&mut self) -> Result<Option<i64>, QueueError> {
        let take = sqlx::query(TAKE_LEAD).bind(LOCK).bind(&self.url).fetch_optional(&mut self.connection);
        let taken = self.database.with_timeout(take).await?;
        taken.map(|row| row.try_get(0)).transpose().map_err(|error| self.database.map_sql_error(&error))
    }

    async fn find_leader(&mut self) -> Result<Option<Leader>, QueueError> {
        let seconds = self.silence.as_secs_f64();
        let look = sqlx::query(FIND_LEADER).bind(LOCK).bind(seconds).fetch_optional(&mut self.connection);
        let Some(row) = self.database.with_timeout(look).await? else { return Ok(None) };
        let read = || Ok((Leader { url: row.try_get(0)?, epoch: row.try_get(1)? }, row.try_get::<bool, _>(2)?));
        let (leader, is_ended) = read().map_err(|error| self.database.map_sql_error(&error))?;
        if is_ended {
            tracing::warn!(url = leader.url, seconds, "the leader is silent; terminated its database connection");
        }
        Ok(Some(leader))
    }
}
