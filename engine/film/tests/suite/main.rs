//! Tests of tiles, frames and files, one module per topic.

mod codec;
mod exr;
mod features;
mod layers;
mod merge;
mod metrics;
mod piece;
mod thumbnail;
