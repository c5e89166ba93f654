//! Pictures of frames. The farm has no rendering code of its own: a program that has it supplies a [`DrawPicture`] function.

mod compare;

use std::collections::VecDeque;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use bytes::Bytes;
use femc_model::{Digest, FrameParts, FrameRecord, JobId, Output, Refusal, Role};
use femc_store::Store;
use tokio::sync::Semaphore;

use crate::call::Call;
use crate::farm::Farm;
use crate::job_control::MissingOutput;
use crate::light::{LightViewError, LightViews};
pub(crate) use compare::ComparedPicture;

/// Source of a picture.
#[derive(Debug, Clone)]
pub enum PictureSource {
    /// Image of a finished frame as EXR.
    Image(Bytes),
    /// Tone-mapped image of a finished frame as PNG.
    Preview(Bytes),
    /// Light statistics of a finished frame.
    Statistics(Bytes),
    /// Available outputs of an unfinished frame.
    Parts(FrameParts, Vec<(Role, Bytes)>),
}

/// Kind of picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PictureKind {
    /// A small, tone-mapped PNG.
    Thumbnail {
        /// Maximum height in pixels.
        height: u32,
    },
    /// Planes of half floats, as specified in `docs/http.md`.
    Pixels,
    /// Planes of half floats with the light statistics of each pixel.
    Maps,
    /// Planes of half floats with all that a statistics file knows about each pixel. They stand for the image, which it does not
    /// contain.
    FileMaps,
}

/// Function that draws pictures. It may take seconds. Its error describes the fault of the source.
pub type DrawPicture = fn(PictureSource, PictureKind) -> Result<Vec<u8>, String>;

/// Function that compares two pictures and writes the errors of the first one against the second one as JSON, as specified in
/// `docs/http.md`. It may take seconds. Its error describes the fault of a source.
pub type ComparePictures = fn([PictureSource; 2]) -> Result<Vec<u8>, String>;

/// A picture, and a tag that identifies its source.
#[derive(Debug, Clone)]
pub(crate) struct Picture {
    pub(crate) tag: String,
    pub(crate) bytes: Bytes,
}

/// Draws pictures for all clients. Clones share the cache.
#[derive(Clone)]
pub(crate) struct Pictures {
    draw: Option<DrawPicture>,
    compare: Option<ComparePictures>,
    store: Store,
    /// Limits the number of pictures that are drawn at the same time.
    draw_permits: Arc<Semaphore>,
    /// Cache of the latest thumbnails and comparisons.
    small_answers: Arc<Mutex<VecDeque<Picture>>>,
}

impl fmt::Debug for Pictures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Pictures").field("can_draw", &self.draw.is_some()).finish_non_exhaustive()
    }
}

impl Pictures {
    /// Maximum number of pictures drawn at the same time: each may use as much memory as the frame.
    const MAX_CONCURRENT: usize = 2;
    /// Size of the cache of thumbnails and comparisons in bytes.
    const CACHE_BYTES: usize = 16 << 20;

    pub(crate) fn new(draw: Option<DrawPicture>, compare: Option<ComparePictures>, store: Store) -> Self {
        let draw_permits = Arc::new(Semaphore::new(Self::MAX_CONCURRENT));
        Self { draw, compare, store, draw_permits, small_answers: Arc::default() }
    }

    /// Returns a picture of a frame; `None`: no data is available yet.
    /// - `known`: tag of the picture that the client has. If it is current, nothing is drawn and the bytes are empty.
    pub(crate) async fn get<S>(
        &self,
        farm: &Farm<S>,
        job: JobId,
        frame: u32,
        kind: PictureKind,
        known: Option<&str>,
    ) -> Result<Option<Picture>, Refusal> {
        let draw = self.draw()?;
        let finished = farm.call(|reply| Call::Frames { job, reply }).await?;
        let of_frame = finished.into_iter().find(|record| record.frame == frame);
        let (current, outputs, parts) = match &of_frame {
            Some(record) => {
                let Some(output) = best(record, kind) else { return Ok(None) };
                (tag(&[output], kind), vec![output], None)
            }
            // Statistics exist only for whole frames.
            None if matches!(kind, PictureKind::Maps | PictureKind::FileMaps) => return Ok(None),
            None => {
                let parts = farm.call(|reply| Call::Parts { job, reply }).await?;
                let Some(parts) = parts.into_iter().find(|parts| parts.frame == frame) else { return Ok(None) };
                let shown = |output: &&Output| matches!(output.role, Role::Tile | Role::Sums | Role::Pixels);
                let outputs: Vec<Output> = parts.outputs.iter().filter(shown).copied().collect();
                (tag(&outputs, kind), outputs, Some(parts))
            }
        };
        if known == Some(&current) {
            return Ok(Some(Picture { tag: current, bytes: Bytes::new() }));
        }
        if let Some(kept) = self.cached_answer(&current) {
            return Ok(Some(kept));
        }
        // The semaphore is never closed.
        let _turn = self.draw_permits.acquire().await;
        let if_missing = if parts.is_some() { MissingOutput::Replaced } else { MissingOutput::Lost };
        let (mut artifacts, mut read) = (Vec::with_capacity(outputs.len()), Vec::new());
        for output in outputs {
            if let Some(bytes) = farm.read_output(&self.store, output.artifact.digest, if_missing).await? {
                artifacts.push((output.role, bytes));
                read.push(output);
            }
        }
        // Outputs may be missing. The tag is that of the outputs in the picture.
        let tag = tag(&read, kind);
        let source = match (parts, artifacts.pop()) {
            (Some(parts), Some(last)) => PictureSource::Parts(parts, artifacts.into_iter().chain([last]).collect()),
            (None, Some((Role::Preview, png))) => PictureSource::Preview(png),
            (None, Some((Role::Statistics, bytes))) => PictureSource::Statistics(bytes),
            (None, Some((_, exr))) => PictureSource::Image(exr),
            (_, None) => return Ok(None),
        };
        let bytes = draw_in_background(draw, source, kind)
            .await
            .map_err(|message| Refusal::Unavailable { message: format!("frame {frame}: {message}") })?;
        let drawn = Picture { tag, bytes };
        if matches!(kind, PictureKind::Thumbnail { .. }) {
            self.cache_answer(drawn.clone());
        }
        Ok(Some(drawn))
    }

