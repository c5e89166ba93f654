//! Shared vocabulary of the farm: ids, jobs, tasks, results, failures, refusals, session messages and status queries.
//!
//! The crate holds values only: no clock, no network, no engine types. The scheduler, the wire, the coordinator, the worker and the
//! command line share it. The wire has its own generated types and converts.
#![deny(missing_docs)]

mod bounded_map;
mod chunks;
mod digest;
mod failure;
mod graph;
mod grid;
mod id;
mod job;
mod log;
mod log_version;
mod manifest;
mod notes;
mod owner_usage;
mod refusal;
mod result;
mod session;
mod status;
mod table;
mod task;
pub mod testing;
mod usage;

pub use bounded_map::BoundedMap;
pub use chunks::{ChunkSize, Chunks, StepsTaken, UnevenSteps};
pub use digest::{Digest, ParseDigestError};
pub use failure::{Failure, FailureVerdict};
pub use femc_graph::{
    Affinity, Graph, Hint, Lane, LogDestination, Loop, Need, Reach, Role, RoleProperties, Round, Scope, StageKind,
    StageKindProperties, StageTemplate, TaskSizes,
};
pub use graph::{GraphError, check_graph, check_graph_frames, encode_graph, max_graph_inputs};
pub use grid::{Grid, TileRect};
pub use id::{Epoch, JobId, ParseJobIdError, Tick, WorkerId};
pub use job::{Control, JobSpec, JobState, SpecError};
pub use log::{AttemptOutcome, LogRecord, LogText, TaskLog};
pub use log_version::{since_version_9, since_version_10, since_version_11, with_log_version};
pub use manifest::{BundlePiece, FileExtent, Manifest, ManifestError};
pub use notes::{JobNotes, NotesError};
pub use owner_usage::{Month, OwnerUsage, ParseMonthError, UsageSums};
pub use refusal::Refusal;
pub use result::{Artifact, BlockCounts, Decision, FrameParts, FrameRecord, TaskResult};
pub use session::{
    Death, FromWorker, HeldLease, LeaseStatus, Phase, Registration, RevokeReason, TaskProgress, TaskUsage, ToWorker,
};
pub use status::{
    Drain, FrameProgress, FrameStop, Intake, JobStatus, OfflineWorker, QuarantinedTask, WaitReason, WorkerList,
    WorkerSelector, WorkerStatus, WorstFrame,
};
pub use table::{FrameStatus, TaskFilter, TaskPage, TaskState, TaskStatus};
pub use task::{Assignment, Input, NextRound, Output, ParseTaskKeyError, Stage, TaskKey, TaskSpec};
pub use usage::{AttemptRecord, AttemptTimes, Attempts, LeaseEnding, ResourceUsage};
