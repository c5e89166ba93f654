//! Light in fog, by point and along lines.

mod integral;
mod line;
#[cfg(test)]
mod tests;
mod tree;

pub use line::{Line, LinePoint};
pub use tree::{FogCell, FogLeaf, FogTree};
