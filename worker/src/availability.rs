//! The times at which a worker takes tasks: its working hours and its idle limit.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use crate::table::Table;

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
pub struct Shift(Arc<dyn Fn() -> Availability + Send + Sync>);

impl Shift {
    /// Creates a schedule from `shift`, which is called at every heartbeat.
    pub fn by(shift: impl Fn() -> Availability + Send + Sync + 'static) -> Self {
        Self(Arc::new(shift))
    }

    pub(crate) fn now(&self) -> Availability {
        (self.0)()
    }
}

impl Default for Shift {
    fn default() -> Self {
        Self::by(|| Availability::Available)
    }
}

impl fmt::Debug for Shift {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Shift")
    }
}

/// Returns when the worker has held no task for `limit`. Without a limit, it never returns.
pub(crate) async fn idle(table: &Table, limit: Option<Duration>) {
    /// Polling interval while the worker holds tasks.
    const LOOK: Duration = Duration::from_millis(100);
    let Some(limit) = limit else { return std::future::pending().await };
    loop {
        match table.idle_since() {
            None => tokio::time::sleep(LOOK).await,
            Some(since) if since.elapsed() >= limit => {
                tracing::info!(?limit, "idle limit reached: stopping");
                return;
            }
            Some(since) => tokio::time::sleep_until(far(since, limit)).await,
        }
    }
}

/// Returns `since + limit`, with `limit` capped at a year so that the sum does not overflow.
fn far(since: Instant, limit: Duration) -> Instant {
    const YEAR: Duration = Duration::from_secs(31_536_000);
    since + limit.min(YEAR)
}
