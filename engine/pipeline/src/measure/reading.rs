//! Readings: samples of a place until a stated accuracy.

use super::places::Place;
use super::request::Quantity;
use crate::settings::StopCondition;
use femc_film::convergence::student_95;
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_montecarlo::record::{BranchEvent, Continuation, Contribution, RecordLevel, Recorder, Termination, Vertex};
use femc_montecarlo::{PathSettings, Tracer};
use femc_prepared::Prepared;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Number of independent parts of the samples of a reading.
pub const REPLICATES: usize = 32;
/// Maximum number of samples of a reading whose error is given.
pub const MAX_SAMPLES: u32 = 1 << 20;
/// Number of samples of the first round of a reading whose error is given.
pub(super) const FIRST_SAMPLES: u32 = 32 * REPLICATES as u32;
/// Error for which the number of samples is planned, relative to the requested one.
const PLANNED_ERROR: f64 = 0.8;
/// Maximum growth of the number of samples from round to round.
const MAX_GROWTH: f64 = 4.0;
/// Number of samples without any light after which a reading is dark.
const DARK_SAMPLES: u32 = 1 << 14;
/// Bits that the seed is combined with, so that a reading and a frame with equal seeds use different random numbers.
const STREAM: u64 = 0x6d65_6173_7572_6573;

/// Settings of measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasureSettings {
    /// Number of samples of each reading (rounded up to a multiple of [`REPLICATES`]), or its maximum relative error with 95 %
    /// confidence. Seconds are not possible.
    pub stop: StopCondition,
    /// Maximum path length in segments; 1: only light that comes directly from lamps; 0: unlimited.
    pub max_depth: u32,
    /// Key of the random numbers.
    pub seed: u64,
    /// Whether the light of each lamp is measured, too.
    pub by_lamp: bool,
}

/// Light of a lamp at a place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LampShare {
    /// Name of the lamp, as in layers: object and material, or photometric file, or a medium that glows.
    pub lamp: String,
    /// Light of the lamp, in the unit of the reading.
    pub value: f64,
    /// Half width of its 95 % confidence interval.
    pub half_width: f64,
}

/// Result of a measurement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// Light by channel, as in images: a gray light of 1 lx or 1 cd/m2 is 1 in each channel.
    pub color: [f64; 3],
    /// Illuminance, lx, or luminance, cd/m2.
    pub value: f64,
    /// Half width of the 95 % confidence interval of `value`.
    pub half_width: f64,
    /// Number of samples.
    pub samples: u64,
    /// Number of samples that were not finite. They are left out.
    pub bad_samples: u64,
    /// Number of rays.
    pub rays: u64,
    /// Whether the requested error was reached. A dark place reaches it.
    pub is_converged: bool,
    /// Light of each lamp that arrives, brightest first; empty unless requested.
    pub lamps: Vec<LampShare>,
}

impl Reading {
    /// Returns the half width of the confidence interval relative to the value; 0 for a dark place.
    pub fn relative_error(&self) -> f64 {
        if self.value > 0.0 { self.half_width / self.value } else { 0.0 }
    }

    /// Returns the variance of the value.
    pub(super) fn variance(&self) -> f64 {
        let error = self.half_width / student_95((REPLICATES - 1) as f64);
        error * error
    }
}

/// Measures the light at a place, on the calling thread's rayon pool. `None`: the measurement was cancelled.
/// - `number`: number of the place in its request;
/// - `progress`: counts the samples.
pub fn measure(
    scene: &Prepared,
    number: u32,
    place: &Place,
    settings: &MeasureSettings,
    cancel: &AtomicBool,
    progress: &AtomicU64,
) -> Option<Reading> {
    let mut sums: Vec<ReplicateSum> = (0..REPLICATES).map(|_| ReplicateSum::default()).collect();
    let task = SampleTask { scene, number, place, settings, cancel, progress };
    let mut begin = 0;
    loop {
        let end = next_round(begin, &sums, settings.stop);
        if begin == end {
            break;
        }
        let per_replicate = begin / REPLICATES as u32..end / REPLICATES as u32;
        sums.par_iter_mut()
            .enumerate()
            .for_each(|(replicate, sum)| task.add_samples(replicate as u32, per_replicate.clone(), sum));
        if cancel.load(Ordering::Relaxed) {
            return None;
        }
        begin = end;
    }
    let mut reading = reading(&sums);
    reading.is_converged = match settings.stop {
        StopCondition::Error(error) => reading.relative_error() <= error,
        _ => true,
    };
    reading.lamps = lamp_shares(scene, &sums);
    Some(reading)
}

