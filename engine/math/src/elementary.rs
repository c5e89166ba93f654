//! Elementary functions that return the same bits on every machine.
//!
//! Most of them come from the `libm` crate. `f32::sin` and its kin call the platform's libm, which differs between systems. Square
//! root, division and the other IEEE operations are exact and are used directly. The price is a few nanoseconds per call on some
//! targets. Paths use functions for less general arguments, which consist of such operations alone.

use glam::Vec3A;
use std::f32::consts::{FRAC_PI_2, LOG2_E, PI, TAU};

macro_rules! forward {
    ($($(#[$doc:meta])* $name:ident($($arg:ident),+) = $single:ident, $double:ident;)*) => {
        $($(#[$doc])* #[inline] pub fn $name($($arg: f32),+) -> f32 { libm::$single($($arg),+) })*
        /// Elementary functions in double precision.
        pub mod double {
            $($(#[$doc])* #[inline] pub fn $name($($arg: f64),+) -> f64 { libm::$double($($arg),+) })*
            /// Sine and cosine of `x` radians.
            #[inline]
            pub fn sin_cos(x: f64) -> (f64, f64) { libm::sincos(x) }
        }
    };
}

forward! {
    /// Sine of `x` radians.
    sin(x) = sinf, sin;
    /// Cosine of `x` radians.
    cos(x) = cosf, cos;
    /// Tangent of `x` radians.
    tan(x) = tanf, tan;
    /// Arc sine, radians; the argument is clamped to [-1, 1].
    asin(x) = asinf, asin;
    /// Arc cosine, radians.
    acos(x) = acosf, acos;
    /// Arc tangent, radians.
    atan(x) = atanf, atan;
    /// Angle of the vector (`x`, `y`), radians in [-pi, pi].
    atan2(y, x) = atan2f, atan2;
    /// `e^x`.
    exp(x) = expf, exp;
    /// `e^x - 1`, accurate near 0.
    exp_m1(x) = expm1f, expm1;
    /// Natural logarithm.
    ln(x) = logf, log;
    /// `ln(1 + x)`, accurate near 0.
    ln_1p(x) = log1pf, log1p;
    /// Base-2 logarithm.
    log2(x) = log2f, log2;
    /// Base-10 logarithm.
    log10(x) = log10f, log10;
    /// `x^y`.
    pow(x, y) = powf, pow;
    /// Cube root.
    cbrt(x) = cbrtf, cbrt;
    /// Length of the vector (`x`, `y`) without overflow.
    hypot(x, y) = hypotf, hypot;
    /// Floating-point remainder with the sign of `x`.
    fmod(x, y) = fmodf, fmod;
}

/// Sine and cosine of `x` radians.
#[inline]
pub fn sin_cos(x: f32) -> (f32, f32) {
    libm::sincosf(x)
}

/// Sine and cosine of an angle of at most pi / 4, radians, with errors below 1e-7. There is no branch and no table.
#[inline]
pub fn sin_cos_of_octant(x: f32) -> (f32, f32) {
    // Taylor series; the first omitted terms are 2e-9 and 2e-8 at pi / 4.
    let x2 = x * x;
    let sin = x + x * x2 * (-1.0 / 6.0 + x2 * (1.0 / 120.0 + x2 * (-1.0 / 5040.0 + x2 * (1.0 / 362_880.0))));
    let cos = 1.0 - 0.5 * x2 + x2 * x2 * (1.0 / 24.0 + x2 * (-1.0 / 720.0 + x2 * (1.0 / 40_320.0)));
    (sin, cos)
}

/// Sine and cosine of `turns` full turns, |turns| < 2^20, with errors below 2e-7.
#[inline]
pub fn sin_cos_of_turns(turns: f32) -> (f32, f32) {
    /// Adding it rounds to the nearest integer, which then is in the lowest bits of the mantissa.
    const ROUND: f32 = 1.5 * 8_388_608.0;
    let shifted = 4.0 * turns + ROUND;
    let quarter = shifted.to_bits();
    // The difference is exact.
    let (sin, cos) = sin_cos_of_octant((turns - 0.25 * (shifted - ROUND)) * TAU);
    let (a, b) = if quarter & 1 == 0 { (sin, cos) } else { (cos, sin) };
    let flip = |x: f32, negative: u32| f32::from_bits(x.to_bits() ^ (negative & 2) << 30);
    (flip(a, quarter), flip(b, quarter + 1))
}

/// `e^-x` for `x` >= 0, with a relative error below 2e-7; 0 for `x` > 87, where the result is not a normal number.
#[inline]
pub fn decay(x: f32) -> f32 {
    decay_of_each(Vec3A::splat(x)).x
}

/// [`decay`] of each coordinate.
#[inline]
pub fn decay_of_each(x: Vec3A) -> Vec3A {
    /// Adding it rounds to the nearest integer, which then is in the lowest bits of the mantissa.
    const ROUND: f32 = 1.5 * 8_388_608.0;
    /// Parts of the logarithm of 2. The first has few digits, so its products with small integers are exact.
    const LN_2: [f32; 2] = [0.693_145_75, 1.428_606_8e-6];
    const MAX: f32 = 87.0;
    let c = Vec3A::splat;
    let shifted = c(ROUND) - x * LOG2_E;
    let power = shifted - c(ROUND);
    let r = (-x - power * LN_2[0]) - power * LN_2[1];
    let sum = c(1.0 / 24.0) + r * (c(1.0 / 120.0) + r * (c(1.0 / 720.0) + r * (1.0 / 5040.0)));
    let sum = c(0.5) + r * (c(1.0 / 6.0) + r * sum);
    let mantissa = c(1.0) + (r + r * r * sum);
    let scale = shifted.to_array().map(|shifted| f32::from_bits(shifted.to_bits().wrapping_add(127) << 23));
    Vec3A::select(x.cmpgt(c(MAX)), Vec3A::ZERO, mantissa * Vec3A::from_array(scale))
}

/// Factors of r^1, r^3, .. of the arc tangent of r in [0, 1]; the relative error of the sum is at most 9e-8.
pub const ATAN: [f32; 8] = [
    0.999_999_9,
    -0.333_320_94,
    0.199_713_75,
    -0.140_294_2,
    0.099_427_6,
    -0.059_904_728,
    0.024_557_13,
    -0.004_780_456_5,
];

/// Angle of the vector (`x`, `y`), radians in [-pi, pi], with errors below 4e-7. Both coordinates are finite, and their ratio or its
/// inverse is. There is no branch and no table.
#[inline]
pub fn fast_atan2(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (least, most) = (ax.min(ay), ax.max(ay));
    let ratio = least / most;
    let angle = ratio * ATAN.iter().rev().fold(0.0, |sum, factor| sum * (ratio * ratio) + factor);
    let angle = if ay > ax { FRAC_PI_2 - angle } else { angle };
    (if x < 0.0 { PI - angle } else { angle }).copysign(y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn functions_of_paths_are_exact_to_rounding() {
        let (mut turns_error, mut angle_error) = (0.0f64, 0.0f64);
        for k in -40_000..40_000 {
            let turns = k as f32 * 7.3e-5;
            let (sin, cos) = sin_cos_of_turns(turns);
            let (exact_sin, exact_cos) = double::sin_cos(f64::from(turns) * std::f64::consts::TAU);
            turns_error = turns_error.max((f64::from(sin) - exact_sin).abs()).max((f64::from(cos) - exact_cos).abs());
            for length in [1e-18, 1.0, 3e18] {
                let (y, x) = (length * sin, length * cos);
                let error = f64::from(fast_atan2(y, x)) - double::atan2(y.into(), x.into());
                angle_error = angle_error.max(error.abs());
            }
        }
        assert!(turns_error < 2e-7 && angle_error < 4e-7, "{turns_error} {angle_error}");
        for (y, x) in [(0.0, 1.0), (1.0, 0.0), (-1.0, 0.0), (1e-30, 1.0), (-0.5, -0.5), (0.0, -1.0)] {
            assert!((fast_atan2(y, x) - atan2(y, x)).abs() < 3e-7, "{y} {x}");
        }
        let mut decay_error = 0.0f64;
        for k in 0..87_000 {
            for x in [k as f32 * 1e-3, k as f32 * 1e-9] {
                decay_error = decay_error.max((f64::from(decay(x)) * double::exp(x.into()) - 1.0).abs());
            }
        }
        assert!(decay_error < 2e-7, "{decay_error}");
        assert_eq!((decay(0.0), decay(88.0), decay(f32::INFINITY)), (1.0, 0.0, 0.0));
        assert!(decay(f32::NAN).is_nan());
    }
}
