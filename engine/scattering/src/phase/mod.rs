//! Phase functions: one member per file.
//!
//! `wo` points back along the ray, `wi` toward the light, both unit. The cosine is between PROPAGATION directions, that is
//! `-wo . wi`: positive parameters scatter forward. Every density is in 1/sr and integrates to 1. Samples follow it exactly, so a
//! sample's weight is 1.

mod henyey_greenstein;
mod rayleigh;
mod schlick;

use femc_math::glam::Vec3A;
use femc_math::{Frame, warp};
use std::f32::consts::PI;

/// A phase function.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Phase {
    /// `1 / (4 pi)`.
    #[default]
    Isotropic,
    /// `(1 - g^2) / (4 pi (1 + g^2 - 2 g cos)^1.5)` (\[henyey1941\]).
    HenyeyGreenstein {
        /// Mean cosine, in (-1, 1).
        g: f32,
    },
    /// `(1 - k^2) / (4 pi (1 - k cos)^2)` (\[blasi1993\]).
    Schlick {
        /// Parameter, in (-1, 1); NOT the mean cosine.
        k: f32,
    },
    /// `3 / (16 pi) (1 + cos^2)`.
    Rayleigh,
}

/// A sampled direction; its weight is 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhaseSample {
    /// Unit direction, away from the scattering point.
    pub wi: Vec3A,
    /// Density, 1/sr.
    pub pdf: f32,
}

impl Phase {
    /// Returns the phase function, 1/sr. It is symmetric in its arguments and integrates to 1 over the sphere.
    #[inline]
    pub fn eval(&self, wo: Vec3A, wi: Vec3A) -> f32 {
        // Half the square of the chord to the peak. It is exact for a narrow peak, where the cosine is not.
        let versine = |parameter: f32| {
            let chord = if parameter >= 0.0 { wo + wi } else { wo - wi };
            0.5 * chord.length_squared()
        };
        match *self {
            Self::Isotropic => 1.0 / (4.0 * PI),
            Self::HenyeyGreenstein { g } => henyey_greenstein::eval(g.abs(), versine(g)),
            Self::Schlick { k } => schlick::eval(k.abs(), versine(k)),
            Self::Rayleigh => rayleigh::eval((-wo.dot(wi)).clamp(-1.0, 1.0)),
        }
    }

    /// Returns the density of [`Self::sample`], 1/sr, which equals [`Self::eval`].
    #[inline]
    pub fn pdf(&self, wo: Vec3A, wi: Vec3A) -> f32 {
        self.eval(wo, wi)
    }

    /// Samples a direction from `u` in [0, 1)^2.
    #[inline]
    pub fn sample(&self, wo: Vec3A, u: [f32; 2]) -> PhaseSample {
        let (parameter, versine) = match *self {
            Self::Isotropic => return PhaseSample { wi: warp::sphere(u), pdf: 1.0 / (4.0 * PI) },
            Self::HenyeyGreenstein { g } => (g, henyey_greenstein::sample_versine(g.abs(), u[0])),
            Self::Schlick { k } => (k, schlick::sample_versine(k.abs(), u[0])),
            Self::Rayleigh => (1.0, 1.0 - f64::from(rayleigh::sample_cos(u[0]))),
        };
        let peak = if parameter >= 0.0 { -wo } else { wo };
        let wi = Frame::from_normal(peak).to_world(warp::direction_from_versine(versine, u[1])).normalize();
        PhaseSample { wi, pdf: self.eval(wo, wi) }
    }

    /// Returns the parameter of a Schlick phase function that is close to this one (\[blasi1993\]); 0 for those that are not
    /// narrow.
    pub fn schlick_parameter(&self) -> f32 {
        match *self {
            Self::Isotropic | Self::Rayleigh => 0.0,
            Self::HenyeyGreenstein { g } => 1.55 * g - 0.55 * g * g * g,
            Self::Schlick { k } => k,
        }
    }

    /// Returns the mean cosine between propagation directions.
    pub fn mean_cosine(&self) -> f32 {
        match *self {
            Self::Isotropic | Self::Rayleigh => 0.0,
            Self::HenyeyGreenstein { g } => g,
            Self::Schlick { k } => schlick::mean_cosine(k),
        }
    }
}
