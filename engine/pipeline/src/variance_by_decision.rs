//! Variance of samples by the decisions of their paths: directions, lamps, points on lamps, distances, Russian roulette.
//!
//! A sample `X` is a function of random numbers. Its decisions draw them one after the other. Let `W(i)` be the variance that is left
//! when the first `i` decisions are fixed, averaged over these decisions. `W(0)` is the variance of `X`, and `W(n)` is 0 after the
//! last decision. The part of decision `i` is `W(i) - W(i + 1)`, so the parts add up to the variance (law of total variance).
//!
//! A second sample `X'` that shares the first `i` decisions with `X` gives an unbiased estimate: the mean of `(X - X')^2 / 2` is
//! `W(i)`. Each sample is therefore traced again once for each of its decisions, with new numbers from that decision on. The numbers
//! are the same for all cuts, so neighboring estimates differ by one decision only, which makes their difference precise.
//!
//! The variance is that of independent samples. Evenly spread samples have less.

use crate::replay::Replay;
use crate::settings::Settings;
use femc_geometry::Ray;
use femc_math::SampleStream;
use femc_math::color::luminance;
pub use femc_montecarlo::record::Decision;
use femc_montecarlo::record::{BranchEvent, Continuation, Contribution, RecordLevel, Recorder, Termination, Vertex};
use femc_prepared::Prepared;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;

/// Segment from which on decisions are not told apart.
pub const MAX_BOUNCE: u32 = 8;

/// A kind of decisions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct DecisionKey {
    /// Decision. `None`: any decision from segment [`MAX_BOUNCE`] on.
    pub decision: Option<Decision>,
    /// Segment that ends at the vertex of the decision, or on which it is made; 0: the camera's.
    pub bounce: u32,
    /// Whether the guide of a first pass drew the direction.
    pub is_guided: bool,
}

/// A mean with its standard error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MeanEstimate {
    /// Mean.
    pub mean: f64,
    /// Standard error of the mean.
    pub error: f64,
}

/// A pixel, and the factor by which its variance counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WeightedPixel {
    /// Column and row.
    pub pixel: (u32, u32),
    /// Factor, for example 1 over the squared luminance.
    pub weight: f64,
}

/// Parts of the variance of a sample.
#[derive(Clone, Debug, Default)]
pub struct VarianceByDecision {
    /// Part of each kind of decisions.
    pub parts: BTreeMap<DecisionKey, MeanEstimate>,
    /// Sum of all parts.
    pub sum: MeanEstimate,
    /// Variance from the spread of the samples of each pixel, for comparison.
    pub spread: MeanEstimate,
    /// Number of samples, and of samples traced again.
    pub samples: u64,
    /// Number of samples traced again.
    pub replays: u64,
}

/// Sum and sum of squares of some values.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    sum: f64,
    squares: f64,
}

impl Sums {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.squares += value * value;
    }

    fn merge(&mut self, other: Self) {
        self.sum += other.sum;
        self.squares += other.squares;
    }

    /// Returns the mean of `n` values. Values that were not added count as 0.
    fn estimate(self, n: f64) -> MeanEstimate {
        let mean = self.sum / n.max(1.0);
        let variance = (self.squares / n.max(1.0) - mean * mean).max(0.0) / (n - 1.0).max(1.0);
        MeanEstimate { mean, error: variance.sqrt() }
    }
}

/// Results of one pixel.
#[derive(Default)]
struct PixelResult {
    parts: BTreeMap<DecisionKey, Sums>,
    sum: Sums,
    spread: f64,
    samples: u64,
    replays: u64,
}

impl VarianceByDecision {
    /// Traces samples of pixels, and each again for all of its decisions. The result does not depend on the number of threads.
    /// - `samples`: numbers of the samples of each pixel.
    pub fn from_replay(
        prepared: &Prepared,
        settings: &Settings,
        pixels: &[WeightedPixel],
        samples: Range<u32>,
    ) -> Self {
        let results: Vec<PixelResult> =
            pixels.par_iter().map(|pixel| PixelResult::new(prepared, settings, *pixel, samples.clone())).collect();
        let (mut parts, mut sum, mut spread) = (BTreeMap::<DecisionKey, Sums>::new(), Sums::default(), Sums::default());
        let mut out = Self::default();
        for result in results {
            for (key, of_pixel) in result.parts {
                parts.entry(key).or_default().merge(of_pixel);
            }
            sum.merge(result.sum);
            spread.add(result.spread);
            out.samples += result.samples;
            out.replays += result.replays;
        }
        let n = out.samples as f64;
        out.parts = parts.into_iter().map(|(key, of_key)| (key, of_key.estimate(n))).collect();
        out.sum = sum.estimate(n);
        out.spread = spread.estimate(pixels.len() as f64);
        out
    }
}

impl PixelResult {
    fn new(prepared: &Prepared, settings: &Settings, at: WeightedPixel, samples: Range<u32>) -> Self {
        let WeightedPixel { pixel, weight } = at;
        let mut replay = Replay::with_recorder(prepared, settings, DecisionRecorder::default());
        let (mut out, mut values) = (Self::default(), Sums::default());
        for sample in samples {
            let mut trace = |cut: Option<u32>| {
                replay.recorder_mut().cut = cut;
                let (color, recorder) = replay.sample(pixel, sample);
                let log = if cut.is_none() { recorder.log.clone() } else { Vec::new() };
                color.map(|color| (f64::from(luminance(color)), log))
            };
            let Some((value, log)) = trace(None) else { continue };
            out.samples += 1;
            values.add(value);
            let mut whole = 0.0;
            let mut before = None;
            for (number, key) in (0u32..).zip(&log) {
                // Variance that is left from this decision on, and from the next one on.
                let mut left = |number: u32| {
                    if number as usize >= log.len() {
                        return 0.0;
                    }
                    out.replays += 1;
                    trace(Some(number)).map_or(0.0, |(other, _)| 0.5 * weight * (value - other).powi(2))
                };
                let here = before.unwrap_or_else(|| left(number));
                let is_last = key.decision.is_none();
                let after = if is_last { 0.0 } else { left(number + 1) };
                if number == 0 {
                    whole = here;
                }
                out.parts.entry(*key).or_default().add(here - after);
                before = Some(after);
                if is_last {
                    break;
                }
            }
            out.sum.add(whole);
        }
        let n = out.samples as f64;
        let mean = values.sum / n.max(1.0);
        out.spread = weight * (values.squares - n * mean * mean).max(0.0) / (n - 1.0).max(1.0);
        out
    }
}

