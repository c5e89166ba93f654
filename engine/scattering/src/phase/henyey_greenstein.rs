//! Henyey-Greenstein (\[henyey1941\]).
//!
//! Everything is by the versine 1 - cos from the direction of the peak: that of `g = 0.9999` is a ten-thousandth wide, and the cosine
//! there is 1 in single precision.

use std::f32::consts::PI;

/// For `g` = |g| by the versine from the peak.
#[inline]
pub fn eval(g: f32, versine: f32) -> f32 {
    let d = (1.0 - g) * (1.0 - g) + 2.0 * g * versine;
    (1.0 - g) * (1.0 + g) / (4.0 * PI * d * d.sqrt())
}

/// Inverse of the distribution function: the versine from the peak, 0 at `u` = 1, with the division by g carried out on paper so that
/// g = 0 is no special case.
#[inline]
pub fn sample_versine(g: f32, u: f32) -> f64 {
    let (g, u) = (f64::from(g), f64::from(u));
    let d = 1.0 - g + 2.0 * g * u;
    (1.0 - g) * (1.0 - g) * (1.0 - u) / d * (1.0 + (1.0 + g) / d)
}
