//! Statistics of some samples, and the keys of the brightest and the deepest of them.

use super::TOP_RECORDS;
use femc_paths::pixels::PixelSums;
use femc_paths::{LightPath, PathKey, SampleCounters};
use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};

/// Data recorded of some samples.
pub(crate) struct RecordedSamples {
    pub(super) counters: [SampleCounters; 2],
    /// Sums of the pixels of each half, in the order of rendering: row by row.
    pub(super) pixels: [Vec<PixelSums>; 2],
    pub(super) paths: Vec<LightPath>,
    pub(super) bright: TopKeys,
    pub(super) deep: TopKeys,
}

impl RecordedSamples {
    pub(super) fn new() -> Self {
        Self {
            counters: Default::default(),
            pixels: Default::default(),
            paths: Vec::new(),
            bright: TopKeys::default(),
            deep: TopKeys::default(),
        }
    }

    pub(super) fn merge(&mut self, other: Self) {
        for (mine, theirs) in self.counters.iter_mut().zip(&other.counters) {
            mine.merge_counts(theirs);
            mine.merge_bins(&theirs.bins);
        }
        self.pixels.iter_mut().zip(other.pixels).for_each(|(mine, theirs)| mine.extend(theirs));
        self.paths.extend(other.paths);
        self.bright.merge(other.bright);
        self.deep.merge(other.deep);
    }
}

/// Keys of greatest rank of each half. Among equal ranks, those of least hash.
#[derive(Default)]
pub(super) struct TopKeys([BinaryHeap<Reverse<RankedKey>>; 2]);

/// Key with its rank, as the bits of a non-negative number, which are in the same order.
type RankedKey = (u32, Reverse<(u64, PathKey)>);

impl TopKeys {
    #[inline]
    pub(super) fn offer(&mut self, rank: f32, hash: u64, key: PathKey) {
        let half = &mut self.0[usize::from(key.half())];
        let ranked = (rank.to_bits(), Reverse((hash, key)));
        // Among equal ranks, like those of all black samples, only few keys have the least hashes.
        if half.len() < TOP_RECORDS as usize || half.peek().is_none_or(|Reverse(least)| ranked > *least) {
            Self::push(half, ranked);
        }
    }

    fn push(half: &mut BinaryHeap<Reverse<RankedKey>>, ranked: RankedKey) {
        half.push(Reverse(ranked));
        if half.len() > TOP_RECORDS as usize {
            half.pop();
        }
    }

    pub(super) fn merge(&mut self, other: Self) {
        for (mine, theirs) in self.0.iter_mut().zip(other.0) {
            theirs.into_iter().for_each(|Reverse(ranked)| Self::push(mine, ranked));
        }
    }

    pub(super) fn keys(self) -> BTreeSet<PathKey> {
        self.0.into_iter().flatten().map(|Reverse((_, Reverse((_, key))))| key).collect()
    }
}
