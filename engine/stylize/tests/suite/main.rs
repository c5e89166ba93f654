//! Tests of painted light on synthetic images.

mod painted;
mod search;
mod world;
