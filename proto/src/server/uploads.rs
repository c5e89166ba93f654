//! Uploads in progress, and interrupted uploads, which are kept for a while so that they can resume.
//!
//! Uploads are keyed by digest, regardless of the sender: the received bytes are checked against the digest at the end. An upload is a
//! value that belongs to one sender at a time, so senders cannot mix their bytes. An interrupted upload stays here until a sender
//! resumes it at the right offset. Another sender of the same artifact waits for the first one to finish, and then sends nothing.
//! The first sender may be slow or stuck. So after a while, a waiting sender gets an upload of its own, as long as there are few
//! uploads of that artifact. The first complete upload is kept, and the other senders learn with their next piece that the artifact
//! is in the store.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use femc_model::{Artifact, Digest, Refusal};
use femc_service::store_refusal;
use femc_store::{Novelty, Soundness, Store, Upload};
use tokio::sync::Notify;
use tokio::time::Instant;

/// Uploads in progress, by digest. Clones share them.
#[derive(Debug, Clone, Default)]
pub(super) struct Uploads(Arc<Inner>);

#[derive(Debug, Default)]
struct Inner {
    state: Mutex<State>,
    /// Signaled when an upload ends or is interrupted. Waiting senders wake in the order of their arrival.
    ended: Notify,
}

#[derive(Debug, Default)]
struct State {
    entries: BTreeMap<Digest, Entry>,
    /// Number of interrupted uploads so far; gives their order.
    cuts: u64,
}

#[derive(Debug, Default)]
struct Entry {
    /// Number of current senders.
    senders: usize,
    /// The finished artifact, if one of the senders has finished: it is in the store.
    kept: Option<Artifact>,
    /// An interrupted upload that a sender can resume.
    parked: Option<Parked>,
}

#[derive(Debug)]
struct Parked {
    upload: Upload,
    since: Instant,
    number: u64,
}

/// Knowledge of a sender that begins at offset 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Start {
    /// It knows the upload parked here, because it was told where to begin.
    Fresh,
    /// It does not know an upload that was parked while it waited.
    Waited,
}

/// Answer to a client that wants to send.
#[derive(Debug)]
pub(super) enum Turn {
    /// The artifact is in the store already.
    There(Artifact),
    /// The client may send.
    Sends(Box<Sending>),
}

impl Uploads {
    /// Number of interrupted uploads to keep. Each has up to one part (8 MiB) in memory; the rest is on the storage medium.
    const KEPT: usize = 8;
    /// Time for which interrupted uploads are kept.
    const KEEP: Duration = Duration::from_secs(600);
    /// Time that a sender waits for another sender of the same artifact.
    const WAIT: Duration = Duration::from_secs(5);
    /// Largest number of uploads of one artifact at a time. The storage medium may hold its bytes this many times. Further senders
    /// wait without a time limit.
    const SIDE_BY_SIDE: usize = 3;

    fn lock(&self) -> MutexGuard<'_, State> {
        // A panic within the few lines under this lock leaves the state consistent.
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until fewer than `most` clients send the artifact.
    async fn room(&self, digest: &Digest, most: usize) {
        let is_crowded = || self.lock().entries.get(digest).is_some_and(|entry| entry.senders >= most);
        loop {
            // Subscribe before the check, so that no end is missed.
            let ended = self.0.ended.notified();
            if !is_crowded() {
                return;
            }
            ended.await;
        }
    }

    /// Returns the offset of the first byte wanted of an artifact. Waits a while for a current sender. Ask the store afterwards
    /// whether it has the artifact.
    pub(super) async fn offered(&self, digest: &Digest) -> u64 {
        // A timeout is no error: a client that then sends waits again.
        let _ = tokio::time::timeout(Self::WAIT, self.room(digest, 1)).await;
        let state = self.lock();
        let parked = state.entries.get(digest).and_then(|entry| entry.parked.as_ref());
        parked.map_or(0, |cut| cut.upload.size())
    }

