//! An open truncated cone; equal radii make a cylinder. Negative radii turn the normals inward. Sampled by area.

use super::{LightSample, area_pdf, assemble_sample};
use crate::emission::Emission;
use femc_math::elementary::double::sin_cos;
use femc_math::glam::{DVec3, Vec3A};
use std::f64::consts::{PI, TAU};

/// A conical or cylindrical light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cone {
    base: DVec3,
    axis: DVec3,
    tangent: DVec3,
    bitangent: DVec3,
    height: f64,
    /// Radii at the base and at the top, >= 0, m.
    radii: [f64; 2],
    facing: f64,
    area: f64,
    /// Emission of the surface.
    pub emission: Emission,
}

impl Cone {
    /// Creates the light.
    /// - `base`, `top`: centers of the two ends, m; radii of one sign, m, negative for inward normals.
    pub fn new(base: Vec3A, base_radius: f32, top: Vec3A, top_radius: f32, emission: Emission) -> Self {
        let v = top.as_dvec3() - base.as_dvec3();
        let height = v.length();
        let axis = v.normalize_or(DVec3::Z);
        let (tangent, bitangent) = axis.any_orthonormal_pair();
        let radii = [f64::from(base_radius.abs()), f64::from(top_radius.abs())];
        let slope = radii[1] - radii[0];
        Self {
            base: base.as_dvec3(),
            axis,
            tangent,
            bitangent,
            height,
            radii,
            facing: if base_radius < 0.0 || top_radius < 0.0 { -1.0 } else { 1.0 },
            area: PI * (radii[0] + radii[1]) * (height * height + slope * slope).sqrt(),
            emission,
        }
    }

    /// Returns the area, m2.
    pub fn area(&self) -> f64 {
        self.area
    }

    /// See [`super::Light::sample`].
    #[inline]
    pub fn sample(&self, reference: Vec3A, u: [f32; 2]) -> Option<LightSample> {
        let [r0, r1] = self.radii;
        let along = f64::from(u[0]);
        let radius = (r0 * r0 + along * (r1 * r1 - r0 * r0)).max(0.0).sqrt();
        // Equals (radius - r0) / (r1 - r0), and also holds for equal radii.
        let t = if radius + r0 > 0.0 { along * (r0 + r1) / (radius + r0) } else { 0.0 };
        let (sin, cos) = sin_cos(TAU * f64::from(u[1]));
        let radial = self.tangent * cos + self.bitangent * sin;
        let normal = (radial * self.height + self.axis * (r0 - r1)).normalize_or_zero() * self.facing;
        assemble_sample(
            reference.as_dvec3(),
            self.base + self.axis * (t * self.height) + radial * radius,
            normal,
            self.base.as_vec3a().abs() + Vec3A::splat((self.height + r0.max(r1)) as f32),
            |dir, distance| area_pdf(self.area, distance * distance, dir.dot(normal)),
            |_, cos| self.emission.radiance(cos),
            [f64::from(u[1]), t],
        )
    }

    /// See [`super::Light::pdf`].
    #[inline]
    pub fn pdf(&self, reference: Vec3A, position: Vec3A, normal: Vec3A, dir: Vec3A) -> f32 {
        let cos = f64::from(-dir.dot(normal));
        if self.emission.is_dark(cos) {
            return 0.0;
        }
        area_pdf(self.area, position.as_dvec3().distance_squared(reference.as_dvec3()), cos)
    }

    /// Luminous flux, lm.
    pub fn power(&self) -> f32 {
        self.emission.power(self.area)
    }

    /// Bounding box.
    pub fn bounds(&self) -> (Vec3A, Vec3A) {
        let across = (DVec3::ONE - self.axis * self.axis).max(DVec3::ZERO).map(f64::sqrt);
        let (base, top) = (self.base, self.base + self.axis * self.height);
        let (e0, e1) = (across * self.radii[0], across * self.radii[1]);
        ((base - e0).min(top - e1).as_vec3a(), (base + e0).max(top + e1).as_vec3a())
    }
}
