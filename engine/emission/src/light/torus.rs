//! A torus between two radii about an axis. Both radii negative: normals inward. Sampled by area.

use super::{LightSample, area_pdf, assemble_sample};
use crate::emission::Emission;
use femc_math::elementary::double::sin_cos;
use femc_math::glam::{DVec3, Vec3A};
use std::f64::consts::{PI, TAU};

/// A toroidal light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Torus {
    center: DVec3,
    axis: DVec3,
    tangent: DVec3,
    bitangent: DVec3,
    /// Radius of the tube's center line, m.
    major: f64,
    /// Radius of the tube, m, <= major.
    minor: f64,
    facing: f64,
    /// Emission of the surface.
    pub emission: Emission,
}

impl Torus {
    /// Creates the light.
    /// - `center`, m; `axis`: unit; `inner`, `outer`: smallest and largest distance from the axis, m; both negative for inward
    ///   normals.
    pub fn new(center: Vec3A, axis: Vec3A, inner: f32, outer: f32, emission: Emission) -> Self {
        let axis = axis.as_dvec3().normalize_or(DVec3::Z);
        let (tangent, bitangent) = axis.any_orthonormal_pair();
        let (a, b) = (f64::from(inner.abs()), f64::from(outer.abs()));
        Self {
            center: center.as_dvec3(),
            axis,
            tangent,
            bitangent,
            major: 0.5 * (a + b),
            minor: 0.5 * (a - b).abs(),
            facing: if outer < 0.0 { -1.0 } else { 1.0 },
            emission,
        }
    }

    /// Returns the area, m2.
    pub fn area(&self) -> f64 {
        4.0 * PI * PI * self.major * self.minor
    }

    /// See [`super::Light::sample`].
    #[inline]
    pub fn sample(&self, reference: Vec3A, u: [f32; 2]) -> Option<LightSample> {
        let (sin_tube, cos_tube) = sin_cos(self.tube_angle(f64::from(u[0])));
        let (sin, cos) = sin_cos(TAU * f64::from(u[1]));
        let radial = self.tangent * cos + self.bitangent * sin;
        let outward = radial * cos_tube + self.axis * sin_tube;
        let normal = outward * self.facing;
        assemble_sample(
            reference.as_dvec3(),
            self.center + radial * self.major + outward * self.minor,
            normal,
            self.center.as_vec3a().abs() + Vec3A::splat((self.major + self.minor) as f32),
            |dir, distance| area_pdf(self.area(), distance * distance, dir.dot(normal)),
            |_, cos| self.emission.radiance(cos),
            [f64::from(u[1]), f64::from(u[0])],
        )
    }

    /// Samples the angle v about the tube with density (major + minor cos v) / (2 pi major): the root of
    /// `v + (minor / major) sin v = 2 pi u`, by Newton steps inside a shrinking bracket.
    fn tube_angle(&self, u: f64) -> f64 {
        let (ratio, goal) = (self.minor / self.major, TAU * u);
        let (mut low, mut high) = (0.0, TAU);
        let mut v = goal;
        for _ in 0..64 {
            let (sin, cos) = sin_cos(v);
            let miss = v + ratio * sin - goal;
            if miss.abs() < 1e-12 {
                break;
            }
            if miss > 0.0 {
                high = v;
            } else {
                low = v;
            }
            let step = v - miss / (1.0 + ratio * cos);
            v = if step > low && step < high { step } else { 0.5 * (low + high) };
        }
        v
    }

    /// See [`super::Light::pdf`].
    #[inline]
    pub fn pdf(&self, reference: Vec3A, position: Vec3A, normal: Vec3A, dir: Vec3A) -> f32 {
        let cos = f64::from(-dir.dot(normal));
        if self.emission.is_dark(cos) {
            return 0.0;
        }
        area_pdf(self.area(), position.as_dvec3().distance_squared(reference.as_dvec3()), cos)
    }

    /// Luminous flux, lm.
    pub fn power(&self) -> f32 {
        self.emission.power(self.area())
    }

    /// Bounding box.
    pub fn bounds(&self) -> (Vec3A, Vec3A) {
        let across = (DVec3::ONE - self.axis * self.axis).max(DVec3::ZERO).map(f64::sqrt);
        let extent = across * self.major + self.minor;
        ((self.center - extent).as_vec3a(), (self.center + extent).as_vec3a())
    }
}
