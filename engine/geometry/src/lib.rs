//! Ray tracing: trees of triangles and analytic shapes, placed in a world by fixed or moving poses.
//!
//! A [`Blas`] contains the surfaces of one group in its own frame. A [`World`] contains placed groups and answers
//! [`World::intersect`] and [`World::occluded`]. Binary trees built by surface area are collapsed into eight-wide ones. The kernels
//! test eight boxes or eight triangles at once, with AVX2 if the processor has it, and with equal bits elsewhere.
//!
//! All numbers are f32 in meters, in coordinates that the preparation of a frame has moved near the origin. Shapes other than
//! triangles compute in f64 internally. There are no epsilons: triangles are watertight (\[woop2013\]), positions carry error
//! bounds, and rays leave a surface by those bounds (\[pharr2023\]). Hits do not depend on the layout of the trees: at equal
//! distances, the lowest (instance, primitive) wins.
#![deny(missing_docs)]
#![cfg_attr(
    test,
    allow(clippy::disallowed_methods, reason = "tests compute expected values independently of the engine")
)]

mod blas;
mod bounds;
mod interaction;
mod kernel;
mod motion;
mod offset;
mod ray;
mod shape;
mod tree;
mod world;

pub use blas::{Blas, Cull, ShapeInput, TriangleInput};
pub use bounds::Aabb;
pub use interaction::{Interaction, triangle_interaction};
pub use motion::Pose;
pub use offset::{offset_origin, shadow_segment};
pub use ray::{Hit, Ray, RayLanes};
pub use shape::{Facing, Quadric};
pub use world::{InstanceInput, World};

#[cfg(test)]
mod tests;
