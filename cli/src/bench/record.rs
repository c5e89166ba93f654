//! Measurements and the file that keeps them.

use super::method::Method;
use super::setup::{Difference, SceneSetup, Setup};
use crate::exit::{Failure, failed, usage};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Of the form of the file.
const VERSION: u32 = 1;

/// All measurements of one setup.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Record {
    /// Version of this form.
    femc_bench: u32,
    /// On what was measured.
    pub setup: Setup,
    /// What was rendered.
    pub scenes: Vec<SceneSetup>,
    /// One frame each.
    pub runs: Vec<Run>,
}

/// One frame rendered, timed, and held against its reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// Name of the scene.
    pub scene: String,
    /// Name of the method.
    pub method: String,
    /// Its budget: samples a pixel or relative error.
    pub budget: f64,
    /// Seed.
    pub seed: u64,
    /// Wall time of the first pass and of the rendering, s.
    pub seconds: f64,
    /// Of these the first pass, which was solved once for all runs of its method; 0: the method has none.
    #[serde(default)]
    pub first_pass_seconds: f64,
    /// Processor time of the same, all threads, s.
    pub cpu_seconds: f64,
    /// Samples drawn, of all pixels.
    pub samples: u64,
    /// The same a pixel.
    pub spp: f64,
    /// Rays traced.
    pub rays: u64,
    /// Against the reference, whose noise is in it, (cd/m2)^2.
    pub mse: f64,
    /// The same, relative.
    pub relmse: f64,
    /// Mean HDR-FLIP.
    pub flip: f64,
    /// Largest relative error of a block of pixels, see [`worst_block`](super::worst::worst_block).
    pub worst: f64,
    /// Pixels that were left out because they are not finite, in the image or in the reference.
    pub left_out: u64,
}

impl Run {
    /// Whether it is this one.
    pub fn is_of(&self, scene: &str, method: &Method, budget: f64) -> bool {
        // What was written as text may come back off by a bit.
        self.scene == scene && self.method == method.name && (self.budget - budget).abs() <= 1e-9 * budget
    }
}

impl Record {
    /// Of this setup, with the measurements of the file `path` if it is there.
    /// - errors: the file is of another setup, and what differs.
    pub fn open(path: Option<&Path>, setup: Setup, scenes: Vec<SceneSetup>) -> Result<Self, Failure> {
        let new = Self { femc_bench: VERSION, setup, scenes, runs: Vec::new() };
        let Some(path) = path.filter(|path| path.exists()) else { return Ok(new) };
        let shown = path.display();
        let text = std::fs::read_to_string(path).map_err(|e| failed(format!("{shown}: {e}")))?;
        let old: Self = serde_json::from_str(&text).map_err(|e| {
            failed(format!("{shown}: no measurements by `femc bench`: {e}; give another file, or move this one away"))
        })?;
        if old.femc_bench != VERSION {
            let found = old.femc_bench;
            return Err(failed(format!("{shown}: form {found}, this version writes {VERSION}; give another file")));
        }
        new.gone_on_with(old, path)
    }

    fn gone_on_with(mut self, old: Self, path: &Path) -> Result<Self, Failure> {
        let mut differing = told("", self.setup.differences(&old.setup));
        for scene in &self.scenes {
            if let Some(there) = old.scenes.iter().find(|there| there.name == scene.name) {
                differing.extend(told(&format!("{}: ", scene.name), scene.differences(there)));
            }
        }
        if !differing.is_empty() {
            return Err(usage(format!(
                "{}: what is in it was measured with something else; give another file with -o, or move this one away. {}",
                path.display(),
                differing.join("; ")
            )));
        }
        let is_new = |there: &SceneSetup| self.scenes.iter().all(|scene| scene.name != there.name);
        let others: Vec<SceneSetup> = old.scenes.into_iter().filter(is_new).collect();
        self.scenes.extend(others);
        self.runs = old.runs;
        Ok(self)
    }

    /// The measurement of this scene, method, budget and seed.
    pub fn run(&self, scene: &str, method: &Method, budget: f64, seed: u64) -> Option<&Run> {
        self.runs.iter().find(|run| run.seed == seed && run.is_of(scene, method, budget))
    }
}

fn told(of: &str, differences: Vec<Difference>) -> Vec<String> {
    let tell = |(name, there, here): Difference| format!("{of}{name}: {there} there, {here} here");
    differences.into_iter().map(tell).collect()
}
