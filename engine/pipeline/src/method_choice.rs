//! Choice between path tracing alone and a first pass.
//!
//! A pilot traces some paths of the job's first frame, which do not count in any image. It estimates the work of the frame, and the
//! part of the samples' variance that is in light which guides could find. Guides act where a path leaves a diffuse surface, so
//! they can reduce only the noise of light found after that. Two passes gain more where samples are noisier, so the variance gives
//! an expected gain. If the expected work of two passes is less than that of path tracing, the first pass is solved and the same
//! samples are traced with its guides. They measure the gain, and the cheaper method is chosen. Work is counted in rays, not in
//! seconds: the choice depends on the job, not on the machine.

use crate::first_pass::{
    FieldMismatch, FrameLight, attach_first_pass, first_pass_key, first_pass_world, solve_first_pass,
};
use crate::first_pass_steps::{count_surfaces, first_pass_blocks};
use crate::pilot;
use crate::plan::Plan;
use crate::preparation::{attach_learned_targets, frame_key, prepare_pilot, prepare_world};
use crate::render::{RenderError, RenderTask};
use crate::settings::{Method, Settings, StopCondition};
use femc_film::Rect;
use femc_geometry::Ray;
use femc_math::Rgb;
use femc_math::elementary::double::{exp, ln, pow};
use femc_math::glam::DVec3;
use femc_montecarlo::has_lanes;
use femc_montecarlo::record::{
    BranchEvent, Continuation, Contribution, InteractionKind, LightTechnique, RecordLevel, Recorder, Termination,
    Vertex,
};
use femc_prepared::{PrepareError, Prepared, SceneSource};
use femc_radiosity::Solution;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Number of samples of each pixel of the pilot, to measure the variance.
const VARIANCE_PILOT_SPP: u32 = 32;
/// Number of rounds after which the samples needed for an error are extrapolated, and the number of samples by then.
const EXTRAPOLATION_ROUNDS: u32 = 3;
const EXTRAPOLATION_SPP: u32 = 16;
/// Maximum share of a pilot's samples in the minimum number of samples of the job.
const MAX_PILOT_SHARE: f64 = 0.02;
/// Minimum number of pixels of a useful pilot.
const MIN_PIXELS: f64 = 128.0;

/// Work of a first pass, in rays of paths that take as long: a minimum, and an amount for each surface.
const MIN_FIRST_PASS_RAYS: f64 = 1.5e6;
const RAYS_PER_SURFACE: f64 = 1e3;
/// Work of a ray of a pilot path that learns targets, in rays of a scene whose rays are fast: openings and shares also take time.
const LEARNING_WORK: f64 = 2.0;
/// Maximum work of a first pass that is tried, as a share of the work of path tracing. It is lost if the gain is small.
const MAX_FIRST_PASS_SHARE: f64 = 0.3;
/// Relative variance of a sample up to which two passes gain nothing, and the power of the variance beyond it that they gain. In
/// fifteen scenes with variances of 0.1 to 600, the gain was 0.5 to 1.5 times the expected one (docs/two-passes.md).
const GAINLESS_VARIANCE: f64 = 0.2;
const GAIN_POWER: f64 = 0.22;
/// Standard deviations of the logarithm of the expected gain, and of the gain that a pilot measures even with infinitely many pixels.
/// A job has more samples in a pixel than the pilot. They are spread more evenly, which helps path tracing more than two passes.
const EXPECTED_GAIN_DEVIATION: f64 = 0.3;
const PILOT_GAIN_DEVIATION: f64 = 0.15;
/// Work of a vertex at which guides sample directions, in rays of a scene whose rays are fast.
const RAYS_PER_GUIDED_VERTEX: f64 = 1.0;
/// Work of a ray of paths that are traced side by side ([`has_lanes`]), in rays of paths traced one after the other. Guided paths are
/// traced one after the other. In seven scenes it was 0.39 to 0.57.
const WORK_OF_LANE_RAY: f64 = 0.45;
/// Minimum ratio of the samples' variance to the variance of the light that no guide can improve.
const MIN_POSSIBLE_GAIN: f64 = 1.25;

/// The method for a job, with the reason.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MethodChoice {
    /// Path tracing alone, or guided by a first pass.
    pub method: Method,
    /// Reason for the choice, as a sentence without a full stop.
    pub reason: String,
    /// Result of the pilot. `None`: the job is too small for one.
    pub pilot: Option<Pilot>,
}

