//! Reports as pages: one HTML file each, with its figures inside, which asks nobody for anything.

pub mod bench;
mod cost;
mod durations;
mod errors;
mod figure;
mod heat;
mod jobs;
pub mod light;
mod logarithmic;
mod page;
mod timeline;
mod variants;

pub use jobs::Report;
