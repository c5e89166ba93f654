//! Means over seeds, their intervals, and ratios.

use femc_film::convergence::student_95;
use serde::Serialize;

/// A mean over seeds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Mean value.
    pub mean: f64,
    /// Half width of the 95 % interval by Student's distribution; `None` for a single value.
    pub half_width: Option<f64>,
}

impl Estimate {
    /// Computes the mean of one or more independent values.
    pub fn from_values(values: &[f64]) -> Self {
        let (mean, variance) = mean_and_variance(values);
        let half_width = variance.map(|it| student_95(values.len() as f64 - 1.0) * it.sqrt());
        Self { mean, half_width }
    }

    /// Subtracts a constant from the mean.
    pub fn minus(self, constant: f64) -> Self {
        Self { mean: self.mean - constant, ..self }
    }
}

/// Computes the mean, and the variance of the mean.
fn mean_and_variance(values: &[f64]) -> (f64, Option<f64>) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|it| (it - mean).powi(2)).sum();
    (mean, (values.len() > 1).then(|| squares / (n - 1.0) / n))
}

/// Computes the median: the middle value, or the mean of the two middle values.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match (sorted.get(sorted.len().wrapping_sub(1) / 2), sorted.get(sorted.len() / 2)) {
        (Some(low), Some(high)) => 0.5 * (low + high),
        _ => f64::NAN,
    }
}

/// A positive number, stored as its logarithm with an error. For products, ratios and geometric means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Factor {
    /// Natural logarithm.
    log: f64,
    /// Variance of the logarithm, with its degrees of freedom; `None`: unknown.
    spread: Option<(f64, f64)>,
}

/// A positive number with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Interval {
    /// Value of the number.
    pub value: f64,
    /// Lower and upper end; `None`: unknown.
    pub interval: Option<[f64; 2]>,
}

impl Factor {
    /// Computes 1 / (mean of `errors` x mean of `seconds`). The error combines both values of each seed, and treats small relative
    /// deviations as additive. `None`: a mean is not positive.
    pub fn efficiency(errors: &[f64], seconds: &[f64]) -> Option<Self> {
        let ((error, _), (time, _)) = (mean_and_variance(errors), mean_and_variance(seconds));
        if !(error > 0.0 && time > 0.0) {
            return None;
        }
        let deviations: Vec<f64> = errors.iter().zip(seconds).map(|(e, s)| e / error + s / time).collect();
        let freedom = deviations.len() as f64 - 1.0;
        let spread = mean_and_variance(&deviations).1.map(|variance| (variance, freedom));
        Some(Self { log: -(error * time).ln(), spread })
    }

    /// Divides by another, independent number.
    pub fn divided_by(self, other: Self) -> Self {
        Self { log: self.log - other.log, spread: combine_spreads(&[self, other]) }
    }

    /// Computes the geometric mean of independent numbers; `None`: the list is empty.
    pub fn geometric_mean(factors: &[Self]) -> Option<Self> {
        let n = factors.len() as f64;
        let log = factors.iter().map(|it| it.log).sum::<f64>() / n;
        let spread = combine_spreads(factors).map(|(variance, freedom)| (variance / (n * n), freedom));
        (!factors.is_empty()).then_some(Self { log, spread })
    }

    /// Computes the geometric mean of numbers that may depend on each other. The interval assumes full dependence.
    pub fn mean_of_dependent(factors: &[Self]) -> Option<Self> {
        let n = factors.len() as f64;
        let log = factors.iter().map(|it| it.log).sum::<f64>() / n;
        let spreads: Option<Vec<(f64, f64)>> = factors.iter().map(|it| it.spread).collect();
        let spread = spreads.map(|spreads| {
            let deviation = spreads.iter().map(|it| it.0.sqrt()).sum::<f64>() / n;
            (deviation * deviation, spreads.iter().map(|it| it.1).fold(f64::INFINITY, f64::min))
        });
        (!factors.is_empty()).then_some(Self { log, spread })
    }

    /// Interpolates between points (error, factor) at an error, linearly in the logarithms of both. `None`: the error is outside
    /// the measured range.
    pub fn interpolate(points: &[(f64, Self)], error: f64) -> Option<Self> {
        let mut sorted: Vec<(f64, Self)> = points.to_vec();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, there)) = sorted.iter().find(|it| it.0 == error) {
            return Some(*there);
        }
        let pair = sorted.windows(2).find(|pair| pair[0].0 < error && error < pair[1].0)?;
        let [(low, below), (high, above)] = [pair[0], pair[1]];
        let share = (error / low).ln() / (high / low).ln();
        Some(below.power(1.0 - share).times(above.power(share)))
    }

    /// Computes the reciprocal.
    pub fn inverse(self) -> Self {
        self.power(-1.0)
    }

    fn power(self, exponent: f64) -> Self {
        let spread = self.spread.map(|(variance, freedom)| (variance * exponent * exponent, freedom));
        Self { log: self.log * exponent, spread }
    }

    fn times(self, other: Self) -> Self {
        Self { log: self.log + other.log, spread: combine_spreads(&[self, other]) }
    }

    /// Returns the number and its interval.
    pub fn interval(self) -> Interval {
        let ends = |(variance, freedom): (f64, f64)| {
            let half = student_95(freedom) * variance.sqrt();
            [(self.log - half).exp(), (self.log + half).exp()]
        };
        Interval { value: self.log.exp(), interval: self.spread.map(ends) }
    }
}

