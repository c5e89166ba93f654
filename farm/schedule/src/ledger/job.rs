//! A job in the ledger.

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroU32;
use std::ops::Range;

use femc_model::{
    Control, Cut, Decision, Digest, Epoch, Failure, FrameRecord, GatherResult, Grains, JobSpec, MergeResult, StageKind,
    TaskKey, Tick, TileResult,
};
use serde::{Deserialize, Serialize};

use super::frame::Frame;
use super::layout::Layout;
use crate::Casualty;

/// What a person has done to a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Hold {
    /// Nothing: it may run.
    Free,
    /// Held.
    Paused,
    /// Ended.
    Cancelled,
}

/// A finished frame and the lease that finished it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Finished {
    /// Of the last merge: a repeated completion gets the same answer.
    pub epoch: Epoch,
    /// What `femc fetch` needs.
    pub record: FrameRecord,
}

/// A job: as asked for, and what has come of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Job {
    pub(crate) spec: Box<JobSpec>,
    pub(crate) hold: Hold,
    pub(crate) doom: Option<Failure>,
    /// First lease of a task that was completed.
    pub(crate) began: Option<Tick>,
    pub(crate) ended: Option<Tick>,
    /// Frames with some result or failure, not finished; the others cost nothing.
    pub(crate) frames: BTreeMap<u32, Frame>,
    pub(crate) finished: BTreeMap<u32, Finished>,
    /// Frames that only a retry can move.
    pub(crate) blocked: BTreeSet<u32>,
    pub(crate) relative_error: Option<f64>,
    submitted: Tick,
    /// Durable in the annex.
    #[serde(skip)]
    cut: Cut,
    /// Tiles of a group, where frames are merged as a tree. In a snapshot it follows the ledger's first versions.
    #[serde(skip)]
    pub(super) group: Option<NonZeroU32>,
}

impl Job {
    pub(super) fn new(spec: Box<JobSpec>, now: Tick) -> Self {
        Self {
            spec,
            hold: Hold::Free,
            doom: None,
            began: None,
            ended: None,
            frames: BTreeMap::new(),
            finished: BTreeMap::new(),
            blocked: BTreeSet::new(),
            relative_error: None,
            submitted: now,
            cut: Cut::Whole,
            group: None,
        }
    }

    /// Says how its tiles are cut: once, before anything of it is done, or as a snapshot is read.
    pub(super) fn cut(&mut self, cut: Cut) {
        self.cut = cut;
        for frame in self.frames.values_mut() {
            frame.recount(&Grains::of(&self.spec, frame.round, cut));
        }
    }

    /// The keys of a round's render stage.
    pub(crate) fn grains(&self, round: u32) -> Grains {
        Grains::of(&self.spec, round, self.cut)
    }

    /// How the work on a round of its frames is cut.
    pub(crate) fn layout(&self, round: u32) -> Layout {
        Layout::new(self.grains(round), self.group)
    }

    pub(super) fn grouped(&mut self, tiles: u32) -> Vec<Digest> {
        self.group = NonZeroU32::new(tiles);
        Vec::new()
    }

    /// Whether every frame is finished or blocked, or the job as a whole is over.
    pub(crate) fn has_ended(&self) -> bool {
        self.hold == Hold::Cancelled
            || self.doom.is_some()
            || self.finished.len() + self.blocked.len() == self.spec.frames.len()
    }

    /// Whether its tasks may be leased.
    pub(crate) fn is_runnable(&self) -> bool {
        self.hold == Hold::Free && !self.has_ended()
    }

    /// Whether the frame is asked for and neither finished nor blocked.
    pub(crate) fn is_open(&self, frame: u32) -> bool {
        !self.finished.contains_key(&frame)
            && !self.blocked.contains(&frame)
            && self.spec.frames.binary_search(&frame).is_ok()
    }

    /// The round that the frame is in.
    pub(crate) fn round(&self, frame: u32) -> u32 {
        self.frames.get(&frame).map_or(0, |frame| frame.round)
    }

