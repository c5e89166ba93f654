//! Storage medium of the artifact store, with faults.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::future;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

use async_trait::async_trait;
use femc_model::Digest;
use femc_store::artifact_path;
use femc_store::object_store::memory::InMemory;
use femc_store::object_store::path::Path;
use femc_store::object_store::{
    CopyOptions, Error, GetOptions, GetResult, GetResultPayload, ListResult, MultipartUpload, ObjectMeta, ObjectStore,
    ObjectStoreExt as _, PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
};
use futures_util::stream::{self, BoxStream};
use futures_util::{FutureExt as _, StreamExt as _, TryStreamExt as _};

use crate::audit::Violation;
use crate::shared::Shared;

/// Artifacts in memory that outlive every host, on a medium with faults. They age by the simulated clock.
#[derive(Debug, Clone)]
pub(crate) struct FaultyMedium {
    objects: Arc<InMemory>,
    shared: Shared,
    faults: Arc<Mutex<MediumFaults>>,
    /// Time at which each artifact was put.
    put_times: Arc<Mutex<BTreeMap<Path, Duration>>>,
}

/// Current faults of the medium.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct MediumFaults {
    /// Nothing new can be stored.
    pub(crate) full: bool,
    /// Every operation fails with an error.
    pub(crate) unavailable: bool,
    /// Longest extra duration of an operation.
    pub(crate) delay: Duration,
    /// Torn upload: number of other uploads before it, and thousandths of its bytes that are kept.
    pub(crate) torn_upload: Option<(u32, u64)>,
    /// Number of other reads before a read that returns bytes of another artifact. The stored artifact does not change.
    pub(crate) wrong_read: Option<u32>,
}

/// Damage of a stored artifact.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Damage {
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

impl Damage {
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

    fn apply(self, mut bytes: Vec<u8>) -> Vec<u8> {
        match self {
            Self::Lost => {}
            Self::Flipped => bytes.iter_mut().step_by(2).for_each(|byte| *byte ^= 0x55),
            Self::Short(left) => bytes.truncate(fraction_of(bytes.len(), left)),
            Self::Long => bytes.extend([0; 100]),
            Self::Zeroed(from) => {
                let from = fraction_of(bytes.len(), from);
                bytes[from..].fill(0);
            }
        }
        bytes
    }
}

/// Returns thousandths of a length, always less than the whole length.
fn fraction_of(length: usize, thousandths: u64) -> usize {
    (length * thousandths as usize / 1000).min(length.saturating_sub(1))
}

impl FaultyMedium {
    pub(crate) fn new(shared: &Shared) -> Self {
        Self { objects: Arc::default(), shared: shared.clone(), faults: Arc::default(), put_times: Arc::default() }
    }

    /// Changes the faults of the medium.
    pub(crate) fn change_faults(&self, change: impl FnOnce(&mut MediumFaults)) {
        change(&mut self.faults.lock().unwrap_or_else(PoisonError::into_inner));
    }

