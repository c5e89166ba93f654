//! Second pass: unbiased path tracing of surfaces and fog.
//!
//! Direct light combines two samplers with multiple importance sampling: a light and a point on it, in fog together with a distance
//! by the scattered amount of that light, and scattering that hits the light. The kernel is monomorphized over the scene's needs
//! (media or none) and chosen once per tile.
#![deny(missing_docs)]

mod dimensions;
mod first_hit;
mod fog;
mod guided;
mod path;
pub mod record;
mod shadow;
mod technique;

pub use first_hit::{FirstSurface, first_surface};
pub use path::{PathSample, PathSettings, PixelFilter, Tracer, TracerCounters};
pub use record::{Recorder, Recording};
pub use technique::MisTechnique;
