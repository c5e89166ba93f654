//! Statistics that merge to the same bits in any order, and the statistical tests of the test suites.
//!
//! [`exact`] holds sums whose value depends on the set of the terms alone, not on their order or grouping: a farm of any
//! size adds up one picture. `testing` (feature `testing`) holds chi-square and z tests for samplers and estimators.
#![deny(missing_docs)]

pub mod exact;
#[cfg(feature = "testing")]
pub mod testing;

pub use exact::{ExactSum, Refused};
