//! The traversal kernels, written once over a vector type and compiled for each instruction set.
//!
//! [`simd`] holds the vector types and the choice between them; [`walk`] the traversal of a tree; [`leaf`] the tests of what is in its
//! leaves. All instruction sets do the same IEEE operations in the same order (no fused multiply-add), so they give the same bits.

mod leaf;
mod probe;
mod simd;
mod walk;

pub(crate) use leaf::{Best, blas_closest, blas_occluded};
pub(crate) use probe::Probe;
pub(crate) use simd::{Level, Simd, Task};
pub(crate) use walk::{AnyLeaf, NearestLeaf, any, nearest_first};