    /// Returns the maps of a statistics file that is served beside the farm.
    /// - `known`: tag of the maps that the client has. If it is current, nothing is drawn and the bytes are empty.
    pub(crate) async fn file_maps(
        &self,
        views: &LightViews,
        number: usize,
        known: Option<&str>,
    ) -> Result<Picture, LightViewError> {
        let draw = self.draw()?;
        let kind = PictureKind::FileMaps;
        let tag = Digest::compute(format!("{} {kind:?}", views.file_tag(number).await?).as_bytes()).to_string();
        if known == Some(&tag) {
            return Ok(Picture { tag, bytes: Bytes::new() });
        }
        // The semaphore is never closed.
        let _turn = self.draw_permits.acquire().await;
        let source = PictureSource::Statistics(views.read_file(number).await?);
        let drawn = draw_in_background(draw, source, kind).await;
        let bytes = drawn.map_err(|message| LightViewError::Unreadable { message })?;
        Ok(Picture { tag, bytes })
    }

    fn draw(&self) -> Result<DrawPicture, Refusal> {
        self.draw.ok_or_else(|| Refusal::Unavailable { message: "this program cannot draw pictures".into() })
    }

    fn cached_answer(&self, tag: &str) -> Option<Picture> {
        // A poisoned lock is safe to use: a panic in the few lines under it leaves no partial change.
        let kept = self.small_answers.lock().unwrap_or_else(PoisonError::into_inner);
        kept.iter().find(|drawn| drawn.tag == tag).cloned()
    }

    fn cache_answer(&self, drawn: Picture) {
        let mut kept = self.small_answers.lock().unwrap_or_else(PoisonError::into_inner);
        kept.push_back(drawn);
        while kept.iter().map(|drawn| drawn.bytes.len()).sum::<usize>() > Self::CACHE_BYTES {
            kept.pop_front();
        }
    }
}

/// Draws on a thread for long work. The error describes the fault of the source.
async fn draw_in_background(draw: DrawPicture, source: PictureSource, kind: PictureKind) -> Result<Bytes, String> {
    let drawn = tokio::task::spawn_blocking(move || draw(source, kind)).await;
    drawn.map_err(|error| error.to_string()).and_then(|drawn| drawn).map(Bytes::from)
}

/// Returns the output of a finished frame to draw from. Thumbnails use the PNG, if there is one.
fn best(record: &FrameRecord, kind: PictureKind) -> Option<Output> {
    let of_role = |role: Role| record.outputs.iter().find(|output| output.role == role).copied();
    match kind {
        PictureKind::Thumbnail { .. } => of_role(Role::Preview).or_else(|| of_role(Role::Image)),
        PictureKind::Pixels => of_role(Role::Image),
        PictureKind::Maps | PictureKind::FileMaps => of_role(Role::Statistics),
    }
}

/// Returns a tag that identifies the outputs and the kind of picture.
fn tag(outputs: &[Output], kind: PictureKind) -> String {
    let mut bytes: Vec<u8> = outputs.iter().flat_map(|output| *output.artifact.digest.as_bytes()).collect();
    bytes.extend(format!("{kind:?}").bytes());
    Digest::compute(&bytes).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn latest_thumbnails_are_kept_up_to_16_mebibytes() {
        let pictures = Pictures::new(None, None, Store::in_memory());
        let tags: Vec<String> = (0..6).map(|number| format!("tag {number}")).collect();
        let keep = |tag: &String| {
            pictures.cache_answer(Picture { tag: tag.clone(), bytes: Bytes::from(vec![7; 4 << 20]) });
        };
        let kept = || tags.iter().filter(|tag| pictures.cached_answer(tag).is_some()).collect::<Vec<_>>();
        tags[..4].iter().for_each(keep);
        assert_eq!(kept(), tags[..4].iter().collect::<Vec<_>>());
        tags[4..].iter().for_each(keep);
        assert_eq!(kept(), tags[2..].iter().collect::<Vec<_>>());
        assert!(pictures.cached_answer("tag").is_none());
    }
}
