//! Checks that images are right on average and that their claimed errors are true: compares many seeds with a reference.

use crate::reference::Reference;
use femc_film::tile::NONE_HELD;
use femc_film::{FrameError, FrameImage, Rect, SamplingState, Tile, TileErrors, Tiling, TimedProgress};
use femc_pipeline::{
    Outputs, PlanError, Prepared, RenderError, RenderTask, RenderedFrame, RoundEnd, RoundVerdict, SceneSource,
    Settings, StopCondition, plan_job, prepare_frame, render_rounds,
};
use femc_scene::Scene;
use std::ops::Range;
use std::sync::Arc;

/// Rule that ends a tile's samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// The rule of the settings.
    Settings,
    /// The tile's own error estimate. A control for tests, because it makes images too dark.
    Peeking,
}

/// Rays per second of the clock that limits frames by time.
pub const RAYS_PER_SECOND: f64 = 1e6;

/// A scene to be rendered with many seeds.
pub struct Experiment {
    prepared: Prepared,
    settings: Settings,
    tiling: Tiling,
    rounds: Vec<u32>,
}

/// An image with its claimed error.
pub struct SeedImage {
    /// The image.
    pub image: FrameImage,
    /// Claimed error.
    pub error: FrameError,
    /// Samples drawn per pixel, averaged over the film.
    pub drawn_spp: f64,
    /// Samples per pixel of the tile with the most samples.
    pub max_spp: f64,
}

impl SeedImage {
    /// Returns the mean luminance of the frame, cd/m2.
    pub fn mean(&self) -> f64 {
        let pixels = self.image.color.pixels.len();
        (0..pixels).map(|at| f64::from(self.image.color.luminance(at))).sum::<f64>() / pixels as f64
    }
}

impl Experiment {
    /// Prepares the first frame.
    /// - errors: settings that do not fit the scene.
    pub fn new(scene: &Arc<Scene>, settings: Settings) -> Result<Self, PlanError> {
        Self::for_frame(scene, settings, 1)
    }

    /// Prepares a frame.
    /// - `frame`: counted from 1;
    /// - errors: settings that do not fit the scene, or a missing frame.
    pub fn for_frame(scene: &Arc<Scene>, settings: Settings, frame: u32) -> Result<Self, PlanError> {
        let plan = plan_job(scene, &settings, Some(&[frame]))?;
        // The prepared frame and its first pass do not depend on the seed.
        let prepared = prepare_frame(&SceneSource::new(scene.clone()), &settings, frame, None)?;
        Ok(Self { prepared, settings, tiling: plan.tiling, rounds: plan.rounds })
    }

    /// Renders the image of a seed.
    ///
    /// # Panics
    /// If it cannot be rendered; this is for tests only.
    pub fn render_seed(&self, seed: u64, rule: Rule) -> SeedImage {
        let settings = Settings { seed, ..self.settings.clone() };
        let rendered = render_by_rule(&settings, &self.rounds, self.tiling, rule, |rect, samples| {
            Ok(RenderTask::new(&self.prepared, &settings, rect, samples).render(Outputs::default())?.tile)
        });
        let image = rendered.frame.resolve();
        let drawn: u64 = (self.tiling.rects().enumerate())
            .map(|(index, rect)| rect.area() * rendered.frame.tile(index).map_or(0, Tile::spp))
            .sum();
        let pixels = f64::from(self.tiling.width) * f64::from(self.tiling.height);
        let longest = (0..self.tiling.count()).filter_map(|index| rendered.frame.tile(index)).map(Tile::spp).max();
        SeedImage {
            error: image.error(),
            image,
            drawn_spp: drawn as f64 / pixels,
            max_spp: longest.unwrap_or(0) as f64,
        }
    }
}

/// Renders a frame whose tiles end by a rule, as in the farm.
/// - `rounds`: samples per pixel at the end of each round.
/// - `draw`: function that draws the samples of a tile.
///
/// # Panics
/// If samples do not fit the earlier ones; this is for tests only.
pub fn render_by_rule(
    settings: &Settings,
    rounds: &[u32],
    tiling: Tiling,
    rule: Rule,
    draw: impl Fn(Rect, Range<u32>) -> Result<Tile, RenderError> + Sync,
) -> RenderedFrame {
    let decide = |end: RoundEnd<'_>| match rule {
        Rule::Settings => settings.verdict(end.tiles, end.before, end.rays as f64 / RAYS_PER_SECOND, end.next),
        Rule::Peeking => stop_by_own_error(settings.stop, end.tiles, end.next),
    };
    render_rounds(tiling, rounds, draw, decide).unwrap_or_else(|error| panic!("{error}"))
}

