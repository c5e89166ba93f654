//! Storage medium of the artifact store, with faults.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::future;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

use async_trait::async_trait;
use femc_model::Digest;
use femc_store::object_store::memory::InMemory;
use femc_store::object_store::path::Path;
use femc_store::object_store::{
    CopyOptions, Error, GetOptions, GetResult, GetResultPayload, ListResult, MultipartUpload, ObjectMeta, ObjectStore,
    ObjectStoreExt as _, PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
};
use femc_store::place;
use futures_util::stream::{self, BoxStream};
use futures_util::{FutureExt as _, StreamExt as _, TryStreamExt as _};

use crate::audit::Violation;
use crate::shared::Shared;

/// Artifacts in memory that outlive every host, on a medium with faults. They age by the simulated clock.
#[derive(Debug, Clone)]
pub(crate) struct Shelf {
    objects: Arc<InMemory>,
    shared: Shared,
    troubles: Arc<Mutex<Troubles>>,
    /// Time at which each artifact was put.
    born: Arc<Mutex<BTreeMap<Path, Duration>>>,
}

/// Current faults of the medium.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Troubles {
    /// Nothing new can be stored.
    pub(crate) full: bool,
    /// Every operation fails with an error.
    pub(crate) away: bool,
    /// Longest extra duration of an operation.
    pub(crate) slow: Duration,
    /// Torn upload: number of other uploads before it, and thousandths of its bytes that are kept.
    pub(crate) tears: Option<(u32, u64)>,
    /// Number of other reads before a read that returns bytes of another artifact. The stored artifact does not change.
    pub(crate) swaps: Option<u32>,
}

/// Damage of a stored artifact.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Harm {
    /// The artifact is deleted.
    Lost,
    /// Bits of the artifact are flipped.
    Flipped,
    /// Only these thousandths of the artifact remain.
    Short(u64),
    /// Extra bytes follow the artifact.
    Long,
    /// The artifact is zero after these thousandths.
    Zeroed(u64),
}

impl Harm {
    /// Returns a name for statistics.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Lost => "artifact lost",
            Self::Flipped => "artifact damaged",
            Self::Short(_) => "artifact cut short",
            Self::Long => "artifact grown",
            Self::Zeroed(_) => "artifact zeroed",
        }
    }

    fn done_to(self, mut bytes: Vec<u8>) -> Vec<u8> {
        match self {
            Self::Lost => {}
            Self::Flipped => bytes.iter_mut().step_by(2).for_each(|byte| *byte ^= 0x55),
            Self::Short(left) => bytes.truncate(part(bytes.len(), left)),
            Self::Long => bytes.extend([0; 100]),
            Self::Zeroed(from) => {
                let from = part(bytes.len(), from);
                bytes[from..].fill(0);
            }
        }
        bytes
    }
}

/// Returns thousandths of a length, always less than the whole length.
fn part(length: usize, thousandths: u64) -> usize {
    (length * thousandths as usize / 1000).min(length.saturating_sub(1))
}

impl Shelf {
    pub(crate) fn new(shared: &Shared) -> Self {
        Self { objects: Arc::default(), shared: shared.clone(), troubles: Arc::default(), born: Arc::default() }
    }

    /// Changes the faults of the medium.
    pub(crate) fn trouble(&self, change: impl FnOnce(&mut Troubles)) {
        change(&mut self.troubles.lock().unwrap_or_else(PoisonError::into_inner));
    }

