//! Prepared frames: a scene's description at one time, converted to the data that the kernels read: BVHs, materials, lights, media
//! and the camera.
//!
//! Coordinates are rebased: a whole number of meters near the camera is subtracted in f64 before anything becomes f32. The offset
//! is the same for all frames of a clip. Data that have not changed since an earlier frame, or that are equal in a variant of the
//! scene, are shared.
#![deny(missing_docs)]

pub mod camera;
pub mod compile;
pub mod lights;
pub mod material;
pub mod media;
pub mod single_scatter;
pub mod texture;

pub mod camera_emitters;
mod duplicates;
pub mod film_polygon;
mod frame;
pub mod names;
mod next_frame;
mod scene_source;
mod shading_point;
#[cfg(test)]
mod tests;

pub use frame::{
    FrameSpec, PrepareError, Prepared, find_camera, frame_key, prepare_frame, prepare_frame_at_unit_brightness,
};
pub use lights::Lights;
pub use material::{Crossing, KernelMaterial, Orientation};
pub use next_frame::NextFrame;
pub use scene_source::SceneSource;
pub use shading_point::{FlatTriangle, ShadingPoint};
