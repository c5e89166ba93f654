//! Two-sided z test of a mean.

/// Running mean and variance of independent values, by Welford's recurrence (\[welford1962\]).
#[derive(Clone, Copy, Debug, Default)]
pub struct Moments {
    /// Number of values.
    pub count: u64,
    /// Mean of the values.
    pub mean: f64,
    squares: f64,
}

impl Moments {
    /// Adds `value`.
    pub fn add(&mut self, value: f64) {
        self.count += 1;
        let delta = value - self.mean;
        self.mean += delta / self.count as f64;
        self.squares += delta * (value - self.mean);
    }

    /// Returns the unbiased variance of the values; 0 for fewer than two.
    pub fn variance(&self) -> f64 {
        if self.count < 2 { 0.0 } else { self.squares / (self.count - 1) as f64 }
    }

    /// Returns the standard error of the mean.
    pub fn standard_error(&self) -> f64 {
        (self.variance() / self.count.max(1) as f64).sqrt()
    }

    /// Returns the probability that an unbiased estimator of `expected` misses by this much or more (see [`z_test`]).
    pub fn p_value(&self, expected: f64) -> f64 {
        z_test(self.mean, self.standard_error(), expected)
    }
}

impl Extend<f64> for Moments {
    fn extend<T: IntoIterator<Item = f64>>(&mut self, values: T) {
        values.into_iter().for_each(|v| self.add(v));
    }
}

/// Returns the two-sided p-value of a normal `mean` with `standard_error` under the hypothesis that its expectation is `expected`.
///
/// A standard error of zero gives 1 where the mean is `expected` to 12 digits and 0 elsewhere; NaN gives 0.
pub fn z_test(mean: f64, standard_error: f64, expected: f64) -> f64 {
    let miss = (mean - expected).abs();
    if miss.is_nan() || standard_error.is_nan() {
        return 0.0;
    }
    if standard_error == 0.0 {
        return f64::from(u8::from(miss <= 1e-12 * expected.abs()));
    }
    libm::erfc(miss / standard_error * std::f64::consts::FRAC_1_SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn p_values_match_the_normal_table() {
        assert!((z_test(1.959_963_985, 1.0, 0.0) - 0.05).abs() < 1e-9);
        assert!((z_test(5.0 - 2.0 * 2.575_829_304, 2.0, 5.0) - 0.01).abs() < 1e-9);
        assert_eq!(z_test(3.0, 0.0, 3.0), 1.0);
        assert_eq!(z_test(3.1, 0.0, 3.0), 0.0);
        assert_eq!(z_test(f64::NAN, 1.0, 3.0), 0.0);
    }

    #[test]
    fn moments_of_a_small_set_are_exact() {
        let mut m = Moments::default();
        m.extend([2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]);
        assert_eq!(m.mean, 5.0);
        assert!((m.variance() - 32.0 / 7.0).abs() < 1e-14);
        assert!((m.standard_error() - (4.0f64 / 7.0).sqrt()).abs() < 1e-14);
    }
}
