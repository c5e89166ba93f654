//! Simulation of the farm: the real coordinator and worker code runs over a simulated network and clock, with faults.
//!
//! The seed, one number, decides everything: latencies, people and their jobs, faults and their times, durations and fates of
//! tasks. While a world runs, each record, message, lease and removal is checked against what must be true at that moment. At the
//! end, the log and the frames are checked ([`Violation`]). A failing seed fails every time.
//!
//! Planted bugs, one at a time, show that the audit detects errors: `sim/plants/run` prints the seed that finds each.
//!
//! Simulated parts are the network (turmoil), the clock, the disk under the log and the duration of tasks. Real parts are the
//! scheduler, the coordinator's shell, the wire protocol, the sessions, and the rendering and reducing of real frames.
#![deny(missing_docs)]

mod audit;
mod charges;
mod disk;
mod drill;
mod fault_injector;
mod faults;
mod faulty_medium;
mod history;
mod hosts;
mod leases;
mod network;
mod people;
mod queues;
mod requests;
mod shared;
mod shared_stages;
mod soak;
mod switch;
mod task_durations;
mod tasks;
mod test_jobs;
mod workload;
mod world;

pub use audit::Violation;
pub use faults::{Damage, Fault, FaultPlan};
pub use soak::{Measurement, Soak, SoakReport};
pub use world::{Outcome, RunDetail, run_world};
