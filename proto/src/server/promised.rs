//! What somebody was told is there, or is sending: it is not garbage for a while, whoever refers to it, because a
//! submission or a result that names it may be on its way.
//!
//! Noting comes before looking, and garbage is removed while nobody notes: whoever notes an artifact and then finds it in
//! the store will find it there later.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use femc_model::Digest;
use tokio::sync::{RwLock, RwLockWriteGuard};
use tokio::time::Instant;

/// Digests by when they were last noted; clones share them.
#[derive(Debug, Clone, Default)]
pub(super) struct Promised(Arc<Inner>);

#[derive(Debug, Default)]
struct Inner {
    /// Held for reading while digests are noted, for writing while garbage is removed.
    gate: RwLock<()>,
    noted: Mutex<Noted>,
}

#[derive(Debug, Default)]
struct Noted {
    times: BTreeMap<Digest, Instant>,
    /// When there were too many to remember.
    overflow: Option<Instant>,
}

impl Promised {
    /// How long a promise holds.
    pub(super) const HOLDS: Duration = Duration::from_secs(3600);
    /// Most promises that are remembered: some 100 MB.
    const MOST: usize = 1 << 20;

    fn lock(&self) -> MutexGuard<'_, Noted> {
        // A panic within the few lines under this lock leaves nothing half done.
        self.0.noted.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes `digests`; waits while garbage is being removed. Look into the store only afterwards.
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

    /// What is new needs no promise; so a farm that makes a lot of artifacts has few of them.
    pub(super) fn forget(&self, digest: &Digest) {
        self.lock().times.remove(digest);
    }

    /// Until dropped, nothing is noted.
    pub(super) async fn close(&self) -> RwLockWriteGuard<'_, ()> {
        self.0.gate.write().await
    }

    /// Whether the digest was noted within `grace`.
    pub(super) fn holds(&self, digest: &Digest, grace: Duration) -> bool {
        self.lock().times.get(digest).is_some_and(|time| time.elapsed() < grace.min(Self::HOLDS))
    }

    /// How long it takes until promises that were forgotten hold no longer.
    pub(super) fn is_blind_for(&self) -> Option<Duration> {
        self.lock().overflow.and_then(|since| Self::HOLDS.checked_sub(since.elapsed()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_promise_holds_for_the_grace_period_and_is_not_made_while_garbage_goes() {
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
    fn too_many_promises_forbid_collection_for_a_while_instead_of_filling_the_memory() {
        let promised = Promised::default();
        let digests: Vec<Digest> = (0..11u8).map(|i| Digest::of(&[i])).collect();
        promised.note_at(&digests[..10], Instant::now(), 10);
        assert_eq!(promised.is_blind_for(), None);
        promised.note_at(&digests[10..], Instant::now(), 10);
        assert!(promised.is_blind_for().is_some() && promised.lock().times.is_empty());
    }
}
