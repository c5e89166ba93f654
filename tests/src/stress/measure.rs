//! Measures mean luminances of scenes to a given standard error, and compares them with the truth.

use super::line::{ResultLine, Verdict};
use crate::parse_scene_files;
use femc_film::Filter;
use femc_math::color::luminance;
use femc_montecarlo::{PathSettings, Tracer};
use femc_pipeline::{FilterAdapter, SceneSource, Settings, prepare_frame};
use femc_prepared::Prepared;
use rayon::prelude::*;
use std::time::Instant;

/// Independent renderings per mean. Their number determines the degrees of freedom of its standard error.
const RENDERINGS: u64 = 64;
/// Permitted distance of a mean from the truth, in standard errors.
const MAX_SIGMAS: f64 = 3.0;
/// Number of measurements before a mean that is too far from the truth fails.
const TRIES: u64 = 3;

/// Effort of a run.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Factor on the target standard errors: 1 for a full run, 10 for a quick one, which also leaves out long cases.
    pub error_factor: f64,
    /// Number of grazing rays.
    pub rays: u64,
}

impl Effort {
    /// Full run, with the standard errors that the cases state.
    pub const FULL: Self = Self { error_factor: 1.0, rays: 100_000_000 };
    /// Quick run, which takes seconds.
    pub const QUICK: Self = Self { error_factor: 10.0, rays: 1_000_000 };

    /// Checks whether long cases are left out.
    pub fn is_quick(&self) -> bool {
        self.error_factor >= Self::QUICK.error_factor
    }
}

/// A scene with known mean luminance.
#[derive(Clone, Debug)]
pub struct Case {
    /// Name that tells the special feature of the scene.
    pub name: String,
    /// Files of the scene; the first is the scene itself.
    pub files: Vec<(String, String)>,
    /// True mean luminance of the film, cd/m2.
    pub truth: f64,
    /// Target standard error, relative to the truth.
    pub sigma: f64,
    /// Longest path in segments; 0: unlimited.
    pub max_depth: u32,
    /// Permitted relative error of the scene itself, from rounding of single precision or as a comment explains.
    pub slack: f64,
    /// A quick run leaves this case out.
    pub is_long: bool,
}

/// A measured mean luminance.
#[derive(Clone, Copy, Debug)]
pub struct MeasuredMean {
    /// Mean of all samples, cd/m2.
    pub mean: f64,
    /// Standard error of the mean, from the spread of independent renderings.
    pub error: f64,
    /// Number of samples.
    pub samples: u64,
    /// Number of samples that are NaN, infinite or negative. They are not part of the mean.
    pub bad: u64,
}

impl Case {
    /// Creates a case with a scene of one file and a target standard error of 1e-3.
    pub fn new(name: impl Into<String>, text: impl Into<String>, truth: f64) -> Self {
        let files = vec![("stress.mgf".to_owned(), text.into())];
        Self { name: name.into(), files, truth, sigma: 1e-3, max_depth: 0, slack: 1e-5, is_long: false }
    }

    /// Sets the target standard error.
    pub fn with_sigma(self, sigma: f64) -> Self {
        Self { sigma, ..self }
    }

    /// Limits paths to `max_depth` segments.
    pub fn with_max_depth(self, max_depth: u32) -> Self {
        Self { max_depth, ..self }
    }

    /// Sets the permitted error of the scene itself.
    pub fn with_slack(self, slack: f64) -> Self {
        Self { slack, ..self }
    }

    /// Leaves the case out of quick runs.
    pub fn as_long(self) -> Self {
        Self { is_long: true, ..self }
    }

    /// Adds another file.
    pub fn with_file(mut self, name: &str, text: impl Into<String>) -> Self {
        self.files.push((name.to_owned(), text.into()));
        self
    }

    /// Prepares the scene's first frame for tracing.
    ///
    /// # Panics
    /// If the text is not a scene.
    pub fn prepare(&self) -> Prepared {
        let files: Vec<_> = self.files.iter().map(|(name, text)| (name.as_str(), text.as_str())).collect();
        let source = SceneSource::new(parse_scene_files(&files));
        prepare_frame(&source, &Settings::default(), 1, None).unwrap_or_else(|error| panic!("{}: {error}", self.name))
    }

