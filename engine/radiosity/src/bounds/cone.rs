//! Cones of normals, and bounds of parts of curved surfaces.

use femc_field::{Form, Outline, Surface};
use femc_geometry::Quadric;
use femc_math::elementary::double::{atan2, sin_cos};
use femc_math::glam::{Affine3A, DVec3, Vec2, Vec3A};
use std::f64::consts::{PI, TAU};

/// Directions around an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalCone {
    /// Unit axis.
    pub axis: Vec3A,
    /// Greatest angle from the axis, in [0, pi].
    pub angle: f32,
}

/// Angle that is added to cones for rounding.
const ANGLE_ROUNDING: f64 = 1e-6;

impl NormalCone {
    /// Cone of all directions.
    pub const ALL: Self = Self { axis: Vec3A::Z, angle: std::f32::consts::PI };

    /// Returns a cone around both.
    pub fn union(self, other: Self) -> Self {
        let [a, b] = [self, other].map(|cone| (cone.axis.as_dvec3().normalize(), f64::from(cone.angle)));
        let between = atan2(a.0.cross(b.0).length(), a.0.dot(b.0));
        if between + b.1 <= a.1 {
            return self;
        }
        if between + a.1 <= b.1 {
            return other;
        }
        let angle = 0.5 * (a.1 + b.1 + between) + ANGLE_ROUNDING;
        if angle >= PI || between > PI - 1e-3 {
            return Self::ALL;
        }
        if between < 1e-3 {
            return Self { axis: self.axis, angle: (a.1.max(b.1) + between + ANGLE_ROUNDING).min(PI) as f32 };
        }
        // The axis turns from the first one to the second one.
        let turn = angle - a.1;
        let axis = a.0 * sin_cos(between - turn).0 + b.0 * sin_cos(turn).0;
        Self { axis: axis.normalize().as_vec3a(), angle: angle as f32 }
    }
}

/// Returns the greatest angle between the normal at the middle of a part of a surface and the part's other normals. For flat
/// surfaces it is the rounding of their normal.
pub fn spread_of_normals(surface: &Surface, outline: &Outline) -> f32 {
    match &surface.form {
        Form::Triangle([_, a, b]) | Form::Parallelogram([_, a, b]) => {
            let sine = f64::from(femc_math::cross(*a, *b).length()) / (f64::from(a.length()) * f64::from(b.length()));
            let rounding = 4.0 * f64::from(f32::EPSILON) / sine;
            if rounding < 1.0 { rounding as f32 } else { NormalCone::ALL.angle }
        }
        Form::Curved { shape, pose } => CurvedPart::new(shape, pose, outline).spread_of_normals(),
    }
}

/// Returns the corners of the box around a part of a quadric in its pose, m.
pub fn curved_box(shape: &Quadric, pose: &Affine3A, outline: &Outline) -> [DVec3; 2] {
    let part = CurvedPart::new(shape, pose, outline);
    let axes = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| part.extent_along(axis));
    [0, 1].map(|end| DVec3::from_array(axes.map(|extent| extent[end])))
}

/// A part of a curved surface between two values of each parameter.
struct CurvedPart<'a> {
    shape: &'a Quadric,
    pose: &'a Affine3A,
    /// Bounds of the angle about the axis.
    around: [f64; 2],
    /// Second parameter of the part's middle, and its bounds.
    middle: f64,
    along: [f64; 2],
}

/// Rounding of a surface's parameters.
const PARAMETER_ROUNDING: f64 = 1e-7;

impl<'a> CurvedPart<'a> {
    fn new(shape: &'a Quadric, pose: &'a Affine3A, outline: &Outline) -> Self {
        let corners = [Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE].map(|local| outline.point_at(local));
        let bounds = |parameter: fn(&Vec2) -> f32| {
            let values = corners.iter().map(parameter);
            let (low, high) =
                values.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
            [f64::from(low) - PARAMETER_ROUNDING, f64::from(high) + PARAMETER_ROUNDING]
        };
        let around = bounds(|corner| corner.x).map(|u| u * TAU);
        let along = bounds(|corner| corner.y).map(|share| shape.parameter_at_share(share.clamp(0.0, 1.0)));
        let middle = shape.parameter_at_share(f64::from(outline.point_at(Vec2::splat(0.5)).y));
        Self { shape, pose, around, middle, along }
    }

