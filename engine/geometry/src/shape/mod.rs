//! Analytic shapes: exact intersections in f64 from f32 parameters.
//!
//! In f64, the side of the surface on which a ray starts is known far more accurately than the f32 offset that moved it there. So a
//! ray that left a convex shape cannot hit it again. The price is about twice the time of an f32 test; only shapes pay it.

mod cone;
mod polynomial;
mod ring;
mod sphere;
mod torus;

use crate::Aabb;
use femc_math::{
    elementary::double::{acos, atan2, sin_cos},
    glam::{DVec3, Vec3A},
};
use std::f64::consts::{PI, TAU};

/// Orientation of a shape: whether its front side is the outer or the inner one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Facing {
    /// Normals point outward.
    Outward,
    /// Normals point inward.
    Inward,
}

/// A curved surface (or a flat ring), m. Parameters of a hit: `u` is the angle about the axis / 2 pi in [0, 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Quadric {
    /// A sphere; `v` is the angle from +z / pi.
    Sphere {
        /// Center.
        center: Vec3A,
        /// Radius, > 0.
        radius: f32,
        /// Front side.
        facing: Facing,
    },
    /// An open truncated cone, a cylinder when the radii are equal; `v` goes from 0 at `start` to 1 at `end`.
    Cone {
        /// Center of the first end.
        start: Vec3A,
        /// Center of the second end.
        end: Vec3A,
        /// Radius at `start`; at most one radius is 0.
        start_radius: f32,
        /// Radius at `end`.
        end_radius: f32,
        /// Front side.
        facing: Facing,
    },
    /// A flat annulus with its front on the side of `normal`; `v` goes from 0 at `inner` to 1 at `outer`.
    Ring {
        /// Center.
        center: Vec3A,
        /// Unit normal.
        normal: Vec3A,
        /// Inner radius; may be 0.
        inner: f32,
        /// Outer radius.
        outer: f32,
    },
    /// A torus; `v` is the angle around the tube / 2 pi.
    Torus {
        /// Center.
        center: Vec3A,
        /// Unit axis.
        axis: Vec3A,
        /// Distance of the tube's center line from the axis.
        major: f32,
        /// Radius of the tube, at most `major`.
        minor: f32,
        /// Front side.
        facing: Facing,
    },
}

/// Crossings of a surface that count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CrossingFilter {
    /// Crossings in both directions.
    All,
    /// Only crossings from the outer side (for a ring: against its normal).
    Entering,
    /// Only crossings from the inner side.
    Leaving,
}

impl CrossingFilter {
    /// Returns whether a crossing counts, given the derivative along the ray of a function that increases outward.
    #[inline]
    fn admits(self, outward_slope: f64) -> bool {
        match self {
            Self::All => true,
            Self::Entering => outward_slope < 0.0,
            Self::Leaving => outward_slope > 0.0,
        }
    }
}

/// The surface point closest to a given point.
pub(crate) struct NearestPoint {
    pub position: DVec3,
    /// Unit normal of the front side.
    pub normal: DVec3,
    pub uv: [f64; 2],
}

/// An open interval of ray parameters.
#[derive(Clone, Copy)]
pub(crate) struct Span {
    pub from: f64,
    pub to: f64,
}

impl Span {
    #[inline]
    fn contains(&self, t: f64) -> bool {
        t > self.from && t < self.to
    }
}

impl Quadric {
    /// Returns the front side; for a ring it is the side of its normal.
    pub fn facing(&self) -> Facing {
        match *self {
            Self::Sphere { facing, .. } | Self::Cone { facing, .. } | Self::Torus { facing, .. } => facing,
            Self::Ring { .. } => Facing::Outward,
        }
    }

    /// Returns whether the shape is finite and has an area.
    pub fn is_valid(&self) -> bool {
        let good = match *self {
            Self::Sphere { radius, .. } => radius > 0.0,
            Self::Cone { start, end, start_radius, end_radius, .. } => {
                start != end && start_radius >= 0.0 && end_radius >= 0.0 && start_radius + end_radius > 0.0
            }
            Self::Ring { normal, inner, outer, .. } => normal != Vec3A::ZERO && inner >= 0.0 && outer > inner,
            Self::Torus { axis, major, minor, .. } => axis != Vec3A::ZERO && minor > 0.0 && major >= minor,
        };
        let bounds = self.bounds();
        good && bounds.min.is_finite() && bounds.max.is_finite()
    }