    fn faults(&self) -> MediumFaults {
        *self.faults.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Checks that the medium has no fault that can fail an upload.
    pub(crate) fn is_healthy(&self) -> bool {
        let MediumFaults { full, unavailable: away, torn_upload: tears, .. } = self.faults();
        !full && !away && tears.is_none()
    }

    /// Damages an artifact. Returns `false` if it does not exist.
    pub(crate) fn damage(&self, artifact: &Digest, damage_kind: Damage) -> bool {
        let at = artifact_path(artifact);
        if damage_kind == Damage::Lost {
            let was_there = self.lock_put_times().remove(&at).is_some();
            return was_there && self.objects.delete(&at).now_or_never().is_some_and(|gone| gone.is_ok());
        }
        let harmed = async {
            let bytes = self.objects.get(&at).await?.bytes().await?.to_vec();
            self.objects.put(&at, damage_kind.apply(bytes).into()).await
        };
        harmed.now_or_never().is_some_and(|harmed| harmed.is_ok())
    }

    /// Checks that a stored artifact exists and is intact.
    pub(crate) fn is_intact(&self, artifact: &Digest) -> bool {
        let at = artifact_path(artifact);
        let read = async { self.objects.get(&at).await?.bytes().await };
        read.now_or_never().and_then(Result::ok).is_some_and(|bytes| Digest::compute(&bytes) == *artifact)
    }

    /// Returns the digests of all stored artifacts.
    pub(crate) fn digests(&self) -> BTreeSet<Digest> {
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

    fn lock_put_times(&self) -> MutexGuard<'_, BTreeMap<Path, Duration>> {
        self.put_times.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn record_put_time(&self, location: &Path) {
        self.lock_put_times().insert(location.clone(), now());
    }

    /// Waits for the duration of an operation. Fails if the medium is unavailable.
    async fn access(&self) -> Result<()> {
        let MediumFaults { unavailable: away, delay: slow, .. } = self.faults();
        if !slow.is_zero() {
            tokio::time::sleep(self.shared.draw_duration(slow)).await;
        }
        if away { Err(medium_error(io::ErrorKind::NotConnected)) } else { Ok(()) }
    }

    fn check_space(&self) -> Result<()> {
        if self.faults().full { Err(medium_error(io::ErrorKind::StorageFull)) } else { Ok(()) }
    }

    /// Returns the bytes that remain of an upload, if this upload is torn.
    fn take_torn(&self, payload: &PutPayload) -> Option<Vec<u8>> {
        let mut troubles = self.faults.lock().unwrap_or_else(PoisonError::into_inner);
        let (others, thousandths) = troubles.torn_upload.as_mut()?;
        if *others > 0 {
            *others -= 1;
            return None;
        }
        let thousandths = *thousandths;
        troubles.torn_upload = None;
        let bytes: Vec<u8> = payload.iter().flat_map(|bytes| bytes.to_vec()).collect();
        Some(Damage::Short(thousandths).apply(bytes))
    }

    /// Checks whether this read returns bytes of another artifact.
    fn is_wrong_read(&self) -> bool {
        let mut troubles = self.faults.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(others) = troubles.wrong_read.as_mut() else { return false };
        let is_due = *others == 0;
        *others = others.saturating_sub(1);
        if is_due {
            troubles.wrong_read = None;
        }
        is_due
    }

    /// Replaces the bytes of a read by those of another artifact, if possible of the same size, so that only the bytes differ.
    async fn read_other(&self, read: GetResult) -> Result<GetResult> {
        let all: Vec<ObjectMeta> = self.objects.list(None).try_collect().await?;
        let others = all.into_iter().filter(|other| other.location != read.meta.location && other.size > 0);
        let Some(other) = others.min_by_key(|other| other.size.abs_diff(read.meta.size)) else { return Ok(read) };
        let bytes = self.objects.get(&other.location).await?.bytes().await?;
        let (from, length) = (read.range.start as usize, (read.range.end - read.range.start) as usize);
        let bytes: Vec<u8> = bytes.iter().copied().cycle().skip(from).take(length).collect();
        self.shared.lock().count_fault("read of another artifact");
        let payload = GetResultPayload::Stream(stream::once(future::ready(Ok(bytes.into()))).boxed());
        Ok(GetResult { payload, ..read })
    }

    /// Checks a removal: an intact artifact that the log references must not be removed.
    fn check_removal(&self, at: &Path) {
        let name: String = at.parts().map(|part| part.as_ref().to_owned()).collect();
        let Ok(digest) = name.parse::<Digest>() else { return };
        if !self.is_intact(&digest) {
            return;
        }
        let mut state = self.shared.lock();
        if state.disk.ledger().is_ok_and(|ledger| ledger.references().contains(&digest)) {
            state.violations.push(Violation::ReferencedArtifactRemoved { digest });
        }
    }
}

fn medium_error(kind: io::ErrorKind) -> Error {
    Error::Generic { store: "shelf", source: Box::new(io::Error::from(kind)) }
}

fn now() -> Duration {
    turmoil::sim_elapsed().unwrap_or_default()
}

impl fmt::Display for FaultyMedium {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Shelf")
    }
}

#[async_trait]
impl ObjectStore for FaultyMedium {
    async fn put_opts(&self, location: &Path, payload: PutPayload, opts: PutOptions) -> Result<PutResult> {
        self.access().await?;
        self.check_space()?;
        if let Some(bytes) = self.take_torn(&payload) {
            // A torn upload cannot replace an existing artifact either.
            let torn = self.objects.put_opts(location, bytes.into(), opts).await;
            if torn.is_ok() {
                self.record_put_time(location);
                self.shared.lock().count_fault("torn upload");
            }
            return Err(medium_error(io::ErrorKind::BrokenPipe));
        }
        let put = self.objects.put_opts(location, payload, opts).await?;
        self.record_put_time(location);
        Ok(put)
    }

    async fn put_multipart_opts(&self, at: &Path, opts: PutMultipartOptions) -> Result<Box<dyn MultipartUpload>> {
        self.access().await?;
        self.check_space()?;
        self.record_put_time(at);
        self.objects.put_multipart_opts(at, opts).await
    }

    async fn get_opts(&self, location: &Path, options: GetOptions) -> Result<GetResult> {
        self.access().await?;
        let is_head = options.head;
        let read = self.objects.get_opts(location, options).await?;
        if is_head || !self.is_wrong_read() { Ok(read) } else { self.read_other(read).await }
    }

    fn delete_stream(&self, locations: BoxStream<'static, Result<Path>>) -> BoxStream<'static, Result<Path>> {
        let shelf = self.clone();
        let forget = move |at: &Path| {
            shelf.check_removal(at);
            shelf.lock_put_times().remove(at);
        };
        self.objects.delete_stream(locations.inspect_ok(forget).boxed())
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        let (shelf, now) = (self.clone(), now());
        let aged = move |meta: ObjectMeta| {
            let born = shelf.lock_put_times().get(&meta.location).copied().unwrap_or(now);
            ObjectMeta { last_modified: (SystemTime::now() - now.saturating_sub(born)).into(), ..meta }
        };
        self.objects.list(prefix).map_ok(aged).boxed()
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.objects.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        self.check_space()?;
        self.objects.copy_opts(from, to, options).await
    }
}
