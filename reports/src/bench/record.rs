//! Measurements, and the file that stores them.

use super::method::Method;
use super::setup::{Difference, SceneSetup, Setup};
use crate::ReportError;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Version of the file format.
const VERSION: u32 = 1;

/// All measurements of one setup.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Record {
    /// Version of the file format.
    femc_bench: u32,
    /// Machine and program of the measurements.
    pub setup: Setup,
    /// Scenes that were rendered.
    pub scenes: Vec<SceneSetup>,
    /// Runs, one frame each.
    pub runs: Vec<Run>,
}

/// A rendered frame with its duration and its errors against the reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// Name of the scene.
    pub scene: String,
    /// Name of the method.
    pub method: String,
    /// Budget of the method: samples per pixel or relative error.
    pub budget: f64,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Wall time of the first pass and of the rendering, s.
    pub seconds: f64,
    /// Wall time of the first pass alone, which was solved once for all runs of its method; 0: the method has none.
    #[serde(default)]
    pub first_pass_seconds: f64,
    /// Processor time of the first pass and of the rendering over all threads, s.
    pub cpu_seconds: f64,
    /// Samples drawn in all pixels.
    pub samples: u64,
    /// Samples drawn per pixel.
    pub spp: f64,
    /// Rays traced.
    pub rays: u64,
    /// Mean squared error against the reference, including the reference's noise, (cd/m2)^2.
    pub mse: f64,
    /// Relative mean squared error against the reference, including the reference's noise.
    pub relmse: f64,
    /// Mean HDR-FLIP.
    pub flip: f64,
    /// Largest relative error of a block of pixels, see [`worst_block`](super::worst::worst_block).
    pub worst: f64,
    /// Pixels that are left out because they are not finite in the image or in the reference.
    pub left_out: u64,
}

impl Run {
    /// Checks whether the run has this scene, method and budget.
    pub fn matches(&self, scene: &str, method: &Method, budget: f64) -> bool {
        // A budget that was written as text may be off by a bit.
        self.scene == scene && self.method == method.name && (self.budget - budget).abs() <= 1e-9 * budget
    }
}

impl Record {
    /// Creates a record of this setup, with the measurements of the file `path` if it exists.
    /// - errors: the file has another setup. The message lists the differences.
    pub fn open(path: Option<&Path>, setup: Setup, scenes: Vec<SceneSetup>) -> Result<Self, ReportError> {
        let new = Self { femc_bench: VERSION, setup, scenes, runs: Vec::new() };
        let Some(path) = path.filter(|path| path.exists()) else { return Ok(new) };
        let text = std::fs::read_to_string(path).map_err(ReportError::file(path))?;
        let old: Self =
            serde_json::from_str(&text).map_err(|cause| ReportError::Measurements { path: path.to_owned(), cause })?;
        if old.femc_bench != VERSION {
            let found = old.femc_bench;
            return Err(ReportError::MeasurementsVersion { path: path.to_owned(), found, own: VERSION });
        }
        new.resume_from(old, path)
    }

    fn resume_from(mut self, stored: Self, path: &Path) -> Result<Self, ReportError> {
        let mut differing = describe_differences("", self.setup.differences(&stored.setup));
        for scene in &self.scenes {
            if let Some(there) = stored.scenes.iter().find(|there| there.name == scene.name) {
                differing.extend(describe_differences(&format!("{}: ", scene.name), scene.differences(there)));
            }
        }
        if !differing.is_empty() {
            return Err(ReportError::SetupMismatch { path: path.to_owned(), differing: differing.join("; ") });
        }
        let is_new = |there: &SceneSetup| self.scenes.iter().all(|scene| scene.name != there.name);
        let others: Vec<SceneSetup> = stored.scenes.into_iter().filter(is_new).collect();
        self.scenes.extend(others);
        self.runs = stored.runs;
        Ok(self)
    }

    /// Returns the measurement of this scene, method, budget and seed.
    pub fn run(&self, scene: &str, method: &Method, budget: f64, seed: u64) -> Option<&Run> {
        self.runs.iter().find(|run| run.seed == seed && run.matches(scene, method, budget))
    }
}

fn describe_differences(prefix: &str, differences: Vec<Difference>) -> Vec<String> {
    let tell = |(name, there, here): Difference| format!("{prefix}{name}: {there} in the file, {here} now");
    differences.into_iter().map(tell).collect()
}
