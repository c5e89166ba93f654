//! Schlick's rational approximation (\[blasi1993\]).

use femc_math::elementary::double::ln;
use std::f32::consts::PI;

/// Returns the density for `k` = |k| by the versine 1 - cos from the direction of the peak, where the cosine loses its digits.
#[inline]
pub fn eval(k: f32, versine: f32) -> f32 {
    let d = 1.0 - k + k * versine;
    (1.0 - k) * (1.0 + k) / (4.0 * PI * d * d)
}

/// Returns the inverse of the distribution function: the versine from the peak, 0 at `u` = 1.
#[inline]
pub fn sample_versine(k: f32, u: f32) -> f64 {
    let (k, u) = (f64::from(k), f64::from(u));
    2.0 * (1.0 - k) * (1.0 - u) / (1.0 - k + 2.0 * k * u)
}

/// Computes `1/k - (1 - k^2) / (2 k^2) ln((1 + k) / (1 - k))`, with its series near 0.
pub fn mean_cosine(k: f32) -> f32 {
    let k = f64::from(k);
    let mean = if k.abs() < 1e-3 {
        2.0 * k / 3.0
    } else {
        1.0 / k - (1.0 - k * k) / (2.0 * k * k) * ln((1.0 + k) / (1.0 - k))
    };
    mean as f32
}
