//! Distances along a ray with the density of the angle subtended at a point (\[kulla2012\]).
//!
//! With h the distance of the point from the ray, `pdf(t) = h / (delta (h^2 + t'^2))`, t' the distance from the foot of the
//! perpendicular and delta the angle of the whole segment. The inverse is written from the segment's start,
//! `t = sin(x) (h^2 + a^2) / (h cos(x) - a sin(x))`, a = t' at the start and x = u delta: nothing cancels for points far
//! beside, before or behind the segment.

use femc_math::elementary::double::{atan2, sin_cos};
use femc_math::glam::Vec3A;

/// Sampling of distances on `[0, t_max]` of one ray about one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Equiangular {
    /// Distance of the point from the ray, m, > 0.
    h: f64,
    /// Coordinate of the ray's origin from the foot of the perpendicular, m.
    a: f64,
    /// Angle of the segment at the point, rad; 0 if there is nothing to sample.
    delta: f64,
    t_max: f64,
}

impl Equiangular {
    /// - `origin`, m; `dir`: unit; `t_max`: m, may be infinite; `center`: the point, m.
    /// - `least_distance`: the point is treated as no nearer to the ray than this, m, > 0 (1e-6 of the scene's extent).
    pub fn new(origin: Vec3A, dir: Vec3A, t_max: f32, center: Vec3A, least_distance: f32) -> Self {
        let v = center.as_dvec3() - origin.as_dvec3();
        let dir = dir.as_dvec3();
        let h = v.cross(dir).length().max(f64::from(least_distance)).max(f64::MIN_POSITIVE.sqrt());
        let a = -v.dot(dir);
        let t_max = f64::from(t_max);
        // The angle between the two ends, from the sine and cosine of the difference; the limit where t_max is infinite.
        let delta = if t_max == f64::INFINITY { atan2(h, a) } else { atan2(h * t_max, h * h + a * (a + t_max)) };
        Self { h, a, delta: if t_max > 0.0 { delta } else { 0.0 }, t_max }
    }

    /// A distance, m, and its density, 1/m, from `u` in [0, 1). `None` on an empty segment.
    #[inline]
    pub fn sample(&self, u: f32) -> Option<(f32, f32)> {
        let (sin, cos) = sin_cos(f64::from(u) * self.delta);
        let t = sin * (self.h * self.h + self.a * self.a) / (self.h * cos - self.a * sin);
        let t = if t.is_nan() { 0.0 } else { t.clamp(0.0, self.t_max.min(f64::from(f32::MAX))) } as f32;
        let pdf = self.pdf(t);
        (pdf > 0.0).then_some((t, pdf))
    }

    /// Density at distance `t`, 1/m; 0 outside the segment.
    #[inline]
    pub fn pdf(&self, t: f32) -> f32 {
        let t = f64::from(t);
        if self.delta <= 0.0 || t < 0.0 || t > self.t_max {
            return 0.0;
        }
        let along = self.a + t;
        let pdf = (self.h / (self.delta * (self.h * self.h + along * along))) as f32;
        if pdf.is_finite() { pdf } else { 0.0 }
    }
}
