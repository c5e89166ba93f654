//! A perfect mirror: `rs F(cos)` times a delta at the mirror direction.

use super::{BsdfSample, LobeKind, Sides, Transmitted};
#[cfg(test)]
use super::{Example, MaterialParameters, WARM};
use crate::Fresnel;
use femc_math::{Rgb, glam::Vec3A};

/// A smooth, purely specular surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mirror {
    /// Reflectance before the Fresnel factor, in [0, 1].
    pub rs: Rgb,
    /// Fresnel factor.
    pub fresnel: Fresnel,
    /// Sides that reflect.
    pub sides: Sides,
}

impl Mirror {
    /// Samples the mirror direction.
    #[inline]
    pub fn sample(&self, wo: Vec3A) -> Option<BsdfSample> {
        (wo.z != 0.0 && self.sides.exist_at(wo.z)).then(|| BsdfSample {
            wi: Vec3A::new(-wo.x, -wo.y, wo.z),
            weight: self.albedo(wo),
            pdf: 1.0,
            lobe: LobeKind::Delta,
            transmitted: Transmitted::No,
            eta: 1.0,
        })
    }

    /// Returns the exact directional albedo.
    #[inline]
    pub fn albedo(&self, wo: Vec3A) -> Rgb {
        self.rs * self.fresnel.eval(wo.z.abs())
    }
}

/// Materials of this member, for the tests of the laws.
#[cfg(test)]
pub(super) fn examples() -> Vec<Example> {
    vec![Example::new("mirror", MaterialParameters { rs: WARM, ..MaterialParameters::default() })]
}
