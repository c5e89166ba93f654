//! Output of the program: results on stdout; progress, notes and errors on stderr.

pub mod blocks;
mod busy;
pub mod error;
pub mod faults;
pub mod job;
pub mod json;
mod progress;
mod say;
mod terminal;

pub use busy::Busy;
pub use femc_reports::human;
pub use progress::{Progress, Snapshot, Stage};
pub use say::Say;
