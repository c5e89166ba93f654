//! The pipeline on small scenes.

mod features;
mod layers;
mod statistics;
