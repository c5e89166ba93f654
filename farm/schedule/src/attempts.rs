//! Records of attempts and their usage. The caller stores them beside the log, so the ledger does not grow with them.

use femc_model::{AttemptRecord, LeaseEnding, Phase, TaskResult, TaskUsage, Tick, WorkerId};

use crate::lease_table::{Lease, LeaseKey};
use crate::scheduler::Scheduler;
use crate::{Command, SnapshotError};

/// First byte of a note: its version. Notes of other versions are refused. Then the attempts recorded by earlier programs are not
/// shown; there are no other consequences.
pub(crate) const VERSION: u8 = 2;

/// Encodes attempts as one note beside the log.
pub fn encode_attempts(attempts: &[AttemptRecord]) -> Result<Vec<u8>, SnapshotError> {
    // Enough for most attempts.
    let mut bytes = Vec::with_capacity(1 + 160 * attempts.len());
    bytes.push(VERSION);
    Ok(postcard::to_extend(attempts, bytes)?)
}

/// Decodes a note of [`encode_attempts`].
pub fn decode_attempts(note: &[u8]) -> Result<Vec<AttemptRecord>, SnapshotError> {
    match note.split_first() {
        Some((&VERSION, attempts)) => Ok(postcard::from_bytes(attempts)?),
        Some((&found, _)) => Err(SnapshotError::NoteVersion { found }),
        None => Err(SnapshotError::Empty),
    }
}

/// Figures of a result that go into the record of its attempt.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct ResultSummary {
    samples: u64,
    relative_error: Option<f64>,
}

impl ResultSummary {
    pub(crate) fn from_result(result: &TaskResult) -> Self {
        Self { samples: result.units, relative_error: result.relative_error }
    }

    /// Returns the number of pixel samples.
    pub(crate) fn samples(self) -> u64 {
        self.samples
    }
}

impl Scheduler {
    /// Handles a worker's report of a lease's usage. If the lease holds, its outcome follows. If the lease is over, no other report
    /// follows.
    pub(crate) fn handle_usage(
        &mut self,
        worker: WorkerId,
        TaskUsage { task, epoch, usage }: TaskUsage,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        if self.table.lease_held_by(worker, &task, epoch).is_some() {
            self.reported_usage = Some(((task, epoch), usage));
            return;
        }
        // The usage of a counted result is already recorded: this is a repetition.
        let is_new = self.ledger.jobs.get(&task.job).is_some_and(|job| !job.has_completion(&task, epoch));
        let Some(known) = self.table.workers.get(&worker).filter(|_| is_new) else { return };
        let milliseconds = ((usage.wall + usage.wait) * 1000.0) as u64;
        let (name, instance) = (known.registration.name.clone(), known.registration.instance);
        self.meter_attempt(&task, &usage);
        out.push(Command::RecordAttempt(Box::new(AttemptRecord {
            task,
            epoch,
            worker: name,
            instance,
            granted: Tick(now.0.saturating_sub(milliseconds)),
            ended: now,
            ending: LeaseEnding::Revoked,
            samples: 0,
            relative_error: None,
            usage: Some(usage),
        })));
    }

    /// Records the end of a lease. Call it while its worker is known.
    pub(crate) fn record_lease_end(
        &mut self,
        key: &LeaseKey,
        lease: &Lease,
        ending: LeaseEnding,
        summary: ResultSummary,
        out: &mut Vec<Command>,
    ) {
        let usage = self.reported_usage.take_if(|(reported, _)| reported == key).map(|(_, usage)| usage);
        let is_begun = match ending {
            LeaseEnding::Done | LeaseEnding::Failed => true,
            LeaseEnding::Lost | LeaseEnding::Revoked | LeaseEnding::Cancelled => {
                usage.is_some() || lease.phase > Phase::Waiting
            }
        };
        if let Some(usage) = &usage {
            self.meter_attempt(&key.0, usage);
        }
        let Some(known) = self.table.workers.get(&lease.worker).filter(|_| is_begun) else { return };
        out.push(Command::RecordAttempt(Box::new(AttemptRecord {
            task: key.0,
            epoch: key.1,
            worker: known.registration.name.clone(),
            instance: known.registration.instance,
            granted: lease.granted,
            ended: self.now,
            ending,
            samples: summary.samples,
            relative_error: summary.relative_error,
            usage,
        })));
    }
}
