use super::{CrossingFilter, NearestPoint, Span, angle_fraction_about};
use femc_math::glam::{DVec3, Vec3A};

/// An open truncated cone: distance from the axis = `radius + slope z` for z in [0, `height`].
pub(super) struct Cone {
    start: DVec3,
    axis: DVec3,
    height: f64,
    radius: f64,
    slope: f64,
}

impl Cone {
    #[inline]
    pub fn new(start: Vec3A, end: Vec3A, start_radius: f32, end_radius: f32) -> Self {
        let way = end.as_dvec3() - start.as_dvec3();
        let height = way.length();
        let (r0, r1) = (f64::from(start_radius), f64::from(end_radius));
        Self { start: start.as_dvec3(), axis: way / height, height, radius: r0, slope: (r1 - r0) / height }
    }

    /// Returns the first crossing in `span`. The quadratic is taken about the ray's point closest to the middle of the axis, so
    /// that distant rays keep their accuracy.
    #[inline]
    pub fn intersect(&self, origin: DVec3, dir: DVec3, span: Span, crossings: CrossingFilter) -> Option<f64> {
        let from_middle = self.start + self.axis * (0.5 * self.height) - origin;
        let shift = from_middle.dot(dir) / dir.length_squared();
        let p = origin + dir * shift - self.start;
        let (z, dz) = (p.dot(self.axis), dir.dot(self.axis));
        let (across, dacross) = (p - self.axis * z, dir - self.axis * dz);
        let (r, dr) = (self.radius + self.slope * z, self.slope * dz);
        // |across + t dacross|^2 - (r + t dr)^2 = a t^2 + 2 b t + c
        let a = dacross.length_squared() - dr * dr;
        let b = across.dot(dacross) - r * dr;
        let c = across.length_squared() - r * r;
        let discriminant = b * b - a * c;
        if discriminant < 0.0 {
            return None;
        }
        let q = -(b + discriminant.sqrt().copysign(b));
        let (t0, t1) = (q / a, c / q);
        let (near, far) = if t0 < t1 || t1.is_nan() { (t0, t1) } else { (t1, t0) };
        [near, far].into_iter().find_map(|t| {
            let height = z + t * dz;
            let inside = (0.0..=self.height).contains(&height);
            (inside && span.contains(t + shift) && crossings.admits(a * t + b)).then_some(t + shift)
        })
    }

    pub fn nearest(&self, p: DVec3) -> NearestPoint {
        let q = p - self.start;
        let z = q.dot(self.axis).clamp(0.0, self.height);
        let across =
            (q - self.axis * q.dot(self.axis)).try_normalize().unwrap_or_else(|| self.axis.any_orthonormal_vector());
        NearestPoint {
            position: self.start + self.axis * z + across * (self.radius + self.slope * z),
            normal: (across - self.axis * self.slope).normalize(),
            uv: [angle_fraction_about(self.axis, across), z / self.height],
        }
    }
}