    /// Begins an upload, or resumes one that has `offset` bytes. Offset 0 begins a new upload and discards an interrupted one. The
    /// exception is an upload that was interrupted while this sender waited: it is kept, because this sender did not know of it and
    /// may be gone itself.
    pub(super) async fn take(&self, store: &Store, digest: Digest, offset: u64) -> Result<Turn, Refusal> {
        self.tidy(Instant::now());
        let (mut most, mut start) = (1, Start::Fresh);
        let mut patience = std::pin::pin!(tokio::time::sleep(Self::WAIT));
        loop {
            if let Some(outcome) = self.admit(store, digest, offset, most, start) {
                return outcome.map(|sending| Turn::Sends(Box::new(sending)));
            }
            tokio::select! {
                biased;
                () = self.room(&digest, most) => {}
                () = &mut patience, if most == 1 => most = Self::SIDE_BY_SIDE,
            }
            start = Start::Waited;
            if let Soundness::Sound(bytes) = store.verify(&digest).await.map_err(|error| store_refusal(&error))? {
                return Ok(Turn::There(Artifact { digest, bytes }));
            }
        }
    }

    /// Admits a sender; `None` if `most` clients send the artifact already.
    fn admit(
        &self,
        store: &Store,
        digest: Digest,
        offset: u64,
        most: usize,
        start: Start,
    ) -> Option<Result<Sending, Refusal>> {
        let mut state = self.lock();
        let entry = state.entries.entry(digest).or_default();
        if entry.senders >= most {
            return None;
        }
        let size = entry.parked.as_ref().map_or(0, |cut| cut.upload.size());
        let begins_anew = offset == 0 && start == Start::Fresh;
        if offset != size && !begins_anew {
            state.tidy(&digest);
            return Some(Err(Refusal::Resume { offset: size }));
        }
        let upload = match entry.parked.take() {
            Some(cut) if offset == size => cut.upload,
            before => {
                before.into_iter().for_each(|cut| abandon(cut.upload));
                store.upload(digest)
            }
        };
        entry.senders += 1;
        // The artifact that was kept is no longer in the store.
        entry.kept = None;
        Some(Ok(Sending { uploads: self.clone(), digest, upload: Some(upload) }))
    }

    /// Drops interrupted uploads that are too old, and the oldest ones beyond the limit.
    fn tidy(&self, now: Instant) {
        let mut state = self.lock();
        let parked = state.entries.iter().filter_map(|(digest, entry)| Some((entry.parked.as_ref()?, *digest)));
        let mut parked: Vec<(Instant, u64, Digest)> =
            parked.map(|(cut, digest)| (cut.since, cut.number, digest)).collect();
        parked.sort_unstable();
        let beyond = parked.len().saturating_sub(Self::KEPT);
        for (place, (since, _, digest)) in parked.into_iter().enumerate() {
            if (place < beyond || now.saturating_duration_since(since) >= Self::KEEP)
                && let Some(cut) = state.entries.get_mut(&digest).and_then(|entry| entry.parked.take())
            {
                abandon(cut.upload);
                state.tidy(&digest);
            }
        }
    }
}

impl State {
    /// Removes an entry that has neither senders nor an interrupted upload.
    fn tidy(&mut self, digest: &Digest) {
        if self.entries.get(digest).is_some_and(|entry| entry.senders == 0 && entry.parked.is_none()) {
            self.entries.remove(digest);
        }
    }

    /// Keeps an interrupted upload. If there are two, keeps the longer one and returns the other.
    fn park(&mut self, digest: Digest, upload: Upload) -> Option<Upload> {
        self.cuts += 1;
        let cut = Parked { upload, since: Instant::now(), number: self.cuts };
        let entry = self.entries.entry(digest).or_default();
        let (better, other) = match entry.parked.take() {
            Some(before) if before.upload.size() > cut.upload.size() => (before, Some(cut)),
            before => (cut, before),
        };
        entry.parked = Some(better);
        other.map(|other| other.upload)
    }
}

/// Removes an upload's data from the storage medium, unless the runtime is shutting down.
fn abandon(upload: Upload) {
    if let Ok(runtime) = tokio::runtime::Handle::try_current() {
        runtime.spawn(upload.abandon());
    }
}

