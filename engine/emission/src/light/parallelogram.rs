//! A parallelogram, front side `edge_u x edge_v`.
//!
//! A rectangle is sampled uniformly over its solid angle (\[urena2013\]). Any other parallelogram is sampled as the two triangles
//! of its diagonal, one of which is chosen by solid angle. The triangles are computed in double precision. The limits are those of
//! [`crate::solid_angle`].

use super::triangle::sample_facing_hemisphere;
use super::{LightSample, bounding_box, intersect_plane, sample_of_point, single_area_pdf};
use crate::emission::{AngularProfile, Emission, EmittingSides};
use crate::solid_angle::{self, RectangleView, Strategy};
use femc_math::Rgb;
use femc_math::glam::{DVec3, Vec3A};
use std::f32::consts::TAU;

/// Largest cosine between the edges of a rectangle. The resulting error in the density is of second order in it.
const MAX_RECTANGLE_COSINE: f64 = 1e-5;

/// A light in the shape of a parallelogram.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parallelogram {
    origin: Vec3A,
    edges: [Vec3A; 2],
    normal: Vec3A,
    area: f32,
    /// Square of half the longer diagonal, m2.
    reach2: f32,
    shape: Shape,
    scale: Vec3A,
    /// Emission of the surface.
    pub emission: Emission,
}

/// Shape that determines the density.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Shape {
    /// Unit axes and extents of a rectangle.
    Rectangle { axes: [Vec3A; 2], size: [f32; 2] },
    /// Other parallelograms, as two triangles.
    Skew(Edges),
}

/// Edges and their cross product in double precision.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Edges {
    u: DVec3,
    v: DVec3,
    cross: DVec3,
}

/// Data of a rectangle with the same radiance at each point and in each direction, for samples from several reference points.
#[derive(Clone, Copy, Debug)]
pub struct UniformRectangle {
    /// A corner, m.
    pub origin: Vec3A,
    /// Edges from it, m.
    pub edges: [Vec3A; 2],
    /// Front normal, unit.
    pub normal: Vec3A,
    /// Unit axes, and extents along them, m.
    pub axes: [Vec3A; 2],
    /// Extents along the axes, m.
    pub size: [f32; 2],
    /// Area, m2.
    pub area: f32,
    /// Square of half the diagonal, m2.
    pub reach2: f32,
    /// Scale of position errors, m.
    pub scale: Vec3A,
    /// Sides that emit.
    pub sides: EmittingSides,
    /// Radiance, cd/m2.
    pub radiance: Rgb,
}

/// View of the light from one reference point, which determines the density.
enum View {
    /// Nothing arrives.
    Dark,
    /// A point is sampled uniformly over the area.
    Area,
    /// Uniform over the solid angle of a rectangle.
    Rectangle(RectangleView),
    /// Uniform over the solid angles of the triangles at the origin and at the opposite corner, sr.
    Skew(Edges, f64, f64),
    /// Uniform over the hemisphere on the light's side; directions that miss are dropped.
    Hemisphere,
}

impl Parallelogram {
    /// Creates the light.
    /// - `origin`: a corner, m; `edge_u`, `edge_v`: the edges from it, m.
    pub fn new(origin: Vec3A, edge_u: Vec3A, edge_v: Vec3A, emission: Emission) -> Self {
        let (u, v) = (edge_u.as_dvec3(), edge_v.as_dvec3());
        let cross = u.cross(v);
        let size = [u.length(), v.length()];
        let right = u.dot(v).abs() <= MAX_RECTANGLE_COSINE * size[0] * size[1];
        let shape = if right && cross != DVec3::ZERO {
            // y is made exactly perpendicular to x within the plane.
            let x = u / size[0];
            let axes = [x, cross.normalize().cross(x)].map(|axis| axis.as_vec3a());
            Shape::Rectangle { axes, size: size.map(|size| size as f32) }
        } else {
            Shape::Skew(Edges { u, v, cross })
        };
        Self {
            origin,
            edges: [edge_u, edge_v],
            normal: cross.normalize_or_zero().as_vec3a(),
            area: cross.length() as f32,
            reach2: (0.25 * (u + v).length_squared().max((u - v).length_squared())) as f32,
            shape,
            scale: origin.abs() + edge_u.abs() + edge_v.abs(),
            emission,
        }
    }

    /// Returns the front normal, unit; zero if the area is zero.
    pub fn normal(&self) -> Vec3A {
        self.normal
    }

    /// Returns the area, m2.
    pub fn area(&self) -> f64 {
        self.area.into()
    }

    /// Returns the data of a rectangle with the same radiance at each point and in each direction; `None` for others.
    pub fn uniform_rectangle(&self) -> Option<UniformRectangle> {
        let Self { origin, edges, normal, area, reach2, scale, emission, .. } = *self;
        let Shape::Rectangle { axes, size } = self.shape else { return None };
        (emission.profile == AngularProfile::Lambertian).then(|| UniformRectangle {
            origin,
            edges,
            normal,
            axes,
            size,
            area,
            reach2,
            scale,
            sides: emission.sides,
            radiance: emission.radiance(1.0),
        })
    }

    /// Returns the view from a reference point.
    /// - `corner`: from the reference to the origin, m.
    #[inline]
    fn view(&self, corner: Vec3A) -> View {
        let behind = corner.dot(self.normal);
        if behind == 0.0 || (behind > 0.0 && self.emission.sides == EmittingSides::One) {
            return View::Dark;
        }
        let center = corner + 0.5 * (self.edges[0] + self.edges[1]);
        if solid_angle::is_far(self.reach2, center.length_squared()) {
            return View::Area;
        }
        match self.shape {
            Shape::Rectangle { axes: [x, y], size } => {
                let view = RectangleView::new([corner.dot(x), corner.dot(y), behind.abs()], size);
                if view.solid_angle() >= solid_angle::MAX_SOLID_ANGLE as f32 {
                    View::Hemisphere
                } else if view.solid_angle() >= solid_angle::MIN_RECTANGLE_SOLID_ANGLE {
                    View::Rectangle(view)
                } else {
                    View::Area
                }
            }
            Shape::Skew(edges) => Self::skew_view(corner.as_dvec3(), edges),
        }
    }

