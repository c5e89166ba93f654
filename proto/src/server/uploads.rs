//! Uploads under way, and those that were cut: these are kept for a while, so that they can go on where they were.
//!
//! By digest, whoever sends: what comes in is checked against the digest at the end. A sender who comes with the right
//! offset takes over, also from another one who seems to be still at it: that may be the same one's dead connection.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use femc_model::{Artefact, Digest, Refusal};
use femc_store::{Novelty, Store, Upload};
use tokio::time::Instant;

use super::artifacts::refusal;

/// Uploads under way by digest; clones share them.
#[derive(Debug, Clone, Default)]
pub(super) struct Uploads(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    entries: BTreeMap<Digest, Entry>,
    senders: u64,
}

/// An upload; `None` when it is over.
type Shared = Arc<tokio::sync::Mutex<Option<Upload>>>;

#[derive(Debug)]
struct Entry {
    upload: Shared,
    /// Who sends, or sent last.
    sender: u64,
    /// Since when nobody sends; `None`: somebody does.
    idle: Option<Instant>,
}

impl Uploads {
    /// Cut uploads that are kept; each has up to a part of bytes in memory (8 MiB), the rest is on the medium.
    const KEPT: usize = 8;
    /// How long they are kept.
    const KEEP: Duration = Duration::from_secs(600);

    fn lock(&self) -> MutexGuard<'_, State> {
        // A panic within the few lines under this lock leaves nothing half done.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Bytes that are here of an artefact that is not whole.
    pub(super) async fn size(&self, digest: &Digest) -> u64 {
        let upload = self.lock().entries.get(digest).map(|entry| entry.upload.clone());
        match upload {
            Some(upload) => upload.lock().await.as_ref().map_or(0, Upload::size),
            None => 0,
        }
    }

    /// Begins an upload, or goes on with one that has `offset` bytes. From 0 on it begins anew.
    pub(super) async fn take(&self, store: &Store, digest: Digest, offset: u64) -> Result<Sending, Refusal> {
        self.tidy(Instant::now());
        let size = self.size(&digest).await;
        if offset != 0 && offset != size {
            return Err(Refusal::Resume { offset: size });
        }
        let mut state = self.lock();
        state.senders += 1;
        let sender = state.senders;
        let new = || Arc::new(tokio::sync::Mutex::new(Some(store.upload(digest))));
        let entry = state.entries.entry(digest).or_insert_with(|| Entry { upload: new(), sender, idle: None });
        if offset == 0 && size != 0 {
            abandon(std::mem::replace(&mut entry.upload, new()));
        }
        (entry.sender, entry.idle) = (sender, None);
        Ok(Sending { uploads: self.clone(), digest, sender, upload: entry.upload.clone() })
    }

    /// Forgets what was cut too long ago, and the oldest beyond the number that is kept.
    fn tidy(&self, now: Instant) {
        let mut state = self.lock();
        let idle = state.entries.iter().filter_map(|(digest, entry)| Some((entry.idle?, entry.sender, *digest)));
        let mut idle: Vec<(Instant, u64, Digest)> = idle.collect();
        idle.sort_unstable();
        let beyond = idle.len().saturating_sub(Self::KEPT);
        for (place, (since, _, digest)) in idle.into_iter().enumerate() {
            if (place < beyond || now.saturating_duration_since(since) >= Self::KEEP)
                && let Some(entry) = state.entries.remove(&digest)
            {
                abandon(entry.upload);
            }
        }
    }
}

fn abandon(upload: Shared) {
    tokio::spawn(async move {
        if let Some(upload) = upload.lock().await.take() {
            upload.abandon().await;
        }
    });
}

/// A sender's hold of an upload. Dropped before the end, it leaves what has come for the next one.
pub(super) struct Sending {
    uploads: Uploads,
    digest: Digest,
    sender: u64,
    upload: Shared,
}

impl Sending {
    fn is_mine(&self) -> bool {
        self.uploads.lock().entries.get(&self.digest).is_some_and(|entry| entry.sender == self.sender)
    }

    fn forget(&self) {
        let mut state = self.uploads.lock();
        if state.entries.get(&self.digest).is_some_and(|entry| entry.sender == self.sender) {
            state.entries.remove(&self.digest);
        }
    }

    fn taken_over() -> Refusal {
        Refusal::Unavailable { message: "another connection goes on with this upload".into() }
    }

