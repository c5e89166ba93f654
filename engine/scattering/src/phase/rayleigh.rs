//! Rayleigh scattering of unpolarized light.

use femc_math::elementary::cbrt;
use std::f32::consts::PI;

#[inline]
pub fn eval(cos: f32) -> f32 {
    3.0 / (16.0 * PI) * (1.0 + cos * cos)
}

/// Returns the real root of `c^3 + 3 c = 8 u - 4` (\[frisvad2011\]), computed on the side without cancellation.
#[inline]
pub fn sample_cos(u: f32) -> f32 {
    let q = 4.0 * u - 2.0;
    let a = cbrt(q.abs() + (q * q + 1.0).sqrt());
    ((a - 1.0 / a).copysign(q)).clamp(-1.0, 1.0)
}
