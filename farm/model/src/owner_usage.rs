//! Monthly farm usage of an owner's jobs.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// A calendar month in UTC.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Month {
    year: u16,
    month: u8,
}

impl Month {
    /// Makes the month `month` (1..=12) of the year `year` (1..=9999); `None` outside these ranges.
    pub fn new(year: u16, month: u8) -> Option<Self> {
        ((1..=9999).contains(&year) && (1..=12).contains(&month)).then_some(Self { year, month })
    }

    /// Returns the year, 1..=9999.
    pub fn year(self) -> u16 {
        self.year
    }

    /// Returns the month of the year, 1..=12.
    pub fn month(self) -> u8 {
        self.month
    }
}

impl fmt::Display for Month {
    /// Writes the ISO 8601 form: `2026-11`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04}-{:02}", self.year, self.month)
    }
}

/// Error for a text that is not a month.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a month; write YYYY-MM, such as 2026-11")]
pub struct ParseMonthError(pub String);

impl FromStr for Month {
    type Err = ParseMonthError;

    fn from_str(text: &str) -> Result<Self, ParseMonthError> {
        let is_digit = |index: usize| text.as_bytes()[index].is_ascii_digit();
        let is_formed = text.len() == 7 && text.as_bytes()[4] == b'-' && [0, 1, 2, 3, 5, 6].into_iter().all(is_digit);
        let month = is_formed.then(|| Self::new(text[..4].parse().ok()?, text[5..].parse().ok()?)).flatten();
        month.ok_or_else(|| ParseMonthError(text.to_owned()))
    }
}

/// Sums over a month. They are integers, so that they do not depend on the order of addition.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct UsageSums {
    /// Number of jobs submitted.
    pub jobs: u64,
    /// Number of frames finished.
    pub frames: u64,
    /// Number of tasks done.
    pub tasks: u64,
    /// Number of pixel samples in the results that count.
    pub samples: u64,
    /// Worker time in milliseconds: the time in which workers held leases of the owner's jobs. Each moment of a worker counts once.
    pub worker_ms: u64,
    /// Processor time in microseconds of all attempts, as measured by their workers.
    pub processor_us: u64,
}

impl UsageSums {
    /// Returns the sum of both.
    pub fn plus(self, other: Self) -> Self {
        Self {
            jobs: self.jobs.saturating_add(other.jobs),
            frames: self.frames.saturating_add(other.frames),
            tasks: self.tasks.saturating_add(other.tasks),
            samples: self.samples.saturating_add(other.samples),
            worker_ms: self.worker_ms.saturating_add(other.worker_ms),
            processor_us: self.processor_us.saturating_add(other.processor_us),
        }
    }
}

/// Farm usage of an owner's jobs in a month.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OwnerUsage {
    /// Month in UTC.
    pub month: Month,
    /// Name of the owner.
    pub owner: String,
    /// Sums of the month so far.
    pub sums: UsageSums,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn months_read_what_they_write_and_nothing_else() {
        for text in ["0001-01", "2026-11", "9999-12"] {
            assert_eq!(text.parse::<Month>().map(|month| month.to_string()), Ok(text.to_owned()));
        }
        for text in
            ["", "2026", "2026-13", "2026-00", "0000-01", "2026-1", "26-11", "2026-011", "+026-11", "2026/11", "ä026-1"]
        {
            assert!(text.parse::<Month>().is_err(), "{text}");
        }
        assert!("2026-02".parse::<Month>().unwrap() < "2026-10".parse::<Month>().unwrap());
    }
}
