//! The farm's server: a shell around the scheduler.
//!
//! One task owns the scheduler and the log. It takes what has come in since the last time, lets the scheduler say what follows,
//! makes the facts durable in one go, and only then executes the commands: nobody hears of what a crash could undo. If there is
//! no room for the log it waits until there is. If the log cannot be written at all the coordinator stops, because what it knows
//! is ahead of what is durable; one of several stands by instead, and begins anew from the log when it leads again. Artifacts go
//! past it, straight into the store.
#![deny(missing_docs)]

mod actor;
mod announce;
mod any_queue;
mod attempts;
mod clock;
mod config;
mod disks;
mod execute;
mod janitor;
mod lead;
mod metrics;
mod session;
mod start;
mod target;
mod wait;

pub use actor::ROSTER;
pub use announce::{Announce, KeyError, NotifyKey, PrefixError, UrlPrefix};
pub use clock::Time;
pub use config::{Artifacts, Config, CoordinatorError, Exposure, Log};
pub use femc_proto::{Entrance, Files, Limits, Site};
pub use femc_queue::{Database, Loss, Postgres, QueueError};
pub use lead::Standing;
pub use metrics::Metrics;
pub use start::{Coordinator, Handle};
