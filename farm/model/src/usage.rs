//! What attempts at tasks took: as their workers measured it, and as the farm keeps it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::{Epoch, TaskKey, Tick};

/// What one attempt took, as its worker measured it. Seconds are finite and not negative.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Usage {
    /// Seconds between the arrival of the task and its beginning.
    pub wait: f64,
    /// Seconds from its beginning until there was a result or a failure.
    pub wall: f64,
    /// Of these, until its inputs were ready: its scene read, its frame prepared.
    pub preparation: f64,
    /// Processor seconds of the worker's process while it did the task and sent the result, shared among what it did at the
    /// same time.
    pub cpu: f64,
    /// Most bytes that the worker's process had in memory meanwhile; `None`: its system does not say.
    pub peak: Option<u64>,
    /// Pixel samples taken.
    pub samples: u64,
    /// Rays traced, those to lights too.
    pub rays: u64,
    /// Bytes of artifacts that were fetched for it.
    pub fetched: u64,
    /// Bytes of the artifacts that it brought home.
    pub sent: u64,
}

/// Time that the ended attempts at a task, or at all tasks of a frame, took. Seconds by the farm's clock, which stands still while no
/// coordinator runs; processor and wall seconds as workers measured them.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Times {
    /// Attempts that have ended.
    pub attempts: u32,
    /// Processor seconds of these attempts, summed: also of those that failed, were revoked or given back. An attempt whose worker was
    /// lost adds none, because nobody knows them.
    pub processor: f64,
    /// Seconds that workers spent in these attempts, summed: attempts that run side by side count each. Of an attempt without a
    /// measurement it is the length of its lease.
    pub wall: f64,
    /// Seconds from the first lease of these attempts to the end of the last one in which none of them ran: the worker did other
    /// tasks, of other jobs too, or the lease lay in its queue, or nobody had one. Never negative.
    pub waiting: f64,
}

/// How a lease ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Ending {
    /// Its worker was gone.
    Lost,
    /// It ran out, its frame began anew, or another lease of the same task was the first that was done.
    Revoked,
    /// The worker gave the task back, or was told to stop because the job had ended.
    Cancelled,
    /// With a failure of the task, or of the worker's surroundings.
    Failed,
    /// With the result that counts.
    Done,
}

impl Ending {
    /// All, the least first.
    pub const ALL: [Self; 5] = [Self::Lost, Self::Revoked, Self::Cancelled, Self::Failed, Self::Done];

    /// Name, one word.
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

/// One attempt at a task: a lease under which work was begun.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AttemptRecord {
    /// The task.
    pub task: TaskKey,
    /// Of the lease: there is one attempt for each.
    pub epoch: Epoch,
    /// Name of the worker.
    pub worker: String,
    /// The worker's process.
    pub instance: u64,
    /// When the lease was granted; where that is not known any more, when the work was begun.
    pub granted: Tick,
    /// When the coordinator heard of its end.
    pub ended: Tick,
    /// How the lease ended.
    pub ending: Ending,
    /// Pixel samples of the result that counts.
    pub samples: u64,
    /// Relative error of the frame, where the task measured it.
    pub relative_error: Option<f64>,
    /// What it took; `None`: the worker could not tell.
    pub usage: Option<Usage>,
}

/// The attempts of a job, each once, whatever was noted of it and how often.
#[derive(Debug, Clone, Default)]
pub struct Attempts(BTreeMap<(TaskKey, Epoch), AttemptRecord>);

impl Attempts {
    /// Adds what was noted of an attempt. A lease that had ended may have been taken up again, and what it took may have
    /// been told after its end: the last ending counts unless it is the lesser one, and what is known stays known.
    pub fn put(&mut self, record: AttemptRecord) {
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

    /// All, by task and lease.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &AttemptRecord> {
        self.0.values()
    }
}

impl FromIterator<AttemptRecord> for Attempts {
    fn from_iter<I: IntoIterator<Item = AttemptRecord>>(records: I) -> Self {
        let mut attempts = Self::default();
        records.into_iter().for_each(|record| attempts.put(record));
        attempts
    }
}

#[cfg(test)]
mod tests {
    use crate::{JobId, Stage, StageKind};

    use super::*;

    fn record(ending: Ending, granted: u64, usage: Option<f64>) -> AttemptRecord {
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
            usage: usage.map(|cpu| Usage { cpu, ..Usage::default() }),
        }
    }

    #[test]
    fn what_was_noted_of_a_lease_is_one_attempt_in_whatever_order_it_came() {
        let notes =
            [record(Ending::Lost, 10, None), record(Ending::Done, 50, Some(2.0)), record(Ending::Done, 50, Some(2.0))];
        for order in [[0, 1, 2], [1, 0, 2], [2, 1, 0]] {
            let attempts: Attempts = order.iter().map(|&index| notes[index].clone()).collect();
            let all: Vec<_> = attempts.iter().collect();
            assert_eq!(all, [&record(Ending::Done, 10, Some(2.0))], "{order:?}");
        }
    }

    #[test]
    fn what_a_revoked_lease_took_is_told_after_its_end() {
        let notes = [record(Ending::Revoked, 10, None), record(Ending::Revoked, 20, Some(1.5))];
        let attempts: Attempts = notes.into_iter().collect();
        assert_eq!(attempts.iter().collect::<Vec<_>>(), [&record(Ending::Revoked, 10, Some(1.5))]);
    }
}
