//! A farm machine: connects to a coordinator, renders tiles and assembles frames.
//!
//! Communication is asynchronous; computation is not. Two lanes execute tasks: one renders, one combines existing outputs. A third
//! thread prepares the frames of tasks that arrived early. Each of these three threads prepares scenes and frames on a rayon pool
//! of its own. Rendering has one more pool. All pools have the same number of threads, and rayon's global pool is never started.
//! Results are uploaded while the next task runs. When the session breaks, running tasks continue and finished results are kept.
//! The next session reports both.
#![deny(missing_docs)]

mod availability;
mod bundle;
mod cache;
mod claims;
pub mod clip;
mod clock;
mod config;
mod execute;
mod extra_outputs;
mod fetch;
mod journal;
mod log;
mod memory;
mod meter;
mod metrics;
mod niceness;
mod outbox;
mod outcome;
mod parcel;
mod piece_cache;
mod session;
mod simulated;
mod task_table;
#[cfg(feature = "testing")]
pub mod testing;
mod threads;
mod upload;
mod worker;

pub use availability::{Availability, WorkingHours};
pub use cache::Cache;
pub use config::{
    Config, Executor, OutboxConfig, OutboxConflict, OutboxStorage, SimulatedOutcome, StopBehavior, TaskSimulation,
    WorkerError,
};
pub use execute::drill_key;
pub use extra_outputs::{ExtraOutputs, Painting, Video};
pub use journal::Journal;
pub use log::{TASK_LOG_LEVEL, TaskLogs};
pub use memory::MemoryLimit;
pub use meter::process_time;
pub use metrics::Metrics;
pub use outbox::MemoryOutbox;
pub use parcel::{Parcel, ParcelError};
pub use piece_cache::PieceCache;
pub use worker::Worker;

/// Returns the build of the engine that this program's workers render with.
pub fn engine() -> &'static str {
    femc_fault::pretended_value(femc_fault::PretendedValue::Engine).unwrap_or(femc_pipeline::BUILD)
}
