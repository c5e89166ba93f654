//! Resource usage of attempts, as workers measure it and as the farm keeps it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::{Epoch, TaskKey, Tick};

/// Resources that one attempt used, as its worker measured them. Seconds are finite and not negative.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct ResourceUsage {
    /// Seconds between the arrival and the start of the task.
    pub wait: f64,
    /// Seconds from the start until there was a result or a failure.
    pub wall: f64,
    /// Part of `wall` until the inputs were ready: the scene was read and the frame prepared.
    pub preparation: f64,
    /// Processor seconds of the worker's process while it ran the task and sent the result, divided among the tasks that ran at the
    /// same time.
    pub cpu: f64,
    /// Peak memory in bytes of the worker's process during the attempt; `None`: its system does not report it.
    pub peak: Option<u64>,
    /// Number of pixel samples.
    pub samples: u64,
    /// Number of rays traced, including rays to lights.
    pub rays: u64,
    /// Bytes of artifacts that were fetched.
    pub fetched: u64,
    /// Bytes of artifacts that were uploaded.
    pub sent: u64,
}

/// Time that the ended attempts at a task, or at all tasks of a frame, took. Wait seconds are by the farm's clock, which stands
/// still while no coordinator runs. Processor and wall seconds are as measured by workers.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct AttemptTimes {
    /// Number of ended attempts.
    pub attempts: u32,
    /// Processor seconds of these attempts, summed. Attempts that failed, were revoked or were given back are included. An attempt
    /// whose worker was lost adds none, because its usage is not known.
    pub processor: f64,
    /// Seconds that workers spent in these attempts, summed. Attempts that run in parallel count separately. An attempt without a
    /// measurement counts with the length of its lease.
    pub wall: f64,
    /// Seconds in which no attempt ran, between the first lease of these attempts and the end of the last. In this time the worker
    /// ran other tasks, the lease was queued, or no worker had a lease. Never negative.
    pub waiting: f64,
}

/// End of a lease.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum LeaseEnding {
    /// The worker was lost.
    Lost,
    /// The lease expired, its frame was restarted, or another lease of the same task was done first.
    Revoked,
    /// The worker gave the task back, or was stopped because the job had ended.
    Cancelled,
    /// The task failed, or the surroundings of the worker did.
    Failed,
    /// The lease gave the result that counts.
    Done,
}

impl LeaseEnding {
    /// All endings, in ascending rank.
    pub const ALL: [Self; 5] = [Self::Lost, Self::Revoked, Self::Cancelled, Self::Failed, Self::Done];

    /// Name in one word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lost => "lost",
            Self::Revoked => "revoked",
            Self::Cancelled => "cancelled",
            Self::Failed => "failed",
            Self::Done => "done",
        }
    }
}

/// One attempt at a task: a lease under which work was started.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AttemptRecord {
    /// The task.
    pub task: TaskKey,
    /// Epoch of the lease. There is one attempt for each.
    pub epoch: Epoch,
    /// Name of the worker.
    pub worker: String,
    /// Process of the worker.
    pub instance: u64,
    /// Time at which the lease was granted. If that is no longer known, time at which the work started.
    pub granted: Tick,
    /// Time at which the coordinator received the end.
    pub ended: Tick,
    /// Ending of the lease.
    pub ending: LeaseEnding,
    /// Pixel samples of the result that counts.
    pub samples: u64,
    /// Relative error of the frame, if the task measured it.
    pub relative_error: Option<f64>,
    /// Resources used; `None`: the worker did not report them.
    pub usage: Option<ResourceUsage>,
}

/// Attempts of a job. Several records of the same attempt are merged.
#[derive(Debug, Clone, Default)]
pub struct Attempts(BTreeMap<(TaskKey, Epoch), AttemptRecord>);

impl Attempts {
    /// Adds a record of an attempt. An attempt may have several records: an ended lease may have been resumed, and its usage may
    /// arrive after its end. The ending of higher rank wins, at equal rank the later record. The earliest grant and any known usage
    /// are kept.
    pub fn insert(&mut self, record: AttemptRecord) {
        let key = (record.task, record.epoch);
        let Some(known) = self.0.remove(&key) else {
            self.0.insert(key, record);
            return;
        };
        let granted = known.granted.min(record.granted);
        let usage = record.usage.or(known.usage);
        let chosen = if record.ending >= known.ending { record } else { known };
        self.0.insert(key, AttemptRecord { granted, usage, ..chosen });
    }

    /// Returns all attempts, ordered by task and lease.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &AttemptRecord> {
        self.0.values()
    }
}

impl FromIterator<AttemptRecord> for Attempts {
    fn from_iter<I: IntoIterator<Item = AttemptRecord>>(records: I) -> Self {
        let mut attempts = Self::default();
        records.into_iter().for_each(|record| attempts.insert(record));
        attempts
    }
}

#[cfg(test)]
mod tests {
    use crate::{JobId, Stage, StageKind};

    use super::*;

    fn record(ending: LeaseEnding, granted: u64, usage: Option<f64>) -> AttemptRecord {
        let stage = Stage { frame: 1, round: 0, number: 0, kind: StageKind::Render };
        AttemptRecord {
            task: TaskKey { job: JobId(1), stage, index: 3 },
            epoch: Epoch(9),
            worker: "one".into(),
            instance: 1,
            granted: Tick(granted),
            ended: Tick(100),
            ending,
            samples: 0,
            relative_error: None,
            usage: usage.map(|cpu| ResourceUsage { cpu, ..ResourceUsage::default() }),
        }
    }

    #[test]
    fn notes_of_a_lease_merge_to_one_attempt_in_any_order() {
        let notes = [
            record(LeaseEnding::Lost, 10, None),
            record(LeaseEnding::Done, 50, Some(2.0)),
            record(LeaseEnding::Done, 50, Some(2.0)),
        ];
        for order in [[0, 1, 2], [1, 0, 2], [2, 1, 0]] {
            let attempts: Attempts = order.iter().map(|&index| notes[index].clone()).collect();
            let all: Vec<_> = attempts.iter().collect();
            assert_eq!(all, [&record(LeaseEnding::Done, 10, Some(2.0))], "{order:?}");
        }
    }

    #[test]
    fn what_a_revoked_lease_took_is_told_after_its_end() {
        let notes = [record(LeaseEnding::Revoked, 10, None), record(LeaseEnding::Revoked, 20, Some(1.5))];
        let attempts: Attempts = notes.into_iter().collect();
        assert_eq!(attempts.iter().collect::<Vec<_>>(), [&record(LeaseEnding::Revoked, 10, Some(1.5))]);
    }
}
