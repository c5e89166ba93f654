//! Light in fog, by point and along lines.

mod integral;
mod line;
#[cfg(test)]
mod tests;
mod tree;

pub use line::{FogLine, FogLinePoint};
pub use tree::{FogCell, FogLeaf, FogTree};
