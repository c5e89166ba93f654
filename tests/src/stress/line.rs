//! A line of the table.

/// Whether a line holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It does.
    Holds,
    /// It does not: why.
    Fails(String),
}

/// What was measured of one case, and what is true.
#[derive(Clone, Debug)]
pub struct Line {
    /// Group and case.
    pub name: String,
    /// Measured; a count where `error` is 0.
    pub value: f64,
    /// Standard error of `value`.
    pub error: f64,
    /// What is true.
    pub truth: f64,
    /// Samples, or rays, that `value` is of.
    pub samples: u64,
    /// Samples that are NaN, infinite or negative.
    pub bad: u64,
    /// Time taken.
    pub seconds: f64,
    /// Whether it holds.
    pub verdict: Verdict,
}

impl Line {
    /// A count of faults among `samples`, which is to be 0.
    pub fn faults(name: impl Into<String>, faults: u64, samples: u64, seconds: f64, what: &str) -> Self {
        let verdict = if faults == 0 { Verdict::Holds } else { Verdict::Fails(format!("{faults} {what}")) };
        Self { name: name.into(), value: faults as f64, error: 0.0, truth: 0.0, samples, bad: 0, seconds, verdict }
    }

    /// How many standard errors the value is from the truth; 0 where both are counts.
    pub fn z(&self) -> f64 {
        if self.error > 0.0 { (self.value - self.truth) / self.error } else { 0.0 }
    }

    /// Whether it holds.
    pub fn holds(&self) -> bool {
        self.verdict == Verdict::Holds
    }
}
