//! Lambertian reflection: `f = rd / pi` on one or both sides.

use super::{BsdfSample, LobeKind, Sides, Transmitted};
#[cfg(test)]
use super::{Example, MaterialParameters, WARM};
use femc_math::{Rgb, glam::Vec3A, warp};
use std::f32::consts::FRAC_1_PI;

/// A matte surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Diffuse {
    /// Reflectance, in [0, 1].
    pub rd: Rgb,
    /// Sides that reflect.
    pub sides: Sides,
}

impl Diffuse {
    /// Returns f |cos wi|, 1/sr.
    #[inline]
    pub fn eval(&self, wo: Vec3A, wi: Vec3A) -> Rgb {
        self.rd * self.pdf(wo, wi)
    }

    /// Returns `|cos wi| / pi` if both directions are on one side that exists, else 0.
    #[inline]
    pub fn pdf(&self, wo: Vec3A, wi: Vec3A) -> f32 {
        if wo.z * wi.z > 0.0 && self.sides.exist_at(wo.z) { wi.z.abs() * FRAC_1_PI } else { 0.0 }
    }

    /// Samples a cosine-distributed direction on the viewer's side.
    #[inline]
    pub fn sample(&self, wo: Vec3A, u: [f32; 2]) -> Option<BsdfSample> {
        if wo.z == 0.0 || !self.sides.exist_at(wo.z) {
            return None;
        }
        let wi = super::flip_to_side(warp::cosine_hemisphere(u), wo.z);
        let pdf = wi.z.abs() * FRAC_1_PI;
        (pdf > 0.0).then_some(BsdfSample {
            wi,
            weight: self.rd,
            pdf,
            lobe: LobeKind::Diffuse,
            transmitted: Transmitted::No,
            eta: 1.0,
        })
    }
}

/// Materials of this member, for the tests of the laws.
#[cfg(test)]
pub(super) fn examples() -> Vec<Example> {
    let p = MaterialParameters::default();
    vec![
        Example::new("diffuse", MaterialParameters { rd: Rgb::new(0.9, 0.5, 0.1), ..p }),
        Example::new("one-sided diffuse", MaterialParameters { rd: WARM, sides: Sides::One, ..p }),
    ]
}
