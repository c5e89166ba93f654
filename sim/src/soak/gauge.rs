//! Measures the size of the farm from time to time, and checks that it does not grow.

use std::time::Duration;

use femc_schedule::{Config, Scheduler, SnapshotError};
use serde::Serialize;

use super::audit_queue::AuditQueue;
use crate::audit::Violation;
use crate::faulty_medium::FaultyMedium;
use crate::shared::Shared;

/// Permitted increase from the first to the second half of the measurements, in percent.
const TOLERANCE: u64 = 5;
/// Shortest run whose growth is checked.
const MIN_DURATION: Duration = Duration::from_secs(4 * 3600);

/// One measurement.
#[derive(Debug, Clone, Serialize)]
pub struct Measurement {
    /// Simulated hours.
    pub hours: f64,
    /// Real seconds.
    pub seconds: f64,
    /// Resident memory of the process: all hosts, the network, the audit; 0 where the system does not report it.
    pub resident_bytes: u64,
    /// Connection ends that the simulated network keeps, including refused and abandoned attempts.
    pub ends: u64,
    /// Number of jobs that have ended so far.
    pub jobs_ended: u64,
    /// Jobs in the ledger.
    pub jobs_kept: u64,
    /// Bytes of the log, with its snapshot.
    pub log_bytes: u64,
    /// Snapshots so far.
    pub snapshots: u32,
    /// Artifacts in the store.
    pub artifacts: u64,
    /// Bytes of all artifacts in the store.
    pub artifact_bytes: u64,
    /// Records that the audit keeps.
    pub audited_records: u64,
    /// Faults so far.
    pub faults: u64,
}

impl Measurement {
    /// Measures the disks and the memory.
    pub(super) fn read(
        now: Duration,
        real: Duration,
        shared: &Shared,
        medium: &FaultyMedium,
        audit_queue: &AuditQueue,
    ) -> Result<Self, SnapshotError> {
        let state = shared.lock();
        let contents = &state.disk.contents;
        let ledger = state.disk.ledger()?;
        let then = ledger.now();
        let (artifacts, artifact_bytes) = medium.volume();
        Ok(Self {
            hours: now.as_secs_f64() / 3600.0,
            seconds: real.as_secs_f64(),
            resident_bytes: resident_bytes(),
            ends: state.connection_ends as u64,
            jobs_ended: audit_queue.ended_jobs(),
            jobs_kept: Scheduler::new(Config::default(), ledger).0.jobs(then).len() as u64,
            log_bytes: contents.snapshot.iter().chain(&contents.records).map(|bytes| bytes.len() as u64).sum(),
            snapshots: state.disk.snapshots,
            artifacts,
            artifact_bytes,
            audited_records: state.disk.history.len() as u64,
            faults: state.fired.values().map(|&times| u64::from(times)).sum(),
        })
    }
}

/// Reads one quantity of a measurement.
type Reading = fn(&Measurement) -> u64;

/// Quantities that should stay constant, each with its name and an increase that is always permitted.
const STEADY: [(&str, Reading, u64); 5] = [
    ("resident bytes", |gauge| gauge.resident_bytes, 4 << 20),
    ("jobs in the ledger", |gauge| gauge.jobs_kept, 5),
    ("bytes of the log", |gauge| gauge.log_bytes, 64 << 10),
    ("bytes in the store", |gauge| gauge.artifact_bytes, 64 << 10),
    ("records of the audit", |gauge| gauge.audited_records, 500),
];

/// Finds quantities that grow from the first half of the measurements to the second. The first eighth is left out, because the farm
/// fills up then.
pub(super) fn growth(gauges: &[Measurement], time: Duration) -> Vec<Violation> {
    let gauges = &gauges[gauges.len().div_ceil(8)..];
    if time < MIN_DURATION || gauges.len() < 4 {
        return Vec::new();
    }
    let (first, second) = gauges.split_at(gauges.len() / 2);
    let grown = |&(what, reading, slack): &(&'static str, fn(&Measurement) -> u64, u64)| {
        let mean = |half: &[Measurement]| half.iter().map(reading).sum::<u64>() / half.len() as u64;
        let (before, after) = (mean(first), mean(second));
        (after > before + before * TOLERANCE / 100 + slack).then_some(Violation::Growth { what, before, after })
    };
    STEADY.iter().filter_map(grown).collect()
}

fn resident_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let number = line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok());
    number.unwrap_or(0) * 1024
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gauges(resident: impl Fn(u64) -> u64) -> Vec<Measurement> {
        let gauge = |hour: u64| Measurement {
            hours: hour as f64,
            seconds: 0.0,
            resident_bytes: resident(hour),
            jobs_ended: 0,
            jobs_kept: 50,
            log_bytes: 1 << 16,
            snapshots: 0,
            artifacts: 0,
            artifact_bytes: 0,
            audited_records: 1000,
            faults: 0,
            ends: 0,
        };
        (0..=24).map(gauge).collect()
    }

    #[test]
    fn bounded_growth_is_steady_and_unbounded_growth_is_not() {
        let day = Duration::from_secs(86_400);
        assert_eq!(growth(&gauges(|hour| (60 << 20) + ((hour % 3) << 20)), day), []);
        assert_eq!(growth(&gauges(|hour| hour.min(3) * (20 << 20)), day), []);
        let grown = growth(&gauges(|hour| (60 << 20) + (hour << 20)), day);
        assert!(matches!(grown[..], [Violation::Growth { what: "resident bytes", .. }]), "{grown:?}");
    }
}
