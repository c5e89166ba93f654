//! The second pass: unbiased path tracing of surfaces and fog.
//!
//! Direct light is joined from light sampling, from scattering that meets the light and, in fog, from equiangular distance
//! sampling, by multiple importance sampling. The kernel is monomorphised over what the scene needs (media or none), chosen
//! once a tile.
#![deny(missing_docs)]

mod dimensions;
mod fog;
mod path;
pub mod record;
mod shadow;
mod technique;

pub use path::{Counters, PathSample, PathSettings, PixelFilter, Tracer};
pub use record::{Recorder, Recording};
pub use technique::Technique;
