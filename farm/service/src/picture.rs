//! Frames as pictures. The farm knows nothing of light: a program that does brings a [`Draw`] along.

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

/// What a picture is made of.
#[derive(Debug, Clone)]
pub enum Source {
    /// The image of a finished frame, EXR.
    Image(Bytes),
    /// The tone-mapped image of a finished frame, PNG.
    Preview(Bytes),
    /// The light statistics of a finished frame.
    Statistics(Bytes),
    /// What there is of a frame in work.
    Parts(FrameParts, Vec<(Role, Bytes)>),
}

/// What is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wanted {
    /// A small PNG, tone-mapped.
    Thumbnail {
        /// Rows at most.
        height: u32,
    },
    /// Planes of half floats, as `docs/http.md` has them.
    Pixels,
    /// The same of what light statistics know of each pixel.
    Maps,
}

/// Makes pictures; it may take seconds. An error says what is wrong with the source.
pub type Draw = fn(Source, Wanted) -> Result<Vec<u8>, String>;

/// A picture, and the name of what it was made of.
#[derive(Debug, Clone)]
pub(crate) struct Drawn {
    pub(crate) tag: String,
    pub(crate) bytes: Bytes,
}

/// Draws for all who ask; clones share what was drawn lately.
#[derive(Clone)]
pub(crate) struct Pictures {
    draw: Option<Draw>,
    store: Store,
    /// Pictures that are being drawn.
    turns: Arc<Semaphore>,
    /// The latest thumbnails.
    kept: Arc<Mutex<VecDeque<Drawn>>>,
}

impl fmt::Debug for Pictures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Pictures").field("can_draw", &self.draw.is_some()).finish_non_exhaustive()
    }
}

impl Pictures {
    /// Pictures that are drawn at a time: each may take as much memory as the frame.
    const TURNS: usize = 2;
    /// Bytes of thumbnails that are kept.
    const KEPT: usize = 16 << 20;

    pub(crate) fn new(draw: Option<Draw>, store: Store) -> Self {
        Self { draw, store, turns: Arc::new(Semaphore::new(Self::TURNS)), kept: Arc::default() }
    }

    /// A picture of a frame; `None`: there is nothing of it yet.
    /// - `known`: the tag of what the client has: then nothing is drawn, and the bytes are empty.
    pub(crate) async fn of<S>(
        &self,
        farm: &Farm<S>,
        job: JobId,
        frame: u32,
        wanted: Wanted,
        known: Option<&str>,
    ) -> Result<Option<Drawn>, Refusal> {
        let draw =
            self.draw.ok_or_else(|| Refusal::Unavailable { message: "this program draws no pictures".into() })?;
        let finished = farm.ask(|reply| Call::Frames { job, reply }).await?;
        let of_frame = finished.into_iter().find(|record| record.frame == frame);
        let (tag, outputs, parts) = match &of_frame {
            Some(record) => {
                let Some(output) = best(record, wanted) else { return Ok(None) };
                (tag(&[output], wanted), vec![output], None)
            }
            // Statistics are those of the whole frame.
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
        // It is never closed.
        let _turn = self.turns.acquire().await;
        let mut artifacts = Vec::with_capacity(outputs.len());
        for Output { role, artifact } in outputs {
            match self.store.get(&artifact.digest).await {
                Ok(bytes) => artifacts.push((role, bytes)),
                // The frame went on meanwhile.
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
        // A panic within the few lines under this lock leaves nothing half done.
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

/// What of a finished frame is read: for a thumbnail the PNG, if there is one.
fn best(record: &FrameRecord, wanted: Wanted) -> Option<Output> {
    let of_role = |role: Role| record.outputs.iter().find(|output| output.role == role).copied();
    match wanted {
        Wanted::Thumbnail { .. } => of_role(Role::Preview).or_else(|| of_role(Role::Image)),
        Wanted::Pixels => of_role(Role::Image),
        Wanted::Maps => of_role(Role::Statistics),
    }
}

/// Names what was drawn of what.
fn tag(outputs: &[Output], wanted: Wanted) -> String {
    let mut bytes: Vec<u8> = outputs.iter().flat_map(|output| *output.artifact.digest.as_bytes()).collect();
    bytes.extend(format!("{wanted:?}").bytes());
    Digest::of(&bytes).to_string()
}
