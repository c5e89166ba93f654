//! Comparison of a picture of a first pass with path-traced pictures.

use crate::clock::processor_seconds;
use crate::flux::SolutionFlux;
use femc_film::Tiling;
use femc_pipeline::radiosity::{SolveOptions, SolveReport, VerifyError, solve};
use femc_pipeline::{
    FrameLight, Method, SceneSource, Settings, StopCondition, attach_first_pass, attach_learned_targets,
    first_pass_world,
};
use femc_scene::Scene;
use std::error::Error;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// Width and height of the pictures, pixels.
const SIZE: [u32; 2] = [96, 72];
/// Width and height of a block, pixels.
const BLOCK: usize = 8;
/// Samples a pixel of the picture of the solution.
const SOLUTION_SPP: u32 = 32;

/// Pixels in which the camera sees lamps straight, and their neighbors: few samples of these hit a lamp. They have the same light in
/// all pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LampPixels {
    /// They are compared as well.
    Included,
    /// They are left out, because a bright lamp would dominate the mean.
    Excluded,
}

/// Samples a pixel that determine where the camera sees lamps.
const LAMP_SPP: u32 = 16;

/// A picture of the solution, compared with two path-traced pictures.
#[derive(Clone, Debug)]
pub struct PictureComparison {
    /// Ratio of the means, and its standard error from the noise of the path-traced pixels.
    pub mean: [f64; 2],
    /// Ratio of the median pixels.
    pub median: f64,
    /// Relative rms difference of whole blocks of 8 x 8 pixels with at least a twentieth of the mean, and the part of it that is noise of the
    /// path-traced pictures.
    pub blocks: [f64; 2],
    /// Flux of the solution.
    pub flux: SolutionFlux,
    /// Report of the solver.
    pub report: SolveReport,
    /// Processor seconds of the solver.
    pub solver_seconds: f64,
    /// Processor seconds of path tracing with 32 samples a pixel.
    pub path_seconds: f64,
    /// Reason why the solution is refused, if it is.
    pub refusal: Option<VerifyError>,
}

impl PictureComparison {
    /// Solves a scene and renders the pictures.
    /// - `spp`: samples a pixel of each path-traced picture;
    /// - errors: the scene cannot be prepared or rendered.
    pub fn new(scene: Arc<Scene>, spp: u32, lamps: LampPixels) -> Result<Self, Box<dyn Error>> {
        let source = SceneSource::new(scene);
        let settings = |method, seed, spp| Settings {
            size: Some(SIZE),
            method,
            seed,
            stop: StopCondition::Spp(spp),
            ..Settings::default()
        };
        let clock = || processor_seconds().unwrap_or(0.0);
        let start = clock();
        let a = render(&source, &settings(Method::Pt, 1, spp), None)?;
        let b = render(&source, &settings(Method::Pt, 2, spp), None)?;
        let path_seconds = (clock() - start) * 0.5 * 32.0 / f64::from(spp);
        let world = first_pass_world(&source, &settings(Method::Fem, 1, SOLUTION_SPP), 1, None)?;
        let start = clock();
        let solution = solve(&world, &SolveOptions::default(), &AtomicBool::new(false)).map_err(|_| "cancelled")?;
        let solver_seconds = clock() - start;
        let (flux, report) = (SolutionFlux::new(&world, &solution), solution.report);
        let refusal = solution.verify(&world).err();
        let brightness = femc_pipeline::prepare_world(&source, &Settings::default(), 1, None)?.brightness;
        let light = FrameLight::new(Arc::new(solution.field), brightness);
        let elements = render(&source, &settings(Method::Fem, 3, SOLUTION_SPP), Some(light))?;
        let is_compared: Vec<bool> = match lamps {
            LampPixels::Included => vec![true; a.len()],
            LampPixels::Excluded => {
                let straight = Settings { max_depth: 1, ..settings(Method::Pt, 1, LAMP_SPP) };
                without_neighbors(
                    &render(&source, &straight, None)?.into_iter().map(|light| light > 0.0).collect::<Vec<_>>(),
                )
            }
        };
        let paths: Vec<f64> = a.iter().zip(&b).map(|(a, b)| 0.5 * (a + b)).collect();
        let blocks_of = |picture: &[f64]| blocks(picture, &is_compared);
        let truth = blocks_of(&paths);
        let differences = [
            block_difference(&blocks_of(&elements), &truth, &truth),
            0.5 * block_difference(&blocks_of(&a), &blocks_of(&b), &truth),
        ];
        let compared = |picture: &[f64]| -> Vec<f64> {
            picture.iter().zip(&is_compared).filter(|(_, is_compared)| **is_compared).map(|(pixel, _)| *pixel).collect()
        };
        let [a, b, paths, elements] = [&a, &b, &paths, &elements].map(|picture| compared(picture));
        let ratio = mean(&elements) / mean(&paths);
        // Half of the difference of two pixels has the variance of their mean.
        let noise = a.iter().zip(&b).map(|(a, b)| 0.25 * (a - b).powi(2)).sum::<f64>().sqrt() / a.len() as f64;
        Ok(Self {
            mean: [ratio, ratio * noise / mean(&paths)],
            median: median(&elements) / median(&paths),
            blocks: differences,
            flux,
            report,
            solver_seconds,
            path_seconds,
            refusal,
        })
    }

