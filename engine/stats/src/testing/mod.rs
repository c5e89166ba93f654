//! Statistical tests: they check that a sampler draws from its density and that an estimator has its mean.
//!
//! A test states its level and corrects it with [`sidak`] for the number of tests that run together.

pub mod chi2;
pub mod gamma;
pub mod variants;
pub mod ztest;

pub use chi2::{Chi2, pooled_test, sphere_test};
pub use variants::assert_covers;
pub use ztest::{Moments, z_test};

/// Returns the level of each of `tests` independent tests, so that the probability of any false alarm among them is `level`
/// (\[sidak1967\]): `1 - (1 - level)^(1 / tests)`.
pub fn sidak(level: f64, tests: usize) -> f64 {
    -libm::expm1(libm::log1p(-level) / tests.max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::sidak;

    #[test]
    fn sidak_of_one_test_is_the_level_and_of_many_nearly_bonferroni() {
        assert!((sidak(0.01, 1) - 0.01).abs() < 1e-15);
        assert!((sidak(0.05, 2) - 0.025_320_565_519_103_6).abs() < 1e-15);
        let many = sidak(0.01, 1000);
        assert!(many > 0.01 / 1000.0 && many < 0.010_051 / 1000.0);
    }
}
