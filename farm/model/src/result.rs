//! Results of tasks.

use serde::{Deserialize, Serialize};

use crate::{AttemptTimes, Digest, Grid, Output, Role};

/// Reference to bytes in the artifact store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Artifact {
    /// BLAKE3 digest of the bytes.
    pub digest: Digest,
    /// Size in bytes.
    pub bytes: u64,
}

impl Artifact {
    /// Returns the reference to `bytes`.
    pub fn from_bytes(bytes: &[u8]) -> Self {
        Self { digest: Digest::compute(bytes), bytes: bytes.len() as u64 }
    }
}

/// Decision of the task that closes a loop. It depends only on the task's inputs and the job's settings.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Decision {
    /// Run another round, as planned.
    Continue,
    /// Run another round. At its end, each task of the loop's divided stage has taken this many steps in total.
    Steps(Vec<u32>),
    /// The loop is over.
    Done,
}

/// Blocks of pixels of a measured frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct BlockCounts {
    /// Number of all blocks.
    pub all: u32,
    /// Number of blocks in which no sample found light. They are excluded from the relative error.
    pub unlit: u32,
}

impl BlockCounts {
    /// Returns whether no sample of the frame found light.
    pub fn is_dark(self) -> bool {
        self.all > 0 && self.unlit == self.all
    }
}

/// Result of a task.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TaskResult {
    /// Outputs of the task, each role once.
    pub outputs: Vec<Output>,
    /// Units of work done, if the task is divided into chunks: pixel samples taken.
    pub units: u64,
    /// Number of samples refused because they were NaN, infinite or negative.
    pub bad_samples: u64,
    /// Measured relative error, if the task measures it. `None` also if no sample found light.
    pub relative_error: Option<f64>,
    /// Blocks that the task measured.
    #[serde(default, deserialize_with = "crate::since_version_9")]
    pub blocks: Option<BlockCounts>,
    /// Decision, if the task closes a loop.
    pub decision: Option<Decision>,
    /// Seconds that the worker spent on the task.
    pub seconds: f64,
}

impl TaskResult {
    /// Maximum number of outputs: one of each role.
    pub const MAX_OUTPUTS: usize = Role::ALL.len();

    /// Returns every artifact that the result names.
    pub fn artifacts(&self) -> impl Iterator<Item = Artifact> + '_ {
        self.outputs.iter().map(|output| output.artifact)
    }

    /// Returns the output of this role.
    pub fn output(&self, role: Role) -> Option<Artifact> {
        find_output(&self.outputs, role)
    }
}

fn find_output(outputs: &[Output], role: Role) -> Option<Artifact> {
    outputs.iter().find(|output| output.role == role).map(|output| output.artifact)
}

/// Available outputs of an unfinished frame: enough for a preview.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameParts {
    /// Frame number.
    pub frame: u32,
    /// Film and tiles.
    pub grid: Grid,
    /// Available outputs that are not yet combined with others, so that each sample occurs once. Ordered by round, stage and task.
    pub outputs: Vec<Output>,
}

/// A finished frame, or finished results of the job itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameRecord {
    /// Frame number, or [`Stage::JOB_FRAME`](crate::Stage::JOB_FRAME) for the job's own results.
    pub frame: u32,
    /// Results of the frame.
    pub outputs: Vec<Output>,
    /// Average samples per pixel.
    pub spp: u32,
    /// Relative error reached. `None` also if no sample found light.
    pub relative_error: Option<f64>,
    /// Blocks of the frame, if it was measured.
    #[serde(default, deserialize_with = "crate::since_version_9")]
    pub blocks: Option<BlockCounts>,
    /// Number of samples refused.
    pub bad_samples: u64,
    /// Seconds that workers spent on the results that count, summed.
    pub busy_seconds: f64,
    /// Seconds from the first lease to the last result. This includes time in which workers ran other tasks and other jobs.
    pub seconds: f64,
    /// Number of rounds; `None`: not known, as for frames finished before version 11 of the log.
    #[serde(default, deserialize_with = "crate::since_version_11")]
    pub rounds: Option<u32>,
    /// Time of the frame's attempts; `None`: not looked up. The log does not hold it.
    #[serde(skip)]
    pub times: Option<AttemptTimes>,
}

impl FrameRecord {
    /// Returns the result of this role.
    pub fn output(&self, role: Role) -> Option<Artifact> {
        find_output(&self.outputs, role)
    }

    /// Returns the image as EXR.
    pub fn image(&self) -> Option<Artifact> {
        self.output(Role::Image)
    }

    /// Returns the light statistics, if the job makes them.
    pub fn statistics(&self) -> Option<Artifact> {
        self.output(Role::Statistics)
    }

    /// Returns the layers as EXR, if the job makes them.
    pub fn layers(&self) -> Option<Artifact> {
        self.output(Role::LayerImage)
    }

    /// Returns the readings of light as JSON, if the job measures.
    pub fn readings(&self) -> Option<Artifact> {
        self.output(Role::Readings)
    }

    /// Returns the tone-mapped image as PNG.
    pub fn preview(&self) -> Option<Artifact> {
        self.output(Role::Preview)
    }
}