/// Returns the number of samples at the end of the next round. It is `done` if no more are necessary.
fn next_round(done: u32, sums: &[ReplicateSum], stop: StopCondition) -> u32 {
    let whole = |samples: u32| samples.clamp(1, u32::MAX / 2).next_multiple_of(REPLICATES as u32);
    let error = match stop {
        StopCondition::Error(error) => error,
        StopCondition::Spp(samples) => return whole(samples),
        StopCondition::Time(_) => return whole(FIRST_SAMPLES),
    };
    if done == 0 {
        return FIRST_SAMPLES;
    }
    let so_far = reading(sums);
    let is_dark = so_far.value == 0.0 && done >= DARK_SAMPLES;
    let is_reached = so_far.value > 0.0
        && so_far.relative_error() <= error * if done == FIRST_SAMPLES { PLANNED_ERROR } else { 1.0 };
    if done >= MAX_SAMPLES || is_dark || is_reached {
        return done;
    }
    // The number is planned for a smaller error, so that few readings need another round. A reading that ended whenever its error is
    // small by chance would state too narrow an interval.
    let growth = if so_far.value > 0.0 { so_far.relative_error() / (PLANNED_ERROR * error) } else { 2.0 };
    let planned = f64::from(done) * (growth * growth).clamp(1.5, MAX_GROWTH);
    let per_replicate = (planned / REPLICATES as f64).ceil() as u32;
    let power = per_replicate.next_power_of_two();
    let even = if per_replicate <= power / 4 * 3 { power / 4 * 3 } else { power };
    (even * REPLICATES as u32).min(MAX_SAMPLES)
}

/// Sums of a replicate.
#[derive(Clone, Debug, Default)]
struct ReplicateSum {
    color: [f64; 3],
    samples: u64,
    bad_samples: u64,
    rays: u64,
    lamps: BTreeMap<LampKey, f64>,
}

impl ReplicateSum {
    /// Returns the mean of a sum.
    fn mean(&self, sum: f64) -> f64 {
        if self.samples == 0 { 0.0 } else { sum / self.samples as f64 }
    }

    fn value(&self) -> f64 {
        let [r, g, b] = femc_math::color::LUMINANCE_WEIGHTS.to_array().map(f64::from);
        self.mean(self.color[0] * r + self.color[1] * g + self.color[2] * b)
    }
}

/// A lamp, or a medium that glows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum LampKey {
    Light(u32),
    Medium(u16),
}

/// Samples of a place.
struct SampleTask<'a> {
    scene: &'a Prepared,
    number: u32,
    place: &'a Place,
    settings: &'a MeasureSettings,
    cancel: &'a AtomicBool,
    progress: &'a AtomicU64,
}

impl SampleTask<'_> {
    /// Adds samples of a replicate, in order.
    fn add_samples(&self, replicate: u32, samples: Range<u32>, sum: &mut ReplicateSum) {
        if self.settings.by_lamp {
            self.trace(LampRecorder::default(), replicate, samples, sum);
        } else {
            self.trace((), replicate, samples, sum);
        }
    }

    fn trace<R: Recorder + LampLight>(&self, recorder: R, replicate: u32, samples: Range<u32>, sum: &mut ReplicateSum) {
        const STREAM_REPLICATES: u32 = femc_math::sampler::REPLICATES as u32;
        let settings = PathSettings {
            seed: self.settings.seed ^ STREAM,
            max_depth: self.settings.max_depth,
            single_technique: None,
        };
        let mut tracer = Tracer::with_recorder(self.scene, settings, recorder);
        // A stream has four replicates of its own.
        let stream = self.number * (REPLICATES as u32 / STREAM_REPLICATES) + replicate / STREAM_REPLICATES;
        let count = u64::from(samples.end - samples.start);
        for sample in samples {
            if self.cancel.load(Ordering::Relaxed) {
                return;
            }
            let sample = sample * STREAM_REPLICATES + replicate % STREAM_REPLICATES;
            let place = |u, time| self.place.reader.receiver(self.scene, u, time);
            let color = tracer.receive(stream, sample, place);
            if color.is_finite() && color.min_element() >= 0.0 {
                sum.samples += 1;
                let channels = color.to_array();
                sum.color.iter_mut().zip(channels).for_each(|(sum, value)| *sum += f64::from(value));
                tracer.recorder.add_to(&mut sum.lamps, self.place.info.quantity);
            } else {
                sum.bad_samples += 1;
            }
        }
        sum.rays += tracer.counters.rays + tracer.counters.shadow_rays;
        self.progress.fetch_add(count, Ordering::Relaxed);
    }
}

