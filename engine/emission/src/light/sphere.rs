//! A sphere. A negative radius turns the normals inward.
//!
//! From outside, it is sampled uniformly over the cone that it fills; from inside, uniformly over all directions. A one-sided
//! sphere with inward normals is transparent from outside, where the inside of the far wall is visible.
//!
//! A reference point on the sphere itself may be rounded to either side, so its side does not decide what it sees. In this case the
//! far wall is sampled, uniformly by area. The near wall, which only a point outside the sphere could see, is not sampled.

use super::{LightSample, assemble_sample};
use crate::emission::{Emission, EmittingSides};
use femc_math::elementary::sin_cos_of_turns;
use femc_math::gamma;
use femc_math::glam::{DVec3, Vec3A};
use std::f64::consts::{PI, TAU};

/// A spherical light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    center: DVec3,
    /// Radius, > 0, m.
    radius: f64,
    /// 1 for outward normals, -1 for inward ones.
    facing: f64,
    /// Emission of the surface.
    pub emission: Emission,
}

/// The cone that a sphere fills for a point outside of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OutsideView {
    radius: f64,
    to_center: DVec3,
    distance2: f64,
    /// 1 - cos of the cone's half angle, computed without cancellation.
    versine: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Wall {
    Near,
    Far,
}

/// Returns sine and cosine of an angle in turns.
#[inline]
fn sin_cos(turns: f32) -> (f64, f64) {
    let (sin, cos) = sin_cos_of_turns(turns);
    (sin.into(), cos.into())
}

impl OutsideView {
    /// Returns the cone; `None` from inside. `to_center`: from the reference to the center, m.
    #[inline]
    pub(super) fn new(radius: f64, to_center: DVec3) -> Option<Self> {
        let distance2 = to_center.length_squared();
        let sin2 = radius * radius / distance2;
        let versine = sin2 / (1.0 + (1.0 - sin2).sqrt());
        (sin2 < 1.0 && versine > 0.0).then_some(Self { radius, to_center, distance2, versine })
    }

    /// Returns the density of the directions, 1/sr.
    #[inline]
    pub(super) fn density(&self) -> f64 {
        1.0 / (TAU * self.versine)
    }

    /// Returns the outward unit normal of a visible point, uniform over the cone.
    #[inline]
    pub(super) fn sample(&self, u: [f32; 2]) -> DVec3 {
        self.sample_wall(u, Wall::Near)
    }

    #[inline]
    fn sample_wall(&self, u: [f32; 2], wall: Wall) -> DVec3 {
        let (sin_phi, cos_phi) = sin_cos(u[1]);
        let distance = self.distance2.sqrt();
        let versine = f64::from(u[0]) * self.versine;
        let (sin2, cos) = (versine * (2.0 - versine), 1.0 - versine);
        // The point's angle at the center follows from the two sides and the angle at the reference.
        let half_chord = (self.radius * self.radius - self.distance2 * sin2).max(0.0).sqrt();
        let half_chord = match wall {
            Wall::Near => half_chord,
            Wall::Far => -half_chord,
        };
        let cos_at_center = ((distance * sin2 + half_chord * cos) / self.radius).clamp(-1.0, 1.0);
        let sin_at_center = ((distance * cos - half_chord) * sin2.sqrt() / self.radius).clamp(0.0, 1.0);
        let axis = self.to_center / distance;
        let (x, y) = axis.any_orthonormal_pair();
        (x * cos_phi + y * sin_phi) * sin_at_center - axis * cos_at_center
    }
}

/// The wall that a reference point sees, which determines the density of directions.
#[derive(Clone, Copy, Debug, PartialEq)]
enum View {
    /// No lit wall.
    Dark,
    /// From outside: the near wall, or the far one if the near one is transparent.
    Cone(OutsideView, Wall),
    /// From inside.
    Inside,
    /// From the sphere itself, within rounding: the far wall, whose directions have the density cos / pi about this unit vector to
    /// the center.
    On(DVec3),
}

impl Sphere {
    /// Creates the light.
    /// - `center`, m; `radius`: m, negative for inward normals.
    pub fn new(center: Vec3A, radius: f32, emission: Emission) -> Self {
        Self {
            center: center.as_dvec3(),
            radius: f64::from(radius.abs()),
            facing: if radius < 0.0 { -1.0 } else { 1.0 },
            emission,
        }
    }