/// Ends a tile when the error estimate from its own samples is small enough.
fn stop_by_own_error(stop: StopCondition, tiles: &[TileErrors], next: Option<u32>) -> (RoundVerdict, SamplingState) {
    let StopCondition::Error(most) = stop else { panic!("expected a stop criterion with an error") };
    let blocks = || tiles.iter().flat_map(|tile| &tile.blocks);
    let floor = FrameError::from_blocks(blocks().map(|it| it.block).collect()).floor;
    let is_enough = |tile: &TileErrors| {
        tile.blocks.iter().all(|it| it.block.relative_error(floor).is_none_or(|relative| relative <= most))
    };
    let stops =
        SamplingState { floors: [floor; 2], ends: vec![NONE_HELD; tiles.len()], progress: TimedProgress::default() };
    let Some(next) = next.filter(|_| !tiles.iter().all(is_enough)) else { return (RoundVerdict::Done, stops) };
    let steps = tiles.iter().map(|tile| if is_enough(tile) { tile.samples.end } else { next }).collect();
    (RoundVerdict::Steps(steps), stops)
}

/// A number and its standard error.
#[derive(Clone, Copy, Debug, Default)]
pub struct MeanWithError {
    /// Value of the number.
    pub value: f64,
    /// Standard error of the number.
    pub error: f64,
}

impl MeanWithError {
    /// Computes the mean of independent values.
    pub fn mean(values: &[f64]) -> Self {
        let n = values.len() as f64;
        let value = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|it| (it - value).powi(2)).sum();
        Self { value, error: (squares / (n - 1.0) / n).sqrt() }
    }
}

/// Statistics of many seeds.
#[derive(Clone, Copy, Debug)]
pub struct SeedStatistics {
    /// Mean luminance over seeds minus the reference's, relative to the reference's, with the noise of both.
    pub bias: MeanWithError,
    /// Fraction of the blocks' 95 % intervals, over all seeds, that contain the reference. The noise of the reference widens the
    /// intervals.
    pub coverage: MeanWithError,
    /// True relmse, averaged over seeds, minus the noise of the reference.
    pub relmse: MeanWithError,
    /// True relmse over claimed relmse.
    pub true_over_claimed: MeanWithError,
    /// Largest claimed error of a block, at 95 %.
    pub worst: MeanWithError,
    /// Samples drawn per pixel.
    pub drawn_spp: MeanWithError,
    /// Samples per pixel that count.
    pub counted_spp: MeanWithError,
    /// Samples per pixel of the tile with the most samples. All pixels would need this number if tiles did not end one by one.
    pub max_spp: MeanWithError,
}

/// Statistics of one shot.
struct ImageStatistics {
    mean: f64,
    covered: f64,
    relmse: f64,
    claimed: f64,
    worst: f64,
    drawn_spp: f64,
    counted_spp: f64,
    max_spp: f64,
}

impl SeedStatistics {
    /// Compares the shots of many seeds with a reference.
    pub fn from_seeds(reference: &Reference, shots: impl Iterator<Item = SeedImage>) -> Self {
        let (noise, mean) = (reference.noise_relmse(), reference.mean_luminance());
        let statistics: Vec<ImageStatistics> = shots.map(|shot| image_statistics(reference, &shot, noise)).collect();
        let over =
            |of: fn(&ImageStatistics) -> f64| MeanWithError::mean(&statistics.iter().map(of).collect::<Vec<_>>());
        let found = over(|it| it.mean);
        let (relmse, claimed) = (over(|it| it.relmse), over(|it| it.claimed));
        // This is a ratio of means, so the errors of true and claimed relmse are combined seed by seed.
        let ratio = relmse.value / claimed.value;
        let residuals: Vec<f64> =
            statistics.iter().map(|it| (it.relmse - ratio * it.claimed) / claimed.value).collect();
        Self {
            bias: MeanWithError {
                value: found.value / mean.0 - 1.0,
                error: (found.error.powi(2) + mean.1).sqrt() / mean.0,
            },
            coverage: over(|it| it.covered),
            relmse,
            true_over_claimed: MeanWithError { value: ratio, error: MeanWithError::mean(&residuals).error },
            worst: over(|it| it.worst),
            drawn_spp: over(|it| it.drawn_spp),
            counted_spp: over(|it| it.counted_spp),
            max_spp: over(|it| it.max_spp),
        }
    }
}

fn image_statistics(reference: &Reference, shot: &SeedImage, noise: f64) -> ImageStatistics {
    let SeedImage { image, error, drawn_spp: drawn, max_spp: longest } = shot;
    let width = image.color.width as usize;
    let (mut covered, mut lit) = (0, 0);
    for block in &error.blocks {
        let Some(relative) = block.relative else { continue };
        let places = || block.rect.pixels().map(|(x, y)| y as usize * width + x as usize);
        let area = block.rect.area() as f64;
        let mean = places().map(|at| f64::from(image.color.luminance(at))).sum::<f64>() / area;
        let (expected, variance) = reference.block_luminance(places());
        let half_width = relative * mean.max(error.floor);
        let widened = (half_width.powi(2) + 1.96f64.powi(2) * variance).sqrt();
        lit += 1;
        covered += usize::from((mean - expected).abs() <= widened);
    }
    ImageStatistics {
        mean: shot.mean(),
        covered: f64::from(covered as u32) / f64::from((lit as u32).max(1)),
        relmse: reference.compare(image, femc_film::convergence::BLOCK_EDGE as usize).relmse - noise,
        claimed: reference.claimed_relmse(image),
        worst: error.worst,
        drawn_spp: *drawn,
        max_spp: *longest,
        counted_spp: image.mean_spp(),
    }
}
