//! How long the attempts at a job's frames and tasks took.
//!
//! The scheduler knows states, and the notes beside the log know what attempts took. Here both come together, when somebody asks: the
//! ledger does not grow with attempts. A job's notes are read once and then from where the last reading ended.

mod book;
mod job;
mod sum;
#[cfg(test)]
mod tests;

pub use book::Book;
pub use job::JobTimes;
pub use sum::{Span, Sum};
