//! A point with a measured intensity distribution.

use super::{DeltaKind, LightSample};
use crate::photometry::IntensityDistribution;
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use std::sync::Arc;

/// A luminaire without a luminous size.
#[derive(Clone, Debug, PartialEq)]
pub struct PhotometricPoint {
    /// Position, m.
    pub position: Vec3A,
    /// The luminaire's x, y and z axes, unit; left-handed after a mirroring transform.
    pub axes: [Vec3A; 3],
    /// Intensity by direction.
    pub distribution: Arc<IntensityDistribution>,
    /// Color and multiplier of the intensity; luminance 1 keeps the candela of the file.
    pub tint: Rgb,
}

impl PhotometricPoint {
    /// Returns the luminous intensity, cd, in the direction `dir` (unit, common frame, away from the light).
    #[inline]
    pub fn intensity(&self, dir: Vec3A) -> Rgb {
        let local = Vec3A::new(dir.dot(self.axes[0]), dir.dot(self.axes[1]), dir.dot(self.axes[2]));
        self.tint * self.distribution.intensity(local)
    }

    /// See [`super::Light::sample`].
    #[inline]
    pub fn sample(&self, reference: Vec3A, _u: [f32; 2]) -> Option<LightSample> {
        let (dir, distance) = super::direction_and_distance(reference.as_dvec3(), self.position.as_dvec3())?;
        let dir = dir.as_vec3a();
        let radiance = self.intensity(-dir) * (1.0 / (distance * distance)) as f32;
        (radiance.is_finite() && radiance != Rgb::ZERO).then_some(LightSample {
            dir,
            distance: distance as f32,
            position: self.position,
            normal: Vec3A::ZERO,
            error: Vec3A::ZERO,
            radiance,
            pdf: 1.0,
            delta: DeltaKind::Position,
            uv: [0.0, 0.0],
        })
    }

    /// Returns 0, because no ray hits a point.
    #[inline]
    pub fn pdf(&self, _reference: Vec3A, _position: Vec3A, _normal: Vec3A, _dir: Vec3A) -> f32 {
        0.0
    }

    /// Luminous flux, lm.
    pub fn power(&self) -> f32 {
        luminance(self.tint) * self.distribution.flux() as f32
    }

    /// Returns the point itself as both corners.
    pub fn bounds(&self) -> (Vec3A, Vec3A) {
        (self.position, self.position)
    }
}