    /// Returns the smallest f32 box around the shape, up to rounding.
    pub fn bounds(&self) -> Aabb {
        /// Returns the half extents of a disc of unit radius with unit normal `n`.
        fn disc(n: DVec3) -> DVec3 {
            (DVec3::ONE - n * n).max(DVec3::ZERO).map(f64::sqrt)
        }
        match *self {
            Self::Sphere { center, radius, .. } => {
                Aabb::around_center(center.as_dvec3(), DVec3::splat(f64::from(radius)))
            }
            Self::Cone { start, end, start_radius, end_radius, .. } => {
                let extent = disc((end.as_dvec3() - start.as_dvec3()).normalize_or_zero());
                Aabb::around_center(start.as_dvec3(), extent * f64::from(start_radius))
                    .union(Aabb::around_center(end.as_dvec3(), extent * f64::from(end_radius)))
            }
            Self::Ring { center, normal, outer, .. } => {
                Aabb::around_center(center.as_dvec3(), disc(normal.as_dvec3().normalize_or_zero()) * f64::from(outer))
            }
            Self::Torus { center, axis, major, minor, .. } => {
                let extent = disc(axis.as_dvec3().normalize_or_zero()) * f64::from(major);
                Aabb::around_center(center.as_dvec3(), extent + f64::from(minor))
            }
        }
    }

    /// Returns the smallest ray parameter in `span` at which `origin + t dir` crosses the surface. `dir` need not be unit.
    #[inline]
    pub(crate) fn intersect(&self, origin: DVec3, dir: DVec3, span: Span, crossings: CrossingFilter) -> Option<f64> {
        match *self {
            Self::Sphere { center, radius, .. } => {
                sphere::intersect(origin - center.as_dvec3(), dir, f64::from(radius), span, crossings)
            }
            Self::Cone { start, end, start_radius, end_radius, .. } => {
                cone::Cone::new(start, end, start_radius, end_radius).intersect(origin, dir, span, crossings)
            }
            Self::Ring { center, normal, inner, outer } => ring::intersect(
                origin - center.as_dvec3(),
                dir,
                normal.as_dvec3(),
                [f64::from(inner), f64::from(outer)],
                span,
                crossings,
            ),
            Self::Torus { center, axis, major, minor, .. } => {
                let torus =
                    torus::Torus { axis: axis.as_dvec3().normalize(), major: major.into(), minor: minor.into() };
                torus.intersect(origin - center.as_dvec3(), dir, span, crossings)
            }
        }
    }

    /// Returns the point with the parameters `u` and `v` of a hit, and the unit normal of the front side there. This is the inverse
    /// of [`World::intersect`](crate::World::intersect)'s parameters (test `parameters_name_the_point_that_has_them`).
    pub fn point_at(&self, [u, v]: [f64; 2]) -> (DVec3, DVec3) {
        let around = |axis: DVec3| {
            let (x, y) = axis.any_orthonormal_pair();
            let (sin, cos) = sin_cos(TAU * u);
            x * cos + y * sin
        };
        let (position, normal) = match *self {
            Self::Sphere { center, radius, .. } => {
                let ((sin, cos), (sin_polar, cos_polar)) = (sin_cos(TAU * u), sin_cos(PI * v));
                let n = DVec3::new(sin_polar * cos, sin_polar * sin, cos_polar);
                (center.as_dvec3() + n * f64::from(radius), n)
            }
            Self::Cone { start, end, start_radius, end_radius, .. } => {
                let (start, end) = (start.as_dvec3(), end.as_dvec3());
                let (from, to) = (f64::from(start_radius), f64::from(end_radius));
                let axis = (end - start).normalize();
                let across = around(axis);
                let slope = (to - from) / (end - start).length();
                (start.lerp(end, v) + across * (from + (to - from) * v), (across - axis * slope).normalize())
            }
            Self::Ring { center, normal, inner, outer } => {
                let n = normal.as_dvec3().normalize();
                let (inner, outer) = (f64::from(inner), f64::from(outer));
                (center.as_dvec3() + around(n) * (inner + (outer - inner) * v), n)
            }
            Self::Torus { center, axis, major, minor, .. } => {
                let axis = axis.as_dvec3().normalize();
                let outward = around(axis);
                let (sin, cos) = sin_cos(TAU * v);
                let n = outward * cos + axis * sin;
                (center.as_dvec3() + outward * f64::from(major) + n * f64::from(minor), n)
            }
        };
        (position, if self.facing() == Facing::Inward { -normal } else { normal })
    }

    /// Returns the area, m2.
    pub fn area(&self) -> f64 {
        match *self {
            Self::Sphere { radius, .. } => 2.0 * TAU * f64::from(radius) * f64::from(radius),
            Self::Cone { start, end, start_radius, end_radius, .. } => {
                let (height, step) =
                    ((end.as_dvec3() - start.as_dvec3()).length(), f64::from(end_radius - start_radius));
                PI * f64::from(start_radius + end_radius) * (height * height + step * step).sqrt()
            }
            Self::Ring { inner, outer, .. } => PI * f64::from(outer + inner) * f64::from(outer - inner),
            Self::Torus { major, minor, .. } => TAU * TAU * f64::from(major) * f64::from(minor),
        }
    }

