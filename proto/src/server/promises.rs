//! Promised artifacts: a client was told that they are in the store, or is uploading them. They are not garbage for a while, even
//! if nothing refers to them, because a submission or a result that names them may be on its way.
//!
//! A caller notes an artifact before it looks into the store, and garbage is not removed while artifacts are being noted. So an
//! artifact that was noted and then found will still be there later.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use femc_model::Digest;
use tokio::sync::{RwLock, RwLockWriteGuard};
use tokio::time::Instant;

/// Digests with the time of their last promise. Clones share them.
#[derive(Debug, Clone, Default)]
pub(super) struct Promises(Arc<Inner>);

#[derive(Debug, Default)]
struct Inner {
    /// Lock held for reading while digests are noted, and for writing while garbage is removed.
    gate: RwLock<()>,
    table: Mutex<PromiseTable>,
}

#[derive(Debug, Default)]
struct PromiseTable {
    times: BTreeMap<Digest, Instant>,
    /// Time when there were too many promises to remember.
    overflow: Option<Instant>,
}

impl Promises {
    /// Duration of a promise.
    pub(super) const DURATION: Duration = Duration::from_secs(3600);
    /// Largest number of promises to remember: about 100 MB.
    const CAPACITY: usize = 1 << 20;

    fn lock_table(&self) -> MutexGuard<'_, PromiseTable> {
        // A panic within the few lines under this lock leaves the state consistent.
        self.0.table.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes `digests`. Waits while garbage is being removed. Look into the store only afterwards.
    pub(super) async fn record(&self, digests: &[Digest]) {
        let _open = self.0.gate.read().await;
        self.record_at(digests, Instant::now(), Self::CAPACITY);
    }

    fn record_at(&self, digests: &[Digest], now: Instant, capacity: usize) {
        let mut table = self.lock_table();
        table.times.extend(digests.iter().map(|digest| (*digest, now)));
        if table.times.len() > capacity {
            table.times.retain(|_, time| now.saturating_duration_since(*time) < Self::DURATION);
        }
        if table.times.len() > capacity {
            table.times.clear();
            table.overflow = Some(now);
        }
    }

    /// Drops the promise of a new artifact, which its age protects. So a farm that makes many artifacts needs few promises.
    pub(super) fn remove(&self, digest: &Digest) {
        self.lock_table().times.remove(digest);
    }

    /// Blocks notes until the returned guard is dropped.
    pub(super) async fn block_recording(&self) -> RwLockWriteGuard<'_, ()> {
        self.0.gate.write().await
    }

    /// Checks that the digest was noted within `grace`.
    pub(super) fn is_promised(&self, digest: &Digest, grace: Duration) -> bool {
        self.lock_table().times.get(digest).is_some_and(|time| time.elapsed() < grace.min(Self::DURATION))
    }

    /// Returns the remaining time of promises that were lost in an overflow; `None` if there are none.
    pub(super) fn overflow_remaining(&self) -> Option<Duration> {
        self.lock_table().overflow.and_then(|since| Self::DURATION.checked_sub(since.elapsed()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn promise_holds_for_grace_period_and_waits_for_collection() {
        let promises = Promises::default();
        let [one, two] = [Digest::compute(b"one"), Digest::compute(b"two")];
        promises.record(&[one]).await;
        assert!(promises.is_promised(&one, Duration::from_secs(60)) && !promises.is_promised(&one, Duration::ZERO));
        assert!(!promises.is_promised(&two, Duration::from_secs(60)));
        let closed = promises.block_recording().await;
        let late = tokio::spawn({
            let promised = promises.clone();
            async move { promised.record(&[two]).await }
        });
        tokio::task::yield_now().await;
        assert!(!late.is_finished() && !promises.is_promised(&two, Duration::from_secs(60)));
        drop(closed);
        late.await.unwrap();
        assert!(promises.is_promised(&two, Duration::from_secs(60)));
    }

    #[test]
    fn too_many_promises_forbid_collection_to_bound_memory() {
        let promises = Promises::default();
        let digests: Vec<Digest> = (0..11u8).map(|i| Digest::compute(&[i])).collect();
        promises.record_at(&digests[..10], Instant::now(), 10);
        assert_eq!(promises.overflow_remaining(), None);
        promises.record_at(&digests[10..], Instant::now(), 10);
        assert!(promises.overflow_remaining().is_some() && promises.lock_table().times.is_empty());
    }
}