/// Recorder that lists the decisions of a path, or replaces the random numbers from one of them on.
#[derive(Clone, Debug, Default)]
struct DecisionRecorder {
    /// Number of the first decision with new random numbers. `None`: no decision.
    cut: Option<u32>,
    /// Decisions of the current sample.
    log: Vec<DecisionKey>,
    /// Whether the decision of the cut was reached, and whether the current branch still has its old numbers.
    is_cut: bool,
    is_old_branch: bool,
    is_in_branch: bool,
    /// Whether the decision was reached before the copy that is being split off.
    was_cut: bool,
}

/// Number of the stream with new random numbers.
const NEW_NUMBERS: u64 = 0x6e65_775f_6e75_6d62;

impl Recorder for DecisionRecorder {
    const WANTS_OCCLUDERS: bool = false;
    const WANTS_ZERO_LIGHT: bool = false;

    fn begin_sample(&mut self, _: u32, _: u32) -> RecordLevel {
        self.log.clear();
        (self.is_cut, self.is_old_branch, self.is_in_branch) = (false, false, false);
        RecordLevel::All
    }

    fn decide(&mut self, decision: Decision, bounce: u32, stream: &mut SampleStream) {
        let is_first_new = self.cut == Some(self.log.len() as u32);
        if is_first_new || self.is_cut && self.is_old_branch {
            *stream = stream.branch(NEW_NUMBERS);
            self.is_cut = true;
            self.is_old_branch = false;
        }
        let decision = (bounce < MAX_BOUNCE).then_some(decision);
        self.log.push(DecisionKey { decision, bounce: bounce.min(MAX_BOUNCE), is_guided: false });
    }

    fn vertex(&mut self, _: impl FnOnce() -> Vertex) {}

    fn leave(&mut self, continuation: Continuation) {
        let is_direction = |key: &&mut DecisionKey| key.decision == Some(Decision::Direction);
        if let Some(key) = self.log.last_mut().filter(is_direction) {
            key.is_guided |= continuation.is_guide_sample && !self.is_in_branch;
        }
    }

    fn occluded(&mut self, _: impl FnOnce() -> Ray) {}

    fn contribution(&mut self, _: impl FnOnce() -> Contribution) {}

    fn branch(&mut self, event: BranchEvent) {
        match event {
            BranchEvent::Begin => (self.is_in_branch, self.was_cut) = (true, self.is_cut),
            BranchEvent::Suspend | BranchEvent::Discard => {
                self.is_in_branch = false;
                // The original path still has the numbers from before the copy.
                self.is_old_branch |= self.is_cut && !self.was_cut;
            }
            // The branch still has the numbers from before the cut.
            BranchEvent::Resume => self.is_old_branch = true,
        }
    }

    fn terminate(&mut self, _: Termination) {}

    fn end_sample(&mut self, _: Option<femc_math::Rgb>) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Records one direction, and returns whether its random numbers are new.
    fn decides_anew(recorder: &mut DecisionRecorder, stream: &mut SampleStream) -> bool {
        let number = |mut stream: SampleStream| {
            stream.seek(7);
            stream.next_1d().to_bits()
        };
        let before = number(*stream);
        recorder.decide(Decision::Direction, 0, stream);
        number(*stream) != before
    }

    /// A path is split at its second decision. The copy decides once while it leaves and once when it is resumed; the original path
    /// decides once in between. All decisions from the cut on, and no other, get new numbers.
    #[test]
    fn decisions_of_all_branches_after_the_cut_are_new() {
        for cut in 0..6u32 {
            let mut recorder = DecisionRecorder { cut: Some(cut), ..DecisionRecorder::default() };
            recorder.begin_sample(0, 0);
            let mut original = SampleStream::new(1, 1, 0, 0);
            let mut renewed = Vec::new();
            renewed.push(decides_anew(&mut recorder, &mut original));
            renewed.push(decides_anew(&mut recorder, &mut original));
            recorder.branch(BranchEvent::Begin);
            let mut copy = original;
            renewed.push(decides_anew(&mut recorder, &mut copy));
            recorder.branch(BranchEvent::Suspend);
            // The tracer replaces the stream of a copy that waits.
            let mut waiting = original.branch(1);
            renewed.push(decides_anew(&mut recorder, &mut original));
            recorder.branch(BranchEvent::Resume);
            let is_new_by_split = cut < 2;
            renewed.push(decides_anew(&mut recorder, &mut waiting) || is_new_by_split);
            let is_new: Vec<bool> = (0..5).map(|number| number >= cut).collect();
            // A stream that was renewed stays so without another change.
            let has_new_numbers = |number: usize| renewed[..=number].iter().any(|renewed| *renewed);
            assert!((0..5).all(|number| has_new_numbers(number) == is_new[number]), "{cut}: {renewed:?}");
            assert!(cut != 2 || renewed[3] && renewed[4], "{renewed:?}");
            assert!(cut != 3 || renewed[4], "{renewed:?}");
        }
    }
}
