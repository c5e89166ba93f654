//! Sums of what an owner's jobs used of the farm in a month.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// A month of the calendar, in UTC.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Month {
    year: u16,
    month: u8,
}

impl Month {
    /// The month `month` (1..=12) of the year `year` (1..=9999); `None` outside these ranges.
    pub fn new(year: u16, month: u8) -> Option<Self> {
        ((1..=9999).contains(&year) && (1..=12).contains(&month)).then_some(Self { year, month })
    }

    /// The year, 1..=9999.
    pub fn year(self) -> u16 {
        self.year
    }

    /// The month of the year, 1..=12.
    pub fn month(self) -> u8 {
        self.month
    }
}

impl fmt::Display for Month {
    /// As ISO 8601 has it: `2026-11`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04}-{:02}", self.year, self.month)
    }
}

/// A text that names no month.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` names no month; write YYYY-MM, like 2026-11")]
pub struct NoMonth(pub String);

impl FromStr for Month {
    type Err = NoMonth;

    fn from_str(text: &str) -> Result<Self, NoMonth> {
        let is_digit = |place: usize| text.as_bytes()[place].is_ascii_digit();
        let is_formed = text.len() == 7 && text.as_bytes()[4] == b'-' && [0, 1, 2, 3, 5, 6].into_iter().all(is_digit);
        let month = is_formed.then(|| Self::new(text[..4].parse().ok()?, text[5..].parse().ok()?)).flatten();
        month.ok_or_else(|| NoMonth(text.to_owned()))
    }
}

/// Sums over a month. Integers, so that they do not depend on the order in which they are added.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct UsageSums {
    /// Jobs submitted.
    pub jobs: u64,
    /// Frames finished.
    pub frames: u64,
    /// Tasks done.
    pub tasks: u64,
    /// Pixel samples in the results that count.
    pub samples: u64,
    /// Milliseconds of workers: the time in which leases of the owner's jobs held them, each moment of a worker counted once.
    pub worker_ms: u64,
    /// Microseconds of processors in all attempts, as their workers measured them.
    pub processor_us: u64,
}

impl UsageSums {
    /// The sums of both.
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

/// What an owner's jobs used of the farm in a month.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OwnerUsage {
    /// The month, UTC.
    pub month: Month,
    /// Name of the owner.
    pub owner: String,
    /// Sums over the month until now.
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
