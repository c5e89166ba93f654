//! The second pass: unbiased path tracing of surfaces and fog.
//!
//! Direct light is joined from drawing a light and a point on it, in fog with a distance by what is scattered of that light, and from scattering
//! that meets the light, by multiple importance sampling. The kernel is monomorphised over what the scene needs (media or none), chosen
//! once a tile.
#![deny(missing_docs)]

mod dimensions;
mod first;
mod fog;
mod guided;
mod path;
pub mod record;
mod shadow;
mod technique;

pub use first::{FirstSurface, first_surface};
pub use path::{Counters, PathSample, PathSettings, PixelFilter, Tracer};
pub use record::{Recorder, Recording};
pub use technique::Technique;
