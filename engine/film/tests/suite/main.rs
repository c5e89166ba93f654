//! Tiles, frames and files, a module a topic.

mod codec;
mod exr;
mod features;
mod layers;
mod merge;
mod metrics;
mod piece;
mod thumbnail;
