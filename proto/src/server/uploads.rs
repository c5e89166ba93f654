//! Uploads in progress, and interrupted uploads, which are kept for a while so that they can resume.
//!
//! Uploads are keyed by digest, regardless of the sender: the received bytes are checked against the digest at the end. An upload
//! is a value that belongs to one sender at a time, so senders cannot mix their bytes. An interrupted upload stays here until a
//! sender resumes it at the right offset. Another sender of the same artifact waits for the first one to finish, and then sends
//! nothing. The first sender may be slow or stuck. So after a while, a waiting sender gets an upload of its own, as long as there
//! are few uploads of that artifact. The first complete upload is kept, and the other senders learn with their next piece that the
//! artifact is in the store.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use femc_model::{Artifact, Digest, Refusal};
use femc_service::store_refusal;
use femc_store::{Integrity, Novelty, Store, Upload};
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
    interruptions: u64,
}

#[derive(Debug, Default)]
struct Entry {
    /// Number of current senders.
    senders: usize,
    /// The finished artifact, if one of the senders has finished: it is in the store.
    stored: Option<Artifact>,
    /// An interrupted upload that a sender can resume.
    parked: Option<ParkedUpload>,
}

#[derive(Debug)]
struct ParkedUpload {
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
    AfterWaiting,
}

/// Answer to a client that wants to send.
#[derive(Debug)]
pub(super) enum UploadAdmission {
    /// The artifact is in the store already.
    AlreadyStored(Artifact),
    /// The client may send.
    Granted(Box<ActiveUpload>),
}

impl Uploads {
    /// Number of interrupted uploads to keep. Each has up to one part (8 MiB) in memory; the rest is on the storage medium.
    const MAX_PARKED: usize = 8;
    /// Time for which interrupted uploads are kept.
    const PARK_TIME: Duration = Duration::from_secs(600);
    /// Time that a sender waits for another sender of the same artifact.
    const MAX_WAIT: Duration = Duration::from_secs(5);
    /// Largest number of uploads of one artifact at a time. The storage medium may hold its bytes this many times. Further senders
    /// wait without a time limit.
    const MAX_CONCURRENT: usize = 3;

