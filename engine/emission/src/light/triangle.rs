//! A flat triangle, front side by the right-hand rule.
//!
//! Under a moderate solid angle, it is sampled uniformly over the solid angle (\[arvo1995\]). If it nearly fills a hemisphere,
//! directions are sampled over the hemisphere. Below 1e-8 sr, it is sampled by area.

use super::{LightSample, bounding_box, intersect_plane, sample_of_point, single_area_pdf};
use crate::emission::{Emission, EmittingSides};
use crate::solid_angle::{self, Strategy};
use femc_math::glam::{DVec3, Vec3A};
use femc_math::{Frame, warp};
use std::f32::consts::TAU;

/// A triangular light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangle {
    /// First vertex and the edges from it, m.
    origin: Vec3A,
    edges: [DVec3; 2],
    /// Cross product of the edges.
    cross: DVec3,
    normal: Vec3A,
    area: f32,
    /// Square of the largest distance of a vertex from the centroid, m2.
    reach2: f32,
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
            reach2: [a, b, c].map(|v| v.distance_squared(centroid)).into_iter().fold(0.0, f64::max) as f32,
            origin: vertices[0],
            edges: [b - a, c - a],
            cross,
            normal: cross.normalize_or_zero().as_vec3a(),
            area: (0.5 * cross.length()) as f32,
            scale: vertices[0].abs().max(vertices[1].abs()).max(vertices[2].abs()),
            emission,
        }
    }

    /// Returns the front normal, unit; zero for a triangle without area.
    pub fn normal(&self) -> Vec3A {
        self.normal
    }

    /// Returns the area, m2.
    pub fn area(&self) -> f64 {
        self.area.into()
    }

    /// Returns the strategy for a reference point.
    /// - `corner`: from the reference to the first vertex, m.
    #[inline]
    fn strategy(&self, corner: Vec3A) -> Strategy {
        let behind = corner.dot(self.normal);
        if behind == 0.0 || (behind > 0.0 && self.emission.sides == EmittingSides::One) {
            return Strategy::EdgeOn;
        }
        let [e1, e2] = self.single_edges();
        let centroid = corner + (e1 + e2) * (1.0 / 3.0);
        if solid_angle::is_far(self.reach2, centroid.length_squared()) {
            return Strategy::Area;
        }
        let [e1, e2] = self.edges;
        Strategy::from_solid_angle(solid_angle::triangle(corner.as_dvec3(), e1, e2, self.cross))
    }

    #[inline]
    fn single_edges(&self) -> [Vec3A; 2] {
        self.edges.map(|edge| edge.as_vec3a())
    }

    /// See [`super::Light::sample`].
    #[inline]
    pub fn sample(&self, reference: Vec3A, u: [f32; 2]) -> Option<LightSample> {
        let corner = self.origin - reference;
        let strategy = self.strategy(corner);
        let at = match strategy {
            Strategy::EdgeOn => return None,
            Strategy::Area => warp::triangle(u),
            Strategy::SolidAngle(omega) => self.sample_solid_angle(corner.as_dvec3(), omega, u)?,
            Strategy::Hemisphere => {
                let dir = sample_facing_hemisphere(self.normal, corner, u).as_dvec3();
                let [b1, b2] = self.barycentric(corner.as_dvec3(), dir);
                (b1 >= 0.0 && b2 >= 0.0 && b1 + b2 <= 1.0).then_some([b1 as f32, b2 as f32])?
            }
        };
        self.sample_of_point(reference, at, |distance2, cos| self.density(strategy, distance2, cos))
    }

    /// Samples the barycentric coordinates of a point uniformly over the solid angle.
    #[inline(never)]
    fn sample_solid_angle(&self, corner: DVec3, omega: f64, u: [f32; 2]) -> Option<[f32; 2]> {
        let [e1, e2] = self.edges;
        let dir = solid_angle::sample_triangle(corner, corner + e1, corner + e2, omega, u)?;
        let [b1, b2] = self.barycentric(corner, dir).map(|b| b.clamp(0.0, 1.0));
        let excess = (b1 + b2).max(1.0);
        Some([b1, b2].map(|b| (b / excess) as f32))
    }

    /// Returns the sample at the point with barycentric coordinates `at`.
    /// - `pdf`: density, 1/sr, for the squared distance, m2, and the cosine at the light.
    #[inline]
    fn sample_of_point(
        &self,
        reference: Vec3A,
        at: [f32; 2],
        pdf: impl FnOnce(f32, f32) -> f32,
    ) -> Option<LightSample> {
        let [e1, e2] = self.single_edges();
        let position = self.origin + e1 * at[0] + e2 * at[1];
        // An edge may be twice as long as the largest coordinate.
        let scale = 3.0 * self.scale;
        sample_of_point(reference, position, self.normal, scale, pdf, |cos| self.emission.radiance(cos), at)
    }

    /// Returns the vertices, m.
    pub fn corners(&self) -> [Vec3A; 3] {
        let [e1, e2] = self.edges;
        let origin = self.origin.as_dvec3();
        [origin, origin + e1, origin + e2].map(|v| v.as_vec3a())
    }

    /// See [`super::Light::sample_in_direction`].
    #[inline]
    pub fn sample_in_direction(&self, reference: Vec3A, dir: Vec3A) -> Option<LightSample> {
        let corner = self.origin.as_dvec3() - reference.as_dvec3();
        let [e1, e2] = self.edges;
        let [b1, b2] = intersect_plane(corner, [e1, e2, self.cross], dir.as_dvec3())?;
        if b1 + b2 > 1.0 {
            return None;
        }
        self.sample_of_point(reference, [b1 as f32, b2 as f32], |_, _| 1.0)
    }

    /// Returns the barycentric coordinates of the point that the ray along `dir` hits.
    #[inline]
    fn barycentric(&self, corner: DVec3, dir: DVec3) -> [f64; 2] {
        let [e1, e2] = self.edges;
        let p = dir * (corner.dot(self.cross) / dir.dot(self.cross)) - corner;
        let scale = 1.0 / self.cross.length_squared();
        [p.cross(e2).dot(self.cross) * scale, e1.cross(p).dot(self.cross) * scale]
    }

    #[inline]
    fn density(&self, strategy: Strategy, distance2: f32, cos: f32) -> f32 {
        match strategy {
            Strategy::EdgeOn => 0.0,
            Strategy::Area => single_area_pdf(self.area, distance2, cos),
            Strategy::SolidAngle(omega) => (1.0 / omega) as f32,
            Strategy::Hemisphere => 1.0 / TAU,
        }
    }

    /// See [`super::Light::pdf`].
    #[inline]
    pub fn pdf(&self, reference: Vec3A, position: Vec3A, _normal: Vec3A, dir: Vec3A) -> f32 {
        let strategy = self.strategy(self.origin - reference);
        self.density(strategy, position.distance_squared(reference), dir.dot(self.normal))
    }

    /// Luminous flux, lm.
    pub fn power(&self) -> f32 {
        self.emission.power(self.area())
    }

    /// Bounding box.
    pub fn bounds(&self) -> (Vec3A, Vec3A) {
        bounding_box(&self.corners())
    }
}

/// Samples a direction uniformly over the hemisphere that faces the plane with `normal` through the point `a`.
#[inline]
pub(super) fn sample_facing_hemisphere(normal: Vec3A, a: Vec3A, u: [f32; 2]) -> Vec3A {
    let axis = if a.dot(normal) < 0.0 { -normal } else { normal };
    Frame::from_normal(axis).to_world(warp::direction(1.0 - u[0], u[1]))
}
