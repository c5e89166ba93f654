//! Henyey-Greenstein (\[henyey1941\]).

use std::f32::consts::PI;

#[inline]
pub fn eval(g: f32, cos: f32) -> f32 {
    // (1 - |g|)^2 + 2 |g| (1 -+ cos): no cancellation in the peak.
    let toward_peak = if g >= 0.0 { 1.0 - cos } else { 1.0 + cos };
    let g = g.abs();
    let d = (1.0 - g) * (1.0 - g) + 2.0 * g * toward_peak;
    (1.0 - g) * (1.0 + g) / (4.0 * PI * d * d.sqrt())
}

/// Inverse of the distribution function, with the division by g carried out on paper so that g = 0 is no special case.
#[inline]
pub fn sample_cos(g: f32, u: f32) -> f32 {
    let (g, s) = (f64::from(g), 2.0 * f64::from(u) - 1.0);
    let d = 1.0 + g * s;
    let cos = (s + g * (0.5 * (s * s + 3.0) + g * (s + 0.5 * g * (s * s - 1.0)))) / (d * d);
    cos.clamp(-1.0, 1.0) as f32
}
