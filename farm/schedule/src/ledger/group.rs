//! The merge as a tree: groups of consecutive tiles, gathered while the frame is still being rendered.
//!
//! A group is ready when all its tiles of the round are done. What is gathered of it are its sums with those of the rounds
//! before, as one artefact, for the next round, and its resolved pixels, which are all that the merge reads. The tiles' own
//! artefacts may go then. If something of a gathered group is lost, its tiles of this round are rendered again: the sums of
//! the rounds before are kept until the round is merged.

use std::collections::BTreeMap;
use std::num::NonZeroU32;
use std::ops::Range;

use femc_model::{Artefact, Digest, Epoch, GatherResult, MergeInputs, Parts, StageKind};
use serde::{Deserialize, Serialize};

use super::frame::Frame;
use crate::RangeSet;

/// How the work on a frame is cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Cut {
    tiles: u32,
    group: Option<NonZeroU32>,
}

impl Cut {
    /// `group`: tiles that are gathered before the merge; `None`: the merge reads the tiles.
    pub(super) fn new(tiles: u32, group: Option<NonZeroU32>) -> Self {
        Self { tiles, group }
    }

    /// Tiles of a frame.
    pub(crate) fn tiles(self) -> u32 {
        self.tiles
    }

    /// Groups of a frame; 0 where the merge reads the tiles.
    pub(crate) fn groups(self) -> u32 {
        self.group.map_or(0, |group| self.tiles.div_ceil(group.get()))
    }

    /// The tiles of a group.
    pub(crate) fn span(self, group: u32) -> Range<u32> {
        let edge = |group: u32| self.group.map_or(0, |size| group.saturating_mul(size.get()).min(self.tiles));
        edge(group)..edge(group.saturating_add(1))
    }

    /// The group of a tile.
    pub(crate) fn group_of(self, tile: u32) -> Option<u32> {
        self.group.map(|group| tile / group.get())
    }
}

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
    /// Whether all samples that this round takes of these tiles are there.
    fn has_all(&self, span: &Range<u32>) -> bool {
        self.tiles.range(span.clone()).count() == span.len()
    }

    /// The artefacts of this round that there are of these tiles, in key order.
    pub(crate) fn tiles_of(&self, span: Range<u32>) -> impl Iterator<Item = Artefact> + '_ {
        self.tiles.range(span).map(|(_, tile)| tile.result.tile)
    }

    /// Tiles of this round that are done, gathered or not.
    pub(crate) fn tiles_done(&self, cut: Cut) -> u32 {
        self.tiles.len() as u32 + self.groups.done.keys().map(|&group| cut.span(group).len() as u32).sum::<u32>()
    }

    /// Whether all that the merge reads is there.
    pub(crate) fn is_whole(&self, cut: Cut) -> bool {
        match cut.groups() {
            0 => self.tiles.len() == cut.tiles() as usize,
            groups => self.groups.done.len() == groups as usize,
        }
    }

    /// What it is at.
    pub(crate) fn stage(&self, cut: Cut) -> StageKind {
        if self.is_whole(cut) {
            StageKind::Merge
        } else if self.tiles_done(cut) == cut.tiles() {
            StageKind::Gather
        } else {
            StageKind::Render
        }
    }

    /// Whether the group can be gathered.
    pub(crate) fn gather_is_open(&self, cut: Cut, group: u32) -> bool {
        group < cut.groups()
            && !self.groups.done.contains_key(&group)
            && self.has_all(&cut.span(group))
            && !self.is_quarantined(StageKind::Gather, group)
    }

    /// The groups that can be gathered.
    pub(crate) fn open_gathers(&self, cut: Cut) -> RangeSet {
        let mut open = RangeSet::default();
        (0..cut.groups()).filter(|&group| self.gather_is_open(cut, group)).for_each(|group| open.insert(group));
        open
    }

    /// What the merge reads.
    pub(crate) fn merge_inputs(&self, cut: Cut) -> MergeInputs {
        match cut.groups() {
            0 => MergeInputs::Tiles(Parts { previous: self.sums, tiles: self.tiles_of(0..cut.tiles()).collect() }),
            _ => MergeInputs::Groups(self.groups.pixels()),
        }
    }

    /// What a group is gathered from.
    pub(crate) fn parts_of(&self, cut: Cut, group: u32) -> Parts {
        let previous = self.groups.before.get(&group).copied();
        Parts { previous, tiles: self.tiles_of(cut.span(group)).collect() }
    }

    /// Takes a gathered group in; its tiles' artefacts may go.
    pub(super) fn gathered(&mut self, index: u32, epoch: Epoch, cut: Cut, result: GatherResult) -> Vec<Digest> {
        let span = cut.span(index);
        if self.groups.done.contains_key(&index) || !self.has_all(&span) {
            return Vec::new();
        }
        let mut group = Group { epoch, result, samples: 0, bad_samples: 0 };
        let mut released = Vec::with_capacity(span.len());
        for tile in span.filter_map(|tile| self.tiles.remove(&tile)) {
            group.samples += tile.result.samples;
            group.bad_samples += tile.result.bad_samples;
            released.push(tile.result.tile.digest);
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_groups_hold_every_tile_once() {
        for (tiles, size) in [(1, 1), (7, 3), (9, 3), (10, 16)] {
            let cut = Cut::new(tiles, NonZeroU32::new(size));
            let all: Vec<u32> = (0..cut.groups()).flat_map(|group| cut.span(group)).collect();
            assert_eq!(all, (0..tiles).collect::<Vec<_>>());
            assert!(all.iter().all(|&tile| cut.group_of(tile).is_some_and(|group| cut.span(group).contains(&tile))));
            assert!(cut.span(cut.groups()).is_empty());
        }
        let whole = Cut::new(9, None);
        assert_eq!((whole.groups(), whole.group_of(3)), (0, None));
    }
}
