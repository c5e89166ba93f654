//! Statistics that merge to the same bits in any order, and the statistical tests of the test suites.
//!
//! [`exact`] holds sums whose value depends only on the set of the terms, not on their order or grouping, so a farm of any size
//! adds up to the same picture. `testing` (feature `testing`) holds chi-square and z tests for samplers and estimators.
#![deny(missing_docs)]

pub mod exact;
#[cfg(feature = "testing")]
pub mod testing;

pub use exact::{ExactSum, TermError};
