//! Cache of the attempt times of jobs that users look at.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use femc_model::{JobId, Refusal};
use tokio::sync::{Mutex as AsyncMutex, OwnedMutexGuard};
use tokio::time::Instant;

use super::job::JobTimes;
use crate::call::{AttemptPage, Call, JobShape};
use crate::farm::Farm;

/// Times of jobs. A job is kept as long as users ask for it.
#[derive(Debug, Clone, Default)]
pub struct TimesCache(Arc<Mutex<BTreeMap<JobId, Slot>>>);

#[derive(Debug, Clone)]
struct Slot {
    times: Arc<AsyncMutex<JobTimes>>,
    last_used: Instant,
    attempts: usize,
}

impl TimesCache {
    /// Maximum number of attempts kept for all jobs together, about 130 bytes each. The times of a job with more attempts are not
    /// available.
    pub const MAX_ATTEMPTS: usize = 2_000_000;
    /// Time for which a job is kept after the last request for it.
    const RETENTION: Duration = Duration::from_secs(60);

    fn slots(&self) -> MutexGuard<'_, BTreeMap<JobId, Slot>> {
        // Nothing panics under this lock.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn slot(&self, job: JobId) -> Arc<AsyncMutex<JobTimes>> {
        let mut slots = self.slots();
        if slots.is_empty() {
            tokio::spawn(evict_unused(Arc::downgrade(&self.0)));
        }
        let slot =
            slots.entry(job).or_insert_with(|| Slot { times: Arc::default(), last_used: Instant::now(), attempts: 0 });
        slot.last_used = Instant::now();
        slot.times.clone()
    }

    /// Records the number of attempts of a job. If the limit is exceeded, the least recently used jobs are dropped.
    fn record_size(&self, job: JobId, attempts: usize) {
        let mut slots = self.slots();
        if let Some(slot) = slots.get_mut(&job) {
            slot.attempts = attempts;
        }
        while slots.values().map(|slot| slot.attempts).sum::<usize>() > Self::MAX_ATTEMPTS {
            let others = slots.iter().filter(|(other, _)| **other != job);
            let Some(oldest) = others.min_by_key(|(_, slot)| slot.last_used).map(|(other, _)| *other) else { break };
            slots.remove(&oldest);
        }
    }

    /// Returns the times of a job's ended attempts; `None`: there are more than [`Self::MAX_ATTEMPTS`].
    pub async fn get<S>(
        &self,
        farm: &Farm<S>,
        job: JobId,
        shape: &JobShape,
    ) -> Result<Option<OwnedMutexGuard<JobTimes>>, Refusal> {
        let mut times = self.slot(job).lock_owned().await;
        loop {
            let from = times.from;
            let AttemptPage { attempts, next } = farm.call(|reply| Call::Attempts { job, from, reply }).await?;
            attempts.iter().for_each(|record| times.put(shape, record));
            self.record_size(job, times.len());
            if times.len() > Self::MAX_ATTEMPTS {
                self.slots().remove(&job);
                return Ok(None);
            }
            let Some(next) = next else { break };
            times.from = next;
        }
        times.update_sums();
        Ok(Some(times))
    }
}

/// Drops jobs without recent requests. Ends when none is left.
async fn evict_unused(slots: Weak<Mutex<BTreeMap<JobId, Slot>>>) {
    loop {
        tokio::time::sleep(TimesCache::RETENTION / 2).await;
        let Some(slots) = slots.upgrade() else { return };
        let mut slots = slots.lock().unwrap_or_else(PoisonError::into_inner);
        slots.retain(|_, slot| slot.last_used.elapsed() < TimesCache::RETENTION);
        if slots.is_empty() {
            return;
        }
    }
}
