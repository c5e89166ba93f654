//! Fast approximations of elementary functions for densities, over vectors.
//!
//! Samples are divided by the same approximate density, so an error costs variance but no bias. Each function states its error.

use femc_simd::{Simd, Vector};

/// Approximates `exp(x)` for x >= 0, as a denominator. The result is too small by 0.4 % at 5, by 6 % at 10, and by more beyond, so
/// that far lights keep some weight; infinite on overflow.
#[inline(always)]
pub fn exp<S: Simd>(simd: S, x: S::V) -> S::V {
    let c = |x| simd.splat(x);
    let y = x * c(1.0 / 16.0);
    let p = c(1.0) + y * (c(1.0) + y * (c(0.5) + y * (c(1.0 / 6.0) + y * c(1.0 / 24.0))));
    let p = p * p;
    let p = p * p;
    let p = p * p;
    p * p
}

/// Approximates `exp(-x)` for x >= 0 with [`exp`].
#[inline(always)]
pub fn attenuation<S: Simd>(simd: S, x: S::V) -> S::V {
    simd.splat(1.0) / exp(simd, x)
}

/// Approximates `cos^-m` for a cosine in 0..1 and m >= 0, as a denominator, from below. The result is too small by 1 % at 60
/// degrees for m = 1, and by more for larger m and larger angles.
#[inline(always)]
pub fn inverse_cos_power<S: Simd>(simd: S, cos: S::V, m: S::V) -> S::V {
    let c = |x| simd.splat(x);
    let u = c(1.0) - cos;
    let logarithm = u * (c(1.0) + u * (c(0.5) + u * (c(1.0 / 3.0) + u * (c(0.25) + u * c(0.2)))));
    exp(simd, m * logarithm)
}

/// Approximates the arc tangent of x >= 0, which may be infinite, rad, to 2e-5.
#[inline(always)]
pub fn arc_tangent<S: Simd>(simd: S, x: S::V) -> S::V {
    let c = |x| simd.splat(x);
    let one = c(1.0);
    let is_large = one.lt(x);
    let z = is_large.select(one / x, x);
    let z2 = z * z;
    let p = c(0.052_653_32) - z2 * c(0.011_721_20);
    let p = c(0.193_543_46) + z2 * (c(-0.116_432_87) + z2 * p);
    let angle = z * (c(0.999_977_26) + z2 * (c(-0.332_623_47) + z2 * p));
    is_large.select(c(std::f32::consts::FRAC_PI_2) - angle, angle)
}

/// Approximates sine and cosine of x in 0..pi/4, to 4e-7.
#[inline(always)]
pub fn sine_cosine<S: Simd>(simd: S, x: S::V) -> (S::V, S::V) {
    let c = |x| simd.splat(x);
    let x2 = x * x;
    let sin = x * (c(1.0) - x2 * (c(1.0 / 6.0) - x2 * (c(1.0 / 120.0) - x2 * c(1.0 / 5040.0))));
    let cos = c(1.0) - x2 * (c(0.5) - x2 * (c(1.0 / 24.0) - x2 * (c(1.0 / 720.0) - x2 * c(1.0 / 40320.0))));
    (sin, cos)
}

/// Approximates the arc sine of x in 0..1, rad, to 3e-8 (\[abramowitz1964\], 4.4.46).
#[inline(always)]
pub fn arc_sine<S: Simd>(simd: S, x: S::V) -> S::V {
    let c = |x| simd.splat(x);
    let p = c(0.006_670_090_1) - x * c(0.001_262_491_1);
    let p = c(0.030_891_881_0) + x * (c(-0.017_088_125_6) + x * p);
    let p = c(0.088_978_987_4) + x * (c(-0.050_174_304_6) + x * p);
    let p = c(1.570_796_305_0) + x * (c(-0.214_598_801_6) + x * p);
    c(std::f32::consts::FRAC_PI_2) - (c(1.0) - x).max(c(0.0)).sqrt() * p
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_simd::{Kernel, Lanes, Level};

    /// Task that evaluates all functions at eight numbers.
    struct AllFunctions(Lanes);

    impl Kernel for AllFunctions {
        type Output = [Lanes; 5];

        #[inline(always)]
        fn run<S: Simd>(self, simd: S) -> [Lanes; 5] {
            let x = simd.load(&self.0);
            let (sin, cos) = sine_cosine(simd, x);
            [attenuation(simd, x), arc_tangent(simd, x), sin, cos, arc_sine(simd, x)].map(Vector::lanes)
        }
    }

    fn worst_error(low: f64, high: f64, function: usize, error: impl Fn(f64, f64) -> f64) -> f64 {
        let n = 20_000;
        let mut worst = 0.0f64;
        for i in 0..n / 8 {
            let x = Lanes(std::array::from_fn(|k| {
                (low + (high - low) * f64::from(8 * i + k as u32) / f64::from(n)) as f32
            }));
            let found = Level::detect().run(AllFunctions(x))[function];
            for (x, found) in x.0.into_iter().zip(found.0) {
                worst = worst.max(error(f64::from(x), f64::from(found)));
            }
        }
        worst
    }

    #[test]
    fn errors_are_as_stated() {
        let relative = |x: f64, found: f64| (found * x.exp() - 1.0).abs();
        assert!(worst_error(0.0, 5.0, 0, relative) < 4e-3, "{}", worst_error(0.0, 5.0, 0, relative));
        assert!(worst_error(0.0, 10.0, 0, relative) < 0.06, "{}", worst_error(0.0, 10.0, 0, relative));
        assert!(worst_error(0.0, 80.0, 0, |x, found| 1.0 - found * x.exp()) < 1e-5);
        assert!(worst_error(0.0, 30.0, 1, |x, found| (found - x.atan()).abs()) < 2e-5);
        assert!(worst_error(0.0, std::f64::consts::FRAC_PI_4, 2, |x, found| (found - x.sin()).abs()) < 4e-7);
        assert!(worst_error(0.0, std::f64::consts::FRAC_PI_4, 3, |x, found| (found - x.cos()).abs()) < 4e-7);
        assert!(worst_error(0.0, 1.0, 4, |x, found| (found - x.asin()).abs()) < 3e-7);
        let far = Level::detect().run(AllFunctions(Lanes([f32::INFINITY; 8])));
        assert_eq!(far[0], Lanes::ZERO);
        assert!((far[1].0[0] - std::f32::consts::FRAC_PI_2).abs() < 2e-5);
    }
}
