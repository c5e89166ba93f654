//! Henyey-Greenstein (\[henyey1941\]).
//!
//! All computations use the versine 1 - cos from the direction of the peak. The peak of `g = 0.9999` is a ten-thousandth wide, and
//! the cosine there is 1 in single precision.

use std::f32::consts::PI;

/// Returns the density for `g` = |g| by the versine from the peak.
#[inline]
pub fn eval(g: f32, versine: f32) -> f32 {
    let d = (1.0 - g) * (1.0 - g) + 2.0 * g * versine;
    (1.0 - g) * (1.0 + g) / (4.0 * PI * d * d.sqrt())
}

/// Returns the inverse of the distribution function: the versine from the peak, 0 at `u` = 1. The division by g is carried out
/// analytically, so that g = 0 needs no special case.
#[inline]
pub fn sample_versine(g: f32, u: f32) -> f64 {
    let (g, u) = (f64::from(g), f64::from(u));
    let d = 1.0 - g + 2.0 * g * u;
    (1.0 - g) * (1.0 - g) * (1.0 - u) / d * (1.0 + (1.0 + g) / d)
}
