//! The store's medium.

use std::collections::BTreeMap;
use std::fmt;
use std::future;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

use async_trait::async_trait;
use femc_model::Digest;
use femc_store::object_store::memory::InMemory;
use femc_store::object_store::path::Path;
use femc_store::object_store::{
    CopyOptions, Error, GetOptions, GetResult, ListResult, MultipartUpload, ObjectMeta, ObjectStore,
    ObjectStoreExt as _, PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
};
use femc_store::place;
use futures_util::stream::BoxStream;
use futures_util::{FutureExt as _, StreamExt as _, TryStreamExt as _};

/// Artefacts in memory that outlive every host, on a medium that may be full. They age by the simulated clock.
#[derive(Debug, Clone, Default)]
pub(crate) struct Shelf {
    objects: Arc<InMemory>,
    full: Arc<AtomicBool>,
    /// When each was put.
    born: Arc<Mutex<BTreeMap<Path, Duration>>>,
}

impl Shelf {
    /// From now on nothing new finds room, or does again.
    pub(crate) fn fill(&self, full: bool) {
        self.full.store(full, Ordering::Relaxed);
    }

    /// An artefact is gone; `false` if it was not there.
    pub(crate) fn lose(&self, artefact: &Digest) -> bool {
        let at = place(artefact);
        let was_there = self.births().remove(&at).is_some();
        was_there && self.objects.delete(&at).now_or_never().is_some_and(|gone| gone.is_ok())
    }

    /// Half of an artefact's bytes are wrong; `false` if it was not there.
    pub(crate) fn damage(&self, artefact: &Digest) -> bool {
        let at = place(artefact);
        let harm = async {
            let mut bytes = self.objects.get(&at).await?.bytes().await?.to_vec();
            bytes.iter_mut().step_by(2).for_each(|byte| *byte ^= 0x55);
            self.objects.put(&at, bytes.into()).await
        };
        harm.now_or_never().is_some_and(|harmed| harmed.is_ok())
    }

    /// How many objects there are, and their bytes.
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

    fn room(&self) -> Result<()> {
        if self.full.load(Ordering::Relaxed) {
            let source = Box::new(io::Error::from(io::ErrorKind::StorageFull));
            return Err(Error::Generic { store: "shelf", source });
        }
        Ok(())
    }
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
        self.room()?;
        let put = self.objects.put_opts(location, payload, opts).await?;
        self.note_birth(location);
        Ok(put)
    }

    async fn put_multipart_opts(&self, at: &Path, opts: PutMultipartOptions) -> Result<Box<dyn MultipartUpload>> {
        self.room()?;
        self.note_birth(at);
        self.objects.put_multipart_opts(at, opts).await
    }

    async fn get_opts(&self, location: &Path, options: GetOptions) -> Result<GetResult> {
        self.objects.get_opts(location, options).await
    }

    fn delete_stream(&self, locations: BoxStream<'static, Result<Path>>) -> BoxStream<'static, Result<Path>> {
        let shelf = self.clone();
        let forget = move |at: &Path| {
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