    #[inline(never)]
    fn skew_view(corner: DVec3, edges: Edges) -> View {
        let Edges { u, v, cross } = edges;
        let near = solid_angle::triangle(corner, u, v, cross);
        let far = solid_angle::triangle(corner + u + v, -u, -v, cross);
        match Strategy::from_solid_angle(near + far) {
            Strategy::SolidAngle(_) => View::Skew(edges, near, far),
            Strategy::Hemisphere => View::Hemisphere,
            Strategy::Area => View::Area,
            Strategy::EdgeOn => View::Dark,
        }
    }

    /// Returns the corners in order, m.
    pub fn corners(&self) -> [Vec3A; 4] {
        let [u, v] = self.edges;
        [Vec3A::ZERO, u, u + v, v].map(|corner| self.origin + corner)
    }

    /// Returns the edges in double precision.
    fn double_edges(&self) -> Edges {
        let [u, v] = self.edges.map(|edge| edge.as_dvec3());
        Edges { u, v, cross: u.cross(v) }
    }

    #[inline]
    fn point(&self, [s, t]: [f32; 2]) -> Vec3A {
        self.origin + self.edges[0] * s + self.edges[1] * t
    }

    /// See [`super::Light::sample_in_direction`].
    #[inline]
    pub fn sample_in_direction(&self, reference: Vec3A, dir: Vec3A) -> Option<LightSample> {
        let Edges { u, v, cross } = self.double_edges();
        let corner = self.origin.as_dvec3() - reference.as_dvec3();
        let [s, t] = intersect_plane(corner, [u, v, cross], dir.as_dvec3())?;
        if s.max(t) > 1.0 {
            return None;
        }
        self.sample_of_point(reference, [s as f32, t as f32], |_, _| 1.0)
    }

    /// See [`super::Light::sample`].
    #[inline]
    pub fn sample(&self, reference: Vec3A, u: [f32; 2]) -> Option<LightSample> {
        let corner = self.origin - reference;
        match self.view(corner) {
            View::Dark => None,
            View::Area => {
                self.sample_of_point(reference, u, |distance2, cos| single_area_pdf(self.area, distance2, cos))
            }
            View::Rectangle(view) => self.sample_of_point(reference, view.sample(u), |_, _| view.density()),
            View::Skew(edges, near, far) => {
                let at = Self::sample_skew(corner.as_dvec3(), edges, near, far, u)?;
                self.sample_of_point(reference, at, |_, _| (1.0 / (near + far)) as f32)
            }
            View::Hemisphere => {
                let dir = sample_facing_hemisphere(self.normal, corner, u).as_dvec3();
                let [s, t] = coordinates(corner.as_dvec3(), dir, &self.double_edges()).map(|x| x as f32);
                if !((0.0..=1.0).contains(&s) && (0.0..=1.0).contains(&t)) {
                    return None;
                }
                self.sample_of_point(reference, [s, t], |_, _| 1.0 / TAU)
            }
        }
    }

    /// Returns the sample at the point (s, t).
    /// - `pdf`: density, 1/sr, for the squared distance, m2, and the cosine at the light.
    #[inline]
    fn sample_of_point(
        &self,
        reference: Vec3A,
        at: [f32; 2],
        pdf: impl FnOnce(f32, f32) -> f32,
    ) -> Option<LightSample> {
        sample_of_point(reference, self.point(at), self.normal, self.scale, pdf, |cos| self.emission.radiance(cos), at)
    }

    #[inline(never)]
    fn sample_skew(corner: DVec3, edges: Edges, near: f64, far: f64, u: [f32; 2]) -> Option<[f32; 2]> {
        let split = (near / (near + far)) as f32;
        let (b, c) = (corner + edges.u, corner + edges.v);
        let dir = if u[0] < split {
            solid_angle::sample_triangle(corner, b, c, near, [u[0] / split, u[1]])?
        } else {
            let rest = ((u[0] - split) / (1.0 - split)).min(1.0);
            solid_angle::sample_triangle(b + edges.v, c, b, far, [rest, u[1]])?
        };
        Some(coordinates(corner, dir, &edges).map(|x| x.clamp(0.0, 1.0) as f32))
    }

    /// See [`super::Light::pdf`].
    #[inline]
    pub fn pdf(&self, reference: Vec3A, position: Vec3A, _normal: Vec3A, dir: Vec3A) -> f32 {
        match self.view(self.origin - reference) {
            View::Dark => 0.0,
            View::Area => single_area_pdf(self.area, position.distance_squared(reference), dir.dot(self.normal)),
            View::Rectangle(view) => view.density(),
            View::Skew(_, near, far) => (1.0 / (near + far)) as f32,
            View::Hemisphere => 1.0 / TAU,
        }
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

/// Returns (s, t) of the point of a parallelogram that the ray from the reference along `dir` hits.
/// - `corner`: from the reference to the corner of the edges, m.
#[inline]
fn coordinates(corner: DVec3, dir: DVec3, edges: &Edges) -> [f64; 2] {
    let Edges { u, v, cross } = *edges;
    let p = dir * (corner.dot(cross) / dir.dot(cross)) - corner;
    let scale = 1.0 / cross.length_squared();
    [p.cross(v).dot(cross) * scale, u.cross(p).dot(cross) * scale]
}
