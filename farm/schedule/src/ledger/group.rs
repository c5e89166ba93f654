//! The merge as a tree: groups of consecutive tiles, gathered while the frame is still being rendered.
//!
//! A group is ready when all its tiles of the round are done. What is gathered of it are its sums with those of the rounds
//! before, as one artefact, for the next round, and its resolved pixels, which are all that the merge reads. The tiles' own
//! artefacts may go then. If something of a gathered group is lost, its tiles of this round are rendered again: the sums of
//! the rounds before are kept until the round is merged.

use std::collections::BTreeMap;
use std::ops::Range;

use femc_model::{Artefact, Digest, Epoch, GatherResult, MergeInputs, Parts, StageKind};
use serde::{Deserialize, Serialize};

use super::frame::Frame;
use super::layout::Layout;
use crate::RangeSet;

/// A gathered group and the lease that gathered it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Group {
    pub(crate) epoch: Epoch,
    pub(crate) result: GatherResult,
    /// In its tiles of this round.
    samples: u64,
    bad_samples: u64,
}

/// The groups of a frame in work.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Groups {
    /// Those that are gathered in this round.
    pub(crate) done: BTreeMap<u32, Group>,
    /// What the rounds before add up to.
    before: BTreeMap<u32, Artefact>,
}

impl Groups {
    pub(super) fn next_round(&mut self) {
        let done = std::mem::take(&mut self.done);
        self.before = done.into_iter().filter_map(|(index, group)| Some((index, group.result.sums?))).collect();
    }

    pub(super) fn artefacts(&self) -> impl Iterator<Item = Artefact> + '_ {
        let done = self.done.values().flat_map(|group| group.result.artefacts());
        done.chain(self.before.values().copied())
    }

    /// Whether one of the sums of the rounds before is among these.
    pub(crate) fn has_lost_sums(&self, lost: &[Digest]) -> bool {
        self.before.values().any(|sums| lost.contains(&sums.digest))
    }

    /// The gathered groups of which something is among these.
    pub(crate) fn lost(&self, lost: &[Digest]) -> impl Iterator<Item = u32> {
        let is_hurt = |group: &Group| group.result.artefacts().any(|artefact| lost.contains(&artefact.digest));
        self.done.iter().filter(move |(_, group)| is_hurt(group)).map(|(&index, _)| index)
    }

    /// The resolved pixels of the gathered groups, in the order of their index.
    pub(crate) fn pixels(&self) -> Vec<Artefact> {
        self.done.values().map(|group| group.result.pixels).collect()
    }

    /// Sums of the rounds before, of groups that are not gathered in this one.
    pub(crate) fn sums_before(&self) -> impl Iterator<Item = Artefact> + '_ {
        self.before.iter().filter(|(index, _)| !self.done.contains_key(index)).map(|(_, &sums)| sums)
    }
}

impl Frame {
    /// Whether all samples that this round takes of these tiles are there, and not gathered yet.
    fn has_all(&self, layout: &Layout, span: &Range<u32>) -> bool {
        // Tiles come in their order, more or less: the last one tells soonest.
        span.clone().rev().all(|tile| self.is_whole(&layout.grains, tile))
    }

    /// The artefacts of this round that there are of these tiles, in key order.
    pub(crate) fn parts_there(&self, keys: Range<u32>) -> impl Iterator<Item = Artefact> + '_ {
        self.tiles.range(keys).map(|(_, tile)| tile.result.tile)
    }

    /// Tiles of this round that are done, gathered or not.
    pub(crate) fn tiles_done(&self, layout: &Layout) -> u32 {
        self.whole + self.groups.done.keys().map(|&group| layout.span(group).len() as u32).sum::<u32>()
    }

    /// Whether all that the merge reads is there.
    pub(crate) fn is_complete(&self, layout: &Layout) -> bool {
        match layout.groups() {
            0 => self.whole == layout.tiles(),
            groups => self.groups.done.len() == groups as usize,
        }
    }

    /// What it is at.
    pub(crate) fn stage(&self, layout: &Layout) -> StageKind {
        if self.is_complete(layout) {
            StageKind::Merge
        } else if self.tiles_done(layout) == layout.tiles() {
            StageKind::Gather
        } else {
            StageKind::Render
        }
    }

    /// Whether the group can be gathered.
    pub(crate) fn gather_is_open(&self, layout: &Layout, group: u32) -> bool {
        group < layout.groups()
            && !self.groups.done.contains_key(&group)
            && self.has_all(layout, &layout.span(group))
            && !self.is_quarantined(StageKind::Gather, group)
    }

    /// The groups that can be gathered.
    pub(crate) fn open_gathers(&self, layout: &Layout) -> RangeSet {
        let mut open = RangeSet::default();
        let groups = (0..layout.groups()).filter(|&group| self.gather_is_open(layout, group));
        groups.for_each(|group| open.insert(group));
        open
    }

    /// What the merge reads.
    pub(crate) fn merge_inputs(&self, layout: &Layout) -> MergeInputs {
        match layout.groups() {
            0 => MergeInputs::Tiles(Parts {
                previous: self.sums,
                tiles: self.parts_there(layout.grains.all()).collect(),
            }),
            _ => MergeInputs::Groups(self.groups.pixels()),
        }
    }

    /// What a group is gathered from.
    pub(crate) fn parts_of(&self, layout: &Layout, group: u32) -> Parts {
        let previous = self.groups.before.get(&group).copied();
        Parts { previous, tiles: self.parts_there(layout.keys(&layout.span(group))).collect() }
    }

    /// Takes a gathered group in; its tiles' artefacts may go.
    pub(super) fn gathered(&mut self, index: u32, epoch: Epoch, layout: &Layout, result: GatherResult) -> Vec<Digest> {
        let span = layout.span(index);
        if span.is_empty() || self.groups.done.contains_key(&index) || !self.has_all(layout, &span) {
            return Vec::new();
        }
        let mut group = Group { epoch, result, samples: 0, bad_samples: 0 };
        let (keys, mut released) = (layout.keys(&span), Vec::with_capacity(span.len()));
        let parts: Vec<u32> = self.tiles.range(keys).map(|(&key, _)| key).collect();
        for part in parts.into_iter().filter_map(|key| self.tiles.remove(&key)) {
            group.samples += part.result.samples;
            group.bad_samples += part.result.bad_samples;
            released.push(part.result.tile.digest);
        }
        self.whole -= span.len() as u32;
        self.busy_seconds += result.seconds;
        self.groups.done.insert(index, group);
        released
    }

    /// A gathered group of which something is gone: its tiles of this round are to be rendered again.
    pub(super) fn lost_group(&mut self, index: u32) -> Vec<Digest> {
        let Some(group) = self.groups.done.remove(&index) else { return Vec::new() };
        self.forget(group.samples, group.bad_samples);
        group.result.artefacts().map(|artefact| artefact.digest).collect()
    }
}
