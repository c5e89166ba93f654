//! The scheduler: who does what next, as a pure state machine.
//!
//! [`Scheduler::on`] takes what happened and the time, and returns what is to be done about it; it reads no clock, sends
//! nothing and writes nothing. Its state has two halves. The [`Ledger`] is durable: it changes by [`Fact`]s alone, and
//! the same facts give the same ledger. The tables (workers, leases, ready tasks) are not: after a restart every lease is
//! void, and what was leased is ready again. A fact comes out as [`Command::Record`] before the commands that tell
//! anybody about it; the caller makes the facts durable first.
//!
//! Waiting tasks are ranges: a frame that nobody has begun costs nothing, one in work costs a row for each finished tile.
#![deny(missing_docs)]

mod affinity;
mod attempts;
mod builds;
mod charge;
mod config;
mod control;
mod deal;
mod deaths;
mod event;
mod fact;
mod figures;
mod intake;
mod lease_table;
mod leases;
mod ledger;
mod logs;
mod meter;
mod open;
mod order;
mod outcome;
mod pace;
mod quarantine;
mod ranges;
mod ready_tasks;
mod retention;
mod roster;
mod scheduler;
mod share;
mod shared;
mod speculate;
mod table;
mod view;

pub use attempts::{decode_attempts, encode_attempts};
pub use config::{Config, Quota};
pub use deaths::{Casualty, Evidence};
pub use event::{Answer, Command, Event, RequestId};
pub use fact::{Fact, Used};
pub use figures::{Figures, WorkerStanding};
pub use ledger::{Ledger, SnapshotError};
pub use ranges::RangeSet;
pub use roster::Roster;
pub use scheduler::Scheduler;
