//! Reports on jobs, light and benchmarks: as pages, as rows of CSV and Parquet, as JSON, and as text.
//!
//! - [`attempts`]: costs of the attempts at a job's tasks.
//! - [`light`]: files of light statistics, their bottlenecks, and the tables of their paths.
//! - [`mod@bench`]: run time against error.
//! - [`measure`]: readings of light at points, on grids and over surfaces.
//! - [`sweep`]: tables of a sweep's frames and variants.
//! - [`pages`]: HTML files with embedded figures.
//! - [`human`]: numbers and tables for people.
#![deny(missing_docs)]

pub mod attempts;
pub mod bench;
mod error;
pub mod human;
pub mod light;
pub mod measure;
pub mod pages;
pub mod sweep;

pub use error::{ErrorKind, ReportError};
