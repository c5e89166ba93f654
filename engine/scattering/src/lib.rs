//! Scattering kernels: surfaces ([`Bsdf`]) and phase functions ([`Phase`]).
//!
//! Closed families are enums with one file per member, and each member has the same three functions: `eval`, `sample`, `pdf`. The
//! crate takes plain `f32` parameters and does not depend on scenes. It has no state and generates no random numbers.
//!
//! Local frame of surfaces: z is the shading normal on the surface's FRONT side. `wo` (toward the viewer) and `wi` (toward the
//! light) are unit vectors that point AWAY from the surface. Either may have a negative z.
#![deny(missing_docs)]
#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "tests compute what they expect apart from the engine"))]

pub mod bsdf;
pub mod fresnel;
pub mod microfacet;
pub mod phase;

pub use bsdf::{Bsdf, BsdfSample, LobeKind, MaterialParameters, Sides, Transmitted};
pub use fresnel::Fresnel;
pub use phase::{Phase, PhaseSample};

#[cfg(test)]
mod tests;