/// A sender's upload. If it is dropped before the end, the received bytes are kept for the next sender.
#[derive(Debug)]
pub(super) struct Sending {
    uploads: Uploads,
    digest: Digest,
    /// The upload; `None` if it has ended, or while an operation that may be cancelled is running.
    upload: Option<Upload>,
}

impl Sending {
    /// Returns the artifact if another sender has finished it meanwhile.
    fn kept(&self) -> Option<Artifact> {
        self.uploads.lock().entries.get(&self.digest)?.kept
    }

    /// Writes the next piece. Returns the artifact if another sender has finished it. After a refusal the received bytes are
    /// dropped.
    pub(super) async fn write(&mut self, piece: &[u8]) -> Result<Option<Artifact>, Refusal> {
        if let Some(kept) = self.kept() {
            return Ok(Some(kept));
        }
        // If this future is dropped during the write, the state of the upload is unknown, so it must not be kept.
        let Some(mut upload) = self.upload.take() else { return Err(Self::over()) };
        match upload.write(piece).await {
            Ok(()) => self.upload = Some(upload),
            Err(error) => {
                upload.abandon().await;
                return Err(store_refusal(&error));
            }
        }
        Ok(None)
    }

    /// Finishes the upload and keeps the artifact if its digest is the announced one.
    pub(super) async fn finish(mut self) -> Result<(Artifact, Novelty), Refusal> {
        if let Some(kept) = self.kept() {
            return Ok((kept, Novelty::Older));
        }
        let upload = self.upload.take().ok_or_else(Self::over)?;
        let (artifact, novelty) = upload.finish().await.map_err(|error| store_refusal(&error))?;
        if let Some(entry) = self.uploads.lock().entries.get_mut(&self.digest) {
            entry.kept = Some(artifact);
        }
        Ok((artifact, novelty))
    }

    fn over() -> Refusal {
        Refusal::Unavailable { message: "the upload has ended".into() }
    }
}