    fn troubles(&self) -> Troubles {
        *self.troubles.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Checks that the medium has no fault that can fail an upload.
    pub(crate) fn is_well(&self) -> bool {
        let Troubles { full, away, tears, .. } = self.troubles();
        !full && !away && tears.is_none()
    }

    /// Damages an artifact. Returns `false` if it does not exist.
    pub(crate) fn harm(&self, artifact: &Digest, harm: Harm) -> bool {
        let at = place(artifact);
        if harm == Harm::Lost {
            let was_there = self.births().remove(&at).is_some();
            return was_there && self.objects.delete(&at).now_or_never().is_some_and(|gone| gone.is_ok());
        }
        let harmed = async {
            let bytes = self.objects.get(&at).await?.bytes().await?.to_vec();
            self.objects.put(&at, harm.done_to(bytes).into()).await
        };
        harmed.now_or_never().is_some_and(|harmed| harmed.is_ok())
    }

    /// Checks that a stored artifact exists and is intact.
    pub(crate) fn whole(&self, artifact: &Digest) -> bool {
        let at = place(artifact);
        let read = async { self.objects.get(&at).await?.bytes().await };
        read.now_or_never().and_then(Result::ok).is_some_and(|bytes| Digest::of(&bytes) == *artifact)
    }

    /// Returns the digests of all stored artifacts.
    pub(crate) fn all(&self) -> BTreeSet<Digest> {
        let name = |meta: ObjectMeta| meta.location.parts().map(|part| part.as_ref().to_owned()).collect::<String>();
        let listed = self.objects.list(None).try_collect::<Vec<_>>().now_or_never().and_then(Result::ok);
        listed.unwrap_or_default().into_iter().filter_map(|meta| name(meta).parse().ok()).collect()
    }

    /// Returns the number of objects and their total bytes.
    pub(crate) fn volume(&self) -> (u64, u64) {
        let add = |(count, bytes), meta: ObjectMeta| future::ready(Ok((count + 1, bytes + meta.size)));
        // A medium in memory never waits.
        self.objects.list(None).try_fold((0, 0), add).now_or_never().and_then(Result::ok).unwrap_or_default()
    }

    fn births(&self) -> MutexGuard<'_, BTreeMap<Path, Duration>> {
        self.born.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn note_birth(&self, location: &Path) {
        self.births().insert(location.clone(), now());
    }

    /// Waits for the duration of an operation. Fails if the medium is unavailable.
    async fn reach(&self) -> Result<()> {
        let Troubles { away, slow, .. } = self.troubles();
        if !slow.is_zero() {
            tokio::time::sleep(self.shared.pause(slow)).await;
        }
        if away { Err(trouble(io::ErrorKind::NotConnected)) } else { Ok(()) }
    }

    fn room(&self) -> Result<()> {
        if self.troubles().full { Err(trouble(io::ErrorKind::StorageFull)) } else { Ok(()) }
    }

    /// Returns the bytes that remain of an upload, if this upload is torn.
    fn torn(&self, payload: &PutPayload) -> Option<Vec<u8>> {
        let mut troubles = self.troubles.lock().unwrap_or_else(PoisonError::into_inner);
        let (others, thousandths) = troubles.tears.as_mut()?;
        if *others > 0 {
            *others -= 1;
            return None;
        }
        let thousandths = *thousandths;
        troubles.tears = None;
        let bytes: Vec<u8> = payload.iter().flat_map(|bytes| bytes.to_vec()).collect();
        Some(Harm::Short(thousandths).done_to(bytes))
    }

    /// Checks whether this read returns bytes of another artifact.
    fn is_swapped(&self) -> bool {
        let mut troubles = self.troubles.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(others) = troubles.swaps.as_mut() else { return false };
        let is_due = *others == 0;
        *others = others.saturating_sub(1);
        if is_due {
            troubles.swaps = None;
        }
        is_due
    }

    /// Replaces the bytes of a read by those of another artifact, if possible of the same size, so that only the bytes differ.
    async fn swapped(&self, read: GetResult) -> Result<GetResult> {
        let all: Vec<ObjectMeta> = self.objects.list(None).try_collect().await?;
        let others = all.into_iter().filter(|other| other.location != read.meta.location && other.size > 0);
        let Some(other) = others.min_by_key(|other| other.size.abs_diff(read.meta.size)) else { return Ok(read) };
        let bytes = self.objects.get(&other.location).await?.bytes().await?;
        let (from, length) = (read.range.start as usize, (read.range.end - read.range.start) as usize);
        let bytes: Vec<u8> = bytes.iter().copied().cycle().skip(from).take(length).collect();
        self.shared.lock().fired("read of another artifact");
        let payload = GetResultPayload::Stream(stream::once(future::ready(Ok(bytes.into()))).boxed());
        Ok(GetResult { payload, ..read })
    }

    /// Checks a removal: an intact artifact that the log references must not be removed.
    fn judge(&self, at: &Path) {
        let name: String = at.parts().map(|part| part.as_ref().to_owned()).collect();
        let Ok(digest) = name.parse::<Digest>() else { return };
        if !self.whole(&digest) {
            return;
        }
        let mut state = self.shared.lock();
        if state.disk.ledger().is_ok_and(|ledger| ledger.references().contains(&digest)) {
            state.wrong.push(Violation::Removed { digest });
        }
    }
}

fn trouble(kind: io::ErrorKind) -> Error {
    Error::Generic { store: "shelf", source: Box::new(io::Error::from(kind)) }
}

fn now() -> Duration {
    turmoil::sim_elapsed().unwrap_or_default()
}

impl fmt::Display for Shelf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Shelf")
    }
}

#[async_trait]
impl ObjectStore for Shelf {
    async fn put_opts(&self, location: &Path, payload: PutPayload, opts: PutOptions) -> Result<PutResult> {
        self.reach().await?;
        self.room()?;
        if let Some(bytes) = self.torn(&payload) {
            // A torn upload cannot replace an existing artifact either.
            let torn = self.objects.put_opts(location, bytes.into(), opts).await;
            if torn.is_ok() {
                self.note_birth(location);
                self.shared.lock().fired("torn upload");
            }
            return Err(trouble(io::ErrorKind::BrokenPipe));
        }
        let put = self.objects.put_opts(location, payload, opts).await?;
        self.note_birth(location);
        Ok(put)
    }

    async fn put_multipart_opts(&self, at: &Path, opts: PutMultipartOptions) -> Result<Box<dyn MultipartUpload>> {
        self.reach().await?;
        self.room()?;
        self.note_birth(at);
        self.objects.put_multipart_opts(at, opts).await
    }

    async fn get_opts(&self, location: &Path, options: GetOptions) -> Result<GetResult> {
        self.reach().await?;
        let is_head = options.head;
        let read = self.objects.get_opts(location, options).await?;
        if is_head || !self.is_swapped() { Ok(read) } else { self.swapped(read).await }
    }

    fn delete_stream(&self, locations: BoxStream<'static, Result<Path>>) -> BoxStream<'static, Result<Path>> {
        let shelf = self.clone();
        let forget = move |at: &Path| {
            shelf.judge(at);
            shelf.births().remove(at);
        };
        self.objects.delete_stream(locations.inspect_ok(forget).boxed())
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        let (shelf, now) = (self.clone(), now());
        let aged = move |meta: ObjectMeta| {
            let born = shelf.births().get(&meta.location).copied().unwrap_or(now);
            ObjectMeta { last_modified: (SystemTime::now() - now.saturating_sub(born)).into(), ..meta }
        };
        self.objects.list(prefix).map_ok(aged).boxed()
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.objects.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        self.room()?;
        self.objects.copy_opts(from, to, options).await
    }
}