    /// Returns `trusted`, or the reason why the solution is refused.
    pub fn verdict(&self) -> String {
        self.refusal.map_or("trusted".to_owned(), |reason| reason.to_string())
    }
}

/// Renders a frame. Returns the luminance of its pixels, cd/m2.
fn render(source: &SceneSource, settings: &Settings, light: Option<FrameLight>) -> Result<Vec<f64>, Box<dyn Error>> {
    let mut prepared = femc_pipeline::prepare_world(source, settings, 1, None)?;
    if let Some(light) = light {
        attach_first_pass(&mut prepared, light)?;
        attach_learned_targets(&mut prepared, settings.method)?;
    }
    let [width, height] = settings.size.unwrap_or_default();
    let tiling = Tiling::new(width, height, 24)?;
    let StopCondition::Spp(spp) = settings.stop else { return Err("no samples".into()) };
    let (cancel, progress) = (AtomicBool::new(false), AtomicU64::new(0));
    let rendered = femc_pipeline::render_frame(&prepared, settings, tiling, &[spp], |_| 0.0, &cancel, &progress)?;
    let image = rendered.frame.resolve().color;
    Ok((0..image.pixels.len()).map(|at| f64::from(image.luminance(at))).collect())
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Returns the means of the blocks of a picture all of whose pixels are compared.
fn blocks(picture: &[f64], is_compared: &[bool]) -> Vec<f64> {
    let [width, height] = SIZE.map(|pixels| pixels as usize);
    let across = width / BLOCK;
    let pixels = |k: usize| {
        let corner = k / across * BLOCK * width + k % across * BLOCK;
        (0..BLOCK * BLOCK).map(move |at| corner + at / BLOCK * width + at % BLOCK)
    };
    let block = |k: usize| pixels(k).map(|at| picture[at]).sum::<f64>() / (BLOCK * BLOCK) as f64;
    let whole = (0..across * (height / BLOCK)).filter(|&k| pixels(k).all(|at| is_compared[at]));
    whole.map(block).collect()
}

/// Returns the rms difference relative to the truth, over blocks with at least a twentieth of its mean.
fn block_difference(one: &[f64], other: &[f64], truth: &[f64]) -> f64 {
    let darkest = 0.05 * mean(truth);
    let lit = (0..truth.len()).filter(|&k| truth[k] > darkest);
    let squares: Vec<f64> = lit.map(|k| ((one[k] - other[k]) / truth[k]).powi(2)).collect();
    mean(&squares).sqrt()
}

/// Returns for each pixel whether neither it nor a neighbor is lit.
fn without_neighbors(is_lit: &[bool]) -> Vec<bool> {
    let [width, height] = SIZE.map(|pixels| pixels as usize);
    let is_far = |at: usize| {
        let near = |k: usize, size: usize| k.saturating_sub(1)..(k + 2).min(size);
        !near(at / width, height).any(|y| near(at % width, width).any(|x| is_lit[y * width + x]))
    };
    (0..is_lit.len()).map(is_far).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A room whose walls emit evenly and reflect half of the light. The camera sees lamps everywhere.
    #[test]
    fn pictures_of_a_furnace_agree_and_have_lamps_everywhere() {
        let scene = crate::parse_scene(&crate::closed_forms::furnace(0.5, 0.0).text);
        let found = PictureComparison::new(scene.clone(), 8, LampPixels::Included).unwrap_or_else(|e| panic!("{e}"));
        assert!((found.mean[0] - 1.0).abs() < 0.01 && found.mean[1] < 0.01, "{found:?}");
        assert!(found.blocks[0] < 0.03 && found.verdict() == "trusted", "{found:?}");
        let found = PictureComparison::new(scene, 1, LampPixels::Excluded).unwrap_or_else(|e| panic!("{e}"));
        assert!(found.mean[0].is_nan() && found.median.is_nan(), "{found:?}");
    }

    #[test]
    fn neighbors_of_lit_pixels_are_left_out() {
        let [width, height] = SIZE.map(|pixels| pixels as usize);
        let mut is_lit = vec![false; width * height];
        (is_lit[0], is_lit[width * 5 + 7]) = (true, true);
        let left_out = without_neighbors(&is_lit).iter().filter(|is_compared| !**is_compared).count();
        assert_eq!(left_out, 4 + 9);
    }

    #[test]
    fn blocks_with_pixels_that_are_not_compared_are_left_out() {
        let [width, height] = SIZE.map(|pixels| pixels as usize);
        let picture: Vec<f64> = (0..width * height).map(|at| (at % width / BLOCK) as f64).collect();
        let mut is_compared = vec![true; picture.len()];
        let all = blocks(&picture, &is_compared);
        assert_eq!(all[..13], [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 0.0]);
        is_compared[width * BLOCK + BLOCK] = false;
        let without = blocks(&picture, &is_compared);
        assert_eq!((all.len(), without.len()), (108, 107));
        assert_eq!(without[12..14], [0.0, 2.0]);
    }
}
