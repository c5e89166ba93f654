//! How long the tasks of a job take, learned from those that are done.

use std::collections::BTreeMap;

/// Smoothed times by stage number, picoseconds a unit of work; a stage of which nothing is done yet is not there.
#[derive(Debug, Clone, Default)]
pub(crate) struct Pace(BTreeMap<u16, u64>);

impl Pace {
    /// What is expected of a task while none of its stage is done, ms.
    pub(crate) const FIRST: u64 = 1_000;
    /// Picoseconds of a millisecond.
    const PICOS: u64 = 1_000_000_000;

    /// Milliseconds that so many units of a stage are expected to take; `None`: nobody knows yet.
    pub(crate) fn expected(&self, stage: u16, units: u64) -> Option<u64> {
        let picos = u128::from(*self.0.get(&stage)?) * u128::from(units);
        Some(u64::try_from(picos.div_ceil(u128::from(Self::PICOS))).unwrap_or(u64::MAX))
    }

    /// So many units of a stage have taken so many milliseconds.
    pub(crate) fn note(&mut self, stage: u16, units: u64, milliseconds: u64) {
        let taken = u128::from(milliseconds.max(1)) * u128::from(Self::PICOS) / u128::from(units.max(1));
        let taken = u64::try_from(taken).unwrap_or(u64::MAX).max(1);
        let mean = self.0.entry(stage).or_insert(taken);
        *mean = (*mean - *mean / 8 + taken / 8).max(1);
    }
}
