//! Placed surfaces of a scene in world space, and rays among them. Checks and surveys use them.
//!
//! All numbers are f64, and the time is the start of the clip. These rays are few and answer questions about the description; no
//! picture is rendered with them.

mod beams;
mod lamps;
mod rays;
mod scope;
mod shine;
mod sources;
mod tree;
mod walk;

pub(crate) use beams::Beams;
pub(crate) use lamps::{LampPoint, emits, lamp_points};
pub(crate) use rays::{Hit, Ray};
pub(crate) use scope::{PlacedLuminaire, PlacedTriangle, Scope};
pub(crate) use shine::{LitPlace, Shone, scattered, shine};
pub(crate) use sources::{Source, area, sources, touching};
pub(crate) use tree::{Bounds, BoxTree};
pub(crate) use walk::{Dice, Ending, walk};
