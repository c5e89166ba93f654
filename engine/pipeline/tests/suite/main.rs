//! Tests of the pipeline on small scenes.

mod dark_layers;
mod decisions;
mod features;
mod horizons;
mod layers;
mod measure;
mod readings;
mod scale;
mod statistics;
mod work;
