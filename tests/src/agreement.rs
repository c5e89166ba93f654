//! Checks that two scene descriptions, or two ways to find light, have the same mean: with independent renderings and a test at a
//! stated level.

use crate::parse_scene_files;
use femc_film::Filter;
use femc_math::color::luminance;
use femc_montecarlo::{MisTechnique, PathSettings, Tracer};
use femc_pipeline::{FilterAdapter, SceneSource, Settings, prepare_frame};
use femc_scene::Scene;
use femc_stats::testing::z_test;
use rayon::prelude::*;
use std::sync::Arc;

/// Independent renderings per estimate.
const RENDERINGS: u64 = 48;

/// Mean luminance of a film, cd/m2, and its standard error.
#[derive(Clone, Copy, Debug)]
pub struct Estimate {
    /// Mean of all samples.
    pub mean: f64,
    /// Standard error, from the spread of independent renderings.
    pub error: f64,
}

impl Estimate {
    /// Estimates the mean luminance of a scene's first frame, seen by its first camera.
    /// - `single_technique`: the only way to find light; `None`: all ways combined;
    /// - `spp`: samples per pixel of each of 48 renderings.
    ///
    /// # Panics
    /// If the scene cannot be prepared, or a sample is not a finite number.
    pub fn from_scene(scene: &Arc<Scene>, only: Option<MisTechnique>, spp: u32) -> Self {
        let source = SceneSource::new(scene.clone());
        let prepared = prepare_frame(&source, &Settings::default(), 1, None).unwrap_or_else(|error| panic!("{error}"));
        let [width, height] = prepared.camera.film;
        let rendering = |seed: u64| {
            let mut tracer = Tracer::new(&prepared, PathSettings { seed, max_depth: 0, single_technique: only });
            let mut sum = 0.0;
            for pixel in 0..width * height {
                for index in 0..spp {
                    let drawn = tracer.sample(pixel, index, FilterAdapter(Filter::Box));
                    let value = luminance(drawn.color);
                    assert!(value.is_finite(), "pixel {pixel}, sample {index}: {value}");
                    sum += f64::from(value);
                }
            }
            sum / f64::from(width * height * spp)
        };
        let means: Vec<f64> = (1..=RENDERINGS).into_par_iter().map(rendering).collect();
        let n = means.len() as f64;
        let mean = means.iter().sum::<f64>() / n;
        let variance = means.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1.0);
        Self { mean, error: (variance / n).sqrt() }
    }

    /// Estimates the mean luminance of a scene given as files. The first file is the scene.
    pub fn from_files(files: &[(&str, &str)], spp: u32) -> Self {
        Self::from_scene(&parse_scene_files(files), None, spp)
    }

    /// Multiplies the estimate by `factor`.
    pub fn scaled(self, factor: f64) -> Self {
        Self { mean: factor * self.mean, error: factor * self.error }
    }

    /// Returns the two-sided level at which the two are equal. Differences up to 1e-5 are ignored: they come from rounding of the
    /// scene and of single precision.
    pub fn p_value(self, other: Self) -> f64 {
        let rounding = 1e-5 * self.mean.abs().max(other.mean.abs());
        z_test(self.mean - other.mean, self.error.hypot(other.error).hypot(rounding), 0.0)
    }
}
