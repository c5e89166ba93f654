//! Attempts at one job's tasks, small enough to keep in memory while users look at the job.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;

use femc_model::{
    AttemptRecord, AttemptTimes, Chunks, FrameStatus, LeaseEnding, ResourceUsage, Stage, TaskKey, TaskState,
    TaskStatus, Tick,
};

use super::sum::{Span, Sum};
use crate::call::JobShape;

/// Key of an attempt: frame, number of the stage, and task (not counting chunks).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct AttemptKey {
    frame: u32,
    number: u16,
    item: u32,
    round: u32,
    index: u32,
    epoch: u64,
}

impl AttemptKey {
    /// Returns the range of attempts at all tasks of a frame.
    fn frame_range(frame: u32) -> RangeInclusive<Self> {
        let first = Self { frame, number: 0, item: 0, round: 0, index: 0, epoch: 0 };
        first..=Self { number: u16::MAX, item: u32::MAX, ..first.last(u32::MAX) }
    }

    /// Returns the range of attempts at a task in these rounds.
    fn task_range(frame: u32, number: u16, item: u32, rounds: RangeInclusive<u32>) -> RangeInclusive<Self> {
        let first = Self { frame, number, item, round: *rounds.start(), index: 0, epoch: 0 };
        first..=first.last(*rounds.end())
    }

    fn last(self, round: u32) -> Self {
        Self { round, index: u32::MAX, epoch: u64::MAX, ..self }
    }
}

/// Stored data of an attempt.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Entry {
    granted: Tick,
    ended: Tick,
    ending: LeaseEnding,
    worker: u32,
    /// Wait, wall and processor seconds, as measured by the worker.
    measured: Option<[f64; 3]>,
}

impl Entry {
    fn span(&self) -> Span {
        let usage =
            self.measured.map(|[wait, wall, cpu]| ResourceUsage { wait, wall, cpu, ..ResourceUsage::default() });
        Span::new(self.granted, self.ended, usage)
    }

    /// Merges two records of one attempt.
    fn merged(self, new: Self) -> Self {
        let chosen = if new.ending >= self.ending { new } else { self };
        Self { granted: self.granted.min(new.granted), measured: new.measured.or(self.measured), ..chosen }
    }
}

/// Ended attempts at a job's tasks, and their sums.
#[derive(Debug, Default)]
pub struct JobTimes {
    attempts: BTreeMap<AttemptKey, Entry>,
    workers: Vec<String>,
    frames: BTreeMap<u32, AttemptTimes>,
    /// Frames with attempts that are not in the sums yet.
    stale: BTreeSet<u32>,
    /// Record at which the next read starts.
    pub(super) from: u64,
}

impl JobTimes {
    /// Returns the number of attempts.
    pub fn len(&self) -> usize {
        self.attempts.len()
    }

    /// Returns whether no attempt has ended.
    pub fn is_empty(&self) -> bool {
        self.attempts.is_empty()
    }

    /// Adds a record of an attempt, with the rules of [`femc_model::Attempts::insert`].
    pub fn put(&mut self, shape: &JobShape, record: &AttemptRecord) {
        let Stage { frame, round, number, .. } = record.task.stage;
        let Some(template) = shape.spec.graph.stage(number) else { return };
        let item = Chunks::new(template, round, None, shape.chunk_size).task(record.task.index);
        let key = AttemptKey { frame, number, item, round, index: record.task.index, epoch: record.epoch.0 };
        let new = Entry {
            granted: record.granted,
            ended: record.ended,
            ending: record.ending,
            worker: self.worker(&record.worker),
            measured: record.usage.map(|usage| [usage.wait, usage.wall, usage.cpu]),
        };
        let known = self.attempts.get(&key).copied();
        let merged = known.map_or(new, |known| known.merged(new));
        // The last page is read again each time, so a record may be known already.
        if known != Some(merged) {
            self.attempts.insert(key, merged);
            self.stale.insert(frame);
        }
    }

    /// Returns the number under which a worker's name is stored.
    fn worker(&mut self, name: &str) -> u32 {
        // A job has few workers, and the last one is likely to occur again.
        let known = self.workers.iter().rposition(|known| known == name);
        known.unwrap_or_else(|| {
            self.workers.push(name.to_owned());
            self.workers.len() - 1
        }) as u32
    }

    /// Updates the sums of frames that have new attempts.
    pub fn update_sums(&mut self) {
        for frame in std::mem::take(&mut self.stale) {
            let sum: Sum = self.attempts.range(AttemptKey::frame_range(frame)).map(|(_, entry)| entry.span()).collect();
            self.frames.extend(sum.times().map(|times| (frame, times)));
        }
    }

    /// Returns the times of a frame, or of the job's own stages; `None`: no attempt at its tasks has ended.
    pub fn frame(&self, frame: u32) -> Option<AttemptTimes> {
        self.frames.get(&frame).copied()
    }

    /// Returns the processor seconds and wall seconds of all frames and of the job's own stages.
    pub fn totals(&self) -> (f64, f64) {
        let all = self.frames.values();
        (all.clone().map(|times| times.processor).sum(), all.map(|times| times.wall).sum())
    }

    /// Fills in the times of a frame.
    pub fn fill_frame(&self, status: &mut FrameStatus) {
        status.times = self.frame(status.frame);
    }

    /// Fills in the times of a task. For a task that is done or failed, also fills in the workers; for one that is done, also the
    /// number of attempts.
    pub fn fill_task(&self, status: &mut TaskStatus) {
        let TaskKey { stage: Stage { frame, round, number, .. }, index: item, .. } = status.task;
        let rounds = if status.covers_all_rounds { 0..=u32::MAX } else { round..=round };
        let mut entries: Vec<&Entry> =
            self.attempts.range(AttemptKey::task_range(frame, number, item, rounds)).map(|(_, entry)| entry).collect();
        status.times = entries.iter().map(|entry| entry.span()).collect::<Sum>().times();
        let Some(times) = status.times else { return };
        if matches!(status.state, TaskState::Done | TaskState::Failed) {
            entries.sort_by_key(|entry| Reverse(entry.ending));
            for name in entries.iter().filter_map(|entry| self.workers.get(entry.worker as usize)) {
                if !status.workers.contains(name) {
                    status.workers.push(name.clone());
                }
            }
        }
        if status.state == TaskState::Done {
            status.attempts = times.attempts;
        }
    }
}
