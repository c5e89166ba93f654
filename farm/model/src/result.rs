//! What tasks bring home.

use serde::{Deserialize, Serialize};

use crate::{Digest, Grid};

/// Bytes in the artefact store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Artefact {
    /// BLAKE3 of the bytes.
    pub digest: Digest,
    /// How many bytes.
    pub bytes: u64,
}

impl Artefact {
    /// The name of `bytes`.
    pub fn of(bytes: &[u8]) -> Self {
        Self { digest: Digest::of(bytes), bytes: bytes.len() as u64 }
    }
}

/// A rendered tile, or some of its samples.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TileResult {
    /// The encoded tile.
    pub tile: Artefact,
    /// Pixel samples that were taken.
    pub samples: u64,
    /// Samples refused because they were NaN, infinite or negative.
    pub bad_samples: u64,
    /// Seconds that the worker spent on it.
    pub seconds: f64,
}

/// Whether a frame is good enough.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Decision {
    /// Another round.
    Continue,
    /// The frame is finished.
    Done,
}

/// A merged round of a frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MergeResult {
    /// Whether the frame is finished.
    pub decision: Decision,
    /// The encoded sums, for the next round's merge; those of a frame in groups are the groups'.
    pub sums: Option<Artefact>,
    /// The finished image as EXR; `None` while the decision is `Continue`.
    pub image: Option<Artefact>,
    /// The same, tone-mapped, as PNG.
    pub preview: Option<Artefact>,
    /// Relative error reached, as the settings' stop rule measures it.
    pub relative_error: Option<f64>,
    /// Samples refused in the whole frame so far.
    pub bad_samples: u64,
    /// Seconds that the worker spent on the merge.
    pub seconds: f64,
}

/// A gathered group of tiles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GatherResult {
    /// Its encoded sums, for the next round; `None` after the last.
    pub sums: Option<Artefact>,
    /// Its resolved pixels, for the merge and for previews.
    pub pixels: Artefact,
    /// Seconds that the worker spent on it.
    pub seconds: f64,
}

impl GatherResult {
    /// Every artefact that it names.
    pub fn artefacts(&self) -> impl Iterator<Item = Artefact> + use<> {
        self.sums.into_iter().chain([self.pixels])
    }
}

/// Result of a task, by its kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum TaskResult {
    /// Of a render task.
    Tile(TileResult),
    /// Of a merge task.
    Merge(MergeResult),
    /// Of a gather task.
    Gather(GatherResult),
}

impl TaskResult {
    /// Every artefact that it names.
    pub fn artefacts(&self) -> impl Iterator<Item = Artefact> {
        let all = match self {
            Self::Tile(tile) => [Some(tile.tile), None, None],
            Self::Merge(merge) => [merge.sums, merge.image, merge.preview],
            Self::Gather(group) => [group.sums, Some(group.pixels), None],
        };
        all.into_iter().flatten()
    }

    /// Seconds that the worker spent on it.
    pub fn seconds(&self) -> f64 {
        match self {
            Self::Tile(tile) => tile.seconds,
            Self::Merge(merge) => merge.seconds,
            Self::Gather(group) => group.seconds,
        }
    }
}

/// What there is of a frame in work: enough for a preview.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameParts {
    /// Frame number.
    pub frame: u32,
    /// Film and tiles.
    pub grid: Grid,
    /// What the rounds before add up to, where it is not in `groups`: of the whole frame, or of groups of tiles.
    pub sums: Vec<Artefact>,
    /// The tiles of this round that are done and not in `groups`, some in parts, in order of key.
    pub tiles: Vec<Artefact>,
    /// Resolved pixels of the groups that are gathered in this round.
    pub groups: Vec<Artefact>,
}

/// A finished frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameRecord {
    /// Frame number.
    pub frame: u32,
    /// The image as EXR.
    pub image: Artefact,
    /// The image tone-mapped, as PNG.
    pub preview: Option<Artefact>,
    /// Samples a pixel.
    pub spp: u32,
    /// Relative error reached.
    pub relative_error: Option<f64>,
    /// Samples refused.
    pub bad_samples: u64,
    /// Seconds that workers spent on it, summed.
    pub busy_seconds: f64,
    /// Seconds from the first lease to the last merge.
    pub seconds: f64,
}
