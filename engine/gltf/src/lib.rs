//! Prepared frames as binary glTF (\[gltf2\]), for viewers.
//!
//! [`scene_geometry`] writes the surfaces of a frame, one node per object and place. Curved surfaces become triangles, whose
//! distance from the surface the file states. A limit on the number of triangles makes curved surfaces coarser, and then turns the
//! largest objects into boxes. [`solution_model`] writes the finite-element solution of a frame in the same coordinates. [`Glb`] is
//! the writer of the file format.
#![deny(missing_docs)]

mod cameras;
mod detail;
mod geometry;
mod glb;
mod material;
mod mesh;
mod objects;
mod root;
mod solution;
mod tessellation;

pub use geometry::{GeometryOptions, scene_geometry};
pub use glb::{Glb, TooLarge};
pub use root::scene_root;
pub use solution::{SolutionOptions, solution_model};
pub use tessellation::{Steps, Tessellation};
