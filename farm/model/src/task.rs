//! The units of work and what a worker is told about one.

use std::fmt;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::{Artefact, Epoch, JobId};

/// What the tasks of a stage do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum StageKind {
    /// Render one tile for one range of samples.
    Render,
    /// Union all tiles of a frame's round, measure, decide, write the image.
    Merge,
    /// Union the tiles of one group: what the merge of a large frame reads instead of its tiles.
    Gather,
}

impl StageKind {
    /// All, in the order in which a frame needs them.
    pub const ALL: [Self; 3] = [Self::Render, Self::Gather, Self::Merge];

    /// In one word.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Render => "render",
            Self::Merge => "merge",
            Self::Gather => "gather",
        }
    }
}

/// An array of tasks that may run side by side: one round of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Stage {
    /// Frame number.
    pub frame: u32,
    /// Sample round of the frame, from 0.
    pub round: u32,
    /// What its tasks do.
    pub kind: StageKind,
}

/// A task's identity; there is no other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct TaskKey {
    /// The job.
    pub job: JobId,
    /// The stage of the job.
    pub stage: Stage,
    /// Number within the stage: of a render stage, the first of the task's [`Grains`](crate::Grains); of a gather stage, the
    /// group's.
    pub index: u32,
}

impl fmt::Display for TaskKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Stage { frame, round, kind } = self.stage;
        write!(f, "{}/{frame}.{round}/{}/{}", self.job, kind.name(), self.index)
    }
}

/// One lease of one task, as the worker gets it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Assignment {
    /// The task.
    pub task: TaskKey,
    /// The fence: every message about this lease carries it.
    pub epoch: Epoch,
    /// Milliseconds after which the lease ends, unless a heartbeat renews it.
    pub lease: u64,
    /// The lease of another worker that does the same, where this is its copy: the first that is done counts.
    pub copy_of: Option<Epoch>,
    /// What to do.
    pub work: Work,
}

/// The content of a task.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Work {
    /// Render these samples of each pixel of a tile.
    Render {
        /// Number of the tile in the grid.
        tile: u32,
        /// Sample indices.
        samples: Range<u32>,
    },
    /// Union all that there is of the frame, measure, decide.
    Merge {
        /// What there is of it.
        inputs: MergeInputs,
        /// Samples a pixel that the sums hold after this merge.
        spp: u32,
        /// Milliseconds since the frame's first lease: for a time budget.
        elapsed: u64,
        /// Seconds that workers spent on the frame's tiles until now.
        busy_seconds: f64,
        /// Whether another round may follow.
        more: More,
    },
    /// Union the tiles of a group, and what was gathered of them before.
    Gather {
        /// Their numbers in the grid.
        span: Range<u32>,
        /// What there is of them.
        parts: Parts,
        /// Whether another round may follow: only then are the sums kept.
        more: More,
    },
}

/// The tiles of a task that unites some.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Parts {
    /// Sums of the rounds before, if any.
    pub previous: Option<Artefact>,
    /// The tiles of this round in the order of their index.
    pub tiles: Vec<Artefact>,
}

/// What a merge is made of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum MergeInputs {
    /// All tiles of the frame.
    Tiles(Parts),
    /// The resolved pixels of every group of tiles, in the order of their index.
    Groups(Vec<Artefact>),
}

impl Work {
    /// Every artefact that is read for it, beside the scene.
    pub fn inputs(&self) -> impl Iterator<Item = Artefact> + '_ {
        let (parts, groups) = match self {
            Self::Render { .. } => (None, &[][..]),
            Self::Gather { parts, .. } | Self::Merge { inputs: MergeInputs::Tiles(parts), .. } => {
                (Some(parts), &[][..])
            }
            Self::Merge { inputs: MergeInputs::Groups(groups), .. } => (None, &groups[..]),
        };
        let parts = parts.into_iter().flat_map(|parts| parts.previous.iter().chain(&parts.tiles));
        parts.chain(groups).copied()
    }
}

/// Whether the plan has a round after this one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum More {
    /// The merge may ask for another round.
    Rounds,
    /// This is the last: the frame is finished with what there is.
    Last,
}
