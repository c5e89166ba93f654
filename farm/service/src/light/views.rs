//! Decoded light of frames and files, in a cache of bounded size, and the threads that answer questions about it.

mod known_rows;

use std::collections::VecDeque;
use std::fmt;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, UNIX_EPOCH};

use bytes::Bytes;
use femc_model::{Artifact, Digest, FrameParts, FrameRecord, JobId, Refusal, Role};
use femc_store::Store;
use tokio::sync::{OnceCell, OwnedSemaphorePermit, Semaphore};

use super::{
    EarlierRows, LightAnswer, LightCall, LightData, LightError, LightFile, LightSource, MAX_LIGHT_BYTES, OpenLight,
};
use crate::access::{CallerKey, TransferSlot, TransferSlots};
use crate::call::Call;
use crate::farm::Farm;
use crate::job_control::MissingOutput;
use known_rows::KnownRows;

/// Light that a question is about.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum LightTarget {
    /// Frames of a job, ascending.
    Frames(JobId, Vec<u32>),
    /// File by its number.
    File(usize),
}

/// A question of a client.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LightQuestion {
    /// Light that it is about.
    pub(crate) target: LightTarget,
    /// The question.
    pub(crate) call: LightCall,
    /// Tag of an earlier answer whose rows the client has.
    pub(crate) since: Option<String>,
}

/// An answer, and a tag that identifies its question and its data.
#[derive(Debug)]
pub(crate) struct TaggedAnswer {
    pub(crate) tag: String,
    /// Answer, and the slot to hold until it is sent. `None`: the client has the answer with this tag.
    pub(crate) answer: Option<(LightAnswer, Arc<TransferSlot>)>,
}

/// Reason why a question has no answer.
#[derive(Debug)]
pub(crate) enum LightViewError {
    /// A parameter is not valid.
    Invalid { field: &'static str, message: String },
    /// Refusal by the farm.
    Refused(Refusal),
    /// The light statistics cannot be read.
    Unreadable { message: String },
    /// The light statistics of a finished frame are damaged or missing in the store.
    Lost { job: JobId, frame: u32, digest: Digest },
    /// The frame is finished and has no light statistics.
    NoStatistics { job: JobId, frame: u32 },
    /// The file does not exist.
    NoFile { number: usize },
}

impl From<Refusal> for LightViewError {
    fn from(refusal: Refusal) -> Self {
        Self::Refused(refusal)
    }
}

/// Decoded data of a target.
#[derive(Clone)]
struct OpenedLight {
    /// Tag of the parts that were read.
    tag: String,
    /// Data; `None`: no sample is recorded yet.
    data: Option<Arc<dyn LightData>>,
}

type OpenedCell = Arc<OnceCell<OpenedLight>>;

/// Answers questions of all clients. Clones share the cache.
#[derive(Clone)]
pub(crate) struct LightViews {
    open: Option<OpenLight>,
    files: Arc<[LightFile]>,
    store: Store,
    /// Slots for questions. A slot is held until all bytes of the answer are sent.
    slots: TransferSlots,
    /// Limits the number of threads that decode and evaluate.
    threads: Arc<Semaphore>,
    /// Latest data of each target, the oldest use first.
    cache: Arc<Mutex<VecDeque<CachedLight>>>,
    /// Rows of answers about growing data.
    known_rows: Arc<Mutex<KnownRows>>,
}

/// Data in the cache.
#[derive(Clone)]
struct CachedLight {
    target: LightTarget,
    /// Tag of the parts for which the entry was made.
    tag: String,
    created: Instant,
    cell: OpenedCell,
}

impl CachedLight {
    /// Returns the tag of the data, or of the parts that will be read.
    fn tag(&self) -> &str {
        self.cell.get().map_or(&self.tag, |opened| &opened.tag)
    }
}

impl fmt::Debug for LightViews {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LightViews").field("can_open", &self.open.is_some()).finish_non_exhaustive()
    }
}

