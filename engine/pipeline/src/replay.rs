//! Replay of samples of a finished frame. A sample is a function of the settings, so data that was not recorded during rendering
//! can be computed afterwards.

use crate::render::{FilterAdapter, film_sample, frame_tracer};
use crate::settings::{Settings, StopCondition};
use femc_math::Rgb;
use femc_montecarlo::{Recorder, Recording, Tracer};
use femc_prepared::Prepared;
use std::ops::Range;

/// Tracer that replays samples on one thread.
pub struct Replay<'a, R = Recording> {
    tracer: Tracer<'a, R>,
    settings: &'a Settings,
    width: u32,
}

impl<'a> Replay<'a> {
    /// Creates a replay of a frame with these settings.
    pub fn new(prepared: &'a Prepared, settings: &'a Settings) -> Self {
        Self::with_recorder(prepared, settings, Recording::default())
    }
}

impl<'a, R: Recorder> Replay<'a, R> {
    /// Creates a replay with another recorder.
    pub fn with_recorder(prepared: &'a Prepared, settings: &'a Settings, recorder: R) -> Self {
        let tracer = frame_tracer(prepared, settings, recorder);
        Self { tracer, settings, width: prepared.camera.film[0] }
    }

    /// Traces sample number `sample` of a pixel. Returns its color, cd/m2, or `None` if the film rejects it, and its recording.
    pub fn sample(&mut self, (x, y): (u32, u32), sample: u32) -> (Option<Rgb>, &R) {
        let drawn = self.tracer.sample(y * self.width + x, sample, FilterAdapter(self.settings.filter));
        let color = film_sample(&drawn).fault().is_none().then_some(drawn.color);
        self.tracer.recorder.end_sample(color);
        (color, &self.tracer.recorder)
    }

    /// Returns the recorder, to change what it records of the next samples.
    pub fn recorder_mut(&mut self) -> &mut R {
        &mut self.tracer.recorder
    }

    /// Returns the recorder, with its data of all samples.
    pub fn into_recorder(self) -> R {
        self.tracer.recorder
    }
}

/// Samples that a pixel's mean consists of. If the halves end separately, it is the mean of their means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CountedSamples {
    /// First sample.
    pub begin: u32,
    /// One past the last sample of each half.
    pub ends: [u32; 2],
}

impl CountedSamples {
    /// Returns all possibilities for a frame of these settings and a pixel whose file says `samples` samples.
    pub fn candidates(settings: &Settings, samples: u32) -> Vec<Self> {
        match (settings.stop, &settings.allocation) {
            (StopCondition::Spp(spp), _) => return vec![Self { begin: 0, ends: [spp; 2] }],
            (StopCondition::Time(_), Some(allocation)) => {
                let begin = allocation.begin;
                return vec![Self { begin, ends: [begin.saturating_add(samples); 2] }];
            }
            _ => {}
        }
        let rounds: Vec<u32> = settings.rounds().into_iter().take_while(|&end| end <= 2 * samples).collect();
        let pairs = rounds.iter().flat_map(|&a| rounds.iter().map(move |&b| Self { begin: 0, ends: [a, b] }));
        pairs.filter(|pair| pair.count() == samples).collect()
    }

    /// Returns the first `samples` samples of a pixel.
    pub fn first_samples(samples: u32) -> Self {
        Self { begin: 0, ends: [samples; 2] }
    }

    /// Returns the number of samples of each half.
    fn halves(self) -> [u32; 2] {
        let [a, b] = self.ends;
        [a.div_ceil(2) - self.begin.div_ceil(2), b / 2 - self.begin / 2]
    }

    /// Returns the number of samples of both halves.
    pub fn count(self) -> u32 {
        self.halves().iter().sum()
    }

    /// Returns the range of samples to trace.
    pub fn range(self) -> Range<u32> {
        self.begin..self.ends[0].max(self.ends[1])
    }

    /// Checks whether a sample counts.
    pub fn contains(self, sample: u32) -> bool {
        sample >= self.begin && sample < self.ends[sample as usize % 2]
    }

