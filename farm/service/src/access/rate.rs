//! Rate limits per caller: a token bucket for each, which refills steadily.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::time::Instant;

use super::Limits;

/// Buckets by caller. Clones share them.
#[derive(Debug, Clone)]
pub(crate) struct RateLimiter {
    /// Average time between two calls.
    interval: Duration,
    /// Time by which a caller may be ahead of the average rate.
    tolerance: Duration,
    /// Time at which the next call of each caller would be due at the average rate. A caller without an entry starts with a full
    /// bucket.
    due: Arc<Mutex<BTreeMap<String, Instant>>>,
}

impl RateLimiter {
    /// Maximum wait of a call that is too early.
    const MAX_WAIT: Duration = Duration::from_secs(1);
    /// Number of remembered callers beyond which idle callers are forgotten.
    const CALLERS: usize = 4096;

    pub(crate) fn new(limits: &Limits) -> Self {
        let every = Duration::from_secs(1) / limits.rate.max(1);
        Self { interval: every, tolerance: every * limits.burst, due: Arc::default() }
    }

    /// Returns how long a call at `now` must wait; `None`: the caller made too many calls.
    pub(crate) fn delay(&self, caller: &str, now: Instant) -> Option<Duration> {
        let mut all = self.due.lock().unwrap_or_else(PoisonError::into_inner);
        if all.len() >= Self::CALLERS && !all.contains_key(caller) {
            all.retain(|_, due| *due > now);
        }
        let due = all.get(caller).copied().unwrap_or(now).max(now);
        let next = due + self.interval;
        let wait = next.saturating_duration_since(now + self.tolerance);
        if wait > Self::MAX_WAIT {
            return None;
        }
        all.insert(caller.to_owned(), next);
        Some(wait)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_burst_passes_what_follows_waits_and_a_flood_is_refused() {
        let rates = RateLimiter::new(&Limits { rate: 10, burst: 5, ..Limits::default() });
        let now = Instant::now();
        let turns: Vec<_> = (0..20).map(|_| rates.delay("ann", now)).collect();
        assert_eq!(turns[..5], [Some(Duration::ZERO); 5]);
        let waits = (1..=10).map(|n| Some(Duration::from_millis(100 * n)));
        assert!(turns[5..15].iter().copied().eq(waits), "{turns:?}");
        assert_eq!(turns[15..], [None; 5]);
        assert_eq!(rates.delay("bob", now), Some(Duration::ZERO), "one caller's flood is not another's");
        assert_eq!(rates.delay("ann", now + Duration::from_secs(10)), Some(Duration::ZERO));
    }

    #[tokio::test]
    async fn callers_without_number_are_not_remembered() {
        let rates = RateLimiter::new(&Limits::default());
        let mut now = Instant::now();
        for n in 0..3 * RateLimiter::CALLERS {
            rates.delay(&n.to_string(), now);
            now += Duration::from_millis(1);
        }
        assert!(rates.due.lock().unwrap().len() <= RateLimiter::CALLERS);
    }
}
