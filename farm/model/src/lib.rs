//! Shared vocabulary of the farm: ids, jobs, tasks, results, failures, refusals, session messages and status queries.
//!
//! The crate holds values only: no clock, no network, no engine types. The scheduler, the wire, the coordinator, the worker and the
//! command line share it. The wire has its own generated types and converts.
#![deny(missing_docs)]

mod digest;
mod failure;
mod grains;
mod graph;
mod grid;
mod id;
mod job;
mod kind;
mod latest;
mod log;
mod manifest;
mod notes;
mod owner_usage;
mod refusal;
mod result;
mod session;
mod since;
mod status;
mod table;
mod task;
pub mod testing;
mod usage;

pub use digest::{Digest, ParseDigestError};
pub use failure::{Failure, Verdict};
pub use grains::{Cut, Grains, Taken, Uneven};
pub use graph::{Graph, GraphError, Hint, Loop, Need, Reach, Round, Scope, Sizes, Template};
pub use grid::{Grid, TileRect};
pub use id::{Epoch, JobId, NoJobId, Tick, WorkerId};
pub use job::{Control, JobSpec, JobState, SpecError};
pub use kind::{KindRow, Lane, LogPlace, Near, Role, RoleRow, StageKind};
pub use latest::Latest;
pub use log::{Attempt, LogRecord, LogText, TaskLog};
pub use manifest::{Extent, Manifest, ManifestError, Piece};
pub use notes::{JobNotes, NotesError};
pub use owner_usage::{Month, NoMonth, OwnerUsage, UsageSums};
pub use refusal::Refusal;
pub use result::{Artifact, Blocks, Decision, FrameParts, FrameRecord, TaskResult};
pub use session::{
    Death, FromWorker, HeldLease, LeaseLeft, Phase, Registration, RevokeReason, TaskProgress, TaskUsage, ToWorker,
};
pub use since::{reading_version, since_version_9, since_version_10, since_version_11};
pub use status::{
    Crew, Drain, FrameProgress, FrameStop, Intake, JobStatus, OfflineWorker, Quarantined, Wait, WorkerName,
    WorkerStatus, WorstFrame,
};
pub use table::{FrameStatus, TaskFilter, TaskPage, TaskState, TaskStatus};
pub use task::{Assignment, Input, More, NoTaskKey, Output, Stage, TaskKey, Work};
pub use usage::{AttemptRecord, Attempts, Ending, Times, Usage};
