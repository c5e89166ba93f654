//! The painter and what it has painted.

mod styles;
