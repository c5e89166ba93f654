//! Output of the program: results on stdout; progress, notes and errors on stderr.

mod busy;
pub mod decisions;
pub mod error;
pub mod faults;
pub mod half_blocks;
pub mod job;
pub mod json;
mod printer;
mod progress;
mod terminal;

pub use busy::BusyIndicator;
pub use femc_reports::human;
pub use printer::Printer;
pub use progress::{Progress, ProgressSnapshot, ProgressTarget};
