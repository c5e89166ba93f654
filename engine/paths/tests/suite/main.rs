//! Tests of the invariants of light statistics, on synthetic paths that are a function of only their keys, like those of a
//! renderer.

mod bytes;
mod causes;
mod frames;
mod laws;
mod plants;
mod questions;
mod reduction;
mod world;
