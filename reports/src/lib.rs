//! What is told of jobs, of light and of measurements: as pages, as rows of CSV and Parquet, as JSON, and in words.
//!
//! - [`attempts`]: what the attempts at a job's tasks took.
//! - [`light`]: files of light statistics, what stands out in them, and the tables of their paths.
//! - [`mod@bench`]: run time against error.
//! - [`sweep`]: the tables of a sweep's frames and variants.
//! - [`pages`]: HTML files with their figures inside.
//! - [`human`]: numbers and tables for people.
#![deny(missing_docs)]

pub mod attempts;
pub mod bench;
mod error;
pub mod human;
pub mod light;
pub mod pages;
pub mod sweep;

pub use error::{Blame, ReportError};
