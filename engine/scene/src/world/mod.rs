//! Placed surfaces of a scene in world space, and rays among them. Checks and surveys use them.
//!
//! All numbers are f64, and the time is the start of the clip. These rays are few and answer questions about the description; no
//! picture is rendered with them.

mod emission_sampler;
mod lamps;
mod light_transport;
mod rays;
mod scope;
mod sources;
mod tree;
mod walk;

pub(crate) use emission_sampler::EmissionSampler;
pub(crate) use lamps::{LampPoint, emits, lamp_points};
pub(crate) use light_transport::{LightPathEnd, LitPoint, scattered_ray, trace_light};
pub(crate) use rays::{Hit, Ray};
pub(crate) use scope::{PlacedLuminaire, PlacedTriangle, Scope};
pub(crate) use sources::{LightSource, group_touching, light_sources, shape_area};
pub(crate) use tree::{Bounds, BoxTree};
pub(crate) use walk::{SplitMix64, WalkEnd, random_walk};
