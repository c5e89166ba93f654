//! An annulus or disc, sampled by area.

use super::{LightSample, area_pdf, assemble_sample};
use crate::emission::Emission;
use femc_math::elementary::double::sin_cos;
use femc_math::glam::{DVec3, Vec3A};
use std::f64::consts::{PI, TAU};

/// A flat round light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ring {
    center: DVec3,
    normal: DVec3,
    tangent: DVec3,
    bitangent: DVec3,
    inner: f64,
    outer: f64,
    /// Emission of the surface.
    pub emission: Emission,
}

impl Ring {
    /// Creates the light.
    /// - `center`, m; `normal`: front, unit; radii in m, `0 <= inner < outer`.
    pub fn new(center: Vec3A, normal: Vec3A, inner: f32, outer: f32, emission: Emission) -> Self {
        let normal = normal.as_dvec3().normalize_or(DVec3::Z);
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        let (inner, outer) = (f64::from(inner), f64::from(outer));
        Self { center: center.as_dvec3(), normal, tangent, bitangent, inner, outer, emission }
    }

    /// Front normal, unit.
    pub fn normal(&self) -> Vec3A {
        self.normal.as_vec3a()
    }

    /// Returns the area, m2.
    pub fn area(&self) -> f64 {
        PI * (self.outer - self.inner) * (self.outer + self.inner)
    }

    /// See [`super::Light::sample`].
    #[inline]
    pub fn sample(&self, reference: Vec3A, u: [f32; 2]) -> Option<LightSample> {
        let (inner2, outer2) = (self.inner * self.inner, self.outer * self.outer);
        let radius = (inner2 + f64::from(u[0]) * (outer2 - inner2)).sqrt();
        let (sin, cos) = sin_cos(TAU * f64::from(u[1]));
        assemble_sample(
            reference.as_dvec3(),
            self.center + (self.tangent * cos + self.bitangent * sin) * radius,
            self.normal,
            self.center.as_vec3a().abs() + Vec3A::splat(self.outer as f32),
            |dir, distance| area_pdf(self.area(), distance * distance, dir.dot(self.normal)),
            |_, cos| self.emission.radiance(cos),
            [f64::from(u[1]), radius / self.outer],
        )
    }

    /// See [`super::Light::pdf`].
    #[inline]
    pub fn pdf(&self, reference: Vec3A, position: Vec3A, _normal: Vec3A, dir: Vec3A) -> f32 {
        let cos = -dir.as_dvec3().dot(self.normal);
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
        let extent = (DVec3::ONE - self.normal * self.normal).max(DVec3::ZERO).map(f64::sqrt) * self.outer;
        ((self.center - extent).as_vec3a(), (self.center + extent).as_vec3a())
    }
}
