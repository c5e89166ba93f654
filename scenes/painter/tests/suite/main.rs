//! The painter and what it has painted.

mod sight;
mod styles;
