//! Scenes: the format-independent description, its selectors, animation and faults.
//!
//! An importer fills a [`Scene`]; nothing in it depends on the file format. Lengths are metres, angles degrees where a
//! field says so and radians elsewhere, times seconds; everything is f64 until a frame is prepared.
#![deny(missing_docs)]

pub mod description;

pub use description::*;
