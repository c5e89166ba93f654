//! A farm machine: joins a coordinator, renders tiles, merges frames.
//!
//! Talking is asynchronous; work is not. Two threads take tasks, one renders and one merges, and both compute on the
//! worker's own rayon pool; a third prepares the frames of tasks that were fetched ahead. Results go up while the next
//! task runs. When the session breaks, what runs is cancelled: the coordinator has given it to others.
#![deny(missing_docs)]

mod cache;
mod clock;
mod config;
mod execute;
mod fetch;
mod gather;
mod parcel;
mod pieces;
mod session;
mod simulated;
mod sums;
mod table;
mod threads;
mod worker;

pub use cache::Cache;
pub use config::{AtStop, Config, Hands, Pace, WorkerError};
pub use parcel::{Parcel, ParcelError};
pub use pieces::Pieces;
pub use worker::Worker;