/// Estimates for a job from some of its paths.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pilot {
    /// Number of samples traced.
    pub samples: u64,
    /// Work of a sample of path tracing, in rays of paths traced one after the other.
    pub rays_a_sample: f64,
    /// Work of a ray of path tracing, in the same unit.
    pub work_of_ray: f64,
    /// Expected number of samples a pixel of the frame.
    pub samples_a_pixel: f64,
    /// Variance of a sample over the squared mean, over all pixels and channels.
    pub variance: f64,
    /// Variance of the samples divided by that of their light which no guide can improve: the maximum gain of guides.
    pub most_gain: f64,
    /// Variance times work of the samples, divided by that of guided ones. `None`: a first pass was not tried, or failed.
    pub gain: Option<Gain>,
    /// Reason why the tested first pass cannot be used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub untrusted: Option<String>,
    /// Work of all frames with path tracing, in the same rays.
    pub rays: f64,
    /// Work of the first passes that the frames share, in the same rays.
    pub first_pass_rays: f64,
    /// Work of learning the targets of all frames, in the same rays.
    #[serde(default)]
    pub learning_rays: f64,
}

/// Gain of two passes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gain {
    /// Variance times work of the samples, divided by that of the same samples with guides.
    pub measured: f64,
    /// Relative standard error of the measured gain.
    pub error: f64,
    /// Mean of the measured gain and of the gain that the variance lets expect, weighted by their accuracy.
    pub estimated: f64,
}

/// First pass that a pilot has solved, for the first frame of a job.
#[derive(Clone, Debug)]
pub struct SolvedFirstPass {
    /// Key of the solution as a single task ([`first_pass_key`]).
    pub key: [u8; 32],
    /// The verified solution.
    pub solution: Arc<Solution>,
}