    /// Returns the share of the area with a second parameter below `v`, in [0, 1]. If it replaces `v`, equal steps of the
    /// parameters have equal areas.
    pub fn share_below(&self, v: f64) -> f64 {
        match *self {
            Self::Sphere { .. } => 0.5 - 0.5 * sin_cos(PI * v).1,
            Self::Cone { start_radius: a, end_radius: b, .. } | Self::Ring { inner: a, outer: b, .. } => {
                let (a, b) = (f64::from(a), f64::from(b));
                v * (2.0 * a + (b - a) * v) / (a + b)
            }
            Self::Torus { major, minor, .. } => v + f64::from(minor / major) * sin_cos(TAU * v).0 / TAU,
        }
    }

    /// Returns the second parameter below which a share of the area lies: the inverse of [`Self::share_below`].
    pub fn parameter_at_share(&self, share: f64) -> f64 {
        // The share increases with the parameter, so bisection passes through the cell that contains the closed form. It begins
        // there, and has the same result as from the whole interval (test `bisection_has_the_same_bits_from_the_closed_form`).
        const CELLS: f64 = (1u64 << 40) as f64;
        if let Some(near) = self.closed_parameter_at_share(share) {
            let cell = [0.0, 1.0].map(|end| ((near * CELLS).floor() + end) / CELLS);
            if self.share_below(cell[0]) < share && self.share_below(cell[1]) >= share {
                return self.bisect_share(share, cell, 12);
            }
        }
        self.bisect_share(share, [0.0, 1.0], 52)
    }

    /// Returns the middle of the interval after some steps of bisection. After 52 steps from [0, 1], the remaining error is a third
    /// of a step in double precision.
    pub(crate) fn bisect_share(&self, share: f64, [mut low, mut high]: [f64; 2], steps: u32) -> f64 {
        for _ in 0..steps {
            let middle = 0.5 * (low + high);
            if self.share_below(middle) < share { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }

    /// Returns the parameter at a share up to rounding, if there is a closed form.
    fn closed_parameter_at_share(&self, share: f64) -> Option<f64> {
        match *self {
            Self::Sphere { .. } => Some(acos(1.0 - 2.0 * share) / PI),
            Self::Cone { start_radius: a, end_radius: b, .. } | Self::Ring { inner: a, outer: b, .. } => {
                let (a, b) = (f64::from(a), f64::from(b));
                Some(share * (a + b) / (a + (a * a + (b * b - a * a) * share).sqrt()))
            }
            Self::Torus { .. } => None,
        }
    }

    /// Returns the surface point closest to `p`, which must be near the surface.
    pub(crate) fn nearest(&self, p: DVec3) -> NearestPoint {
        let (mut point, facing) = match *self {
            Self::Sphere { center, radius, facing } => {
                let n = (p - center.as_dvec3()).try_normalize().unwrap_or(DVec3::Z);
                let uv = [angle_fraction(n.y, n.x), 2.0 * angle_fraction((n.x * n.x + n.y * n.y).sqrt(), n.z)];
                (NearestPoint { position: center.as_dvec3() + n * f64::from(radius), normal: n, uv }, facing)
            }
            Self::Cone { start, end, start_radius, end_radius, facing } => {
                (cone::Cone::new(start, end, start_radius, end_radius).nearest(p), facing)
            }
            Self::Ring { center, normal, inner, outer } => {
                (ring::nearest(p, center.as_dvec3(), normal.as_dvec3(), [inner.into(), outer.into()]), Facing::Outward)
            }
            Self::Torus { center, axis, major, minor, facing } => {
                let torus =
                    torus::Torus { axis: axis.as_dvec3().normalize(), major: major.into(), minor: minor.into() };
                (torus.nearest(p, center.as_dvec3()), facing)
            }
        };
        if facing == Facing::Inward {
            point.normal = -point.normal;
        }
        point
    }
}

/// Returns the angle of the vector (`x`, `y`) / 2 pi, in [0, 1).
fn angle_fraction(y: f64, x: f64) -> f64 {
    let t = atan2(y, x) / TAU;
    if t < 0.0 { (t + 1.0).min(1.0 - f64::EPSILON) } else { t }
}

/// Returns the angle of `p` about `axis` / 2 pi, in [0, 1), from a fixed direction that depends only on the axis.
fn angle_fraction_about(axis: DVec3, p: DVec3) -> f64 {
    let (x, y) = axis.any_orthonormal_pair();
    angle_fraction(p.dot(y), p.dot(x))
}
