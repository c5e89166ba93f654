//! Prepared frames: a scene's description at one time, converted to the data that the kernels read: BVHs, materials, lights, media
//! and the camera.
//!
//! Coordinates are rebased: a whole number of meters near the camera is subtracted in f64 before anything becomes f32. The offset
//! is the same for all frames of a clip. Data that have not changed since an earlier frame, or that are equal in a variant of the
//! scene, are shared.
#![deny(missing_docs)]

pub mod airlit;
pub mod camera;
pub mod compile;
pub mod lights;
pub mod material;
pub mod media;
pub mod texture;

mod frame;
pub mod names;
mod next;
pub mod outline;
pub mod sightings;
mod source;
mod surface;
mod twins;

pub use frame::{FrameSpec, PrepareError, Prepared, find_camera, frame_key, prepare, prepare_of_brightness_one};
pub use lights::Lights;
pub use material::{Crossing, KernelMaterial, Orientation};
pub use next::NextFrame;
pub use source::Source;
pub use surface::SurfacePoint;
