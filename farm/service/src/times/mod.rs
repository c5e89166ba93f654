//! Durations of the attempts at a job's frames and tasks.
//!
//! The scheduler knows states; the records beside the log know the usage of attempts. This module joins both on request, so that
//! the ledger does not grow with the number of attempts. A job's records are read once, and later only from where the last read
//! ended.

mod cache;
mod job;
mod sum;
#[cfg(test)]
mod tests;

pub use cache::TimesCache;
pub use job::JobTimes;
pub use sum::{Span, Sum};
