//! What has happened for good: the entries of the log.

use std::num::NonZeroU64;

use femc_model::{
    Control, Drain, Epoch, Failure, GatherResult, JobId, JobSpec, LogRecord, MergeResult, TaskKey, Tick, TileResult,
};
use serde::{Deserialize, Serialize};

use crate::Casualty;

/// What an owner has used, and where that puts him.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Used {
    /// Milliseconds of workers that his leases have held.
    pub held: u64,
    /// Place in the order of service: who stands lowest goes first. Grows with the time used, the slower the greater the owner's
    /// weight is at the time, and to that of the others when he comes back after an absence.
    pub stands: u64,
}

/// A change of the [`Ledger`](crate::Ledger). New variants go to the end: the log holds their numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Fact {
    /// A coordinator has begun; leases of the ones before are void.
    Opened {
        /// Greater than any before.
        incarnation: u32,
    },
    /// A job was taken.
    Submitted {
        /// Its number.
        job: JobId,
        /// A second submission with this key is the same job.
        key: Option<String>,
        /// As submitted.
        spec: Box<JobSpec>,
    },
    /// A tile was rendered, or some grains of it.
    Rendered {
        /// Which; the result's samples say how many grains, from the task's own key on.
        task: TaskKey,
        /// Of the lease that did it.
        epoch: Epoch,
        /// When that lease was granted.
        leased: Tick,
        /// What came out.
        result: TileResult,
    },
    /// A round of a frame was merged; it is over, or the frame is finished.
    Merged {
        /// Which.
        task: TaskKey,
        /// Of the lease that did it.
        epoch: Epoch,
        /// What came out.
        result: Box<MergeResult>,
    },
    /// A task used up one attempt.
    Failed {
        /// Which.
        task: TaskKey,
        /// Leases of it that were granted before are over: what comes of them counts no more.
        until: Epoch,
        /// Why.
        failure: Failure,
    },
    /// The artefact of a rendered tile is gone, or one of a gathered group: the tile, or the group's tiles of this round, are
    /// to be rendered again.
    Lost {
        /// The task that had made it.
        task: TaskKey,
    },
    /// The sums of a frame are gone, or the image of a finished one: the frame begins anew.
    Restarted {
        /// The job.
        job: JobId,
        /// Frame number.
        frame: u32,
    },
    /// The job cannot succeed.
    Doomed {
        /// The job.
        job: JobId,
        /// Why.
        failure: Failure,
    },
    /// A person steered the job.
    Controlled {
        /// The job.
        job: JobId,
        /// How.
        control: Control,
    },
    /// An operator let a worker have no more tasks, or tasks again.
    Drained {
        /// The worker's process.
        instance: u64,
        /// Which.
        drain: Drain,
    },
    /// A worker wrote something down during an attempt.
    Logged(Box<LogRecord>),
    /// The tiles of a job are cut; follows its submission. Without this they are not.
    Cut {
        /// The job.
        job: JobId,
        /// Pixel samples of a grain: see [`Grains`](femc_model::Grains).
        samples: NonZeroU64,
    },
    /// The frames of a job are merged as a tree; follows its submission. Without this they are not.
    Grouped {
        /// The job.
        job: JobId,
        /// Tiles of a group.
        tiles: u32,
    },
    /// A group of tiles was gathered.
    Gathered {
        /// Which.
        task: TaskKey,
        /// Of the lease that did it.
        epoch: Epoch,
        /// What came out.
        result: GatherResult,
    },
    /// A job that had ended was forgotten, with its key and its logs.
    Forgotten {
        /// The job.
        job: JobId,
    },
    /// The first result of a frame is about to count: it and all others come from one build of the engine. Until the frame is
    /// finished, or begins anew.
    Built {
        /// The job.
        job: JobId,
        /// Frame number.
        frame: u32,
        /// Which build.
        engine: String,
    },
    /// A worker died while it computed a task.
    Died {
        /// Which.
        task: TaskKey,
        /// End of the lease's run of grains, which begins with the task's key; of a task of another kind, the next key.
        end: u32,
        /// Who, and how one knows.
        casualty: Casualty,
    },
    /// A process of which deaths were presumed has come back.
    Lives {
        /// Which.
        instance: u64,
    },
    /// What owners have used, of those of whom it has changed.
    Used {
        /// By owner.
        owners: Vec<(String, Used)>,
    },
}
