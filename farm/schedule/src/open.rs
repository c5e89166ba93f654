//! The frames of a job whose tasks may be leased, and which of them have any to lease now.

use std::collections::{BTreeMap, BTreeSet};

use femc_model::{JobId, Stage, StageKind, TaskKey};

use crate::RangeSet;
use crate::ledger::Layout;

/// A frame whose tasks may be leased.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct OpenFrame {
    pub(crate) round: u32,
    /// Grains of its tiles that nobody holds.
    pub(crate) grains: RangeSet,
    /// Groups of tiles that can be gathered and that nobody holds.
    pub(crate) gathers: RangeSet,
    /// Whether the merge can run and nobody holds it.
    pub(crate) merge: bool,
}

impl OpenFrame {
    /// A frame that nobody has begun.
    pub(crate) fn fresh(layout: &Layout) -> Self {
        Self { grains: RangeSet::full(layout.grains.all()), ..Self::default() }
    }

    /// Its ready tasks: the merge, then groups, then tiles.
    pub(crate) fn tasks(&self, job: JobId, frame: u32) -> impl Iterator<Item = TaskKey> {
        let stage = move |kind| Stage { frame, round: self.round, kind };
        let merge = self.merge.then(|| TaskKey { job, stage: stage(StageKind::Merge), index: 0 });
        let gathers = self.gathers.iter().map(move |index| TaskKey { job, stage: stage(StageKind::Gather), index });
        merge.into_iter().chain(gathers).chain(self.renders(job, frame))
    }

    /// Those that render.
    pub(crate) fn renders(&self, job: JobId, frame: u32) -> impl Iterator<Item = TaskKey> {
        let stage = Stage { frame, round: self.round, kind: StageKind::Render };
        self.grains.iter().map(move |index| TaskKey { job, stage, index })
    }

    /// Whether something of it can be leased.
    fn has_some(&self) -> bool {
        self.merge || !self.gathers.is_empty() || !self.grains.is_empty()
    }
}

/// Open frames by their number. A farm of a thousand workers has as many open whose tasks are all out: who looks for a task
/// does not walk these.
#[derive(Debug, Clone, Default)]
pub(crate) struct OpenFrames {
    all: BTreeMap<u32, OpenFrame>,
    ready: BTreeSet<u32>,
}

impl OpenFrames {
    pub(crate) fn get(&self, frame: u32) -> Option<&OpenFrame> {
        self.all.get(&frame)
    }

    pub(crate) fn len(&self) -> usize {
        self.all.len()
    }

    /// All of them, in the order of their numbers.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (u32, &OpenFrame)> {
        self.all.iter().map(|(&frame, open)| (frame, open))
    }

    /// Those of which something can be leased, in the order of their numbers.
    pub(crate) fn ready(&self) -> impl Iterator<Item = (u32, &OpenFrame)> {
        self.ready.iter().filter_map(|&frame| Some((frame, self.all.get(&frame)?)))
    }

    /// Opens a frame, or puts it right.
    pub(crate) fn put(&mut self, frame: u32, open: OpenFrame) {
        self.note(frame, open.has_some());
        self.all.insert(frame, open);
    }

    pub(crate) fn remove(&mut self, frame: u32) {
        self.ready.remove(&frame);
        self.all.remove(&frame);
    }

    /// Changes a frame, if it is open.
    pub(crate) fn change(&mut self, frame: u32, change: impl FnOnce(&mut OpenFrame)) {
        let Some(open) = self.all.get_mut(&frame) else { return };
        let had_some = open.has_some();
        change(open);
        let has_some = open.has_some();
        if has_some != had_some {
            self.note(frame, has_some);
        }
    }

    fn note(&mut self, frame: u32, is_ready: bool) {
        if is_ready {
            self.ready.insert(frame);
        } else {
            self.ready.remove(&frame);
        }
    }
}
