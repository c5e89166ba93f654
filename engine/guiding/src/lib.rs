//! Guides of a frame's paths, learned from pilot paths that are part of no image: openings through which light comes
//! ([`openings`]), bright patches ([`patches`]), and shares of directions to sample toward each target. A JSON document stores them
//! ([`document`]).
#![deny(missing_docs)]

mod bins;
pub mod document;
mod learn;
pub mod openings;
pub mod patches;
mod pilot;
mod shares;
mod sums;

pub use learn::{Learned, MAX_BYTES, learn, pilot_path_count};

use femc_geometry::Ray;
use femc_math::glam::Vec3A;
use femc_prepared::Prepared;
use openings::Blockers;

/// Middle of the exposure. Moving surfaces block light where they are then.
const EXPOSURE_MIDDLE: f32 = 0.5;

impl Blockers for Prepared {
    fn distance(&self, origin: Vec3A, dir: Vec3A, reach: f32) -> Option<f32> {
        let ray = Ray { origin, dir, t_max: reach, time: EXPOSURE_MIDDLE };
        self.world.intersect(&ray).map(|hit| hit.t)
    }
}
