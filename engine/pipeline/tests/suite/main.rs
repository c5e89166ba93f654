//! The pipeline on small scenes.

mod layers;
mod statistics;