/// Reason why no method could be chosen.
#[derive(Debug, thiserror::Error)]
pub enum MethodChoiceError {
    /// The frame could not be prepared.
    #[error(transparent)]
    Prepare(#[from] PrepareError),
    /// A tile was not rendered.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// The light of the first pass does not match its own frame.
    #[error(transparent)]
    Field(#[from] FieldMismatch),
}

/// Chooses the method of a job whose settings leave it open ([`Method::Auto`]). Also returns the first pass of
/// the choice, if it has one.
/// - `source`: the scene, overrides applied;
/// - `plan`: plan of `settings`.
pub fn choose_method(
    source: &SceneSource,
    settings: &Settings,
    plan: &Plan,
) -> Result<(MethodChoice, Option<SolvedFirstPass>), MethodChoiceError> {
    let paths = |reason: &str| (MethodChoice { method: Method::Pt, reason: reason.to_owned(), pilot: None }, None);
    if matches!(settings.stop, StopCondition::Time(_)) {
        return Ok(paths("a frame with a time limit has no first pass, because its samples start at once"));
    }
    let Some((found, solved)) = run_pilot(source, settings, plan)? else {
        return Ok(paths("the job is small, and path tracing finishes it before a first pass would be solved"));
    };
    let (method, reason) = found.method_and_reason();
    let solved = solved.filter(|_| method == Method::Femc);
    Ok((MethodChoice { method, reason, pilot: Some(found) }, solved))
}

impl Pilot {
    /// Returns the work of the first passes, and of learning targets, as a share of path tracing's.
    fn first_pass_share(&self) -> f64 {
        (self.first_pass_rays + self.learning_rays) / self.rays
    }

    /// Returns the gain of two passes that scenes with this variance have on average.
    fn expected_gain(&self) -> f64 {
        self.work_of_ray * pow((self.variance / GAINLESS_VARIANCE).max(1.0), GAIN_POWER).min(self.most_gain)
    }

    /// Returns the work of two passes for the error of path tracing, as a share of path tracing's work.
    fn guided_share(&self, gain: f64) -> f64 {
        self.first_pass_share() + 1.0 / gain
    }

    /// Checks whether guides are expected to gain enough to try a first pass.
    fn is_promising(&self) -> bool {
        self.most_gain >= MIN_POSSIBLE_GAIN
            && self.first_pass_share() <= MAX_FIRST_PASS_SHARE
            && self.guided_share(self.expected_gain()) < 1.0
    }

    /// Combines a measured gain with the expected one.
    /// - `error`: relative standard error of the measured gain.
    fn estimate_gain(&self, measured: f64, error: f64) -> Gain {
        let known = 1.0 / (error * error + PILOT_GAIN_DEVIATION * PILOT_GAIN_DEVIATION);
        let expected = 1.0 / (EXPECTED_GAIN_DEVIATION * EXPECTED_GAIN_DEVIATION);
        let mean = (known * ln(measured) + expected * ln(self.expected_gain())) / (known + expected);
        Gain { measured, error, estimated: exp(mean) }
    }

    /// Returns the method and the reason for it.
    fn method_and_reason(&self) -> (Method, String) {
        let work = 100.0 * self.first_pass_share();
        let bounced = 100.0 * (1.0 - 1.0 / self.most_gain);
        if let Some(reason) = &self.untrusted {
            return (Method::Pt, format!("the first pass was tried, but {}", without_advice(reason)));
        }
        match self.gain {
            None if self.most_gain < MIN_POSSIBLE_GAIN => (
                Method::Pt,
                format!(
                    "only {bounced:.0} % of the noise comes from light that has left a diffuse surface, and \
                     guides cannot reduce the rest"
                ),
            ),
            None => (
                Method::Pt,
                format!(
                    "a first pass takes about {work:.0} % of the work of path tracing, and samples with guides are expected to \
                     have 1 / {:.2} of the variance for equal work, which is not enough",
                    self.expected_gain()
                ),
            ),
            Some(Gain { measured, estimated, .. }) => {
                let is_worth = self.guided_share(estimated) < 1.0;
                let method = if is_worth { Method::Femc } else { Method::Pt };
                let verdict = if is_worth { "" } else { ", which is not enough" };
                (
                    method,
                    format!(
                        "a first pass takes about {work:.1} % of the work of path tracing, and in a pilot, samples with guides have \
                         1 / {measured:.2} of the variance for equal work (assumed: 1 / {estimated:.2}){verdict}"
                    ),
                )
            }
        }
    }
}

/// Traces some paths of the first frame, and the same samples with guides if that may pay. `None`: the job is too small for a
/// pilot.
fn run_pilot(
    source: &SceneSource,
    settings: &Settings,
    plan: &Plan,
) -> Result<Option<(Pilot, Option<SolvedFirstPass>)>, MethodChoiceError> {
    let settings = Settings { method: Method::Pt, statistics: false, ..settings.clone() };
    let Some(&frame) = plan.frames.first() else { return Ok(None) };
    let drawn = match settings.stop {
        StopCondition::Error(_) => VARIANCE_PILOT_SPP + EXTRAPOLATION_SPP,
        StopCondition::Spp(_) | StopCondition::Time(_) => VARIANCE_PILOT_SPP,
    };
    let frames = plan.frames.len() as f64;
    let pixels = MAX_PILOT_SHARE * plan.samples_per_frame(1) as f64 * frames / f64::from(drawn);
    if pixels < MIN_PIXELS {
        return Ok(None);
    }
    let film = [plan.tiling.width, plan.tiling.height];
    let whole = prepare_world(source, &settings, frame, None)?;
    let settings = Settings { size: Some(pilot::scaled_film_size(film, pixels.min(pilot::PIXELS))), ..settings };
    let prepared = prepare_pilot(source, &settings, frame, &whole)?;
    let paths = PilotSamples::trace(&prepared, &settings)?;
    let work_of_ray = work_of_ray(&prepared, settings.method);
    let samples_a_pixel = match settings.stop {
        StopCondition::Spp(spp) => f64::from(spp),
        StopCondition::Error(_) | StopCondition::Time(_) => {
            let rounds = std::cell::Cell::new(0);
            let is_over = || rounds.replace(rounds.get() + 1) + 1 >= EXTRAPOLATION_ROUNDS;
            pilot::estimate_samples(&prepared, &settings, is_over)?.unwrap_or(0.0)
        }
    };
    let rays = paths.rays_per_sample * samples_a_pixel * f64::from(film[0]) * f64::from(film[1]) * frames;
    let surfaces = count_surfaces(source.scene()) as f64;
    let first_pass_rays =
        (MIN_FIRST_PASS_RAYS + RAYS_PER_SURFACE * surfaces) * first_pass_count(source, &settings, plan)? as f64;
    let mut found = Pilot {
        samples: paths.samples,
        rays_a_sample: paths.rays_per_sample,
        work_of_ray,
        samples_a_pixel,
        variance: paths.relative_variance(),
        most_gain: paths.max_gain(),
        gain: None,
        untrusted: None,
        rays,
        first_pass_rays,
        learning_rays: LEARNING_WORK * f64::from(femc_guiding::pilot_path_count(film)) * paths.rays_per_sample * frames
            / work_of_ray,
    };
    let mut solved = None;
    if found.is_promising() {
        // The work is known better now and may justify more pixels.
        let all = samples_a_pixel * f64::from(film[0]) * f64::from(film[1]) * frames;
        let more = (MAX_PILOT_SHARE * all / f64::from(2 * VARIANCE_PILOT_SPP)).min(pilot::PIXELS);
        let (settings, prepared, paths) = if more > pixels {
            let settings = Settings { size: Some(pilot::scaled_film_size(film, more)), ..settings };
            let prepared = prepare_pilot(source, &settings, frame, &whole)?;
            let paths = PilotSamples::trace(&prepared, &settings)?;
            found.samples += paths.samples;
            (settings, prepared, paths)
        } else {
            (settings, prepared, paths)
        };
        let settings = Settings { method: Method::Femc, ..settings };
        let mut prepared = prepare_world(source, &settings, frame, Some(&prepared))?;
        let world = first_pass_world(source, &settings, frame, Some(&prepared))?;
        match solve_first_pass(&world, Method::Femc, &AtomicBool::new(false)) {
            Ok(solution) => {
                let light = FrameLight::new(Arc::new(solution.field.clone()), prepared.brightness);
                attach_first_pass(&mut prepared, light)?;
                attach_learned_targets(&mut prepared, settings.method)?;
                let guided = PilotSamples::trace(&prepared, &settings)?;
                found.samples += guided.samples;
                let (measured, error) = paths.gain(&guided);
                found.gain = Some(found.estimate_gain(measured, error));
                let key = first_pass_key(&frame_key(source, &settings, frame)?, Method::Femc, 1);
                solved = Some(SolvedFirstPass { key, solution: Arc::new(solution) });
            }
            Err(error @ RenderError::Untrusted(_)) => found.untrusted = Some(error.to_string()),
            Err(error) => return Err(error.into()),
        }
    }
    Ok(Some((found, solved)))
}

/// Returns the work of a ray, in rays of paths traced one after the other.
fn work_of_ray(prepared: &Prepared, method: Method) -> f64 {
    if method == Method::Pt && has_lanes(prepared) { WORK_OF_LANE_RAY } else { 1.0 }
}

/// Returns the work of samples, in rays of paths traced one after the other.
/// - `rays`: number of rays and shadow rays; `guided`: number of vertices at which guides sample directions.
pub fn work(prepared: &Prepared, method: Method, rays: f64, guided: f64) -> f64 {
    work_of_ray(prepared, method) * rays + RAYS_PER_GUIDED_VERTEX * guided
}

/// Returns a message without its advice.
fn without_advice(message: &str) -> &str {
    message.split_once(';').map_or(message, |(what, _)| what)
}

/// Samples of a pilot.
struct PilotSamples {
    samples: u64,
    /// Mean work of a sample, in rays, including guided vertices.
    rays_per_sample: f64,
    film: [u32; 2],
    /// Pixels by row and column.
    pixels: Vec<LightSums>,
}

impl PilotSamples {
    /// Traces samples of all pixels of a frame.
    fn trace(prepared: &Prepared, settings: &Settings) -> Result<Self, RenderError> {
        let [width, height] = prepared.camera.film;
        let whole = Rect { x: 0, y: 0, width, height };
        let task = RenderTask::new(prepared, settings, whole, 0..VARIANCE_PILOT_SPP);
        let (rendered, noise) = task.render_rows(PixelNoise::default)?;
        let samples = whole.area() * u64::from(VARIANCE_PILOT_SPP);
        let rays = (rendered.rays + rendered.shadow_rays) as f64;
        let rays = work(prepared, settings.method, rays, rendered.guided_vertices as f64);
        let pixels = noise.into_iter().flat_map(PixelNoise::into_pixels).collect();
        Ok(Self { samples, rays_per_sample: rays / samples as f64, film: [width, height], pixels })
    }

    /// Returns the relative variance of all light, divided by that of the light which no guide can improve.
    fn max_gain(&self) -> f64 {
        let weights = pixel_weights(&[self]);
        let sum = |part: fn(&LightSums) -> DVec3| -> f64 {
            self.pixels.iter().zip(&weights).map(|(it, weight)| part(it).dot(*weight)).sum()
        };
        let (all, rest) = (sum(LightSums::variance), sum(LightSums::unguidable_variance));
        if all <= rest { 1.0 } else { (all / rest.max(1e-6 * all)).max(1.0) }
    }

    /// Returns the variance of a sample over the squared mean, over all pixels and channels.
    fn relative_variance(&self) -> f64 {
        let sum: f64 = self.weighted_variances(&pixel_weights(&[self])).sum();
        sum / (3 * self.pixels.len()).max(1) as f64
    }

    fn weighted_variances<'a>(&'a self, weights: &'a [DVec3]) -> impl Iterator<Item = f64> + 'a {
        self.pixels.iter().zip(weights).map(|(pixel, weight)| pixel.variance().dot(*weight))
    }

    /// Returns variance times work, divided by that of guided samples of the same pixels, and its relative standard error.
    fn gain(&self, guided: &Self) -> (f64, f64) {
        let weights = pixel_weights(&[self, guided]);
        let sums = [self, guided].map(|of| of.weighted_variances(&weights).sum::<f64>());
        if !sums.iter().all(|&sum| sum > 0.0) {
            return (1.0, 1.0);
        }
        let pairs = self.weighted_variances(&weights).zip(guided.weighted_variances(&weights));
        let squares: f64 = pairs.map(|(paths, guided)| (paths / sums[0] - guided / sums[1]).powi(2)).sum();
        (sums[0] * self.rays_per_sample / (sums[1] * guided.rays_per_sample), squares.sqrt())
    }
}

/// Edge of the blocks whose means weight their pixels, pixels.
const WEIGHT_BLOCK_EDGE: u32 = 8;

/// Returns the weights of each pixel's channels: 1 over the squared mean of all samples of its block, to which a hundredth of the
/// frame's squared mean is added, so that dark blocks and channels do not dominate. A pixel's own samples are not used: a pixel with
/// one bright sample would look bright, which would hide its variance.
fn pixel_weights(all: &[&PilotSamples]) -> Vec<DVec3> {
    let Some([width, height]) = all.first().map(|drawn| drawn.film) else { return Vec::new() };
    let (across, down) = (width.div_ceil(WEIGHT_BLOCK_EDGE), height.div_ceil(WEIGHT_BLOCK_EDGE));
    let block = |at: usize| {
        let at = at as u32;
        (at / width / WEIGHT_BLOCK_EDGE * across + at % width / WEIGHT_BLOCK_EDGE) as usize
    };
    let mut sums = vec![(DVec3::ZERO, 0.0); (across * down) as usize];
    for (at, pixel) in all.iter().flat_map(|drawn| drawn.pixels.iter().enumerate()) {
        let (sum, count) = &mut sums[block(at)];
        *sum += pixel.all.iter().sum::<DVec3>();
        *count += pixel.counts.iter().sum::<f64>();
    }
    let frame = sums.iter().map(|(sum, _)| sum).sum::<DVec3>() / sums.iter().map(|(_, count)| count).sum::<f64>();
    let floor = frame.element_sum() / 3.0;
    let weight = |at| {
        let (sum, count) = sums[block(at)];
        let mean = sum / count;
        let weight = DVec3::ONE / (mean * mean + 0.01 * floor * floor);
        if weight.is_finite() { weight } else { DVec3::ZERO }
    };
    (0..all[0].pixels.len()).map(weight).collect()
}

/// Returns the number of first-pass solutions that the frames share.
fn first_pass_count(source: &SceneSource, settings: &Settings, plan: &Plan) -> Result<usize, PrepareError> {
    let blocks = first_pass_blocks(source.scene());
    let key = |&frame: &u32| Ok(first_pass_key(&frame_key(source, settings, frame)?, Method::Femc, blocks));
    let keys: Result<BTreeSet<_>, PrepareError> = plan.frames.iter().map(key).collect();
    Ok(keys?.len())
}

/// Sums of a pixel's samples by half, cd/m2 by channel: of all light, and of the light that no guide can improve.
#[derive(Clone, Copy, Debug, Default)]
struct LightSums {
    counts: [f64; 2],
    all: [DVec3; 2],
    unguidable: [DVec3; 2],
}

impl LightSums {
    fn variance(&self) -> DVec3 {
        self.mean_variance(self.all)
    }

    fn unguidable_variance(&self) -> DVec3 {
        self.mean_variance(self.unguidable)
    }

    /// Returns the variance of the mean, multiplied by the number of samples. It uses the two halves, which are independent. The
    /// samples of one half are evenly spread, and the benefit of that depends on how their directions are sampled.
    fn mean_variance(&self, sums: [DVec3; 2]) -> DVec3 {
        let [a, b] = [0, 1].map(|half| sums[half] / self.counts[half]);
        let half = 0.5 * (a - b);
        let variance = half * half * self.counts.iter().sum::<f64>();
        if variance.is_finite() { variance } else { DVec3::ZERO }
    }
}

/// Recorder that measures, by pixel, how much of the samples' light arrived by way of a diffuse surface.
#[derive(Debug, Default)]
struct PixelNoise {
    current_pixel: Option<u32>,
    half: usize,
    current_sums: LightSums,
    finished_pixels: Vec<LightSums>,
    /// Light that a guide could have found.
    guidable: DVec3,
    /// Interactions of the path that is traced now.
    path: PathInteractions,
    /// Interactions of the path from which a copy is split off now.
    original: PathInteractions,
    /// Interactions of each copy that waits to be traced.
    waiting: Vec<PathInteractions>,
}

/// Interactions of a path so far.
#[derive(Clone, Copy, Debug, Default)]
struct PathInteractions {
    /// Number of times that the path has left a diffuse surface.
    diffuse: u32,
    /// Whether the path has been reflected by a mirror or refracted since it left a rough surface.
    is_specular: bool,
}

impl PixelNoise {
    fn into_pixels(mut self) -> Vec<LightSums> {
        if self.current_sums.counts != [0.0; 2] {
            self.finished_pixels.push(self.current_sums);
        }
        self.finished_pixels
    }
}

impl Recorder for PixelNoise {
    const WANTS_OCCLUDERS: bool = false;

    fn begin_sample(&mut self, pixel: u32, sample: u32) -> RecordLevel {
        self.half = sample as usize % 2;
        if self.current_pixel != Some(pixel) && self.current_sums.counts != [0.0; 2] {
            self.finished_pixels.push(std::mem::take(&mut self.current_sums));
        }
        self.current_pixel = Some(pixel);
        (self.path, self.guidable) = (PathInteractions::default(), DVec3::ZERO);
        RecordLevel::All
    }

    fn vertex(&mut self, _: impl FnOnce() -> Vertex) {}

    fn leave(&mut self, continuation: Continuation) {
        let path = &mut self.path;
        match continuation.interaction {
            InteractionKind::Diffuse => *path = PathInteractions { diffuse: path.diffuse + 1, is_specular: false },
            InteractionKind::Reflection | InteractionKind::Refraction => path.is_specular = true,
            InteractionKind::Glossy | InteractionKind::Volume => path.is_specular = false,
            InteractionKind::Straight | InteractionKind::Absorbed | InteractionKind::Emission => {}
        }
    }

    fn occluded(&mut self, _: impl FnOnce() -> Ray) {}

    fn contribution(&mut self, contribution: impl FnOnce() -> Contribution) {
        let contribution = contribution();
        // A lamp that is hit straight from the first surface is direct light: it is also sampled from there.
        let is_sampled = contribution.technique == LightTechnique::EmitterHit && !self.path.is_specular;
        if self.path.diffuse > u32::from(is_sampled) {
            self.guidable += contribution.color.as_dvec3();
        }
    }

    fn branch(&mut self, event: BranchEvent) {
        match event {
            BranchEvent::Begin => self.original = self.path,
            BranchEvent::Suspend => self.waiting.push(std::mem::replace(&mut self.path, self.original)),
            BranchEvent::Discard => self.path = self.original,
            BranchEvent::Resume => self.path = self.waiting.pop().unwrap_or_default(),
        }
    }

    fn terminate(&mut self, _: Termination) {}

    fn end_sample(&mut self, color: Option<Rgb>) {
        let Some(all) = color.map(|color| color.as_dvec3()) else { return };
        self.current_sums.counts[self.half] += 1.0;
        self.current_sums.all[self.half] += all;
        self.current_sums.unguidable[self.half] += all - self.guidable;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source(name: &str) -> SceneSource {
        let path = format!("{}/../../scenes/{name}.mgf", env!("CARGO_MANIFEST_DIR"));
        SceneSource::new(Arc::new(femc_import::load_scene_file(path.as_ref()).expect("a scene").scene))
    }

    fn choose_for(source: &SceneSource, size: [u32; 2], stop: StopCondition) -> MethodChoice {
        let settings = Settings { size: Some(size), stop, ..Settings::default() };
        let plan = crate::plan_job(source.scene(), &settings, Some(&[1])).expect("a plan");
        choose_method(source, &settings, &plan).expect("a choice").0
    }

    #[test]
    fn door_ajar_gets_a_first_pass_and_small_or_timed_frames_do_not() {
        let source = source("door-ajar");
        let large = choose_for(&source, [320, 240], StopCondition::Spp(1024));
        assert_eq!(large.method, Method::Femc, "{large:?}");
        let found = large.pilot.as_ref().expect("a pilot");
        assert!(found.most_gain > 4.0 && found.gain.is_some_and(|gain| gain.estimated > 1.2), "{large:?}");
        assert_eq!(choose_for(&source, [320, 240], StopCondition::Spp(1024)), large, "a fact of the job");
        let few = choose_for(&source, [320, 240], StopCondition::Spp(16));
        assert_eq!((few.method, few.pilot.is_some()), (Method::Pt, true), "{few:?}");
        let small = choose_for(&source, [32, 24], StopCondition::Spp(16));
        assert_eq!((small.method, small.pilot), (Method::Pt, None));
        assert_eq!(choose_for(&source, [320, 240], StopCondition::Time(60.0)).method, Method::Pt);
    }

    /// With an error as the stop, the pilot estimates the number of samples.
    #[test]
    fn an_error_is_worth_as_much_as_the_samples_that_it_takes() {
        let source = source("screen");
        let [coarse, fine] = [0.5, 0.005].map(|error| choose_for(&source, [320, 240], StopCondition::Error(error)));
        let spp = |choice: &MethodChoice| choice.pilot.as_ref().expect("a pilot").samples_a_pixel;
        assert!(spp(&fine) > 100.0 * spp(&coarse), "{coarse:?} {fine:?}");
        assert_eq!((coarse.method, fine.method), (Method::Pt, Method::Femc));
    }

    /// Most of the noise below a lamp in a glass ball is in paths that hit the lamp through the glass.
    #[test]
    fn light_through_glass_counts_as_light_that_guides_find() {
        let choice = choose_for(&source("pendant"), [96, 96], StopCondition::Spp(1024));
        let found = choice.pilot.as_ref().expect("a pilot");
        assert!(found.most_gain > 4.0, "{choice:?}");
        assert_eq!(choice.method, Method::Femc, "{choice:?}");
    }

    /// A white floor under a small lamp, in the open: light that leaves the floor reaches nothing else.
    #[test]
    fn a_scene_without_light_by_way_of_surfaces_is_left_to_paths() {
        let text = "camera main =\n\torigin 0 -3 2\n\ttarget 0 0 0\n\tfov 40\n\tfilm 64 64\nm white =\n\tsides 2\n\tc\n\trd 0.8\n\
                    m lamp =\n\tsides 1\n\tc\n\ted 40000\nv a =\n\tp -9 -9 0\nv b =\n\tp 9 -9 0\nv c =\n\tp 9 9 0\nv d =\n\tp -9 9 0\n\
                    m white\nf a b c d\nv l =\n\tp 0 0 2.5\nm lamp\nsph l 0.05\n";
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("floor.mgf");
        std::fs::write(&path, text).expect("a file");
        let scene = femc_import::load_scene_file(&path).expect("a scene").scene;
        let choice = choose_for(&SceneSource::new(Arc::new(scene)), [512, 512], StopCondition::Spp(4096));
        let pilot = choice.pilot.as_ref().expect("a pilot");
        assert_eq!((choice.method, pilot.most_gain, pilot.gain), (Method::Pt, 1.0, None), "{choice:?}");
    }
}