    /// Returns the area, m2.
    pub fn area(&self) -> f64 {
        4.0 * PI * self.radius * self.radius
    }

    #[inline]
    fn view(&self, origin: DVec3) -> View {
        let to_center = self.center - origin;
        let one_sided = self.emission.sides == EmittingSides::One;
        let distance = to_center.length();
        // Rounding of a surface point, of the center and of the radius in single precision.
        let rounding = origin.abs().max_element() + self.center.abs().max_element() + self.radius;
        if (distance - self.radius).abs() <= f64::from(gamma(8)) * rounding && distance > 0.5 * self.radius {
            let faces_away = one_sided && self.facing > 0.0;
            if faces_away { View::Dark } else { View::On(to_center / distance) }
        } else if let Some(outside) = OutsideView::new(self.radius, to_center) {
            let wall = if one_sided && self.facing < 0.0 { Wall::Far } else { Wall::Near };
            View::Cone(outside, wall)
        } else if one_sided && self.facing > 0.0 {
            View::Dark
        } else {
            View::Inside
        }
    }

    /// Returns the density of a direction, 1/sr.
    #[inline]
    fn density(view: View, dir: DVec3) -> f32 {
        let pdf = match view {
            View::Dark => 0.0,
            View::Cone(outside, _) => outside.density(),
            View::Inside => 0.5 / TAU,
            View::On(axis) => axis.dot(dir).max(0.0) / PI,
        } as f32;
        if pdf.is_finite() { pdf } else { 0.0 }
    }

    /// See [`super::Light::sample`].
    #[inline]
    pub fn sample(&self, reference: Vec3A, u: [f32; 2]) -> Option<LightSample> {
        let origin = reference.as_dvec3();
        let to_center = self.center - origin;
        let view = self.view(origin);
        let outward = match view {
            View::Dark => return None,
            View::Cone(outside, wall) => outside.sample_wall(u, wall),
            View::Inside => {
                let cos = 1.0 - 2.0 * f64::from(u[0]);
                let sin = (1.0 - cos * cos).max(0.0).sqrt();
                let (sin_phi, cos_phi) = sin_cos(u[1]);
                let dir = DVec3::new(sin * cos_phi, sin * sin_phi, cos);
                let along = dir.dot(to_center);
                let across2 = to_center.length_squared() - along * along;
                let t = along + (self.radius * self.radius - across2).max(0.0).sqrt();
                ((dir * t - to_center) / self.radius).normalize_or_zero()
            }
            View::On(axis) => {
                // From a point on the sphere, equal areas are equal shares of cos / pi; u = 1 is the reference itself.
                let cos = 1.0 - 2.0 * f64::from(u[0]);
                let sin = (1.0 - cos * cos).max(0.0).sqrt();
                let (sin_phi, cos_phi) = sin_cos(u[1]);
                let (x, y) = axis.any_orthonormal_pair();
                axis * cos + (x * cos_phi + y * sin_phi) * sin
            }
        };
        let scale = self.center.as_vec3a().abs() + Vec3A::splat(self.radius as f32);
        assemble_sample(
            origin,
            self.center + outward * self.radius,
            outward * self.facing,
            scale,
            |dir, _| Self::density(view, dir),
            |_, cos| self.emission.radiance(cos),
            [f64::from(u[1]), 0.5 * (outward.z + 1.0)],
        )
    }

    /// See [`super::Light::pdf`].
    #[inline]
    pub fn pdf(&self, reference: Vec3A, position: Vec3A, _normal: Vec3A, dir: Vec3A) -> f32 {
        let view = self.view(reference.as_dvec3());
        let dir = dir.as_dvec3();
        let is_far_wall = || dir.dot(position.as_dvec3() - self.center) > 0.0;
        if matches!(view, View::On(_)) && !is_far_wall() { 0.0 } else { Self::density(view, dir) }
    }

    /// Luminous flux, lm.
    pub fn power(&self) -> f32 {
        self.emission.power(self.area())
    }

    /// Bounding box.
    pub fn bounds(&self) -> (Vec3A, Vec3A) {
        ((self.center - self.radius).as_vec3a(), (self.center + self.radius).as_vec3a())
    }
}
