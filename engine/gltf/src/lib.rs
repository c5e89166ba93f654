//! Prepared frames as binary glTF (\[gltf2\]), for viewers.
//!
//! [`scene_geometry`] writes the surfaces of a frame, one node per object and place. Curved surfaces become triangles, whose
//! distance from the surface the file states. A limit on the number of triangles makes curved surfaces coarser, and then turns the
//! largest objects into boxes. [`Glb`] is the writer of the file format; the solution of the first pass uses it, too.
#![deny(missing_docs)]

mod cameras;
mod detail;
mod geometry;
mod glb;
mod material;
mod mesh;
mod objects;
mod tessellation;

pub use geometry::{GeometryOptions, scene_geometry};
pub use glb::{Glb, TooLarge};
pub use tessellation::{Steps, Tessellation};
