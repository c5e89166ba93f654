//! Names of things, and the scheduler's time.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// A job, numbered from 1 in order of submission; never used twice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct JobId(pub u64);

impl JobId {
    /// Numbers from here on are not jobs of people: each is what is done for one content by one build of the engine, for all jobs.
    const SHARED: u64 = 1 << 62;

    /// The number `number` (from 1) of what jobs share.
    pub const fn shared(number: u64) -> Self {
        Self(Self::SHARED | number)
    }

    /// Whether it is what jobs share, and none of them.
    pub const fn is_shared(self) -> bool {
        self.0 >= Self::SHARED
    }
}

impl fmt::Display for JobId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_shared() { write!(f, "shared-{}", self.0 - Self::SHARED) } else { self.0.fmt(f) }
    }
}

/// A text that is no [`JobId`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a job is named by its number, like 7, or, if jobs share it, like shared-3")]
pub struct NoJobId;

/// As it is printed.
impl FromStr for JobId {
    type Err = NoJobId;

    fn from_str(text: &str) -> Result<Self, NoJobId> {
        let (number, name): (&str, fn(u64) -> Self) = match text.strip_prefix("shared-") {
            Some(number) => (number, Self::shared),
            None => (text, Self),
        };
        number.parse().ok().filter(|&number| number < Self::SHARED).map(name).ok_or(NoJobId)
    }
}

/// The number of a worker. No two sessions have the same one at a time; a worker that comes back gets its old one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct WorkerId(pub u64);

impl fmt::Display for WorkerId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// The fence of a lease: every lease has a greater epoch than all before it, over restarts too.
///
/// The upper bits hold the coordinator's incarnation, which is durable; the lower bits count the leases of that
/// incarnation, which are not. So a lease costs no write, and a lease of a dead coordinator is always refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Epoch(pub u64);

impl Epoch {
    /// Bits that count the leases of one incarnation.
    const LEASE_BITS: u32 = 40;

    /// Epoch of the lease number `lease` (from 1) of an incarnation (from 1).
    pub const fn new(incarnation: u32, lease: u64) -> Self {
        Self(((incarnation as u64) << Self::LEASE_BITS) | lease)
    }
}

/// The coordinator's running time in milliseconds: it goes on where the log ended, and stands still while the
/// coordinator is down.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Tick(pub u64);

impl Tick {
    /// This instant and `milliseconds` more.
    pub const fn after(self, milliseconds: u64) -> Self {
        Self(self.0.saturating_add(milliseconds))
    }

    /// Milliseconds from `earlier` until this instant; 0 where `earlier` is later.
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
            assert_eq!(text.parse::<JobId>(), Err(NoJobId), "{text}");
        }
    }
}
