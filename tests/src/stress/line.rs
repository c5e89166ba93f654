//! A line of the results table.

/// Verdict of a line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The value agrees with the truth.
    Holds,
    /// The value does not agree, for this reason.
    Fails(String),
}

/// Measured and true value of one case.
#[derive(Clone, Debug)]
pub struct ResultLine {
    /// Group and case.
    pub name: String,
    /// Measured value; a count where `error` is 0.
    pub value: f64,
    /// Standard error of `value`.
    pub error: f64,
    /// True value.
    pub truth: f64,
    /// Number of samples or rays behind `value`.
    pub samples: u64,
    /// Number of samples that are NaN, infinite or negative.
    pub bad: u64,
    /// Duration of the measurement.
    pub seconds: f64,
    /// Verdict of the comparison.
    pub verdict: Verdict,
}

impl ResultLine {
    /// Creates a line for a count of faults among `samples`, which must be 0.
    pub fn faults(name: impl Into<String>, faults: u64, samples: u64, seconds: f64, what: &str) -> Self {
        let verdict = if faults == 0 { Verdict::Holds } else { Verdict::Fails(format!("{faults} {what}")) };
        Self { name: name.into(), value: faults as f64, error: 0.0, truth: 0.0, samples, bad: 0, seconds, verdict }
    }

    /// Returns the distance of the value from the truth in standard errors; 0 where both are counts.
    pub fn z(&self) -> f64 {
        if self.error > 0.0 { (self.value - self.truth) / self.error } else { 0.0 }
    }

    /// Checks whether the value agrees with the truth.
    pub fn holds(&self) -> bool {
        self.verdict == Verdict::Holds
    }
}
