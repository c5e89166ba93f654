//! Traversal kernels, written once over a vector type and compiled for each instruction set.
//!
//! [`femc_simd`] provides the vectors. [`walk`] contains the traversal of a tree, [`stack`] the nodes that are still to visit,
//! [`leaf`] the tests of the leaves' contents. All instruction sets perform the same IEEE operations in the same order (no fused
//! multiply-add), so they give the same bits.

mod leaf;
mod probe;
mod stack;
mod walk;

pub(crate) use femc_simd::{Level, Simd, Task};
pub(crate) use leaf::{Best, blas_closest, blas_occluded};
pub(crate) use probe::Probe;
pub(crate) use walk::{AnyLeaf, NearestLeaf, any, nearest_first};
