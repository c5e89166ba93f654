//! A parallelogram, front side `edge_u x edge_v`.
//!
//! A rectangle is sampled uniformly over its solid angle (\[urena2013\]). Any other parallelogram is sampled as the two triangles
//! of its diagonal, one of which is chosen by solid angle. The limits are those of [`crate::solid_angle`].

use super::triangle::sample_facing_hemisphere;
use super::{LightSample, area_pdf, assemble_sample, bounding_box, intersect_plane};
use crate::emission::{Emission, EmittingSides};
use crate::solid_angle::{self, SphericalRectangle, Strategy};
use femc_math::glam::{DVec3, Vec3A};
use std::f32::consts::TAU;

/// Largest cosine between the edges of a rectangle. The resulting error in the density is of second order in it.
const MAX_RECTANGLE_COSINE: f64 = 1e-5;

/// A light in the shape of a parallelogram.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parallelogram {
    origin: DVec3,
    edge_u: DVec3,
    edge_v: DVec3,
    cross: DVec3,
    normal: DVec3,
    area: f64,
    /// Square of half the longer diagonal, m2.
    reach2: f64,
    shape: Shape,
    scale: Vec3A,
    /// Emission of the surface.
    pub emission: Emission,
}

/// Shape that determines the density.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Shape {
    /// Unit axes and extents of a rectangle.
    Rectangle { x: DVec3, y: DVec3, size: [f64; 2] },
    /// Other parallelograms, as two triangles.
    Skew,
}

/// Strategy for one reference point.
enum View {
    Rectangle(SphericalRectangle),
    /// Solid angles of the triangles at the origin and at the opposite corner.
    Skew(f64, f64),
}

impl Parallelogram {
    /// Creates the light.
    /// - `origin`: a corner, m; `edge_u`, `edge_v`: the edges from it, m.
    pub fn new(origin: Vec3A, edge_u: Vec3A, edge_v: Vec3A, emission: Emission) -> Self {
        let (a, u, v) = (origin.as_dvec3(), edge_u.as_dvec3(), edge_v.as_dvec3());
        let cross = u.cross(v);
        let size = [u.length(), v.length()];
        let right = u.dot(v).abs() <= MAX_RECTANGLE_COSINE * size[0] * size[1];
        let shape = if right && cross != DVec3::ZERO {
            // y is made exactly perpendicular to x within the plane.
            let x = u / size[0];
            Shape::Rectangle { x, y: cross.normalize().cross(x), size }
        } else {
            Shape::Skew
        };
        Self {
            origin: a,
            edge_u: u,
            edge_v: v,
            cross,
            normal: cross.normalize_or_zero(),
            area: cross.length(),
            reach2: 0.25 * (u + v).length_squared().max((u - v).length_squared()),
            shape,
            scale: origin.abs() + edge_u.abs() + edge_v.abs(),
            emission,
        }
    }

    /// Returns the front normal, unit; zero if the area is zero.
    pub fn normal(&self) -> Vec3A {
        self.normal.as_vec3a()
    }

    /// Returns the area, m2.
    pub fn area(&self) -> f64 {
        self.area
    }

    /// Returns the rectangle as seen from the reference; `a` is the origin corner relative to the reference.
    #[inline]
    fn view(&self, a: DVec3) -> (View, f64) {
        match self.shape {
            Shape::Rectangle { x, y, size } => {
                let r = SphericalRectangle::new(a, x, y, self.normal, size);
                (View::Rectangle(r), r.solid_angle())
            }
            Shape::Skew => {
                let near = solid_angle::triangle(a, self.edge_u, self.edge_v, self.cross);
                let opposite = a + self.edge_u + self.edge_v;
                let far = solid_angle::triangle(opposite, -self.edge_u, -self.edge_v, self.cross);
                (View::Skew(near, far), near + far)
            }
        }
    }

    #[inline]
    fn strategy(&self, a: DVec3) -> (Option<View>, Strategy) {
        let behind = a.dot(self.normal);
        if behind == 0.0 || (behind > 0.0 && self.emission.sides == EmittingSides::One) {
            return (None, Strategy::EdgeOn);
        }
        if solid_angle::is_far(a + 0.5 * (self.edge_u + self.edge_v), self.reach2) {
            return (None, Strategy::Area);
        }
        let (view, omega) = self.view(a);
        (Some(view), Strategy::from_solid_angle(omega))
    }

