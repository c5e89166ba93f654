//! Pictures of frames. The farm has no rendering code of its own: a program that has it supplies a [`Draw`] function.

use std::collections::VecDeque;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use bytes::Bytes;
use femc_model::{Digest, FrameParts, FrameRecord, JobId, Output, Refusal, Role};
use femc_store::{Store, StoreError};
use tokio::sync::Semaphore;

use crate::call::Call;
use crate::farm::Farm;
use crate::steer::store_refusal;

/// Source of a picture.
#[derive(Debug, Clone)]
pub enum Source {
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
pub enum Wanted {
    /// A small, tone-mapped PNG.
    Thumbnail {
        /// Maximum height in pixels.
        height: u32,
    },
    /// Planes of half floats, as specified in `docs/http.md`.
    Pixels,
    /// Planes of half floats with the light statistics of each pixel.
    Maps,
}

/// Function that draws pictures. It may take seconds. Its error describes the fault of the source.
pub type Draw = fn(Source, Wanted) -> Result<Vec<u8>, String>;

/// A picture, and a tag that identifies its source.
#[derive(Debug, Clone)]
pub(crate) struct Drawn {
    pub(crate) tag: String,
    pub(crate) bytes: Bytes,
}

/// Draws pictures for all clients. Clones share the cache.
#[derive(Clone)]
pub(crate) struct Pictures {
    draw: Option<Draw>,
    store: Store,
    /// Limits the number of pictures that are drawn at the same time.
    turns: Arc<Semaphore>,
    /// Cache of the latest thumbnails.
    kept: Arc<Mutex<VecDeque<Drawn>>>,
}

impl fmt::Debug for Pictures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Pictures").field("can_draw", &self.draw.is_some()).finish_non_exhaustive()
    }
}

impl Pictures {
    /// Maximum number of pictures drawn at the same time: each may use as much memory as the frame.
    const TURNS: usize = 2;
    /// Size of the thumbnail cache in bytes.
    const KEPT: usize = 16 << 20;

    pub(crate) fn new(draw: Option<Draw>, store: Store) -> Self {
        Self { draw, store, turns: Arc::new(Semaphore::new(Self::TURNS)), kept: Arc::default() }
    }

    /// Returns a picture of a frame; `None`: no data is available yet.
    /// - `known`: tag of the picture that the client has. If it is current, nothing is drawn and the bytes are empty.
    pub(crate) async fn of<S>(
        &self,
        farm: &Farm<S>,
        job: JobId,
        frame: u32,
        wanted: Wanted,
        known: Option<&str>,
    ) -> Result<Option<Drawn>, Refusal> {
        let draw =
            self.draw.ok_or_else(|| Refusal::Unavailable { message: "this program cannot draw pictures".into() })?;
        let finished = farm.ask(|reply| Call::Frames { job, reply }).await?;
        let of_frame = finished.into_iter().find(|record| record.frame == frame);
        let (tag, outputs, parts) = match &of_frame {
            Some(record) => {
                let Some(output) = best(record, wanted) else { return Ok(None) };
                (tag(&[output], wanted), vec![output], None)
            }
            // Statistics exist only for whole frames.
            None if wanted == Wanted::Maps => return Ok(None),
            None => {
                let parts = farm.ask(|reply| Call::Parts { job, reply }).await?;
                let Some(parts) = parts.into_iter().find(|parts| parts.frame == frame) else { return Ok(None) };
                let shown = |output: &&Output| matches!(output.role, Role::Tile | Role::Sums | Role::Pixels);
                let outputs: Vec<Output> = parts.outputs.iter().filter(shown).copied().collect();
                (tag(&outputs, wanted), outputs, Some(parts))
            }
        };
        if known == Some(&tag) {
            return Ok(Some(Drawn { tag, bytes: Bytes::new() }));
        }
        if let Some(kept) = self.kept(&tag) {
            return Ok(Some(kept));
        }
        // The semaphore is never closed.
        let _turn = self.turns.acquire().await;
        let mut artifacts = Vec::with_capacity(outputs.len());
        for Output { role, artifact } in outputs {
            match self.store.get(&artifact.digest).await {
                Ok(bytes) => artifacts.push((role, bytes)),
                // The frame has progressed meanwhile, and the part was replaced.
                Err(StoreError::Missing { .. }) if parts.is_some() => {}
                Err(error) => {
                    if matches!(error, StoreError::Missing { .. } | StoreError::Mismatch { .. }) {
                        farm.lost(artifact.digest).await;
                    }
                    return Err(store_refusal(&error));
                }
            }
        }
        let source = match (parts, artifacts.pop()) {
            (Some(parts), Some(last)) => Source::Parts(parts, artifacts.into_iter().chain([last]).collect()),
            (None, Some((Role::Preview, png))) => Source::Preview(png),
            (None, Some((Role::Statistics, bytes))) => Source::Statistics(bytes),
            (None, Some((_, exr))) => Source::Image(exr),
            (_, None) => return Ok(None),
        };
        let drawn = tokio::task::spawn_blocking(move || draw(source, wanted)).await;
        let drawn = drawn.map_err(|error| error.to_string()).and_then(|drawn| drawn);
        let bytes = drawn.map_err(|message| Refusal::Unavailable { message: format!("frame {frame}: {message}") })?;
        let drawn = Drawn { tag, bytes: bytes.into() };
        if matches!(wanted, Wanted::Thumbnail { .. }) {
            self.keep(drawn.clone());
        }
        Ok(Some(drawn))
    }

    fn kept(&self, tag: &str) -> Option<Drawn> {
        // A poisoned lock is safe to use: a panic in the few lines under it leaves no partial change.
        let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.iter().find(|drawn| drawn.tag == tag).cloned()
    }

    fn keep(&self, drawn: Drawn) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.push_back(drawn);
        while kept.iter().map(|drawn| drawn.bytes.len()).sum::<usize>() > Self::KEPT {
            kept.pop_front();
        }
    }
}

/// Returns the output of a finished frame to draw from. Thumbnails use the PNG, if there is one.
fn best(record: &FrameRecord, wanted: Wanted) -> Option<Output> {
    let of_role = |role: Role| record.outputs.iter().find(|output| output.role == role).copied();
    match wanted {
        Wanted::Thumbnail { .. } => of_role(Role::Preview).or_else(|| of_role(Role::Image)),
        Wanted::Pixels => of_role(Role::Image),
        Wanted::Maps => of_role(Role::Statistics),
    }
}

/// Returns a tag that identifies the outputs and the kind of picture.
fn tag(outputs: &[Output], wanted: Wanted) -> String {
    let mut bytes: Vec<u8> = outputs.iter().flat_map(|output| *output.artifact.digest.as_bytes()).collect();
    bytes.extend(format!("{wanted:?}").bytes());
    Digest::of(&bytes).to_string()
}
