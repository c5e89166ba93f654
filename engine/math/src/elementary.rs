//! Elementary functions that return the same bits on every machine.
//!
//! All of them come from the `libm` crate. `f32::sin` and its kin call the platform's libm, which differs between systems. Square
//! root, division and the other IEEE operations are exact and are used directly. The price is a few nanoseconds per call on some
//! targets.

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
