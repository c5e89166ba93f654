//! The scheduler: decides which worker does which task, as a pure state machine.
//!
//! [`Scheduler::handle`] takes an event and the time, and returns the commands that follow. It reads no clock, sends nothing and
//! writes nothing. Its state has two halves. The [`Ledger`] is durable: only [`Fact`]s change it, and the same facts give the same
//! ledger. The tables (workers, leases, ready tasks) are volatile: after a restart every lease is void, and the leased tasks are
//! ready again. A fact is returned as [`Command::Record`] before the commands that report it to anyone; the caller makes the facts
//! durable first.
//!
//! Waiting tasks are stored as ranges: a frame without results costs nothing, and a frame in progress costs one row per finished
//! tile.
#![deny(missing_docs)]

mod affinity;
mod attempts;
mod builds;
mod charge;
mod config;
mod control;
mod deaths;
mod dispatch;
mod event;
mod fact;
mod intake;
mod lease_size;
mod lease_table;
mod leases;
mod ledger;
mod logs;
mod meter;
mod open_frames;
mod order;
mod outcome;
mod pace;
mod quarantine;
mod queries;
mod ranges;
mod ready_tasks;
mod retention;
mod roster;
mod scheduler;
mod shared;
mod speculate;
mod stats;
mod task_table;

pub use attempts::{decode_attempts, encode_attempts};
pub use config::{Config, Quota};
pub use deaths::{DeathEvidence, WorkerDeath};
pub use event::{Answer, Command, Event, RequestId};
pub use fact::{Fact, UsedTime};
pub use ledger::{Ledger, SnapshotError};
pub use ranges::RangeSet;
pub use roster::Roster;
pub use scheduler::Scheduler;
pub use stats::{FarmStats, WorkerStanding};
