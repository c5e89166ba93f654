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
pub(super) struct Promised(Arc<Inner>);

#[derive(Debug, Default)]
struct Inner {
    /// Lock held for reading while digests are noted, and for writing while garbage is removed.
    gate: RwLock<()>,
    noted: Mutex<Noted>,
}

#[derive(Debug, Default)]
struct Noted {
    times: BTreeMap<Digest, Instant>,
    /// Time when there were too many promises to remember.
    overflow: Option<Instant>,
}

impl Promised {
    /// Duration of a promise.
    pub(super) const HOLDS: Duration = Duration::from_secs(3600);
    /// Largest number of promises to remember: about 100 MB.
    const MOST: usize = 1 << 20;

    fn lock(&self) -> MutexGuard<'_, Noted> {
        // A panic within the few lines under this lock leaves the state consistent.
        self.0.noted.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes `digests`. Waits while garbage is being removed. Look into the store only afterwards.
    pub(super) async fn note(&self, digests: &[Digest]) {
        let _open = self.0.gate.read().await;
        self.note_at(digests, Instant::now(), Self::MOST);
    }

    fn note_at(&self, digests: &[Digest], now: Instant, most: usize) {
        let mut noted = self.lock();
        noted.times.extend(digests.iter().map(|digest| (*digest, now)));
        if noted.times.len() > most {
            noted.times.retain(|_, time| now.saturating_duration_since(*time) < Self::HOLDS);
        }
        if noted.times.len() > most {
            noted.times.clear();
            noted.overflow = Some(now);
        }
    }

    /// Drops the promise of a new artifact, which its age protects. So a farm that makes many artifacts needs few promises.
    pub(super) fn forget(&self, digest: &Digest) {
        self.lock().times.remove(digest);
    }

    /// Blocks notes until the returned guard is dropped.
    pub(super) async fn close(&self) -> RwLockWriteGuard<'_, ()> {
        self.0.gate.write().await
    }

    /// Checks that the digest was noted within `grace`.
    pub(super) fn holds(&self, digest: &Digest, grace: Duration) -> bool {
        self.lock().times.get(digest).is_some_and(|time| time.elapsed() < grace.min(Self::HOLDS))
    }

    /// Returns the remaining time of promises that were lost in an overflow; `None` if there are none.
    pub(super) fn is_blind_for(&self) -> Option<Duration> {
        self.lock().overflow.and_then(|since| Self::HOLDS.checked_sub(since.elapsed()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn promise_holds_for_grace_period_and_waits_for_collection() {
        let promised = Promised::default();
        let [one, two] = [Digest::of(b"one"), Digest::of(b"two")];
        promised.note(&[one]).await;
        assert!(promised.holds(&one, Duration::from_secs(60)) && !promised.holds(&one, Duration::ZERO));
        assert!(!promised.holds(&two, Duration::from_secs(60)));
        let closed = promised.close().await;
        let late = tokio::spawn({
            let promised = promised.clone();
            async move { promised.note(&[two]).await }
        });
        tokio::task::yield_now().await;
        assert!(!late.is_finished() && !promised.holds(&two, Duration::from_secs(60)));
        drop(closed);
        late.await.unwrap();
        assert!(promised.holds(&two, Duration::from_secs(60)));
    }

    #[test]
    fn too_many_promises_forbid_collection_to_bound_memory() {
        let promised = Promised::default();
        let digests: Vec<Digest> = (0..11u8).map(|i| Digest::of(&[i])).collect();
        promised.note_at(&digests[..10], Instant::now(), 10);
        assert_eq!(promised.is_blind_for(), None);
        promised.note_at(&digests[10..], Instant::now(), 10);
        assert!(promised.is_blind_for().is_some() && promised.lock().times.is_empty());
    }
}
