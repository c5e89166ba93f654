//! Tests of the pipeline on small scenes.

mod dark_layers;
mod features;
mod layers;
mod statistics;