/// Computes the variance of a sum, and its degrees of freedom by Satterthwaite's rule.
fn combine_spreads(factors: &[Factor]) -> Option<(f64, f64)> {
    let spreads: Vec<(f64, f64)> = factors.iter().map(|it| it.spread).collect::<Option<_>>()?;
    let variance: f64 = spreads.iter().map(|it| it.0).sum();
    let squares: f64 = spreads.iter().map(|(variance, freedom)| variance * variance / freedom).sum();
    Some((variance, if squares > 0.0 { variance * variance / squares } else { f64::INFINITY }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_near(a: f64, b: f64) -> bool {
        (a / b - 1.0).abs() < 0.01
    }

    #[test]
    fn the_interval_of_a_mean_is_students() {
        // Mean 3, standard deviation sqrt(2.5); 2.776 from the table for 4 degrees of freedom.
        let Estimate { mean, half_width } = Estimate::from_values(&[1.0, 2.0, 3.0, 4.0, 5.0]);
        assert!(mean == 3.0 && is_near(half_width.expect("an interval"), 2.776 * (2.5f64 / 5.0).sqrt()));
        let two = Estimate::from_values(&[1.0, 3.0]);
        assert!(is_near(two.half_width.expect("an interval"), 12.706), "{two:?}");
        assert_eq!(Estimate::from_values(&[7.0]), Estimate { mean: 7.0, half_width: None });
        assert_eq!((median(&[5.0, 1.0, 9.0]), median(&[1.0, 2.0, 4.0, 9.0])), (5.0, 3.0));
    }

    #[test]
    fn factors_are_log_linear_between_budgets_and_unknown_beyond() {
        // Efficiency is error^-0.5, so time is error^-0.5, too.
        let factor = |error: f64| Factor { log: -0.5 * error.ln(), spread: Some((0.04, 4.0)) };
        let points = [0.1, 0.001, 0.01].map(|error| (error, factor(error)));
        for error in [0.1, 0.03, 0.01, 0.0025, 0.001] {
            let found = Factor::interpolate(&points, error).expect("within").interval();
            assert!(is_near(found.value, error.powf(-0.5)), "{error}: {found:?}");
        }
        let half_way = Factor::interpolate(&points, 0.1f64.powf(1.5)).expect("within");
        assert!(is_near(half_way.spread.expect("a spread").0, 0.02), "of two independent halves: {half_way:?}");
        assert_eq!([0.2, 0.0005].map(|error| Factor::interpolate(&points, error)), [None; 2]);
        assert_eq!(Factor::interpolate(&[], 1.0), None);
    }

    #[test]
    fn efficiency_is_inverse_of_error_and_time_paired_per_seed() {
        let [errors, seconds] = [[0.019, 0.02, 0.021], [4.2, 4.0, 3.8]];
        let cancels = Factor::efficiency(&errors, &seconds).expect("positive").interval();
        assert!(is_near(cancels.value, 12.5));
        let [low, high] = cancels.interval.expect("an interval");
        assert!(low > 12.49 && high < 12.51, "{cancels:?}");
        let widens = Factor::efficiency(&errors, &[3.8, 4.0, 4.2]).expect("positive").interval();
        // Deviations of 10 %: 4.303 x 0.1 / sqrt(3) in logarithms.
        assert!(
            is_near(widens.interval.expect("an interval")[1], 12.5 * (4.303 * 0.1 / 3f64.sqrt()).exp()),
            "{widens:?}"
        );
        assert_eq!(Factor::efficiency(&[0.1, -0.3], &[1.0, 1.0]), None, "an error below the reference's noise");
    }

    #[test]
    fn ratios_and_geometric_means_add_their_variances() {
        let one = Factor { log: 8f64.ln(), spread: Some((0.04, 4.0)) };
        let other = Factor { log: 2f64.ln(), spread: Some((0.04, 4.0)) };
        let ratio = one.divided_by(other).interval();
        // 2.306 from the table for 8 degrees of freedom.
        assert!(is_near(ratio.value, 4.0));
        assert!(is_near(ratio.interval.expect("an interval")[1], 4.0 * (2.306 * 0.08f64.sqrt()).exp()));
        let mean = Factor::geometric_mean(&[one, other]).expect("a mean").interval();
        assert!(is_near(mean.value, 4.0));
        assert!(is_near(mean.interval.expect("an interval")[1], 4.0 * (2.306 * 0.02f64.sqrt()).exp()));
        let dependent = Factor::mean_of_dependent(&[one, other]).expect("a mean").interval();
        assert!(is_near(dependent.value, 4.0));
        assert!(is_near(dependent.interval.expect("an interval")[1], 4.0 * (2.776 * 0.2f64).exp()));
        assert_eq!([Factor::geometric_mean(&[]), Factor::mean_of_dependent(&[])], [None; 2]);
    }
}
