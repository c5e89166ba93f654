//! When a worker takes tasks: its hours, and how long it waits for one.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use crate::table::Table;

/// Whether a worker takes tasks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Availability {
    /// It does.
    Available,
    /// It finishes what it has begun, stays connected, and begins nothing.
    Off,
}

/// Says at any time whether the worker takes tasks.
#[derive(Clone)]
pub struct Shift(Arc<dyn Fn() -> Availability + Send + Sync>);

impl Shift {
    /// As `shift` says; it is asked at every heartbeat.
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

/// Returns when the worker has had no task for `limit`; never without one.
pub(crate) async fn idle(table: &Table, limit: Option<Duration>) {
    /// Between two looks at a worker that has tasks.
    const LOOK: Duration = Duration::from_millis(100);
    let Some(limit) = limit else { return std::future::pending().await };
    loop {
        match table.idle_since() {
            None => tokio::time::sleep(LOOK).await,
            Some(since) if since.elapsed() >= limit => {
                tracing::info!(?limit, "no task for so long: ending");
                return;
            }
            Some(since) => tokio::time::sleep_until(far(since, limit)).await,
        }
    }
}

/// `since + limit`, however long that is.
fn far(since: Instant, limit: Duration) -> Instant {
    const YEAR: Duration = Duration::from_secs(31_536_000);
    since + limit.min(YEAR)
}