    /// Returns a bound on the angle to the normal at the middle: that along the surface, and then that around the axis.
    fn spread_of_normals(&self) -> f32 {
        let around = 0.5 * (self.around[1] - self.around[0]);
        let along = (self.along[1] - self.middle).max(self.middle - self.along[0]);
        let angle = match *self.shape {
            Quadric::Ring { .. } => 0.0,
            Quadric::Sphere { .. } => along * PI + around * sin_cos(self.middle * PI).0.abs(),
            Quadric::Cone { start, end, start_radius, end_radius, .. } => {
                let height = (end.as_dvec3() - start.as_dvec3()).length();
                let step = f64::from(end_radius) - f64::from(start_radius);
                around * height / (height * height + step * step).sqrt()
            }
            Quadric::Torus { .. } => along * TAU + around * sin_cos(self.middle * TAU).1.abs(),
        };
        (angle + 10.0 * ANGLE_ROUNDING).min(PI) as f32
    }

    /// Returns the least and greatest coordinate along an axis of the prepared frame, m.
    fn extent_along(&self, axis: DVec3) -> [f64; 2] {
        // The axis in the group's frame, times the scale of the pose.
        let columns = [self.pose.matrix3.x_axis, self.pose.matrix3.y_axis, self.pose.matrix3.z_axis];
        let dir = DVec3::from_array(columns.map(|column| column.as_dvec3().dot(axis)));
        let offset = self.pose.translation.as_dvec3().dot(axis);
        // Bounds of the component of the unit vector that turns about the shape's axis.
        let turning = |pair: (DVec3, DVec3)| wave_bounds(pair.0.dot(dir), pair.1.dot(dir), self.around);
        let local = match *self.shape {
            Quadric::Sphere { center, radius, .. } => {
                let [low, high] = turning((DVec3::X, DVec3::Y));
                let polar = self.along.map(|v| v * PI);
                let ends = [wave_bounds(dir.z, low, polar)[0], wave_bounds(dir.z, high, polar)[1]];
                ends.map(|end| center.as_dvec3().dot(dir) + f64::from(radius) * end)
            }
            Quadric::Cone { start, end, start_radius, end_radius, .. } => {
                let (start, end) = (start.as_dvec3(), end.as_dvec3());
                let turning = turning((end - start).normalize().any_orthonormal_pair());
                let (from, to) = (f64::from(start_radius), f64::from(end_radius));
                bounds_of(
                    self.along.map(|v| turning.map(|x| start.lerp(end, v).dot(dir) + x * (from + (to - from) * v))),
                )
            }
            Quadric::Ring { center, normal, inner, outer } => {
                let turning = turning(normal.as_dvec3().normalize().any_orthonormal_pair());
                let (inner, outer) = (f64::from(inner), f64::from(outer));
                let radius = self.along.map(|v| inner + (outer - inner) * v);
                bounds_of(radius.map(|radius| turning.map(|x| center.as_dvec3().dot(dir) + x * radius)))
            }
            Quadric::Torus { center, axis, major, minor, .. } => {
                let axis = axis.as_dvec3().normalize();
                let [low, high] = turning(axis.any_orthonormal_pair());
                let (major, minor) = (f64::from(major), f64::from(minor));
                let tube = self.along.map(|v| v * TAU);
                let at = |turning: f64, end: usize| {
                    major * turning + wave_bounds(minor * turning, minor * axis.dot(dir), tube)[end]
                };
                [at(low, 0), at(high, 1)].map(|x| center.as_dvec3().dot(dir) + x)
            }
        };
        local.map(|x| x + offset)
    }
}

/// Returns the least and greatest of some values.
fn bounds_of(values: [[f64; 2]; 2]) -> [f64; 2] {
    let [[a, b], [c, d]] = values;
    [a.min(b).min(c.min(d)), a.max(b).max(c.max(d))]
}

/// Returns the least and greatest value of `x` cos t + `y` sin t for t between two angles.
fn wave_bounds(x: f64, y: f64, [from, to]: [f64; 2]) -> [f64; 2] {
    let at = |t: f64| {
        let (sin, cos) = sin_cos(t);
        x * cos + y * sin
    };
    let (ends, amplitude, top) = ([at(from), at(to)], (x * x + y * y).sqrt(), atan2(y, x));
    let passes = |t: f64| ((to - t) / TAU).floor() >= ((from - t) / TAU).ceil();
    let low = if passes(top + PI) { -amplitude } else { ends[0].min(ends[1]) };
    let high = if passes(top) { amplitude } else { ends[0].max(ends[1]) };
    [low, high]
}
