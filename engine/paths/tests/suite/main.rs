//! Laws of light statistics, on made-up paths that are a function of their keys alone, as those of a renderer are.

mod bytes;
mod causes;
mod frames;
mod laws;
mod plants;
mod questions;
mod reduction;
mod world;
