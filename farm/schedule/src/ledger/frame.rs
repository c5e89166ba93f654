//! A frame in work.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use femc_model::{Artefact, Digest, Epoch, Failure, FrameRecord, Grains, MergeResult, StageKind, Tick, TileResult};
use serde::{Deserialize, Serialize};

use super::group::Groups;
use super::layout::Layout;
use crate::{Casualty, Evidence, RangeSet};

/// Attempts after which a task is put aside. A constant of the ledger, so that a log means the same to every program.
pub(crate) const ATTEMPTS: u32 = 3;

/// A rendered tile, or some grains of it, and the lease that rendered it. Which grains follows from the result's samples.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Tile {
    pub(crate) epoch: Epoch,
    pub(crate) result: TileResult,
}

/// Deaths of workers after which a task is put aside.
const DEATHS: usize = 5;

/// Failed attempts of a task that is not done, and workers that died of it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Trouble {
    pub(crate) attempts: u32,
    /// The latest at the end; of each lease one.
    pub(crate) deaths: Vec<Casualty>,
    pub(crate) failure: Failure,
    /// Leases up to this one are over, of whatever they are told later.
    until: Epoch,
}

impl Trouble {
    fn new(failure: Failure) -> Self {
        Self { attempts: 0, deaths: Vec::new(), failure, until: Epoch(0) }
    }

    pub(crate) fn is_quarantined(&self) -> bool {
        self.attempts >= ATTEMPTS || self.is_deadly()
    }

    /// Deaths that are only presumed may be one machine's own: they count beside those of another.
    fn is_deadly(&self) -> bool {
        let known = self.deaths.iter().filter(|death| death.evidence == Evidence::Journal).count();
        let workers: BTreeSet<&str> = self.deaths.iter().map(|death| death.worker.as_str()).collect();
        known >= DEATHS || (self.deaths.len() >= DEATHS && workers.len() > 1)
    }

    /// How often it was tried, with whatever came of it.
    pub(crate) fn tries(&self) -> u32 {
        self.attempts + self.deaths.len() as u32
    }

    fn died(&mut self, casualty: &Casualty) {
        match self.deaths.iter_mut().find(|known| known.epoch == casualty.epoch) {
            Some(known) => known.evidence = known.evidence.max(casualty.evidence),
            None => self.deaths.push(casualty.clone()),
        }
        // Of one worker alone they put nothing aside, however many: a few tell as much.
        let oldest = || self.deaths.iter().position(|death| death.evidence == Evidence::Presumed);
        if self.deaths.len() > 2 * DEATHS
            && let Some(oldest) = oldest()
        {
            self.deaths.remove(oldest);
        }
        self.failure = Failure::Killed { deaths: self.deaths.len() as u32, worker: casualty.worker.clone() };
    }
}

