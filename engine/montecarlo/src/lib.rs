//! Second pass: unbiased path tracing of surfaces and fog.
//!
//! Direct light combines two samplers with multiple importance sampling: a light and a point on it, in fog together with a distance
//! by the scattered amount of that light, and scattering that hits the light. The kernel is monomorphized over the scene's needs
//! (media or none) and chosen once per tile. A [`Packet`] traces several samples side by side, with the same bits.
#![deny(missing_docs)]

#[macro_use]
pub mod record;

mod camera_next_event;
mod dimensions;
mod emission;
mod first_branches;
mod first_hit;
mod fog;
mod guided;
mod medium;
mod next_event;
mod packet;
mod path_state;
mod receiver;
mod roulette;
mod scatter;
mod seen_tables;
mod shadow;
mod surface;
mod technique;
#[cfg(test)]
mod test_scene;
mod tracer;
mod window;

pub use first_hit::{FirstSurface, first_surface};
pub use packet::{Packet, SampleNumber, has_lanes};
pub use receiver::{Receiver, Sensitivity};
pub use record::{Recorder, Recording};
pub use seen_tables::keep_seen_tables;
pub use technique::MisTechnique;
pub use tracer::{Guidance, PathSample, PathSettings, PixelFilter, Tracer, TracerCounters};
pub use window::{FRAME_SHARE, WeightWindow};

#[inline]
fn square(x: f32) -> f32 {
    x * x
}
