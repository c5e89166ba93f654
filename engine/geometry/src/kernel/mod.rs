//! Traversal kernels, written once over a vector type and compiled for each instruction set.
//!
//! [`femc_simd`] provides the vectors. [`traversal`] contains the traversal of a tree, [`stack`] the nodes that are still to visit,
//! [`leaf`] the tests of the leaves' contents. All instruction sets perform the same IEEE operations in the same order (no fused
//! multiply-add), so they give the same bits.

mod leaf;
mod local_ray;
mod stack;
mod traversal;

pub(crate) use femc_simd::{Kernel, Level, Simd};
pub(crate) use leaf::{ClosestHit, blas_closest, blas_occluded};
pub(crate) use local_ray::{LocalRay, LocalRays};
pub(crate) use traversal::{AnyLeaf, NearestLeaf, traverse_any, traverse_nearest_first};
