//! Weights of lights for a segment of a ray in fog: the unoccluded light that is scattered once on it (airlight).
//!
//! With h the distance of a light from the ray and theta the angle from the perpendicular, the light scattered on the segment is
//! `I / h` times the integral over theta of transmittance, phase function and profile (\[kulla2012\]). A mean over a few angles
//! approximates the integral well for every position of the light.

use super::approx::{arc_tangent, attenuation, exp, sine_cosine};
use super::light_blocks::{LightLanes, Weigh, add_scaled, dot, splat, subtract};
use crate::tree::SegmentContext;
use femc_simd::{Simd, Vector};

/// Minimum weight of a light, as a fraction of its weight if it sent its peak intensity everywhere.
const WEIGHT_FLOOR: f32 = 0.01;

/// Maximum distance, m: larger distances are treated as this.
const MAX_DISTANCE: f32 = 1e9;

impl Weigh for SegmentContext {
    #[inline(always)]
    fn weigh<S: Simd>(&self, simd: S, lights: &LightLanes<S>) -> S::V {
        let c = |x| simd.splat(x);
        let (zero, one) = (c(0.0), c(1.0));
        let angles = self.angles.max(1) as f32;
        let (dir, origin) = (splat(simd, self.dir), splat(simd, self.origin));
        let from = subtract(origin, lights.center);
        let along = dot(from, dir);
        // Vector from the light to the nearest point of the line.
        let foot = add_scaled(from, dir, zero - along);
        let h2 = dot(foot, foot).max(c(0.25) * lights.radius * lights.radius).max(c(1e-12));
        let h = h2.sqrt();
        let inverse_h = one / h;
        let (start, end) = (along + c(self.range.0), along + c(self.range.1));
        let (to_start, to_end) = (one / (h2 + start * start).sqrt(), one / (h2 + end * end).sqrt());
        let length = c(self.range.1 - self.range.0);
        let tangent = h * length * to_start * to_end / (one + (h2 + start * end) * to_start * to_end).max(c(1e-7));
        let delta = c(2.0) * arc_tangent(simd, tangent);
        let (sin, cos) = sine_cosine(simd, delta * c(0.5 / angles));
        let (sin_step, cos_step) = (c(2.0) * sin * cos, one - c(2.0) * sin * sin);
        let (x, y) = (h * to_start, start * to_start);
        let (mut x, mut y) = (x * cos - y * sin, y * cos + x * sin);
        // For directions from the light by angle, the cosine with the axis is linear in the angle's cosine and sine.
        let across = dot(foot, lights.axis) * inverse_h;
        let ahead = dot(dir, lights.axis);
        let (eye, rest) = (c(self.extinction), lights.extinction);
        let k = self.phase;
        let mut sum = zero;
        for _ in 0..self.angles {
            let inverse_x = one / x.max(c(1e-6));
            let s = (h * y * inverse_x).max(start).min(end);
            let distance = s * y + h * x;
            let depth = (eye * (s - start) + rest * distance).max(zero);
            let lobe = one + c(k) * y;
            let [profile, below] = lights.profile(across * x + ahead * y, x * inverse_h);
            sum = sum + profile / (below * lobe * lobe * exp(simd, depth));
            (x, y) = (x * cos_step - y * sin_step, y * cos_step + x * sin_step);
        }
        let nearest = zero.max(start).min(end);
        let best = attenuation(simd, eye * (nearest - start) + rest * (h2 + nearest * nearest).sqrt());
        let mean = sum * c((1.0 - k * k) / angles);
        let last = along + c(self.end.min(MAX_DISTANCE));
        let weight = lights.intensity * delta * inverse_h * (mean + c(WEIGHT_FLOOR) * best);
        lights.faces(add_scaled(foot, dir, start), add_scaled(foot, dir, last)).select(weight, zero)
    }
}