    fn lock(&self) -> MutexGuard<'_, State> {
        // A panic within the few lines under this lock leaves the state consistent.
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until fewer than `max_senders` clients send the artifact.
    async fn wait_for_room(&self, digest: &Digest, max_senders: usize) {
        let is_crowded = || self.lock().entries.get(digest).is_some_and(|entry| entry.senders >= max_senders);
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
    pub(super) async fn wanted_offset(&self, digest: &Digest) -> u64 {
        // A timeout is no error: a client that then sends waits again.
        let _ = tokio::time::timeout(Self::MAX_WAIT, self.wait_for_room(digest, 1)).await;
        let state = self.lock();
        let parked = state.entries.get(digest).and_then(|entry| entry.parked.as_ref());
        parked.map_or(0, |parked| parked.upload.size())
    }

    /// Begins an upload, or resumes one that has `offset` bytes. Offset 0 begins a new upload and discards an interrupted one. The
    /// exception is an upload that was interrupted while this sender waited: it is kept, because this sender did not know of it and
    /// may be gone itself.
    pub(super) async fn begin_or_resume(
        &self,
        store: &Store,
        digest: Digest,
        offset: u64,
    ) -> Result<UploadAdmission, Refusal> {
        self.expire_parked(Instant::now());
        let (mut most, mut start) = (1, Start::Fresh);
        let mut patience = std::pin::pin!(tokio::time::sleep(Self::MAX_WAIT));
        loop {
            if let Some(outcome) = self.admit(store, digest, offset, most, start) {
                return outcome.map(|sending| UploadAdmission::Granted(Box::new(sending)));
            }
            tokio::select! {
                biased;
                () = self.wait_for_room(&digest, most) => {}
                () = &mut patience, if most == 1 => most = Self::MAX_CONCURRENT,
            }
            start = Start::AfterWaiting;
            if let Integrity::Intact(bytes) = store.verify(&digest).await.map_err(|error| store_refusal(&error))? {
                return Ok(UploadAdmission::AlreadyStored(Artifact { digest, bytes }));
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
    ) -> Option<Result<ActiveUpload, Refusal>> {
        let mut state = self.lock();
        let entry = state.entries.entry(digest).or_default();
        if entry.senders >= most {
            return None;
        }
        let size = entry.parked.as_ref().map_or(0, |cut| cut.upload.size());
        let begins_anew = offset == 0 && start == Start::Fresh;
        if offset != size && !begins_anew {
            state.remove_if_unused(&digest);
            return Some(Err(Refusal::Resume { offset: size }));
        }
        let upload = match entry.parked.take() {
            Some(cut) if offset == size => cut.upload,
            before => {
                before.into_iter().for_each(|cut| cancel_in_background(cut.upload));
                store.upload(digest)
            }
        };
        entry.senders += 1;
        // The artifact that was kept is no longer in the store.
        entry.stored = None;
        Some(Ok(ActiveUpload { uploads: self.clone(), digest, upload: Some(upload) }))
    }

    /// Drops interrupted uploads that are too old, and the oldest ones beyond the limit.
    fn expire_parked(&self, now: Instant) {
        let mut state = self.lock();
        let parked = state.entries.iter().filter_map(|(digest, entry)| Some((entry.parked.as_ref()?, *digest)));
        let mut parked: Vec<(Instant, u64, Digest)> =
            parked.map(|(cut, digest)| (cut.since, cut.number, digest)).collect();
        parked.sort_unstable();
        let beyond = parked.len().saturating_sub(Self::MAX_PARKED);
        for (place, (since, _, digest)) in parked.into_iter().enumerate() {
            if (place < beyond || now.saturating_duration_since(since) >= Self::PARK_TIME)
                && let Some(cut) = state.entries.get_mut(&digest).and_then(|entry| entry.parked.take())
            {
                cancel_in_background(cut.upload);
                state.remove_if_unused(&digest);
            }
        }
    }
}

impl State {
    /// Removes an entry that has neither senders nor an interrupted upload.
    fn remove_if_unused(&mut self, digest: &Digest) {
        if self.entries.get(digest).is_some_and(|entry| entry.senders == 0 && entry.parked.is_none()) {
            self.entries.remove(digest);
        }
    }

    /// Keeps an interrupted upload. If there are two, keeps the longer one and returns the other.
    fn park(&mut self, digest: Digest, upload: Upload) -> Option<Upload> {
        self.interruptions += 1;
        let parked = ParkedUpload { upload, since: Instant::now(), number: self.interruptions };
        let entry = self.entries.entry(digest).or_default();
        let (better, other) = match entry.parked.take() {
            Some(before) if before.upload.size() > parked.upload.size() => (before, Some(parked)),
            before => (parked, before),
        };
        entry.parked = Some(better);
        other.map(|other| other.upload)
    }
}

/// Removes an upload's data from the storage medium, unless the runtime is shutting down.
fn cancel_in_background(upload: Upload) {
    if let Ok(runtime) = tokio::runtime::Handle::try_current() {
        runtime.spawn(upload.abandon());
    }
}

/// A sender's upload. If it is dropped before the end, the received bytes are kept for the next sender.
#[derive(Debug)]
pub(super) struct ActiveUpload {
    uploads: Uploads,
    digest: Digest,
    /// The upload; `None` if it has ended, or while an operation that may be cancelled is running.
    upload: Option<Upload>,
}

impl ActiveUpload {
    /// Returns the artifact if another sender has finished it meanwhile.
    fn stored_meanwhile(&self) -> Option<Artifact> {
        self.uploads.lock().entries.get(&self.digest)?.stored
    }

    /// Writes the next piece. Returns the artifact if another sender has finished it. After a refusal the received bytes are
    /// dropped.
    pub(super) async fn write(&mut self, piece: &[u8]) -> Result<Option<Artifact>, Refusal> {
        if let Some(kept) = self.stored_meanwhile() {
            return Ok(Some(kept));
        }
        // If this future is dropped during the write, the state of the upload is unknown, so it must not be kept.
        let Some(mut upload) = self.upload.take() else { return Err(Self::ended_refusal()) };
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
        if let Some(kept) = self.stored_meanwhile() {
            return Ok((kept, Novelty::Older));
        }
        let upload = self.upload.take().ok_or_else(Self::ended_refusal)?;
        let (artifact, novelty) = upload.finish().await.map_err(|error| store_refusal(&error))?;
        if let Some(entry) = self.uploads.lock().entries.get_mut(&self.digest) {
            entry.stored = Some(artifact);
        }
        Ok((artifact, novelty))
    }

    fn ended_refusal() -> Refusal {
        Refusal::Unavailable { message: "the upload has ended".into() }
    }
}

impl Drop for ActiveUpload {
    fn drop(&mut self) {
        let mut state = self.uploads.lock();
        let Some(entry) = state.entries.get_mut(&self.digest) else { return };
        entry.senders -= 1;
        let (upload, stored) = (self.upload.take(), entry.stored);
        let useless = match upload {
            Some(upload) if stored.is_none() && upload.size() > 0 => state.park(self.digest, upload),
            other => other,
        };
        // Once the artifact is kept, an interrupted upload is useless: senders that resume learn from the store that it is there.
        let parked = match state.entries.get_mut(&self.digest) {
            Some(entry) if stored.is_some() => entry.parked.take().map(|cut| cut.upload),
            _ => None,
        };
        state.remove_if_unused(&self.digest);
        drop(state);
        useless.into_iter().chain(parked).for_each(cancel_in_background);
        self.uploads.0.ended.notify_waiters();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_resume(outcome: &Result<UploadAdmission, Refusal>, at: u64) -> bool {
        matches!(outcome, Err(Refusal::Resume { offset }) if *offset == at)
    }

    async fn begin_upload(uploads: &Uploads, store: &Store, digest: Digest, offset: u64) -> ActiveUpload {
        match uploads.begin_or_resume(store, digest, offset).await.unwrap() {
            UploadAdmission::Granted(sending) => *sending,
            UploadAdmission::AlreadyStored(_) => panic!("it is there already"),
        }
    }

    #[tokio::test]
    async fn a_cut_upload_goes_on_at_its_byte_and_nowhere_else() {
        let (uploads, store, digest) = (Uploads::default(), Store::in_memory(), Digest::compute(b"abcdef"));
        let mut first = begin_upload(&uploads, &store, digest, 0).await;
        first.write(b"abc").await.unwrap();
        drop(first);
        assert_eq!(uploads.wanted_offset(&digest).await, 3);
        for elsewhere in [1, 4, u64::MAX] {
            assert!(is_resume(&uploads.begin_or_resume(&store, digest, elsewhere).await, 3));
        }
        let mut second = begin_upload(&uploads, &store, digest, 3).await;
        second.write(b"def").await.unwrap();
        assert_eq!(second.finish().await.unwrap(), (Artifact { digest, bytes: 6 }, Novelty::New));
        assert_eq!((uploads.wanted_offset(&digest).await, uploads.lock().entries.len()), (0, 0));
        assert_eq!(store.get(&digest).await.unwrap(), "abcdef");
    }

    #[tokio::test(start_paused = true)]
    async fn who_sends_the_same_waits_for_the_first_and_sends_nothing() {
        let (uploads, store, digest) = (Uploads::default(), Store::in_memory(), Digest::compute(b"abcdef"));
        let mut first = begin_upload(&uploads, &store, digest, 0).await;
        first.write(b"abc").await.unwrap();
        let others: Vec<_> = (0..5)
            .map(|_| {
                let (uploads, store) = (uploads.clone(), store.clone());
                tokio::spawn(async move { uploads.begin_or_resume(&store, digest, 0).await })
            })
            .collect();
        let offer = tokio::spawn({
            let uploads = uploads.clone();
            async move { uploads.wanted_offset(&digest).await }
        });
        tokio::task::yield_now().await;
        assert!(others.iter().all(|other| !other.is_finished()) && !offer.is_finished());
        first.write(b"def").await.unwrap();
        first.finish().await.unwrap();
        for other in others {
            let turn = other.await.unwrap().unwrap();
            assert!(matches!(turn, UploadAdmission::AlreadyStored(Artifact { bytes: 6, .. })), "{turn:?}");
        }
        assert_eq!((offer.await.unwrap(), uploads.lock().entries.len()), (0, 0));
    }

    #[tokio::test(start_paused = true)]
    async fn one_waiter_resumes_when_first_sender_dies_and_others_wait() {
        let (uploads, store, digest) = (Uploads::default(), Store::in_memory(), Digest::compute(b"abcdef"));
        let mut first = begin_upload(&uploads, &store, digest, 0).await;
        first.write(b"ab").await.unwrap();
        let others: Vec<_> = (0..8)
            .map(|number| {
                let (uploads, store) = (uploads.clone(), store.clone());
                tokio::spawn(async move {
                    let mut offset = 0;
                    let mut sending = loop {
                        match uploads.begin_or_resume(&store, digest, offset as u64).await {
                            Ok(UploadAdmission::Granted(sending)) => break sending,
                            Ok(UploadAdmission::AlreadyStored(_)) => return 0,
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
        let (uploads, store, digest) = (Uploads::default(), Store::in_memory(), Digest::compute(b"abcdef"));
        let mut first = begin_upload(&uploads, &store, digest, 0).await;
        first.write(b"abcde").await.unwrap();
        // This sender may be gone when its turn comes.
        let waits = tokio::spawn({
            let (uploads, store) = (uploads.clone(), store.clone());
            async move { uploads.begin_or_resume(&store, digest, 0).await }
        });
        tokio::task::yield_now().await;
        drop(first);
        assert!(is_resume(&waits.await.unwrap(), 5));
        assert_eq!(uploads.wanted_offset(&digest).await, 5, "the first goes on where it was");
        let mut anew = begin_upload(&uploads, &store, digest, 0).await;
        anew.write(b"abcdef").await.unwrap();
        anew.finish().await.expect("who waited for nobody may begin anew");
    }

    #[tokio::test(start_paused = true)]
    async fn who_stands_still_holds_nobody_up_and_few_send_side_by_side() {
        let (uploads, store, digest) = (Uploads::default(), Store::in_memory(), Digest::compute(b"abcdef"));
        let begun = Instant::now();
        let mut slow = Vec::new();
        for expected in [Duration::ZERO, Uploads::MAX_WAIT, 2 * Uploads::MAX_WAIT] {
            let mut sending = begin_upload(&uploads, &store, digest, 0).await;
            // No two uploads share a byte.
            sending.write(b"abc").await.unwrap();
            slow.push(sending);
            assert_eq!(begun.elapsed().as_secs(), expected.as_secs());
        }
        let fourth = tokio::spawn({
            let (uploads, store) = (uploads.clone(), store.clone());
            async move { uploads.begin_or_resume(&store, digest, 0).await }
        });
        tokio::time::sleep(100 * Uploads::MAX_WAIT).await;
        assert!(!fourth.is_finished(), "the medium does not fill up with copies");
        let [first, second, mut third] = <[ActiveUpload; 3]>::try_from(slow).unwrap();
        third.write(b"def").await.unwrap();
        assert_eq!(third.finish().await.unwrap().0.bytes, 6);
        assert!(matches!(fourth.await.unwrap(), Ok(UploadAdmission::AlreadyStored(_))));
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
        let (uploads, store, digest) = (Uploads::default(), Store::in_memory(), Digest::compute(b"abcdef"));
        let slow = begin_upload(&uploads, &store, digest, 0).await;
        let mut quick = begin_upload(&uploads, &store, digest, 0).await;
        quick.write(b"abcdef").await.unwrap();
        quick.finish().await.unwrap();
        store.objects().put(&femc_store::artifact_path(&digest), "abc".into()).await.unwrap();
        let mut third = begin_upload(&uploads, &store, digest, 0).await;
        assert_eq!(third.write(b"abcdef").await, Ok(None), "it is wanted");
        third.finish().await.unwrap();
        assert_eq!(store.get(&digest).await.unwrap(), "abcdef");
        drop(slow);
    }

    #[tokio::test]
    async fn mismatched_upload_is_discarded_and_right_bytes_can_follow() {
        let (uploads, store, digest) = (Uploads::default(), Store::in_memory(), Digest::compute(b"abcdef"));
        let mut liar = begin_upload(&uploads, &store, digest, 0).await;
        liar.write(b"xyz").await.unwrap();
        drop(liar);
        let mut honest = begin_upload(&uploads, &store, digest, 3).await;
        honest.write(b"def").await.unwrap();
        assert_eq!(honest.finish().await, Err(Refusal::DigestMismatch { digest }));
        assert_eq!(uploads.wanted_offset(&digest).await, 0, "the next one begins anew");
    }

    #[tokio::test]
    async fn few_cut_uploads_are_kept_and_not_for_ever() {
        let (uploads, store) = (Uploads::default(), Store::in_memory());
        let digests: Vec<Digest> = (0..20u8).map(|i| Digest::compute(&[i])).collect();
        for digest in &digests {
            begin_upload(&uploads, &store, *digest, 0).await.write(b"part").await.unwrap();
        }
        uploads.expire_parked(Instant::now());
        assert_eq!(uploads.lock().entries.len(), Uploads::MAX_PARKED);
        assert_eq!(
            (uploads.wanted_offset(&digests[11]).await, uploads.wanted_offset(&digests[12]).await),
            (0, 4),
            "the oldest go"
        );
        uploads.expire_parked(Instant::now() + Uploads::PARK_TIME);
        assert_eq!(uploads.lock().entries.len(), 0);
    }
}
