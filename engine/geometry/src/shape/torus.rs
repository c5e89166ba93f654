use super::{CrossingFilter, NearestPoint, Span, angle_fraction, angle_fraction_about, polynomial};
use femc_math::glam::DVec3;

/// A torus about 0: f(p) = (|p|^2 + R^2 - r^2)^2 - 4 R^2 |p - (p . axis) axis|^2, negative in the tube.
pub(super) struct Torus {
    pub axis: DVec3,
    pub major: f64,
    pub minor: f64,
}

impl Torus {
    fn value(&self, p: DVec3) -> f64 {
        let z = p.dot(self.axis);
        let squared = p.length_squared();
        let g = squared + (self.major - self.minor) * (self.major + self.minor);
        g * g - 4.0 * self.major * self.major * (squared - z * z)
    }

    /// Returns the first crossing in `span`. The quartic's critical points (roots of its cubic derivative) cut the ray into pieces
    /// on which f is monotone. A piece contains a crossing exactly when f changes its sign over it. The sign is that of f itself
    /// and not of the expanded polynomial, so the side of the surface on which the ray starts is never in doubt.
    pub fn intersect(&self, origin: DVec3, dir: DVec3, span: Span, crossings: CrossingFilter) -> Option<f64> {
        let speed = dir.length();
        let d = dir / speed;
        // Arc length s from the point of closest approach to the center.
        let shift = -origin.dot(d);
        let p = origin + d * shift;
        let reach = self.major + self.minor;
        let half_squared = reach * reach - p.length_squared();
        if half_squared <= 0.0 {
            return None;
        }
        let half = half_squared.sqrt() * (1.0 + 1e-12);
        let (start, end) = ((span.from * speed - shift).max(-half), (span.to * speed - shift).min(half));
        if start >= end {
            return None;
        }
        let (a, b) = (p.dot(self.axis), d.dot(self.axis));
        let pp = p.length_squared();
        let g = pp + (self.major - self.minor) * (self.major + self.minor);
        let four_rr = 4.0 * self.major * self.major;
        // f = s^4 + 2 g s^2 + g^2 - 4 R^2 ((1 - b^2) s^2 - 2 a b s + pp - a^2), since p . d = 0.
        let derivative = [2.0 * four_rr * a * b, 4.0 * g - 2.0 * four_rr * (1.0 - b * b), 0.0, 4.0];
        let f = |s: f64| {
            // At the ray's own origin the value of the given point is used, without the rounding of s.
            if s + shift <= 0.0 { self.value(origin) } else { self.value(p + d * s) }
        };
        let critical = polynomial::cubic_roots_between(&derivative, start, end);
        let mut lo = start;
        let mut f_lo = f(lo);
        for hi in critical.iter().copied().chain([end]) {
            let f_hi = f(hi);
            if (f_lo < 0.0) != (f_hi < 0.0) && crossings.admits(f_hi - f_lo) {
                let t = (polynomial::bracketed_root(&f, lo, hi) + shift) / speed;
                if span.contains(t) {
                    return Some(t);
                }
            }
            (lo, f_lo) = (hi, f_hi);
        }
        None
    }

    pub fn nearest(&self, p: DVec3, center: DVec3) -> NearestPoint {
        let q = p - center;
        let z = q.dot(self.axis);
        let flat = q - self.axis * z;
        let outward = flat.try_normalize().unwrap_or_else(|| self.axis.any_orthonormal_vector());
        let n = (q - outward * self.major).try_normalize().unwrap_or(outward);
        NearestPoint {
            position: center + outward * self.major + n * self.minor,
            normal: n,
            uv: [angle_fraction_about(self.axis, outward), angle_fraction(z, flat.length() - self.major)],
        }
    }
}
