//! What tasks bring home.

use serde::{Deserialize, Serialize};

use crate::{Digest, Grid, Output, Role, Times};

/// Bytes in the artifact store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Artifact {
    /// BLAKE3 of the bytes.
    pub digest: Digest,
    /// Size in bytes.
    pub bytes: u64,
}

impl Artifact {
    /// The name of `bytes`.
    pub fn of(bytes: &[u8]) -> Self {
        Self { digest: Digest::of(bytes), bytes: bytes.len() as u64 }
    }
}

/// What the task that closes a loop decides; nothing but its inputs and the job's settings go into it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Decision {
    /// Another round, as planned.
    Continue,
    /// Another round, at the end of which each task of the loop's stage that is cut has taken so many steps in all.
    Steps(Vec<u32>),
    /// The loop is over.
    Done,
}

/// Blocks of pixels of a measured frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Blocks {
    /// All blocks.
    pub all: u32,
    /// Blocks in which no sample met light: they have no part in the relative error.
    pub unlit: u32,
}

impl Blocks {
    /// Whether no sample of the frame met light.
    pub fn is_dark(self) -> bool {
        self.all > 0 && self.unlit == self.all
    }
}

/// Result of a task.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TaskResult {
    /// What it has made, each role once.
    pub outputs: Vec<Output>,
    /// Units of work done, of a task that is cut: pixel samples taken.
    pub units: u64,
    /// Samples refused because they were NaN, infinite or negative.
    pub bad_samples: u64,
    /// Relative error that it has measured, if it measures; `None` also where no sample has met light.
    pub relative_error: Option<f64>,
    /// Blocks that it has measured.
    #[serde(default, deserialize_with = "crate::since_version_9")]
    pub blocks: Option<Blocks>,
    /// Of a task that closes a loop.
    pub decision: Option<Decision>,
    /// Seconds that the worker spent on it.
    pub seconds: f64,
}

impl TaskResult {
    /// Most outputs: one of each role.
    pub const MAX_OUTPUTS: usize = Role::ALL.len();

    /// Every artifact that it names.
    pub fn artifacts(&self) -> impl Iterator<Item = Artifact> + '_ {
        self.outputs.iter().map(|output| output.artifact)
    }

    /// Its output of this role.
    pub fn output(&self, role: Role) -> Option<Artifact> {
        find(&self.outputs, role)
    }
}

fn find(outputs: &[Output], role: Role) -> Option<Artifact> {
    outputs.iter().find(|output| output.role == role).map(|output| output.artifact)
}

/// What there is of a frame in work: enough for a preview.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameParts {
    /// Frame number.
    pub frame: u32,
    /// Film and tiles.
    pub grid: Grid,
    /// What is there and not united with others, each sample once: in order of round, stage and task.
    pub outputs: Vec<Output>,
}

/// A finished frame, or what is finished of the job as a whole.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameRecord {
    /// Frame number; [`Stage::OF_JOB`](crate::Stage::OF_JOB) of the job's own.
    pub frame: u32,
    /// Its results.
    pub outputs: Vec<Output>,
    /// Samples a pixel, on the average.
    pub spp: u32,
    /// Relative error reached; `None` also where no sample has met light.
    pub relative_error: Option<f64>,
    /// Blocks of the frame, where it was measured.
    #[serde(default, deserialize_with = "crate::since_version_9")]
    pub blocks: Option<Blocks>,
    /// Samples refused.
    pub bad_samples: u64,
    /// Seconds that workers spent on the results that count, summed.
    pub busy_seconds: f64,
    /// Seconds from the first lease to the last result, also those in which workers did other tasks and other jobs.
    pub seconds: f64,
    /// Rounds that it took; `None`: not known, as of frames that were finished before version 11 of the log.
    #[serde(default, deserialize_with = "crate::since_version_11")]
    pub rounds: Option<u32>,
    /// Time of its attempts; `None`: not looked up. The log does not hold it.
    #[serde(skip)]
    pub times: Option<Times>,
}

impl FrameRecord {
    /// Its result of this role.
    pub fn output(&self, role: Role) -> Option<Artifact> {
        find(&self.outputs, role)
    }

    /// The image as EXR.
    pub fn image(&self) -> Option<Artifact> {
        self.output(Role::Image)
    }

    /// The light statistics, where the job has some.
    pub fn statistics(&self) -> Option<Artifact> {
        self.output(Role::Statistics)
    }

    /// The layers as EXR, where the job has some.
    pub fn layers(&self) -> Option<Artifact> {
        self.output(Role::LayerImage)
    }

    /// The image tone-mapped, as PNG.
    pub fn preview(&self) -> Option<Artifact> {
        self.output(Role::Preview)
    }
}