    /// Returns the corners in order, m.
    pub fn corners(&self) -> [Vec3A; 4] {
        let (u, v) = (self.edge_u, self.edge_v);
        [DVec3::ZERO, u, u + v, v].map(|corner| (self.origin + corner).as_vec3a())
    }

    /// See [`super::Light::sample_in_direction`].
    #[inline]
    pub fn sample_in_direction(&self, reference: Vec3A, dir: Vec3A) -> Option<LightSample> {
        let origin = reference.as_dvec3();
        let [u, v] = intersect_plane(self.origin - origin, [self.edge_u, self.edge_v, self.cross], dir.as_dvec3())?;
        if u.max(v) > 1.0 {
            return None;
        }
        let position = self.origin + self.edge_u * u + self.edge_v * v;
        assemble_sample(
            origin,
            position,
            self.normal,
            self.scale,
            |_, _| 1.0,
            |_, cos| self.emission.radiance(cos),
            [u, v],
        )
    }

    /// See [`super::Light::sample`].
    #[inline]
    pub fn sample(&self, reference: Vec3A, u: [f32; 2]) -> Option<LightSample> {
        let origin = reference.as_dvec3();
        let a = self.origin - origin;
        let (view, strategy) = self.strategy(a);
        let [s, t] = match strategy {
            Strategy::EdgeOn => return None,
            Strategy::Area => u.map(f64::from),
            Strategy::SolidAngle(_) => match view? {
                View::Rectangle(r) => r.sample(u),
                View::Skew(near, far) => self.sample_skew(a, near, far, u)?.map(|x| x.clamp(0.0, 1.0)),
            },
            Strategy::Hemisphere => {
                let [s, t] = self.coordinates(a, sample_facing_hemisphere(self.normal, a, u));
                ((0.0..=1.0).contains(&s) && (0.0..=1.0).contains(&t)).then_some([s, t])?
            }
        };
        let position = self.origin + self.edge_u * s + self.edge_v * t;
        assemble_sample(
            origin,
            position,
            self.normal,
            self.scale,
            |dir, distance| self.density(strategy, distance * distance, dir.dot(self.normal)),
            |_, cos| self.emission.radiance(cos),
            [s, t],
        )
    }

    #[inline]
    fn sample_skew(&self, a: DVec3, near: f64, far: f64, u: [f32; 2]) -> Option<[f64; 2]> {
        let split = (near / (near + far)) as f32;
        let (b, c) = (a + self.edge_u, a + self.edge_v);
        let dir = if u[0] < split {
            solid_angle::sample_triangle(a, b, c, near, [u[0] / split, u[1]])?
        } else {
            let rest = ((u[0] - split) / (1.0 - split)).min(1.0);
            solid_angle::sample_triangle(b + self.edge_v, c, b, far, [rest, u[1]])?
        };
        Some(self.coordinates(a, dir))
    }

    /// Returns (s, t) of the point that the ray along `dir` hits.
    #[inline]
    fn coordinates(&self, a: DVec3, dir: DVec3) -> [f64; 2] {
        let p = dir * (a.dot(self.cross) / dir.dot(self.cross)) - a;
        let scale = 1.0 / self.cross.length_squared();
        [p.cross(self.edge_v).dot(self.cross) * scale, self.edge_u.cross(p).dot(self.cross) * scale]
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
        let (_, strategy) = self.strategy(self.origin - reference.as_dvec3());
        let distance2 = position.as_dvec3().distance_squared(reference.as_dvec3());
        self.density(strategy, distance2, dir.as_dvec3().dot(self.normal))
    }

    /// Luminous flux, lm.
    pub fn power(&self) -> f32 {
        self.emission.power(self.area)
    }

    /// Bounding box.
    pub fn bounds(&self) -> (Vec3A, Vec3A) {
        let (a, u, v) = (self.origin, self.edge_u, self.edge_v);
        bounding_box(&[a, a + u, a + v, a + u + v].map(|p| p.as_vec3a()))
    }
}
