//! Means of scenes to a wanted standard error, beside the truth.

use super::line::{Line, Verdict};
use crate::scene_of;
use femc_film::Filter;
use femc_math::color::luminance;
use femc_montecarlo::{PathSettings, Tracer};
use femc_pipeline::{Places, Settings, Source, prepare};
use femc_prepared::Prepared;
use rayon::prelude::*;
use std::time::Instant;

/// Independent renderings of a mean; their number fixes the degrees of freedom of its standard error.
const RENDERINGS: u64 = 64;
/// Standard errors that a mean may be from the truth.
const FAR: f64 = 3.0;
/// Times that a mean which is too far away is measured.
const TRIES: u64 = 3;

/// How much is measured.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Factor on the standard errors that are wanted: 1 for a full run, 10 for a quick one, which leaves out long cases, too.
    pub coarser: f64,
    /// Grazing rays.
    pub rays: u64,
}

impl Effort {
    /// Everything: the standard errors that the cases state.
    pub const FULL: Self = Self { coarser: 1.0, rays: 100_000_000 };
    /// In seconds.
    pub const QUICK: Self = Self { coarser: 10.0, rays: 1_000_000 };

    /// Whether long cases are left out.
    pub fn is_quick(&self) -> bool {
        self.coarser >= Self::QUICK.coarser
    }
}

/// A scene whose mean luminance is known.
#[derive(Clone, Debug)]
pub struct Case {
    /// What is special about it.
    pub name: String,
    /// The scene's files; the first is the scene itself.
    pub files: Vec<(String, String)>,
    /// Mean luminance of the film, cd/m2.
    pub truth: f64,
    /// Standard error that is wanted, relative to the truth.
    pub sigma: f64,
    /// Longest path in segments; 0: no bound.
    pub max_depth: u32,
    /// What the scene itself may be off, relative: rounding of single precision, or what a comment says.
    pub slack: f64,
    /// Whether a quick run leaves it out.
    pub is_long: bool,
}

/// A mean luminance.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    /// Of all samples, cd/m2.
    pub mean: f64,
    /// Its standard error, by what independent renderings differ.
    pub error: f64,
    /// Samples.
    pub samples: u64,
    /// Samples that are NaN, infinite or negative; they are not in the mean.
    pub bad: u64,
}

impl Case {
    /// A scene of one file, to a thousandth.
    pub fn new(name: impl Into<String>, text: impl Into<String>, truth: f64) -> Self {
        let files = vec![("stress.mgf".to_owned(), text.into())];
        Self { name: name.into(), files, truth, sigma: 1e-3, max_depth: 0, slack: 1e-5, is_long: false }
    }

    /// To another standard error.
    pub fn to(self, sigma: f64) -> Self {
        Self { sigma, ..self }
    }

    /// With paths of so many segments at most.
    pub fn depth(self, max_depth: u32) -> Self {
        Self { max_depth, ..self }
    }

    /// With a scene that is off by so much.
    pub fn slack(self, slack: f64) -> Self {
        Self { slack, ..self }
    }

    /// Not in a quick run.
    pub fn long(self) -> Self {
        Self { is_long: true, ..self }
    }

    /// With another file.
    pub fn file(mut self, name: &str, text: impl Into<String>) -> Self {
        self.files.push((name.to_owned(), text.into()));
        self
    }

    /// The scene's first frame, ready to trace.
    ///
    /// # Panics
    /// If it is no scene.
    pub fn prepare(&self) -> Prepared {
        let files: Vec<_> = self.files.iter().map(|(name, text)| (name.as_str(), text.as_str())).collect();
        let source = Source::new(scene_of(&files));
        prepare(&source, &Settings::default(), 1, None).unwrap_or_else(|error| panic!("{}: {error}", self.name))
    }

    /// First of its seeds: cases do not share their random numbers, so that their errors are independent.
    fn seed(&self) -> u64 {
        let digest = blake3::hash(self.name.as_bytes());
        u64::from_le_bytes(*digest.as_bytes().first_chunk().expect("eight bytes")) >> 8
    }

