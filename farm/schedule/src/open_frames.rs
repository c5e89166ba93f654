//! Open frames of a job: those whose tasks may be leased, and among them those with ready tasks.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use femc_model::{Affinity, JobId, Lane, Stage, TaskKey};

use crate::RangeSet;
use crate::ledger::{GraphView, StageRound};

/// An open frame, or the job's own stages: for each stage, the sample chunks that can run and are not leased. Later stages of the
/// graph come first.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct OpenFrame {
    stages: BTreeMap<(Reverse<u16>, u32), (Stage, RangeSet)>,
}

impl OpenFrame {
    pub(crate) fn new(frame: u32, open: Vec<(StageRound, RangeSet)>, view: &GraphView<'_>) -> Self {
        let mut all = Self::default();
        open.into_iter().for_each(|(stage_round, keys)| all.add(frame, stage_round, &keys, view));
        all
    }

    /// Adds keys that can run.
    pub(crate) fn add(&mut self, frame: u32, (round, number): StageRound, keys: &RangeSet, view: &GraphView<'_>) {
        let Some(template) = view.template(number) else { return };
        let stage = Stage { frame, round, number, kind: template.kind };
        let (_, known) = self.stages.entry((Reverse(number), round)).or_insert_with(|| (stage, RangeSet::default()));
        keys.ranges().for_each(|run| known.insert_range(run));
    }

    /// Removes keys that are leased or no longer wanted.
    pub(crate) fn remove(&mut self, stage: &Stage, run: std::ops::Range<u32>) {
        let key = (Reverse(stage.number), stage.round);
        let Some((_, keys)) = self.stages.get_mut(&key) else { return };
        keys.remove_range(run);
        if keys.is_empty() {
            self.stages.remove(&key);
        }
    }

    /// Returns the ready keys of a stage.
    pub(crate) fn ready_keys(&self, stage: &Stage) -> Option<&RangeSet> {
        self.stages.get(&(Reverse(stage.number), stage.round)).map(|(_, keys)| keys)
    }

    /// Returns the stages with ready keys.
    pub(crate) fn stages(&self) -> impl Iterator<Item = (&Stage, &RangeSet)> {
        self.stages.values().map(|(stage, keys)| (stage, keys))
    }

    /// Returns its ready tasks, those of later stages first.
    pub(crate) fn tasks(&self, job: JobId) -> impl Iterator<Item = TaskKey> {
        self.stages().flat_map(move |(&stage, keys)| keys.iter().map(move |index| TaskKey { job, stage, index }))
    }

    /// Returns its ready tasks that should run where their frame is prepared.
    pub(crate) fn frame_affine_tasks(&self, job: JobId) -> impl Iterator<Item = TaskKey> {
        let affine = self.stages().filter(|(stage, _)| stage.kind.properties().affinity == Affinity::Frame);
        affine.flat_map(move |(&stage, keys)| keys.iter().map(move |index| TaskKey { job, stage, index }))
    }

    /// Checks whether it has ready tasks.
    fn has_ready(&self) -> bool {
        !self.stages.is_empty()
    }

    /// Checks whether it has ready join tasks.
    fn can_join(&self) -> bool {
        self.stages().any(|(stage, _)| stage.kind.properties().lane == Lane::Join)
    }
}

/// Open frames by their number. In a farm with a thousand workers, about a thousand open frames have all their tasks leased. A
/// search for a task does not visit these.
#[derive(Debug, Clone, Default)]
pub(crate) struct OpenFrames {
    all: BTreeMap<u32, OpenFrame>,
    ready: BTreeSet<u32>,
    /// Frames with ready join tasks.
    joinable: BTreeSet<u32>,
}

impl OpenFrames {
    pub(crate) fn get(&self, frame: u32) -> Option<&OpenFrame> {
        self.all.get(&frame)
    }

    /// Returns the number of frames, without the job's own stages.
    pub(crate) fn frames(&self) -> usize {
        self.all.len() - usize::from(self.all.contains_key(&Stage::JOB_FRAME))
    }

    /// Returns all open frames, ascending.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (u32, &OpenFrame)> {
        self.all.iter().map(|(&frame, open)| (frame, open))
    }

    /// Returns the frames with ready tasks, ascending.
    pub(crate) fn ready(&self) -> impl Iterator<Item = (u32, &OpenFrame)> {
        self.ready.iter().filter_map(|&frame| Some((frame, self.all.get(&frame)?)))
    }

    /// Checks whether some frame has ready join tasks.
    pub(crate) fn can_join(&self) -> bool {
        !self.joinable.is_empty()
    }

    /// Opens a frame, or replaces its entry.
    pub(crate) fn put(&mut self, frame: u32, open: OpenFrame) {
        self.update_lists(frame, (open.has_ready(), open.can_join()));
        self.all.insert(frame, open);
    }

    pub(crate) fn remove(&mut self, frame: u32) {
        self.ready.remove(&frame);
        self.joinable.remove(&frame);
        self.all.remove(&frame);
    }

    /// Changes a frame, if it is open.
    pub(crate) fn change(&mut self, frame: u32, change: impl FnOnce(&mut OpenFrame)) {
        let Some(open) = self.all.get_mut(&frame) else { return };
        let before = (open.has_ready(), open.can_join());
        change(open);
        let after = (open.has_ready(), open.can_join());
        if after != before {
            self.update_lists(frame, after);
        }
    }

    /// Updates the lists of frames with ready tasks.
    /// - `is_ready`, `can_join`: state of the frame.
    fn update_lists(&mut self, frame: u32, (is_ready, can_join): (bool, bool)) {
        for (frames, is_in) in [(&mut self.ready, is_ready), (&mut self.joinable, can_join)] {
            if is_in {
                frames.insert(frame);
            } else {
                frames.remove(&frame);
            }
        }
    }
}
