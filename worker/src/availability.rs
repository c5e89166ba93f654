//! The times at which a worker takes tasks: its working hours and its idle limit.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use crate::task_table::TaskTable;

/// Whether a worker takes tasks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Availability {
    /// Takes tasks.
    Available,
    /// Finishes the tasks that have begun, stays connected, and begins no new task.
    Off,
}

/// The worker's schedule: says at any time whether the worker takes tasks.
#[derive(Clone)]
pub struct WorkingHours(Arc<dyn Fn() -> Availability + Send + Sync>);

impl WorkingHours {
    /// Creates a schedule from `availability`, which is called at every heartbeat.
    pub fn from_fn(availability: impl Fn() -> Availability + Send + Sync + 'static) -> Self {
        Self(Arc::new(availability))
    }

    pub(crate) fn availability(&self) -> Availability {
        (self.0)()
    }
}

impl Default for WorkingHours {
    fn default() -> Self {
        Self::from_fn(|| Availability::Available)
    }
}

impl fmt::Debug for WorkingHours {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Shift")
    }
}

/// Returns when the worker has held no task for `limit`. Without a limit, it never returns.
pub(crate) async fn wait_until_idle_limit(table: &TaskTable, limit: Option<Duration>) {
    /// Polling interval while the worker holds tasks.
    const POLL_INTERVAL: Duration = Duration::from_millis(100);
    let Some(limit) = limit else { return std::future::pending().await };
    loop {
        match table.idle_since() {
            None => tokio::time::sleep(POLL_INTERVAL).await,
            Some(since) if since.elapsed() >= limit => {
                tracing::info!(?limit, "idle limit reached: stopping");
                return;
            }
            Some(since) => tokio::time::sleep_until(idle_deadline(since, limit)).await,
        }
    }
}

/// Returns `since + limit`, with `limit` capped at a year so that the sum does not overflow.
fn idle_deadline(since: Instant, limit: Duration) -> Instant {
    const YEAR: Duration = Duration::from_secs(31_536_000);
    since + limit.min(YEAR)
}