/// Parts of a target, before they are read.
struct TargetParts {
    tag: String,
    parts: Vec<TargetPart>,
}

impl TargetParts {
    fn is_growing(&self) -> bool {
        self.parts.iter().any(|part| part.is_growing)
    }
}

struct TargetPart {
    name: String,
    is_growing: bool,
    origin: Origin,
}

enum Origin {
    Frame { job: JobId, frame: u32, artifacts: Vec<Artifact> },
    File(std::path::PathBuf),
}

impl LightViews {
    /// Size limit of the cache, bytes.
    const CACHE_BYTES: usize = 512 << 20;
    /// Shortest interval between two decodings of a frame in progress.
    const MIN_GROWTH_INTERVAL: Duration = Duration::from_secs(1);
    /// Maximum number of cached targets, including those that have no data.
    const MAX_CACHED: usize = 256;

    pub(crate) fn new(open: Option<OpenLight>, files: Vec<LightFile>, store: Store, slots: TransferSlots) -> Self {
        // The rest of the processors is for the coordinator itself.
        let threads = std::thread::available_parallelism().map_or(1, |count| (count.get() / 2).clamp(1, 4));
        Self {
            open,
            files: files.into(),
            store,
            slots,
            threads: Arc::new(Semaphore::new(threads)),
            cache: Arc::default(),
            known_rows: Arc::default(),
        }
    }

    /// Returns the files.
    pub(crate) fn files(&self) -> &[LightFile] {
        &self.files
    }

    fn file(&self, number: usize) -> Result<&LightFile, LightViewError> {
        self.files.get(number).ok_or(LightViewError::NoFile { number })
    }

    /// Returns a tag that changes when the file changes.
    pub(crate) async fn file_tag(&self, number: usize) -> Result<String, LightViewError> {
        let path = &self.file(number)?.path;
        let version = version(path).await;
        let version = version.map_err(|error| unreadable(format!("cannot read {}: {error}", path.display())))?;
        Ok(Digest::compute(version.as_bytes()).to_string())
    }

    /// Reads a file.
    pub(crate) async fn read_file(&self, number: usize) -> Result<Bytes, LightViewError> {
        read_file(&self.file(number)?.path, MAX_LIGHT_BYTES).await
    }