    /// Returns the mean of a pixel's samples, given in order from the first of all. Samples that the film rejects are left out.
    pub fn mean(self, samples: &[Option<Rgb>]) -> Rgb {
        let (mut sums, mut counts) = ([[0f64; 3]; 2], [0u32; 2]);
        let taken = (0u32..).zip(samples).filter_map(|(index, color)| Some((index, (*color)?)));
        for (index, color) in taken.filter(|(index, _)| self.contains(*index)) {
            let half = index as usize % 2;
            counts[half] += 1;
            sums[half].iter_mut().zip(color.to_array()).for_each(|(sum, value)| *sum += f64::from(value));
        }
        let weights = self.weights(counts);
        let mean = |axis: usize| {
            let half = |half: usize| weights[half] * sums[half][axis] / f64::from(counts[half].max(1));
            (half(0) + half(1)) as f32
        };
        Rgb::new(mean(0), mean(1), mean(2))
    }

    /// Returns the weights of the halves in a mean of these numbers of samples: proportional to the numbers, or 1/2 each if the
    /// halves end separately.
    fn weights(self, counts: [u32; 2]) -> [f64; 2] {
        match counts.map(f64::from) {
            [0.0, _] => [0.0, 1.0],
            [_, 0.0] => [1.0, 0.0],
            _ if self.ends[0] != self.ends[1] => [0.5; 2],
            [a, b] => [a / (a + b), b / (a + b)],
        }
    }

    /// Returns the factor from the variance of a sample to that of the mean.
    pub fn variance_factor(self) -> f64 {
        let counts = self.halves();
        let weights = self.weights(counts);
        (0..2).map(|half| weights[half].powi(2) / f64::from(counts[half].max(1))).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SampleAllocation;

    fn counted(begin: u32, ends: [u32; 2]) -> CountedSamples {
        CountedSamples { begin, ends }
    }

    #[test]
    fn the_samples_of_a_pixel_are_found_by_their_number() {
        let even = Settings { stop: StopCondition::Spp(7), ..Settings::default() };
        assert_eq!(CountedSamples::candidates(&even, 7), [counted(0, [7; 2])]);
        assert_eq!(counted(0, [7; 2]).count(), 7);
        let uneven = Settings::default();
        assert_eq!(CountedSamples::candidates(&uneven, 14), [counted(0, [12, 16]), counted(0, [16, 12])]);
        assert_eq!(CountedSamples::candidates(&uneven, 24).len(), 3, "16 and 32, 24 twice, 32 and 16");
        assert_eq!(CountedSamples::candidates(&uneven, 21), []);
        let allocation = Some(SampleAllocation { begin: 4, ends: vec![11, 60] });
        let timed = Settings { stop: StopCondition::Time(9.0), allocation, ..Settings::default() };
        assert_eq!(CountedSamples::candidates(&timed, 7), [counted(4, [11; 2])]);
        assert_eq!(counted(4, [11; 2]).count(), 7);
    }

    #[test]
    fn mean_averages_half_means_and_skips_samples_the_film_refuses() {
        let gray = |value: f32| Rgb::splat(value);
        let samples = [Some(1.0), Some(10.0), Some(3.0), Some(99.0), None, Some(99.0)].map(|it| it.map(gray));
        assert_eq!(counted(0, [6, 2]).mean(&samples), gray(6.0), "1 and 3, and 10 alone");
        assert_eq!(counted(0, [6, 2]).count(), 4);
        let even = counted(0, [3; 2]).mean(&samples).to_array()[1];
        assert!((even - 14.0 / 3.0).abs() < 1e-6, "{even}: of 1, 10 and 3");
        assert!((counted(0, [7; 2]).variance_factor() - 1.0 / 7.0).abs() < 1e-12);
        assert!((counted(0, [8, 4]).variance_factor() - 0.25 * (0.25 + 0.5)).abs() < 1e-12);
    }
}