impl Drop for Sending {
    fn drop(&mut self) {
        let mut state = self.uploads.lock();
        let Some(entry) = state.entries.get_mut(&self.digest) else { return };
        entry.senders -= 1;
        let (upload, kept) = (self.upload.take(), entry.kept);
        let useless = match upload {
            Some(upload) if kept.is_none() && upload.size() > 0 => state.park(self.digest, upload),
            other => other,
        };
        // Once the artifact is kept, an interrupted upload is useless: senders that resume learn from the store that it is there.
        let parked = match state.entries.get_mut(&self.digest) {
            Some(entry) if kept.is_some() => entry.parked.take().map(|cut| cut.upload),
            _ => None,
        };
        state.tidy(&self.digest);
        drop(state);
        useless.into_iter().chain(parked).for_each(abandon);
        self.uploads.0.ended.notify_waiters();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_resume(outcome: &Result<Turn, Refusal>, at: u64) -> bool {
        matches!(outcome, Err(Refusal::Resume { offset }) if *offset == at)
    }

    async fn sends(uploads: &Uploads, store: &Store, digest: Digest, offset: u64) -> Sending {
        match uploads.take(store, digest, offset).await.unwrap() {
            Turn::Sends(sending) => *sending,
            Turn::There(_) => panic!("it is there already"),
        }
    }

    #[tokio::test]
    async fn a_cut_upload_goes_on_at_its_byte_and_nowhere_else() {
        let (uploads, store, digest) = (Uploads::default(), Store::memory(), Digest::of(b"abcdef"));
        let mut first = sends(&uploads, &store, digest, 0).await;
        first.write(b"abc").await.unwrap();
        drop(first);
        assert_eq!(uploads.offered(&digest).await, 3);
        for elsewhere in [1, 4, u64::MAX] {
            assert!(is_resume(&uploads.take(&store, digest, elsewhere).await, 3));
        }
        let mut second = sends(&uploads, &store, digest, 3).await;
        second.write(b"def").await.unwrap();
        assert_eq!(second.finish().await.unwrap(), (Artifact { digest, bytes: 6 }, Novelty::New));
        assert_eq!((uploads.offered(&digest).await, uploads.lock().entries.len()), (0, 0));
        assert_eq!(store.get(&digest).await.unwrap(), "abcdef");
    }

    #[tokio::test(start_paused = true)]
    async fn who_sends_the_same_waits_for_the_first_and_sends_nothing() {
        let (uploads, store, digest) = (Uploads::default(), Store::memory(), Digest::of(b"abcdef"));
        let mut first = sends(&uploads, &store, digest, 0).await;
        first.write(b"abc").await.unwrap();
        let others: Vec<_> = (0..5)
            .map(|_| {
                let (uploads, store) = (uploads.clone(), store.clone());
                tokio::spawn(async move { uploads.take(&store, digest, 0).await })
            })
            .collect();
        let asked = tokio::spawn({
            let uploads = uploads.clone();
            async move { uploads.offered(&digest).await }
        });
        tokio::task::yield_now().await;
        assert!(others.iter().all(|other| !other.is_finished()) && !asked.is_finished());
        first.write(b"def").await.unwrap();
        first.finish().await.unwrap();
        for other in others {
            let turn = other.await.unwrap().unwrap();
            assert!(matches!(turn, Turn::There(Artifact { bytes: 6, .. })), "{turn:?}");
        }
        assert_eq!((asked.await.unwrap(), uploads.lock().entries.len()), (0, 0));
    }

    #[tokio::test(start_paused = true)]
    async fn one_waiter_resumes_when_first_sender_dies_and_others_wait() {
        let (uploads, store, digest) = (Uploads::default(), Store::memory(), Digest::of(b"abcdef"));
        let mut first = sends(&uploads, &store, digest, 0).await;
        first.write(b"ab").await.unwrap();
        let others: Vec<_> = (0..8)
            .map(|number| {
                let (uploads, store) = (uploads.clone(), store.clone());
                tokio::spawn(async move {
                    let mut offset = 0;
                    let mut sending = loop {
                        match uploads.take(&store, digest, offset as u64).await {
                            Ok(Turn::Sends(sending)) => break sending,
                            Ok(Turn::There(_)) => return 0,
                            Err(Refusal::Resume { offset: at }) => offset = at as usize,
                            Err(no) => panic!("{no}"),
                        }
                    };
                    let senders = uploads.lock().entries[&digest].senders;
                    assert_eq!(senders, 1, "nobody else sends");
                    // The first three of these die, too.
                    let piece = if number < 3 { &b"abcdef"[offset..=offset] } else { &b"abcdef"[offset..] };
                    sending.write(piece).await.unwrap();
                    tokio::task::yield_now().await;
                    if number >= 3 {
                        sending.finish().await.unwrap();
                    }
                    piece.len()
                })
            })
            .collect();
        tokio::task::yield_now().await;
        drop(first);
        let mut sent = 0;
        for other in others {
            sent += other.await.unwrap();
        }
        assert_eq!(sent, 4, "what the first has sent, and those after it, nobody sends again");
        assert_eq!(store.get(&digest).await.unwrap(), "abcdef");
        assert!(uploads.lock().entries.is_empty());
    }

    #[tokio::test(start_paused = true)]
    async fn waiting_sender_keeps_bytes_of_previous_sender() {
        let (uploads, store, digest) = (Uploads::default(), Store::memory(), Digest::of(b"abcdef"));
        let mut first = sends(&uploads, &store, digest, 0).await;
        first.write(b"abcde").await.unwrap();
        // This sender may be gone when its turn comes.
        let waits = tokio::spawn({
            let (uploads, store) = (uploads.clone(), store.clone());
            async move { uploads.take(&store, digest, 0).await }
        });
        tokio::task::yield_now().await;
        drop(first);
        assert!(is_resume(&waits.await.unwrap(), 5));
        assert_eq!(uploads.offered(&digest).await, 5, "the first goes on where it was");
        let mut anew = sends(&uploads, &store, digest, 0).await;
        anew.write(b"abcdef").await.unwrap();
        anew.finish().await.expect("who waited for nobody may begin anew");
    }

    #[tokio::test(start_paused = true)]
    async fn who_stands_still_holds_nobody_up_and_few_send_side_by_side() {
        let (uploads, store, digest) = (Uploads::default(), Store::memory(), Digest::of(b"abcdef"));
        let begun = Instant::now();
        let mut slow = Vec::new();
        for expected in [Duration::ZERO, Uploads::WAIT, 2 * Uploads::WAIT] {
            let mut sending = sends(&uploads, &store, digest, 0).await;
            // No two uploads share a byte.
            sending.write(b"abc").await.unwrap();
            slow.push(sending);
            assert_eq!(begun.elapsed().as_secs(), expected.as_secs());
        }
        let fourth = tokio::spawn({
            let (uploads, store) = (uploads.clone(), store.clone());
            async move { uploads.take(&store, digest, 0).await }
        });
        tokio::time::sleep(100 * Uploads::WAIT).await;
        assert!(!fourth.is_finished(), "the medium does not fill up with copies");
        let [first, second, mut third] = <[Sending; 3]>::try_from(slow).unwrap();
        third.write(b"def").await.unwrap();
        assert_eq!(third.finish().await.unwrap().0.bytes, 6);
        assert!(matches!(fourth.await.unwrap(), Ok(Turn::There(_))));
        let mut first = first;
        assert_eq!(first.write(b"d").await, Ok(Some(Artifact { digest, bytes: 6 })), "it need not go on");
        assert_eq!(second.finish().await.unwrap(), (Artifact { digest, bytes: 6 }, Novelty::Older));
        drop(first);
        assert!(uploads.lock().entries.is_empty(), "and leaves nothing");
        assert_eq!(store.get(&digest).await.unwrap(), "abcdef");
    }

    #[tokio::test(start_paused = true)]
    async fn what_was_kept_and_damaged_meanwhile_is_sent_again() {
        use femc_store::object_store::ObjectStoreExt as _;
        let (uploads, store, digest) = (Uploads::default(), Store::memory(), Digest::of(b"abcdef"));
        let slow = sends(&uploads, &store, digest, 0).await;
        let mut quick = sends(&uploads, &store, digest, 0).await;
        quick.write(b"abcdef").await.unwrap();
        quick.finish().await.unwrap();
        store.medium_itself().put(&femc_store::place(&digest), "abc".into()).await.unwrap();
        let mut third = sends(&uploads, &store, digest, 0).await;
        assert_eq!(third.write(b"abcdef").await, Ok(None), "it is wanted");
        third.finish().await.unwrap();
        assert_eq!(store.get(&digest).await.unwrap(), "abcdef");
        drop(slow);
    }

    #[tokio::test]
    async fn mismatched_upload_is_discarded_and_right_bytes_can_follow() {
        let (uploads, store, digest) = (Uploads::default(), Store::memory(), Digest::of(b"abcdef"));
        let mut liar = sends(&uploads, &store, digest, 0).await;
        liar.write(b"xyz").await.unwrap();
        drop(liar);
        let mut honest = sends(&uploads, &store, digest, 3).await;
        honest.write(b"def").await.unwrap();
        assert_eq!(honest.finish().await, Err(Refusal::DigestMismatch { digest }));
        assert_eq!(uploads.offered(&digest).await, 0, "the next one begins anew");
    }

    #[tokio::test]
    async fn few_cut_uploads_are_kept_and_not_for_ever() {
        let (uploads, store) = (Uploads::default(), Store::memory());
        let digests: Vec<Digest> = (0..20u8).map(|i| Digest::of(&[i])).collect();
        for digest in &digests {
            sends(&uploads, &store, *digest, 0).await.write(b"part").await.unwrap();
        }
        uploads.tidy(Instant::now());
        assert_eq!(uploads.lock().entries.len(), Uploads::KEPT);
        assert_eq!((uploads.offered(&digests[11]).await, uploads.offered(&digests[12]).await), (0, 4), "the oldest go");
        uploads.tidy(Instant::now() + Uploads::KEEP);
        assert_eq!(uploads.lock().entries.len(), 0);
    }
}
