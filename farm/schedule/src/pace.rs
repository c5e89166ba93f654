//! How long the tasks of a job take, learned from those that are done.

/// Smoothed times; 0: none is done yet.
#[derive(Debug, Clone, Default)]
pub(crate) struct Pace {
    /// Picoseconds a pixel sample.
    sample: u64,
    /// Microseconds a gathered group.
    gather: u64,
    /// Microseconds a merge.
    merge: u64,
}

impl Pace {
    /// What is expected of a task while none of its kind is done, ms.
    pub(crate) const FIRST: u64 = 1_000;
    /// Picoseconds of a millisecond.
    const PICOS: u64 = 1_000_000_000;

    /// Milliseconds that so many pixel samples are expected to take; `None`: nobody knows yet.
    pub(crate) fn render(&self, samples: u64) -> Option<u64> {
        let picos = u128::from(self.sample) * u128::from(samples);
        let milliseconds = u64::try_from(picos.div_ceil(u128::from(Self::PICOS))).unwrap_or(u64::MAX);
        (self.sample > 0).then_some(milliseconds)
    }

    /// Milliseconds that a merge is expected to take; `None`: nobody knows yet.
    pub(crate) fn merge(&self) -> Option<u64> {
        (self.merge > 0).then(|| self.merge.div_ceil(1_000))
    }

    /// Milliseconds that a group is expected to take; `None`: nobody knows yet.
    pub(crate) fn gather(&self) -> Option<u64> {
        (self.gather > 0).then(|| self.gather.div_ceil(1_000))
    }

    /// Pixel samples were rendered in so many milliseconds.
    pub(crate) fn note_render(&mut self, samples: u64, milliseconds: u64) {
        let taken = u128::from(milliseconds.max(1)) * u128::from(Self::PICOS) / u128::from(samples.max(1));
        smooth(&mut self.sample, u64::try_from(taken).unwrap_or(u64::MAX));
    }

    /// A group has taken so many milliseconds.
    pub(crate) fn note_gather(&mut self, milliseconds: u64) {
        smooth(&mut self.gather, milliseconds.saturating_mul(1_000));
    }

    /// A merge has taken so many milliseconds.
    pub(crate) fn note_merge(&mut self, milliseconds: u64) {
        smooth(&mut self.merge, milliseconds.saturating_mul(1_000));
    }
}

fn smooth(mean: &mut u64, taken: u64) {
    let taken = taken.max(1);
    *mean = if *mean == 0 { taken } else { *mean - *mean / 8 + taken / 8 }.max(1);
}
