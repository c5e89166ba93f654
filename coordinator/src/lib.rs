//! Coordinator of the farm: a shell around the scheduler.
//!
//! One tokio task owns the scheduler and the log. It takes all messages that have arrived, passes them to the scheduler, makes the
//! resulting facts durable together, and only then executes the commands. So nothing is acknowledged that a crash could undo. If
//! there is no space for the log, the coordinator waits. If the log cannot be written at all, it stops, because its state is ahead
//! of the durable state. If there are several coordinators, it becomes a standby instead, and restarts from the log when it leads
//! again. Artifacts bypass the actor and go straight to the store.
#![deny(missing_docs)]

mod actor;
mod announce;
mod any_queue;
mod attempts;
mod clock;
mod config;
mod disks;
mod error_targets;
mod execute;
mod full_log;
mod janitor;
mod leadership;
mod metrics;
mod queries;
mod roster;
mod session;
mod start;
mod worker_events;

pub use announce::{KeyError, NotifyConfig, NotifyKey, PrefixError, UrlPrefix};
pub use clock::TimeSource;
pub use config::{ArtifactStorage, Config, CoordinatorError, Exposure, LogStorage};
pub use femc_proto::{
    AccessControl, LightFault, LightFile, LightSource, Limits, LoginTokens, MAX_LIGHT_BYTES, PageFiles, Site,
};
pub use femc_queue::{Database, LossPolicy, Postgres, QueueError};
pub use leadership::Leadership;
pub use metrics::Metrics;
pub use roster::ROSTER_SUBJECT;
pub use start::{Coordinator, Handle};