    /// Answers a question; `None`: no sample is recorded yet.
    /// - `known`: tag of the answer that the client has. If it is current, nothing is computed.
    pub(crate) async fn answer<S: Send + 'static>(
        &self,
        farm: &Farm<S>,
        question: LightQuestion,
        known: Option<&str>,
        caller_key: CallerKey,
    ) -> Result<Option<TaggedAnswer>, LightViewError> {
        let LightQuestion { target, call, since } = question;
        let open = self.open.ok_or_else(|| unavailable("this program cannot read light statistics".into()))?;
        let Some(located) = self.locate(farm, &target).await? else { return Ok(None) };
        let cached = self.cached(&target, &located);
        let answer_tag = |data: &str| Digest::compute(format!("{data} {call:?}").as_bytes()).to_string();
        let tag = answer_tag(cached.tag());
        if known == Some(&tag) {
            return Ok(Some(TaggedAnswer { tag, answer: None }));
        }
        let slot = Arc::new(self.slots.acquire(caller_key).await);
        let opened = match cached.cell.get() {
            Some(opened) => opened.clone(),
            None => self.open_in_background(farm, open, located, cached.cell, &slot).await?,
        };
        let OpenedLight { tag: data_tag, data: Some(data) } = opened else { return Ok(None) };
        let tag = answer_tag(&data_tag);
        let earlier = since.and_then(|since| self.known_rows().find(&target, &since));
        let permit = self.permit().await;
        let is_cancelled = CancelOnDrop::default();
        let flag = is_cancelled.0.clone();
        let work = move || {
            let _permit = permit;
            data.answer(&call, earlier.as_ref(), &flag)
        };
        let answered = tokio::task::spawn_blocking(work).await.map_err(|error| unavailable(error.to_string()))?;
        match answered {
            Ok(answer) => {
                if let LightAnswer::Rows { identities, .. } = &answer {
                    self.known_rows().add(target, EarlierRows { tag: tag.clone(), identities: identities.clone() });
                }
                Ok(Some(TaggedAnswer { tag, answer: Some((answer, slot)) }))
            }
            Err(LightError::Invalid { field, message }) => Err(LightViewError::Invalid { field, message }),
            Err(LightError::Cancelled) => Err(unavailable("the question was cancelled".into())),
        }
    }

    /// Opens a target in a task of its own: it is finished even if the client leaves, so that the next question finds the data.
    async fn open_in_background<S: Send + 'static>(
        &self,
        farm: &Farm<S>,
        open: OpenLight,
        parts: TargetParts,
        cell: OpenedCell,
        slot: &Arc<TransferSlot>,
    ) -> Result<OpenedLight, LightViewError> {
        let (views, farm, slot) = (self.clone(), farm.clone(), slot.clone());
        let task = tokio::spawn(async move {
            let _slot = slot;
            let opened = cell.get_or_try_init(|| views.open(&farm, open, parts)).await.cloned();
            views.evict();
            opened
        });
        task.await.map_err(|error| unavailable(error.to_string()))?
    }

    /// Finds the parts of a target; `None`: there are none yet.
    async fn locate<S>(&self, farm: &Farm<S>, target: &LightTarget) -> Result<Option<TargetParts>, LightViewError> {
        match target {
            LightTarget::File(number) => {
                let (file, tag) = (self.file(*number)?, self.file_tag(*number).await?);
                let part =
                    TargetPart { name: file.name.clone(), is_growing: false, origin: Origin::File(file.path.clone()) };
                Ok(Some(TargetParts { tag, parts: vec![part] }))
            }
            LightTarget::Frames(job, frames) => self.locate_frames(farm, *job, frames).await,
        }
    }

    async fn locate_frames<S>(
        &self,
        farm: &Farm<S>,
        job: JobId,
        frames: &[u32],
    ) -> Result<Option<TargetParts>, LightViewError> {
        let finished: Vec<FrameRecord> = farm.call(|reply| Call::Frames { job, reply }).await?;
        let record = |frame: u32| finished.iter().find(|record| record.frame == frame);
        let unfinished: Vec<FrameParts> = if frames.iter().all(|frame| record(*frame).is_some()) {
            Vec::new()
        } else {
            farm.call(|reply| Call::Parts { job, reply }).await?
        };
        let mut parts = Vec::new();
        for &frame in frames {
            let (artifacts, is_growing) = match record(frame) {
                Some(record) => {
                    let artifact =
                        record.output(Role::Statistics).ok_or(LightViewError::NoStatistics { job, frame })?;
                    (vec![artifact], false)
                }
                None => {
                    let own = unfinished.iter().filter(|parts| parts.frame == frame).flat_map(|parts| &parts.outputs);
                    let of_light = own.filter(|output| matches!(output.role, Role::Paths | Role::Statistics));
                    (of_light.map(|output| output.artifact).collect(), true)
                }
            };
            if !artifacts.is_empty() {
                let origin = Origin::Frame { job, frame, artifacts };
                parts.push(TargetPart { name: format!("frame {frame}"), is_growing, origin });
            }
        }
        let artifacts = || {
            parts.iter().flat_map(|part| match &part.origin {
                Origin::Frame { artifacts, .. } => &artifacts[..],
                Origin::File(_) => &[],
            })
        };
        let bytes: u64 = artifacts().map(|artifact| artifact.bytes).sum();
        if bytes > MAX_LIGHT_BYTES {
            let message = format!(
                "the light statistics of these frames have {} MiB, at most {} are possible: choose fewer frames",
                bytes >> 20,
                MAX_LIGHT_BYTES >> 20
            );
            return Err(LightViewError::Invalid { field: "frames", message });
        }
        let tag = parts_tag(&parts);
        Ok((!parts.is_empty()).then_some(TargetParts { tag, parts }))
    }

    /// Returns the entry of the cache for a target, and marks it as the latest used. Data with another tag is out of date, but data
    /// of frames in progress is used for [`Self::MIN_GROWTH_INTERVAL`].
    fn cached(&self, target: &LightTarget, parts: &TargetParts) -> CachedLight {
        // A poisoned lock is safe to use: a panic in the few lines under it leaves no partial change.
        let mut cache = self.cache.lock().unwrap_or_else(PoisonError::into_inner);
        let position = cache.iter().position(|cached| cached.target == *target);
        let is_current = |cached: &CachedLight| {
            let is_recent = cached.cell.get().is_none() || cached.created.elapsed() < Self::MIN_GROWTH_INTERVAL;
            cached.tag() == parts.tag || (parts.is_growing() && is_recent)
        };
        let cached = position.and_then(|position| cache.remove(position)).filter(is_current);
        let cached = cached.unwrap_or_else(|| CachedLight {
            target: target.clone(),
            tag: parts.tag.clone(),
            created: Instant::now(),
            cell: OpenedCell::default(),
        });
        cache.push_back(cached.clone());
        cached
    }

    /// Removes the data that was not used for the longest time, until the rest is within the limits. The latest data stays.
    fn evict(&self) {
        let mut cache = self.cache.lock().unwrap_or_else(PoisonError::into_inner);
        let size =
            |cached: &CachedLight| cached.cell.get().and_then(|it| it.data.as_ref()).map_or(0, |it| it.memory_bytes());
        let mut sizes: VecDeque<usize> = cache.iter().map(size).collect();
        while cache.len() > 1 && (sizes.iter().sum::<usize>() > Self::CACHE_BYTES || cache.len() > Self::MAX_CACHED) {
            cache.pop_front();
            sizes.pop_front();
        }
    }

    fn known_rows(&self) -> MutexGuard<'_, KnownRows> {
        // A poisoned lock is safe to use: a panic in the few lines under it leaves no partial change.
        self.known_rows.lock().unwrap_or_else(PoisonError::into_inner)
    }

    async fn permit(&self) -> Option<OwnedSemaphorePermit> {
        // The semaphore is never closed.
        self.threads.clone().acquire_owned().await.ok()
    }

    /// Reads and decodes the parts of a target.
    async fn open<S>(
        &self,
        farm: &Farm<S>,
        open: OpenLight,
        located: TargetParts,
    ) -> Result<OpenedLight, LightViewError> {
        // Parts are read within the limit on threads, so that few of them are in memory at a time.
        let permit = self.permit().await;
        let mut sources = Vec::with_capacity(located.parts.len());
        // Job and digests of the parts of each source.
        let mut origins: Vec<(JobId, Vec<Digest>)> = Vec::new();
        let mut tag = located.tag;
        for TargetPart { name, is_growing, origin } in located.parts {
            let parts = match origin {
                Origin::File(path) => vec![read_file(&path, MAX_LIGHT_BYTES).await?],
                Origin::Frame { job, frame, artifacts } => {
                    let if_missing = if is_growing { MissingOutput::Replaced } else { MissingOutput::Lost };
                    let (mut parts, mut digests) = (Vec::with_capacity(artifacts.len()), Vec::new());
                    for Artifact { digest, .. } in artifacts {
                        let read = farm.read_output(&self.store, digest, if_missing).await;
                        match read.map_err(|refusal| unreadable_artifact(job, frame, refusal))? {
                            Some(bytes) => {
                                parts.push(bytes);
                                digests.push(digest);
                            }
                            // A part is missing, so the data get a tag of their own.
                            None => tag = Digest::compute(format!("{tag} without {digest}").as_bytes()).to_string(),
                        }
                    }
                    origins.push((job, digests));
                    parts
                }
            };
            sources.push(LightSource { name, parts, is_growing });
        }
        let names: Vec<String> = sources.iter().map(|source| source.name.clone()).collect();
        let work = move || {
            let _permit = permit;
            open(&tag, sources).map(|data| OpenedLight { tag, data })
        };
        let opened = tokio::task::spawn_blocking(work).await.map_err(|error| unreadable(error.to_string()))?;
        match opened {
            Ok(opened) => Ok(opened),
            Err(fault) => {
                let origin = names.iter().zip(&origins).find(|(name, _)| fault.sources == [name.as_str()]);
                let message = match origin {
                    Some((name, (job, digests))) => {
                        let place = describe_part(farm, *job, digests, fault.part).await;
                        format!("{name}{place}: {}", fault.message)
                    }
                    None => fault.to_string(),
                };
                Err(unreadable(message))
            }
        }
    }
}