/// A frame of which something is done or has failed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Frame {
    pub(crate) round: u32,
    /// First lease of a task that was completed.
    pub(crate) began: Tick,
    /// What is rendered of this round's tiles, by the first key of each.
    pub(crate) tiles: BTreeMap<u32, Tile>,
    /// How many of them are whole: see [`Frame::is_whole`].
    #[serde(skip)]
    pub(crate) whole: u32,
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
            whole: 0,
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

    /// A finished frame whose image is gone. Its trouble says so, which no attempt is charged for.
    pub(super) fn again(record: &FrameRecord) -> Self {
        let digests: Vec<Digest> =
            [Some(record.image), record.preview].iter().flatten().map(|image| image.digest).collect();
        let failure = Failure::LostInputs { digests, message: "the finished image".into() };
        let trouble = BTreeMap::from([((StageKind::Merge, 0), Trouble::new(failure))]);
        // Nobody has begun it again.
        Self { trouble, busy_seconds: record.busy_seconds, ..Self::new(Tick(u64::MAX)) }
    }

    /// Whether it was finished before, and its image is gone.
    pub(crate) fn is_again(&self) -> bool {
        self.trouble
            .get(&(StageKind::Merge, 0))
            .is_some_and(|trouble| trouble.attempts == 0 && matches!(trouble.failure, Failure::LostInputs { .. }))
    }

    /// Takes in what was rendered from key `first` on; grains that are there already change nothing.
    pub(super) fn rendered(&mut self, layout: &Layout, first: u32, epoch: Epoch, leased: Tick, result: &TileResult) {
        let grains = &layout.grains;
        if layout.group_of(first).is_some_and(|group| self.groups.done.contains_key(&group)) {
            return;
        }
        let Some(run) = grains.run_of(first, result.samples).filter(|run| !self.holds_any(grains, run)) else { return };
        self.began = self.began.min(leased);
        self.tiles.insert(first, Tile { epoch, result: *result });
        let is_all = run.end - run.start == grains.per_tile();
        self.whole += u32::from(is_all || self.is_whole(grains, grains.tile(first)));
        self.trouble.retain(|(kind, key), _| *kind != StageKind::Render || !run.contains(key));
        self.samples += result.samples;
        self.fresh_bad_samples += result.bad_samples;
        self.busy_seconds += result.seconds;
    }

    /// The runs of grains that are rendered, of those that begin in `keys`, ascending.
    fn runs(&self, grains: &Grains, keys: Range<u32>) -> impl DoubleEndedIterator<Item = Range<u32>> {
        self.tiles.range(keys).filter_map(|(&first, tile)| grains.run_of(first, tile.result.samples))
    }

    fn holds_any(&self, grains: &Grains, run: &Range<u32>) -> bool {
        if grains.per_tile() == 1 {
            return self.tiles.contains_key(&run.start);
        }
        self.runs(grains, 0..run.end).next_back().is_some_and(|before| before.end > run.start)
    }

    /// Whether all samples of a tile's round are there.
    pub(crate) fn is_whole(&self, grains: &Grains, tile: u32) -> bool {
        self.runs(grains, grains.of_tile(tile)).map(|run| run.end - run.start).sum::<u32>() == grains.per_tile()
    }

    /// Counts the whole tiles again: a snapshot does not have their number.
    pub(super) fn recount(&mut self, grains: &Grains) {
        let (mut whole, mut tile, mut done) = (0, 0, 0);
        for run in self.runs(grains, grains.all()) {
            if grains.tile(run.start) != tile {
                (tile, done) = (grains.tile(run.start), 0);
            }
            done += run.end - run.start;
            whole += u32::from(done == grains.per_tile());
        }
        self.whole = whole;
    }

    pub(super) fn next_round(&mut self, epoch: Epoch, result: &MergeResult) {
        self.round += 1;
        self.tiles.clear();
        self.whole = 0;
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

    pub(super) fn lost_part(&mut self, grains: &Grains, first: u32) -> Vec<Digest> {
        let was_whole = self.is_whole(grains, grains.tile(first));
        if let Some(tile) = self.tiles.remove(&first) {
            self.whole -= u32::from(was_whole);
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

    /// Another attempt at a task has failed.
    pub(super) fn failed(&mut self, kind: StageKind, index: u32, until: Epoch, failure: &Failure) {
        let trouble = self.trouble.entry((kind, index)).or_insert_with(|| Trouble::new(failure.clone()));
        trouble.attempts += 1;
        trouble.until = trouble.until.max(until);
        trouble.failure = failure.clone();
    }

    /// Whether this lease of a task was over when the task's last failure was counted: what its worker has to say was heard.
    pub(crate) fn is_over(&self, kind: StageKind, index: u32, epoch: Epoch) -> bool {
        self.trouble.get(&(kind, index)).is_some_and(|trouble| epoch <= trouble.until)
    }

    /// A worker died of these tasks, or of one of them.
    pub(super) fn died(&mut self, kind: StageKind, keys: impl Iterator<Item = u32>, casualty: &Casualty) {
        for key in keys {
            let failure = Failure::Killed { deaths: 0, worker: String::new() };
            self.trouble.entry((kind, key)).or_insert_with(|| Trouble::new(failure)).died(casualty);
        }
    }

    /// A process lives: what is not put aside yet has not killed it.
    pub(super) fn lives(&mut self, instance: u64) {
        self.trouble.retain(|_, trouble| {
            if trouble.is_quarantined() {
                return true;
            }
            let before = trouble.deaths.len();
            trouble.deaths.retain(|death| (death.instance, death.evidence) != (instance, Evidence::Presumed));
            trouble.deaths.len() == before || trouble.tries() > 0
        });
    }

    /// Those of a stage's keys that are neither done nor out of attempts.
    pub(crate) fn open_keys(&self, layout: &Layout, kind: StageKind, keys: Range<u32>) -> Vec<u32> {
        let grains = self.open_grains(layout);
        let is_open = |key: &u32| match kind {
            StageKind::Render => grains.covers(&(*key..*key + 1)),
            StageKind::Gather => !self.groups.done.contains_key(key) && !self.is_quarantined(kind, *key),
            StageKind::Merge => !self.is_quarantined(kind, *key),
        };
        keys.filter(is_open).collect()
    }

    /// Grains of the round that are neither done nor out of attempts.
    pub(crate) fn open_grains(&self, layout: &Layout) -> RangeSet {
        let mut open = RangeSet::full(layout.grains.all());
        let gathered = self.groups.done.keys().map(|&group| layout.keys(&layout.span(group)));
        self.runs(&layout.grains, layout.grains.all()).chain(gathered).for_each(|run| open.remove(run));
        for (kind, key, _) in self.quarantined() {
            if kind == StageKind::Render {
                open.remove(key..key + 1);
            }
        }
        open
    }

    /// The first grain of a run that has failed before.
    pub(crate) fn first_trouble(&self, run: &Range<u32>) -> Option<u32> {
        let keys = (StageKind::Render, run.start)..(StageKind::Render, run.end);
        self.trouble.range(keys).next().map(|(&(_, key), _)| key)
    }

    /// Whether the merge may run.
    pub(crate) fn merge_is_open(&self, layout: &Layout) -> bool {
        self.is_complete(layout) && !self.is_quarantined(StageKind::Merge, 0)
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
    pub(crate) fn is_blocked(&self, layout: &Layout) -> bool {
        let mut is_in_trouble = false;
        for (kind, ..) in self.quarantined() {
            match kind {
                StageKind::Render | StageKind::Gather => is_in_trouble = true,
                StageKind::Merge => return true,
            }
        }
        is_in_trouble && self.open_grains(layout).is_empty() && self.open_gathers(layout).is_empty()
    }

    /// Everything in the store that the frame needs.
    pub(crate) fn artefacts(&self) -> impl Iterator<Item = Digest> + '_ {
        let tiles = self.tiles.values().map(|tile| tile.result.tile);
        tiles.chain(self.sums).chain(self.groups.artefacts()).map(|artefact| artefact.digest)
    }
}
