//! A farm machine: joins a coordinator, renders tiles, puts frames together.
//!
//! Talking is asynchronous; work is not. Two lanes take tasks, one renders and one joins what is there; a thread prepares the frames of
//! tasks that were fetched ahead. Each of these three prepares scenes and frames on a rayon pool of its own. Rendering has one more pool.
//! All have as many threads, and rayon's global pool is never started. Results go up while the next
//! task runs. When the session breaks, what runs goes on, and what is done is kept: the next session brings both along.
#![deny(missing_docs)]

mod availability;
mod bundle;
mod cache;
mod claims;
pub mod clip;
mod clock;
mod config;
mod execute;
mod fetch;
mod finish;
mod journal;
mod log;
mod memory;
mod meter;
mod metrics;
mod nice;
mod outbox;
mod parcel;
mod pieces;
mod plan;
mod session;
mod simulated;
mod sums;
mod table;
#[cfg(feature = "testing")]
pub mod testing;
mod threads;
mod upload;
mod worker;

pub use availability::{Availability, Shift};
pub use cache::Cache;
pub use config::{AtStop, Config, Fate, Hands, IfTaken, OutboxConfig, OutboxPlace, Pace, WorkerError};
pub use execute::{Painting, Video, Wish, drill_key};
pub use journal::Journal;
pub use log::{TASK_LOG_LEVEL, TaskLogs};
pub use memory::MemoryLimit;
pub use meter::process_time;
pub use metrics::Metrics;
pub use outbox::MemoryOutbox;
pub use parcel::{Parcel, ParcelError};
pub use pieces::Pieces;
pub use plan::{FEATURES, FIRST_PASS, FIRST_PASS_BLOCKS, LAYERS, PAINTING, STATISTICS, graph};
pub use sums::decode as decode_sums;
pub use worker::Worker;

/// The build of the engine that this program's workers render with.
pub fn engine() -> &'static str {
    femc_fault::pretended(femc_fault::Pretense::Engine).unwrap_or(femc_pipeline::BUILD)
}
