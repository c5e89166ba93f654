//! The farm in a simulated world: the real coordinator and worker code over a simulated network and clock, with faults.
//!
//! One number, the seed, decides everything: latencies, who comes and what they want, which faults come and when, how long tasks
//! take and what becomes of them. As it runs, what is written, told, given out and removed is held against what must be true of it
//! at that moment, and in the end the log and the frames are ([`Violation`]). A seed that fails fails again.
//!
//! That the audit would see it is shown by planted bugs, one at a time: `sim/plants/run` gives the seed that finds each.
//!
//! Simulated are the network (turmoil), the clock, the disk under the log and the time that a task takes. Real
//! are the scheduler, the coordinator's shell, the wire, the sessions, the rendering and the reducing of real frames.
#![deny(missing_docs)]

mod audit;
mod cast;
mod chronicle;
mod contents;
mod disk;
mod drill;
mod faults;
mod hosts;
mod leases;
mod network;
mod paces;
mod people;
mod promises;
mod queues;
mod shared;
mod shares;
mod shelf;
mod soak;
mod stage;
mod switch;
mod tasks;
mod weather;
mod world;

pub use audit::Violation;
pub use faults::{Fault, Harm, Planned};
pub use soak::{Gauge, Soak, Soaked};
pub use world::{Outcome, Tells, run};