    /// Measures it.
    pub fn line(&self, group: &str, effort: &Effort) -> Line {
        let begun = Instant::now();
        let prepared = self.prepare();
        let wanted = self.sigma * effort.coarser * self.truth.abs();
        let is_near = |it: &Measured| (it.mean - self.truth).abs() <= FAR * it.error + self.slack * self.truth.abs();
        let mut now = to_error(&prepared, self.max_depth, wanted, self.seed());
        let mut bad = now.bad;
        for again in 1..TRIES {
            if is_near(&now) || bad > 0 {
                break;
            }
            now = to_error(&prepared, self.max_depth, 0.5 * wanted, self.seed() + (again << 32));
            bad += now.bad;
        }
        let verdict = if bad > 0 {
            Verdict::Fails(format!("{bad} bad samples"))
        } else if !is_near(&now) {
            Verdict::Fails(format!("{:+.1} standard errors off, the third time", (now.mean - self.truth) / now.error))
        } else if now.error > wanted {
            Verdict::Fails(format!("too noisy: {:.1e} is wanted", wanted))
        } else {
            Verdict::Holds
        };
        Line {
            name: format!("{group}: {}", self.name),
            value: now.mean,
            error: now.error,
            truth: self.truth,
            samples: now.samples,
            bad,
            seconds: begun.elapsed().as_secs_f64(),
            verdict,
        }
    }
}

/// Measures a list of cases.
pub fn all(group: &str, cases: &[Case], effort: &Effort, tell: &mut dyn FnMut(Line)) {
    for case in cases.iter().filter(|case| !(case.is_long && effort.is_quick())) {
        tell(case.line(group, effort));
    }
}

/// Greatest number of samples a pixel and rendering.
const MOST: u32 = 1 << 22;

/// Mean to a standard error. Pilots with seeds of their own fix the number of samples, so that it does not depend on the samples that
/// count; what turns out noisier than its pilot is measured anew.
fn to_error(prepared: &Prepared, max_depth: u32, wanted: f64, seed: u64) -> Measured {
    let mut spp = 1u32;
    for run in 0.. {
        let pilot = renderings(prepared, max_depth, spp, seed + ((2 * run) << 16));
        let factor = 1.3 * (pilot.error / wanted).powi(2);
        // A pilot of few samples may not know what there is: 64 times its own samples are as many as it is trusted with.
        let is_enough = factor <= 64.0;
        let next = (f64::from(spp) * factor.clamp(1.0, 64.0)).ceil().min(f64::from(MOST)) as u32;
        // Multiples of a power of two share their points more evenly.
        spp = next.next_multiple_of((next.next_power_of_two() / 16).max(1)).min(MOST);
        if is_enough || spp == MOST {
            let measured = renderings(prepared, max_depth, spp, seed + ((2 * run + 1) << 16));
            if measured.error <= wanted || spp == MOST {
                return measured;
            }
        }
    }
    unreachable!("the number of samples grows up to its bound")
}

/// Mean by [`RENDERINGS`] renderings of `spp` samples a pixel.
fn renderings(prepared: &Prepared, max_depth: u32, spp: u32, seed: u64) -> Measured {
    let [width, height] = prepared.camera.film;
    let rendering = |seed: u64| {
        let mut tracer = Tracer::new(prepared, PathSettings { seed, max_depth, only: None });
        let (mut sum, mut bad) = (0.0, 0);
        for pixel in 0..width * height {
            for index in 0..spp {
                let color = tracer.sample(pixel, index, Places(Filter::Box)).color;
                if color.is_finite() && color.min_element() >= 0.0 {
                    sum += f64::from(luminance(color));
                } else {
                    bad += 1;
                }
            }
        }
        (sum / f64::from(width * height) / f64::from(spp), bad)
    };
    let means: Vec<(f64, u64)> = (1..=RENDERINGS).into_par_iter().map(|k| rendering(seed + k)).collect();
    let n = means.len() as f64;
    let mean = means.iter().map(|it| it.0).sum::<f64>() / n;
    let variance = means.iter().map(|it| (it.0 - mean).powi(2)).sum::<f64>() / (n - 1.0);
    let samples = RENDERINGS * u64::from(width * height) * u64::from(spp);
    Measured { mean, error: (variance / n).sqrt(), samples, bad: means.iter().map(|it| it.1).sum() }
}
