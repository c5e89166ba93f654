//! A flat triangle, front side by the right-hand rule.
//!
//! Under a moderate solid angle, it is sampled uniformly over the solid angle (\[arvo1995\]). If it nearly fills a hemisphere,
//! directions are sampled over the hemisphere. Below 1e-8 sr, it is sampled by area.

use super::{LightSample, area_pdf, assemble_sample, bounding_box, intersect_plane};
use crate::emission::{Emission, EmittingSides};
use crate::solid_angle::{self, Strategy};
use femc_math::glam::{DVec3, Vec3A};
use femc_math::{Frame, warp};
use std::f32::consts::TAU;

/// A triangular light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangle {
    /// First vertex and the edges from it, m.
    origin: DVec3,
    e1: DVec3,
    e2: DVec3,
    /// `e1 x e2`.
    cross: DVec3,
    normal: DVec3,
    area: f64,
    /// Square of the largest distance of a vertex from the centroid, m2.
    reach2: f64,
    /// Largest coordinates of the vertices, m: the scale of position errors.
    scale: Vec3A,
    /// Emission of the surface.
    pub emission: Emission,
}

impl Triangle {
    /// Creates the light from three vertices, m, which must be the same floats as in the geometry.
    pub fn new(vertices: [Vec3A; 3], emission: Emission) -> Self {
        let [a, b, c] = vertices.map(|v| v.as_dvec3());
        let cross = (b - a).cross(c - a);
        let centroid = (a + b + c) / 3.0;
        Self {
            reach2: [a, b, c].map(|v| v.distance_squared(centroid)).into_iter().fold(0.0, f64::max),
            origin: a,
            e1: b - a,
            e2: c - a,
            cross,
            normal: cross.normalize_or_zero(),
            area: 0.5 * cross.length(),
            scale: vertices[0].abs().max(vertices[1].abs()).max(vertices[2].abs()),
            emission,
        }
    }

    /// Returns the front normal, unit; zero for a triangle without area.
    pub fn normal(&self) -> Vec3A {
        self.normal.as_vec3a()
    }

    /// Returns the area, m2.
    pub fn area(&self) -> f64 {
        self.area
    }

    /// Returns the strategy for `a`, the first vertex as seen from the reference.
    #[inline]
    fn strategy(&self, a: DVec3) -> Strategy {
        let behind = a.dot(self.normal);
        if behind == 0.0 || (behind > 0.0 && self.emission.sides == EmittingSides::One) {
            return Strategy::EdgeOn;
        }
        if solid_angle::is_far(a + (self.e1 + self.e2) / 3.0, self.reach2) {
            return Strategy::Area;
        }
        Strategy::from_solid_angle(solid_angle::triangle(a, self.e1, self.e2, self.cross))
    }

    /// See [`super::Light::sample`].
    #[inline]
    pub fn sample(&self, reference: Vec3A, u: [f32; 2]) -> Option<LightSample> {
        let origin = reference.as_dvec3();
        let a = self.origin - origin;
        let strategy = self.strategy(a);
        let [b1, b2] = match strategy {
            Strategy::EdgeOn => return None,
            Strategy::Area => warp::triangle(u).map(f64::from),
            Strategy::SolidAngle(omega) => {
                let dir = solid_angle::sample_triangle(a, a + self.e1, a + self.e2, omega, u)?;
                let [b1, b2] = self.barycentric(a, dir);
                let (b1, b2) = (b1.clamp(0.0, 1.0), b2.clamp(0.0, 1.0));
                let excess = (b1 + b2).max(1.0);
                [b1 / excess, b2 / excess]
            }
            Strategy::Hemisphere => {
                let [b1, b2] = self.barycentric(a, sample_facing_hemisphere(self.normal, a, u));
                (b1 >= 0.0 && b2 >= 0.0 && b1 + b2 <= 1.0).then_some([b1, b2])?
            }
        };
        let position = self.origin + self.e1 * b1 + self.e2 * b2;
        assemble_sample(
            origin,
            position,
            self.normal,
            self.scale,
            |dir, distance| self.density(strategy, distance * distance, dir.dot(self.normal)),
            |_, cos| self.emission.radiance(cos),
            [b1, b2],
        )
    }

    /// Returns the vertices, m.
    pub fn corners(&self) -> [Vec3A; 3] {
        [self.origin, self.origin + self.e1, self.origin + self.e2].map(|v| v.as_vec3a())
    }

    /// See [`super::Light::sample_in_direction`].
    #[inline]
    pub fn sample_in_direction(&self, reference: Vec3A, dir: Vec3A) -> Option<LightSample> {
        let origin = reference.as_dvec3();
        let [b1, b2] = intersect_plane(self.origin - origin, [self.e1, self.e2, self.cross], dir.as_dvec3())?;
        if b1 + b2 > 1.0 {
            return None;
        }
        let position = self.origin + self.e1 * b1 + self.e2 * b2;
        assemble_sample(
            origin,
            position,
            self.normal,
            self.scale,
            |_, _| 1.0,
            |_, cos| self.emission.radiance(cos),
            [b1, b2],
        )
    }

    /// Returns the barycentric coordinates of the point that the ray along `dir` hits.
    #[inline]
    fn barycentric(&self, a: DVec3, dir: DVec3) -> [f64; 2] {
        let p = dir * (a.dot(self.cross) / dir.dot(self.cross)) - a;
        let scale = 1.0 / self.cross.length_squared();
        [p.cross(self.e2).dot(self.cross) * scale, self.e1.cross(p).dot(self.cross) * scale]
    }

    #[inline]
    fn density(&self, strategy: Strategy, distance2: f64, cos: f64) -> f32 {
        match strategy {
            Strategy::EdgeOn => 0.0,
            Strategy::Area => area_pdf(self.area, distance2, cos),
            Strategy::SolidAngle(omega) => (1.0 / omega) as f32,
            Strategy::Hemisphere => 1.0 / TAU,
        }
    }

    /// See [`super::Light::pdf`].
    #[inline]
    pub fn pdf(&self, reference: Vec3A, position: Vec3A, _normal: Vec3A, dir: Vec3A) -> f32 {
        let strategy = self.strategy(self.origin - reference.as_dvec3());
        let distance2 = position.as_dvec3().distance_squared(reference.as_dvec3());
        self.density(strategy, distance2, dir.as_dvec3().dot(self.normal))
    }

    /// Luminous flux, lm.
    pub fn power(&self) -> f32 {
        self.emission.power(self.area)
    }

    /// Bounding box.
    pub fn bounds(&self) -> (Vec3A, Vec3A) {
        let corners = [self.origin, self.origin + self.e1, self.origin + self.e2].map(|v| v.as_vec3a());
        bounding_box(&corners)
    }
}

/// Samples a direction uniformly over the hemisphere that faces the plane with `normal` through the point `a`.
#[inline]
pub(super) fn sample_facing_hemisphere(normal: DVec3, a: DVec3, u: [f32; 2]) -> DVec3 {
    let axis = if a.dot(normal) < 0.0 { -normal } else { normal };
    Frame::from_normal(axis.as_vec3a()).to_world(warp::direction(1.0 - u[0], u[1])).as_dvec3()
}