    fn frame(&mut self, number: u32, began: Tick) -> &mut Frame {
        self.began.get_or_insert(began);
        self.frames.entry(number).or_insert_with(|| Frame::new(began))
    }

    pub(super) fn rendered(&mut self, task: &TaskKey, epoch: Epoch, leased: Tick, result: &TileResult) -> Vec<Digest> {
        let number = task.stage.frame;
        if self.is_open(number) && self.round(number) == task.stage.round {
            let layout = self.layout(task.stage.round);
            self.frame(number, leased).rendered(&layout, task.index, epoch, leased, result);
            self.note_block(number);
        }
        Vec::new()
    }

    pub(super) fn gathered(&mut self, task: &TaskKey, epoch: Epoch, result: &GatherResult) -> Vec<Digest> {
        let (number, layout) = (task.stage.frame, self.layout(task.stage.round));
        if !self.is_open(number) || self.round(number) != task.stage.round {
            return Vec::new();
        }
        let Some(frame) = self.frames.get_mut(&number) else { return Vec::new() };
        let released = frame.gathered(task.index, epoch, &layout, *result);
        self.note_block(number);
        released
    }

    pub(super) fn merged(&mut self, task: &TaskKey, epoch: Epoch, result: &MergeResult, now: Tick) -> Vec<Digest> {
        let number = task.stage.frame;
        let spp = self.spec.samples(task.stage.round).end;
        if !self.is_open(number) || self.round(number) != task.stage.round {
            return Vec::new();
        }
        self.relative_error = result.relative_error.or(self.relative_error);
        let Some(frame) = self.frames.get_mut(&number) else { return Vec::new() };
        let mut released: Vec<Digest> = frame.artefacts().collect();
        match (result.decision, result.image) {
            (Decision::Done, Some(image)) => {
                let record = FrameRecord {
                    frame: number,
                    image,
                    preview: result.preview,
                    spp,
                    relative_error: result.relative_error,
                    bad_samples: result.bad_samples,
                    busy_seconds: frame.busy_seconds + result.seconds,
                    seconds: now.since(frame.began) as f64 / 1000.0,
                };
                released.extend(result.sums.map(|sums| sums.digest));
                self.finished.insert(number, Finished { epoch, record });
                self.frames.remove(&number);
            }
            (Decision::Continue | Decision::Done, _) => frame.next_round(epoch, result),
        }
        released
    }

    pub(super) fn failed(&mut self, task: &TaskKey, until: Epoch, failure: &Failure, now: Tick) -> Vec<Digest> {
        let number = task.stage.frame;
        if self.is_open(number) && self.round(number) == task.stage.round {
            self.frame(number, now).failed(task.stage.kind, task.index, until, failure);
            self.note_block(number);
        }
        Vec::new()
    }

    /// Whether some of a stage's keys from the task's on are still to be done.
    pub(crate) fn wants(&self, task: &TaskKey, keys: &Range<u32>) -> bool {
        let (number, round) = (task.stage.frame, task.stage.round);
        let has_open = |frame: &Frame| !frame.open_keys(&self.layout(round), task.stage.kind, keys.clone()).is_empty();
        !self.has_ended()
            && self.is_open(number)
            && self.round(number) == round
            && self.frames.get(&number).is_none_or(has_open)
    }

    pub(super) fn died(&mut self, task: &TaskKey, end: u32, casualty: &Casualty, now: Tick) -> Vec<Digest> {
        let (number, layout) = (task.stage.frame, self.layout(task.stage.round));
        if self.is_open(number) && self.round(number) == task.stage.round {
            let frame = self.frame(number, now);
            let keys = frame.open_keys(&layout, task.stage.kind, task.index..end);
            frame.died(task.stage.kind, keys.into_iter(), casualty);
            self.note_block(number);
        }
        Vec::new()
    }

    pub(super) fn lives(&mut self, instance: u64) {
        self.frames.values_mut().for_each(|frame| frame.lives(instance));
    }

