//! A frame in work.

use std::collections::BTreeMap;

use femc_model::{Artefact, Digest, Epoch, Failure, MergeResult, StageKind, Tick, TileResult};
use serde::{Deserialize, Serialize};

use super::group::{Cut, Groups};
use crate::RangeSet;

/// Attempts after which a task is put aside. A constant of the ledger, so that a log means the same to every program.
pub(crate) const ATTEMPTS: u32 = 3;

/// A rendered tile and the lease that rendered it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Tile {
    pub(crate) epoch: Epoch,
    pub(crate) result: TileResult,
}

/// Failed attempts of a task that is not done.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Trouble {
    pub(crate) attempts: u32,
    pub(crate) failure: Failure,
}

impl Trouble {
    pub(crate) fn is_quarantined(&self) -> bool {
        self.attempts >= ATTEMPTS
    }
}

/// A frame of which something is done or has failed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Frame {
    pub(crate) round: u32,
    /// First lease of a task that was completed.
    pub(crate) began: Tick,
    /// Finished tiles of this round.
    pub(crate) tiles: BTreeMap<u32, Tile>,
    /// What the rounds before add up to.
    pub(crate) sums: Option<Artefact>,
    /// Of the merge of the round before.
    pub(crate) merged: Option<Epoch>,
    pub(crate) trouble: BTreeMap<(StageKind, u32), Trouble>,
    /// In all rounds.
    pub(crate) samples: u64,
    /// In the tiles of this round.
    pub(crate) fresh_bad_samples: u64,
    /// In the rounds before.
    pub(crate) merged_bad_samples: u64,
    pub(crate) busy_seconds: f64,
    pub(crate) relative_error: Option<f64>,
    /// In a snapshot they follow the ledger's first versions.
    #[serde(skip)]
    pub(crate) groups: Groups,
}

impl Frame {
    pub(super) fn new(began: Tick) -> Self {
        Self {
            round: 0,
            began,
            tiles: BTreeMap::new(),
            sums: None,
            merged: None,
            trouble: BTreeMap::new(),
            samples: 0,
            fresh_bad_samples: 0,
            merged_bad_samples: 0,
            busy_seconds: 0.0,
            relative_error: None,
            groups: Groups::default(),
        }
    }

    pub(super) fn rendered(&mut self, index: u32, epoch: Epoch, leased: Tick, result: &TileResult) {
        if self.tiles.contains_key(&index) {
            return;
        }
        self.began = self.began.min(leased);
        self.tiles.insert(index, Tile { epoch, result: *result });
        self.trouble.remove(&(StageKind::Render, index));
        self.samples += result.samples;
        self.fresh_bad_samples += result.bad_samples;
        self.busy_seconds += result.seconds;
    }

    pub(super) fn next_round(&mut self, epoch: Epoch, result: &MergeResult) {
        self.round += 1;
        self.tiles.clear();
        // Failures of merges add up over the rounds, so that a frame whose sums are lost again and again ends.
        self.trouble.retain(|&(kind, _), _| kind != StageKind::Render);
        self.sums = result.sums;
        self.groups.next_round();
        self.merged = Some(epoch);
        self.fresh_bad_samples = 0;
        self.merged_bad_samples = result.bad_samples;
        self.busy_seconds += result.seconds;
        self.relative_error = result.relative_error;
    }

    pub(super) fn lost_tile(&mut self, index: u32) -> Vec<Digest> {
        if let Some(tile) = self.tiles.remove(&index) {
            self.forget(tile.result.samples, tile.result.bad_samples);
        }
        Vec::new()
    }

    /// Samples of this round that are to be taken again.
    pub(super) fn forget(&mut self, samples: u64, bad_samples: u64) {
        self.samples -= samples;
        self.fresh_bad_samples -= bad_samples;
    }

    pub(super) fn restarted(&mut self) -> Vec<Digest> {
        let released = self.artefacts().collect();
        let trouble = std::mem::take(&mut self.trouble);
        *self = Self { busy_seconds: self.busy_seconds, trouble, ..Self::new(self.began) };
        released
    }

    /// Tiles of the round that are neither done nor out of attempts.
    pub(crate) fn open_tiles(&self, cut: Cut) -> RangeSet {
        let mut open = RangeSet::full(0..cut.tiles());
        let gathered = self.groups.done.keys().flat_map(|&group| cut.span(group));
        self.tiles.keys().copied().chain(gathered).for_each(|index| open.remove(index));
        for (kind, index, _) in self.quarantined() {
            if kind == StageKind::Render {
                open.remove(index);
            }
        }
        open
    }

    /// Whether the merge may run.
    pub(crate) fn merge_is_open(&self, cut: Cut) -> bool {
        self.is_whole(cut) && !self.is_quarantined(StageKind::Merge, 0)
    }

    pub(super) fn is_quarantined(&self, kind: StageKind, index: u32) -> bool {
        self.trouble.get(&(kind, index)).is_some_and(Trouble::is_quarantined)
    }

    /// Tasks out of attempts.
    pub(crate) fn quarantined(&self) -> impl Iterator<Item = (StageKind, u32, &Trouble)> + '_ {
        let out = self.trouble.iter().filter(|(_, trouble)| trouble.is_quarantined());
        out.map(|(&(kind, index), trouble)| (kind, index, trouble))
    }

    /// Whether nothing of it can run without a retry.
    pub(crate) fn is_blocked(&self, cut: Cut) -> bool {
        let (mut tiles, mut gathers) = (0, 0);
        for (kind, ..) in self.quarantined() {
            match kind {
                StageKind::Render => tiles += 1,
                StageKind::Gather => gathers += 1,
                StageKind::Merge => return true,
            }
        }
        let no_tile_is_left = self.tiles_done(cut) + tiles == cut.tiles();
        tiles + gathers > 0 && no_tile_is_left && self.open_gathers(cut).is_empty()
    }

    /// Everything in the store that the frame needs.
    pub(crate) fn artefacts(&self) -> impl Iterator<Item = Digest> + '_ {
        let tiles = self.tiles.values().map(|tile| tile.result.tile);
        tiles.chain(self.sums).chain(self.groups.artefacts()).map(|artefact| artefact.digest)
    }
}