/// Computes the reading of replicates, without the light of lamps.
fn reading(sums: &[ReplicateSum]) -> Reading {
    let total = |part: fn(&ReplicateSum) -> u64| sums.iter().map(part).sum::<u64>();
    let (value, half_width) = interval(sums.iter().map(ReplicateSum::value));
    let channel = |at: usize| interval(sums.iter().map(|sum| sum.mean(sum.color[at]))).0;
    Reading {
        color: [channel(0), channel(1), channel(2)],
        value,
        half_width,
        samples: total(|sum| sum.samples),
        bad_samples: total(|sum| sum.bad_samples),
        rays: total(|sum| sum.rays),
        is_converged: false,
        lamps: Vec::new(),
    }
}

/// Returns the mean of the replicates' means, and the half width of its 95 % confidence interval.
fn interval(means: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let n = REPLICATES as f64;
    let mean = means.clone().sum::<f64>() / n;
    let squares: f64 = means.map(|value| (value - mean) * (value - mean)).sum();
    (mean, student_95(n - 1.0) * (squares / (n - 1.0) / n).sqrt())
}

/// Returns the light of each lamp, brightest first. Lamps of the same name are united.
fn lamp_shares(scene: &Prepared, sums: &[ReplicateSum]) -> Vec<LampShare> {
    let label = |key: &LampKey| match *key {
        LampKey::Light(light) => scene.lamp_label(light),
        LampKey::Medium(medium) => scene.medium_name(medium).to_owned(),
    };
    let mut means: BTreeMap<String, [f64; REPLICATES]> = BTreeMap::new();
    for (replicate, sum) in sums.iter().enumerate() {
        for (key, light) in &sum.lamps {
            means.entry(label(key)).or_default()[replicate] += sum.mean(*light);
        }
    }
    let share = |(lamp, means): (String, [f64; REPLICATES])| {
        let (value, half_width) = interval(means.into_iter());
        LampShare { lamp, value, half_width }
    };
    let mut shares: Vec<LampShare> = means.into_iter().map(share).collect();
    shares.sort_by(|a, b| b.value.total_cmp(&a.value));
    shares
}

/// Light of the lamps in the latest sample.
trait LampLight {
    /// Adds the light of the latest sample to sums by lamp.
    fn add_to(&mut self, sums: &mut BTreeMap<LampKey, f64>, quantity: Quantity);
}

impl LampLight for () {
    fn add_to(&mut self, _: &mut BTreeMap<LampKey, f64>, _: Quantity) {}
}

/// Recorder of the light by lamp.
#[derive(Default)]
struct LampRecorder {
    /// Contributions of the current sample, in luminance.
    light: Vec<(LampKey, f32)>,
}

impl LampLight for LampRecorder {
    fn add_to(&mut self, sums: &mut BTreeMap<LampKey, f64>, quantity: Quantity) {
        let weight = if quantity == Quantity::Luminance { 1.0 } else { std::f64::consts::PI };
        for (key, light) in self.light.drain(..) {
            *sums.entry(key).or_default() += weight * f64::from(light);
        }
    }
}

impl Recorder for LampRecorder {
    const WANTS_OCCLUDERS: bool = false;
    const WANTS_ZERO_LIGHT: bool = false;

    fn begin_sample(&mut self, _: u32, _: u32) -> RecordLevel {
        self.light.clear();
        RecordLevel::All
    }

    fn contribution(&mut self, contribution: impl FnOnce() -> Contribution) {
        let Contribution { color, light, medium, .. } = contribution();
        let key = light.map(LampKey::Light).or(medium.map(LampKey::Medium));
        if let Some(key) = key.filter(|_| color != Rgb::ZERO) {
            self.light.push((key, luminance(color)));
        }
    }

    fn vertex(&mut self, _: impl FnOnce() -> Vertex) {}
    fn leave(&mut self, _: Continuation) {}
    fn occluded(&mut self, _: impl FnOnce() -> femc_geometry::Ray) {}
    fn branch(&mut self, _: BranchEvent) {}
    fn terminate(&mut self, _: Termination) {}
    fn end_sample(&mut self, _: Option<Rgb>) {}
}
