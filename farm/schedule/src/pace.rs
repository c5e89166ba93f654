//! Pace of a job: the expected duration of its tasks, learned from completed ones.

use std::collections::BTreeMap;

/// Smoothed times by stage number, in picoseconds per unit of work. A stage without completed tasks has no entry.
#[derive(Debug, Clone, Default)]
pub(crate) struct Pace(BTreeMap<u16, u64>);

impl Pace {
    /// Expected duration of a task in milliseconds while no task of its stage is completed.
    pub(crate) const DEFAULT: u64 = 1_000;
    /// Picoseconds in a millisecond.
    const PICOSECONDS_PER_MS: u64 = 1_000_000_000;

    /// Returns the expected milliseconds for these units of a stage; `None`: unknown yet.
    pub(crate) fn expected(&self, stage: u16, units: u64) -> Option<u64> {
        let picos = u128::from(*self.0.get(&stage)?) * u128::from(units);
        Some(u64::try_from(picos.div_ceil(u128::from(Self::PICOSECONDS_PER_MS))).unwrap_or(u64::MAX))
    }

    /// Records that these units of a stage took these milliseconds.
    pub(crate) fn update(&mut self, stage: u16, units: u64, milliseconds: u64) {
        let taken = u128::from(milliseconds.max(1)) * u128::from(Self::PICOSECONDS_PER_MS) / u128::from(units.max(1));
        let taken = u64::try_from(taken).unwrap_or(u64::MAX).max(1);
        let mean = self.0.entry(stage).or_insert(taken);
        *mean = (*mean - *mean / 8 + taken / 8).max(1);
    }
}
