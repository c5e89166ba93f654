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
    /// Number within the stage: of a render stage, the first of the task's [`Grains`](crate::Grains).
    pub index: u32,
}

impl fmt::Display for TaskKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Stage { frame, round, kind } = self.stage;
        let kind = match kind {
            StageKind::Render => "render",
            StageKind::Merge => "merge",
        };
        write!(f, "{}/{frame}.{round}/{kind}/{}", self.job, self.index)
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
    /// Union the tiles, and what was merged before them.
    Merge {
        /// Sums of the rounds before, if any.
        previous: Option<Artefact>,
        /// The tiles of this round, some in parts, in order of key: together each sample of each tile once.
        tiles: Vec<Artefact>,
        /// Samples a pixel that the sums hold after this merge.
        spp: u32,
        /// Milliseconds since the frame's first lease: for a time budget.
        elapsed: u64,
        /// Seconds that workers spent on the frame's tiles until now.
        busy_seconds: f64,
        /// Whether another round may follow.
        more: More,
    },
}

/// Whether the plan has a round after this one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum More {
    /// The merge may ask for another round.
    Rounds,
    /// This is the last: finish the frame with what there is.
    Last,
}