    pub(super) fn lost(&mut self, task: &TaskKey) -> Vec<Digest> {
        let grains = self.grains(task.stage.round);
        let Some(frame) = self.frames.get_mut(&task.stage.frame) else { return Vec::new() };
        match task.stage.kind {
            StageKind::Render => frame.lost_part(&grains, task.index),
            StageKind::Gather => frame.lost_group(task.index),
            StageKind::Merge => Vec::new(),
        }
    }

    /// The finished frames whose image or preview this is.
    pub(crate) fn pictured_by(&self, digest: &Digest) -> impl Iterator<Item = u32> + use<'_> {
        let digest = *digest;
        let is_it = move |record: &FrameRecord| {
            record.image.digest == digest || record.preview.is_some_and(|preview| preview.digest == digest)
        };
        self.finished.iter().filter(move |(_, finished)| is_it(&finished.record)).map(|(&frame, _)| frame)
    }

    /// What is known of the frame is forgotten, but for the time that it has taken. The job may have been done.
    pub(super) fn restarted(&mut self, frame: u32) -> Vec<Digest> {
        if let Some(Finished { record, .. }) = self.finished.remove(&frame) {
            self.frames.insert(frame, Frame::again(&record));
            if !self.has_ended() {
                self.ended = None;
            }
            return [Some(record.image), record.preview].into_iter().flatten().map(|image| image.digest).collect();
        }
        self.blocked.remove(&frame);
        self.frames.get_mut(&frame).map(Frame::restarted).unwrap_or_default()
    }

    pub(super) fn doomed(&mut self, failure: &Failure) -> Vec<Digest> {
        self.doom = Some(failure.clone());
        Vec::new()
    }

    pub(super) fn controlled(&mut self, control: Control) -> Vec<Digest> {
        match control {
            Control::Pause => self.hold = Hold::Paused,
            Control::Resume => self.hold = Hold::Free,
            Control::Cancel => self.hold = Hold::Cancelled,
            Control::Retry => {
                self.hold = Hold::Free;
                self.doom = None;
                self.ended = None;
                self.blocked.clear();
                self.frames.values_mut().for_each(|frame| frame.trouble.clear());
            }
            Control::Priority(priority) => self.spec.priority = priority,
        }
        Vec::new()
    }

    fn note_block(&mut self, number: u32) {
        if self.frames.get(&number).is_some_and(|frame| frame.is_blocked(&self.layout(frame.round))) {
            self.blocked.insert(number);
        }
    }

    pub(super) fn note_end(&mut self, now: Tick) {
        if self.has_ended() {
            self.ended.get_or_insert(now);
        }
        // What was paused and came to its end all the same is not held when something of it is lost later.
        if self.finished.len() == self.spec.frames.len() {
            self.hold = Hold::Free;
        }
    }

    pub(super) fn each_artefact(&self, mut see: impl FnMut(Digest)) {
        see(self.spec.bundle);
        self.frames.values().flat_map(Frame::artefacts).for_each(&mut see);
        for Finished { record, .. } in self.finished.values() {
            see(record.image.digest);
            record.preview.iter().for_each(|preview| see(preview.digest));
        }
    }

    /// Whether this completion is the one that the ledger holds.
    pub(crate) fn holds(&self, task: &TaskKey, epoch: Epoch) -> bool {
        let number = task.stage.frame;
        if let Some(finished) = self.finished.get(&number) {
            return task.stage.kind == StageKind::Merge && finished.epoch == epoch;
        }
        let Some(frame) = self.frames.get(&number) else { return false };
        match task.stage.kind {
            StageKind::Render => {
                frame.round == task.stage.round && frame.tiles.get(&task.index).is_some_and(|tile| tile.epoch == epoch)
            }
            StageKind::Gather => {
                frame.round == task.stage.round
                    && frame.groups.done.get(&task.index).is_some_and(|group| group.epoch == epoch)
            }
            StageKind::Merge => frame.merged == Some(epoch),
        }
    }
}