    /// Takes the next piece. An upload that cannot go on is forgotten.
    pub(super) async fn write(&self, piece: &[u8]) -> Result<(), Refusal> {
        let mut slot = self.upload.lock().await;
        if !self.is_mine() {
            return Err(Self::taken_over());
        }
        let upload = slot.as_mut().ok_or_else(Self::taken_over)?;
        if let Err(error) = upload.write(piece).await {
            self.forget();
            if let Some(upload) = slot.take() {
                upload.abandon().await;
            }
            return Err(refusal(&error));
        }
        Ok(())
    }

    /// Keeps the artefact, if it is the one that was announced.
    pub(super) async fn finish(self) -> Result<(Artefact, Novelty), Refusal> {
        let mut slot = self.upload.lock().await;
        if !self.is_mine() {
            return Err(Self::taken_over());
        }
        let finished = slot.take().ok_or_else(Self::taken_over)?.finish().await;
        self.forget();
        finished.map_err(|error| refusal(&error))
    }
}

impl Drop for Sending {
    fn drop(&mut self) {
        let mut state = self.uploads.lock();
        if let Some(entry) = state.entries.get_mut(&self.digest)
            && entry.sender == self.sender
        {
            entry.idle = Some(Instant::now());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_resume(outcome: &Result<Sending, Refusal>, at: u64) -> bool {
        matches!(outcome, Err(Refusal::Resume { offset }) if *offset == at)
    }

    #[tokio::test]
    async fn a_cut_upload_goes_on_at_its_byte_and_nowhere_else() {
        let (uploads, store, digest) = (Uploads::default(), Store::memory(), Digest::of(b"abcdef"));
        let first = uploads.take(&store, digest, 0).await.unwrap();
        first.write(b"abc").await.unwrap();
        drop(first);
        assert_eq!(uploads.size(&digest).await, 3);
        for elsewhere in [1, 4, u64::MAX] {
            assert!(is_resume(&uploads.take(&store, digest, elsewhere).await, 3));
        }
        let second = uploads.take(&store, digest, 3).await.unwrap();
        second.write(b"def").await.unwrap();
        assert_eq!(second.finish().await.unwrap(), (Artefact { digest, bytes: 6 }, Novelty::New));
        assert_eq!((uploads.size(&digest).await, uploads.lock().entries.len()), (0, 0));
        assert_eq!(store.get(&digest).await.unwrap(), "abcdef");
    }

    #[tokio::test]
    async fn who_was_taken_over_writes_nothing_more() {
        let (uploads, store, digest) = (Uploads::default(), Store::memory(), Digest::of(b"abcdef"));
        let first = uploads.take(&store, digest, 0).await.unwrap();
        first.write(b"abc").await.unwrap();
        let second = uploads.take(&store, digest, 3).await.unwrap();
        assert!(matches!(first.write(b"xyz").await, Err(Refusal::Unavailable { .. })));
        drop(first);
        second.write(b"def").await.unwrap();
        second.finish().await.unwrap();
        assert_eq!(store.get(&digest).await.unwrap(), "abcdef");
    }

    #[tokio::test]
    async fn other_bytes_than_announced_are_forgotten_and_the_right_ones_can_come() {
        let (uploads, store, digest) = (Uploads::default(), Store::memory(), Digest::of(b"abcdef"));
        let liar = uploads.take(&store, digest, 0).await.unwrap();
        liar.write(b"xyz").await.unwrap();
        drop(liar);
        let honest = uploads.take(&store, digest, 3).await.unwrap();
        honest.write(b"def").await.unwrap();
        assert_eq!(honest.finish().await, Err(Refusal::DigestMismatch { digest }));
        assert_eq!(uploads.size(&digest).await, 0, "the next one begins anew");
    }

    #[tokio::test]
    async fn few_cut_uploads_are_kept_and_not_for_ever() {
        let (uploads, store) = (Uploads::default(), Store::memory());
        let digests: Vec<Digest> = (0..20u8).map(|i| Digest::of(&[i])).collect();
        for digest in &digests {
            uploads.take(&store, *digest, 0).await.unwrap().write(b"part").await.unwrap();
        }
        uploads.tidy(Instant::now());
        assert_eq!(uploads.lock().entries.len(), Uploads::KEPT);
        assert_eq!((uploads.size(&digests[11]).await, uploads.size(&digests[12]).await), (0, 4), "the oldest go");
        uploads.tidy(Instant::now() + Uploads::KEEP);
        assert_eq!(uploads.lock().entries.len(), 0);
    }
}
