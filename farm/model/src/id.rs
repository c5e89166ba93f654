//! Identifiers, and the scheduler's time.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Number of a job. Jobs are numbered from 1 in the order of submission. A number is never used twice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct JobId(pub u64);

impl JobId {
    /// First number of shared results. Such a number is not a job of a user. It stands for the stages that one build of the engine
    /// computes for one shared content, for all jobs.
    const SHARED: u64 = 1 << 62;

    /// Returns the id of the shared result number `number` (from 1).
    pub const fn shared(number: u64) -> Self {
        Self(Self::SHARED | number)
    }

    /// Returns whether this is the id of a shared result, not of a job.
    pub const fn is_shared(self) -> bool {
        self.0 >= Self::SHARED
    }
}

impl fmt::Display for JobId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_shared() { write!(f, "shared-{}", self.0 - Self::SHARED) } else { self.0.fmt(f) }
    }
}

/// Error for a text that is not a [`JobId`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected the number of a job, such as 7, or the name of a shared result, such as shared-3")]
pub struct ParseJobIdError;

/// Parses the printed form.
impl FromStr for JobId {
    type Err = ParseJobIdError;

    fn from_str(text: &str) -> Result<Self, ParseJobIdError> {
        let (number, name): (&str, fn(u64) -> Self) = match text.strip_prefix("shared-") {
            Some(number) => (number, Self::shared),
            None => (text, Self),
        };
        number.parse().ok().filter(|&number| number < Self::SHARED).map(name).ok_or(ParseJobIdError)
    }
}

/// Number of a worker. No two sessions have the same number at a time. A worker that reconnects gets its old number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct WorkerId(pub u64);

impl fmt::Display for WorkerId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Fencing token of a lease. Every lease has a greater epoch than all earlier leases, also across restarts.
///
/// The upper bits hold the coordinator's incarnation, which is durable. The lower bits count the leases of that incarnation and are
/// not durable. So a lease costs no write, and a lease from an earlier run of the coordinator is always refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Epoch(pub u64);

impl Epoch {
    /// Number of bits that count the leases of one incarnation.
    const LEASE_BITS: u32 = 40;

    /// Returns the epoch of the lease number `lease` (from 1) of an incarnation (from 1).
    pub const fn new(incarnation: u32, lease: u64) -> Self {
        Self(((incarnation as u64) << Self::LEASE_BITS) | lease)
    }
}

/// Running time of the coordinator in milliseconds. It resumes where the log ended, and stands still while the coordinator is down.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Tick(pub u64);

impl Tick {
    /// Returns this instant plus `milliseconds`.
    pub const fn after(self, milliseconds: u64) -> Self {
        Self(self.0.saturating_add(milliseconds))
    }

    /// Returns the milliseconds from `earlier` to this instant; 0 if `earlier` is later.
    pub const fn since(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_is_read_back_from_its_name() {
        for job in [JobId(0), JobId(7), JobId(JobId::SHARED - 1), JobId::shared(1), JobId::shared(123)] {
            assert_eq!(job.to_string().parse(), Ok(job));
        }
        let beyond = JobId::SHARED.to_string();
        for text in ["", "-1", "x", "shared", "shared-", "shared-x", "shared--1", "shared-shared-1", beyond.as_str()] {
            assert_eq!(text.parse::<JobId>(), Err(ParseJobIdError), "{text}");
        }
    }
}
