//! Reports as pages: one HTML file each, with embedded figures and without external resources.

pub mod bench;
mod cost;
mod durations;
mod errors;
mod figure;
mod isolines;
mod jobs;
pub mod light;
mod logarithmic;
pub mod measure;
mod page;
mod sample_maps;
mod timeline;
mod variants;

pub use jobs::JobsReport;