/// Returns a tag that identifies parts of frames: the name and the artifacts of each part, and whether it grows.
fn parts_tag(parts: &[TargetPart]) -> String {
    let mut identity = Vec::new();
    for TargetPart { name, is_growing, origin } in parts {
        let digests = match origin {
            Origin::Frame { artifacts, .. } => artifacts.iter().map(|artifact| artifact.digest.to_string()).collect(),
            Origin::File(path) => vec![path.display().to_string()],
        };
        identity.push(format!("{name} {is_growing} {}", digests.join(" ")));
    }
    Digest::compute(identity.join("\n").as_bytes()).to_string()
}

/// Converts the refusal of a frame's statistics.
fn unreadable_artifact(job: JobId, frame: u32, refusal: Refusal) -> LightViewError {
    match refusal {
        Refusal::NoSuchArtifact { digest } | Refusal::DigestMismatch { digest } => {
            LightViewError::Lost { job, frame, digest }
        }
        Refusal::Unavailable { message } => unavailable(format!("light statistics of frame {frame}: {message}")),
        other => LightViewError::Refused(other),
    }
}

/// Describes a part of a frame: the task that made it and its digest, such as `, task 7/3.0/render.0/2 (artifact ab12..)`. A finished
/// frame has one part.
async fn describe_part<S>(farm: &Farm<S>, job: JobId, digests: &[Digest], part: Option<usize>) -> String {
    let Some(&digest) = digests.get(part.unwrap_or(0)) else { return String::new() };
    let task = farm.call(|reply| Call::Producer { job, digest, reply }).await;
    match (task, part) {
        (Ok(Some(task)), _) => format!(", task {task} (artifact {digest})"),
        (_, Some(part)) => format!(", part {} of {} (artifact {digest})", part + 1, digests.len()),
        (_, None) => format!(" (artifact {digest})"),
    }
}

/// Flag that is set when the request that owns it is dropped.
#[derive(Default)]
struct CancelOnDrop(Arc<AtomicBool>);

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

fn unavailable(message: String) -> LightViewError {
    LightViewError::Refused(Refusal::Unavailable { message })
}

fn unreadable(message: String) -> LightViewError {
    LightViewError::Unreadable { message }
}

/// Returns a text that changes when the file changes.
async fn version(path: &Path) -> std::io::Result<String> {
    let metadata = tokio::fs::metadata(path).await?;
    let modified = metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
    Ok(format!("{} {} {:?}", path.display(), metadata.len(), modified))
}

/// Reads a file of at most `limit` bytes.
async fn read_file(path: &Path, limit: u64) -> Result<Bytes, LightViewError> {
    let failed = |error: std::io::Error| unreadable(format!("cannot read {}: {error}", path.display()));
    let bytes = tokio::fs::metadata(path).await.map_err(failed)?.len();
    if bytes > limit {
        let message = format!("{} has {} MiB, at most {} are possible", path.display(), bytes >> 20, limit >> 20);
        return Err(LightViewError::Invalid { field: "file", message });
    }
    tokio::fs::read(path).await.map(Bytes::from).map_err(failed)
}

#[cfg(test)]
mod tests;