    /// Returns the first of the case's seeds. Cases do not share random numbers, so that their errors are independent.
    fn seed(&self) -> u64 {
        let digest = blake3::hash(self.name.as_bytes());
        u64::from_le_bytes(*digest.as_bytes().first_chunk().expect("eight bytes")) >> 8
    }

    /// Measures the case.
    pub fn measure(&self, group: &str, effort: &Effort) -> ResultLine {
        let begun = Instant::now();
        let prepared = self.prepare();
        let wanted = self.sigma * effort.error_factor * self.truth.abs();
        let is_near =
            |it: &MeasuredMean| (it.mean - self.truth).abs() <= MAX_SIGMAS * it.error + self.slack * self.truth.abs();
        let mut now = measure_to_error(&prepared, self.max_depth, wanted, self.seed());
        let mut bad = now.bad;
        for again in 1..TRIES {
            if is_near(&now) || bad > 0 {
                break;
            }
            now = measure_to_error(&prepared, self.max_depth, 0.5 * wanted, self.seed() + (again << 32));
            bad += now.bad;
        }
        let verdict = if bad > 0 {
            Verdict::Fails(format!("{bad} bad samples"))
        } else if !is_near(&now) {
            Verdict::Fails(format!(
                "{:+.1} standard errors off in the third measurement",
                (now.mean - self.truth) / now.error
            ))
        } else if now.error > wanted {
            Verdict::Fails(format!("too noisy: the limit is {:.1e}", wanted))
        } else {
            Verdict::Holds
        };
        ResultLine {
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
pub fn measure_all(group: &str, cases: &[Case], effort: &Effort, report: &mut dyn FnMut(ResultLine)) {
    for case in cases.iter().filter(|case| !(case.is_long && effort.is_quick())) {
        report(case.measure(group, effort));
    }
}

/// Largest number of samples per pixel and rendering.
const MAX_SPP: u32 = 1 << 22;

/// Measures a mean to a given standard error. Pilot runs with their own seeds determine the number of samples, so that it does not
/// depend on the samples that count. A result that is noisier than its pilot is measured again.
fn measure_to_error(prepared: &Prepared, max_depth: u32, wanted: f64, seed: u64) -> MeasuredMean {
    let mut spp = 1u32;
    for run in 0.. {
        let pilot = renderings(prepared, max_depth, spp, seed + ((2 * run) << 16));
        let factor = 1.3 * (pilot.error / wanted).powi(2);
        // A pilot with few samples may miss rare bright paths. It may raise the number of samples by a factor of at most 64.
        let is_enough = factor <= 64.0;
        let next = (f64::from(spp) * factor.clamp(1.0, 64.0)).ceil().min(f64::from(MAX_SPP)) as u32;
        // Multiples of a power of two distribute their points more evenly.
        spp = next.next_multiple_of((next.next_power_of_two() / 16).max(1)).min(MAX_SPP);
        if is_enough || spp == MAX_SPP {
            let measured = renderings(prepared, max_depth, spp, seed + ((2 * run + 1) << 16));
            if measured.error <= wanted || spp == MAX_SPP {
                return measured;
            }
        }
    }
    unreachable!("the number of samples grows up to its bound")
}

/// Computes the mean of [`RENDERINGS`] renderings of `spp` samples per pixel.
fn renderings(prepared: &Prepared, max_depth: u32, spp: u32, seed: u64) -> MeasuredMean {
    let [width, height] = prepared.camera.film;
    let rendering = |seed: u64| {
        let mut tracer = Tracer::new(prepared, PathSettings { seed, max_depth, single_technique: None });
        let (mut sum, mut bad) = (0.0, 0);
        for pixel in 0..width * height {
            for index in 0..spp {
                let color = tracer.sample(pixel, index, FilterAdapter(Filter::Box)).color;
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
    MeasuredMean { mean, error: (variance / n).sqrt(), samples, bad: means.iter().map(|it| it.1).sum() }
}
