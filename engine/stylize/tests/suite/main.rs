//! Painted light on made-up images.

mod painted;
mod search;
mod world;
