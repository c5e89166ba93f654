//! Checks that images are right on average and that their claimed errors are true: compares many seeds with a reference.

use crate::reference::Reference;
use femc_film::tile::OPEN;
use femc_film::{FrameError, FrameImage, Pace, Rect, Stops, Tile, TileErrors, Tiling};
use femc_pipeline::{
    PlanError, Prepared, RenderError, RenderedFrame, RoundEnd, RoundVerdict, Settings, Source, Stop, by_rounds, plan,
    prepare, render_tile,
};
use femc_scene::Scene;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// Rule that ends a tile's samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// The rule of the settings.
    Settings,
    /// The tile's own error estimate. A control for tests, because it makes images too dark.
    Peeking,
}

/// Rays per second of the clock that limits frames by time.
pub const RAYS_A_SECOND: f64 = 1e6;

/// A scene to be rendered with many seeds.
pub struct Experiment {
    prepared: Prepared,
    settings: Settings,
    tiling: Tiling,
    rounds: Vec<u32>,
}

/// An image with its claimed error.
pub struct Shot {
    /// The image.
    pub image: FrameImage,
    /// Claimed error.
    pub error: FrameError,
    /// Samples drawn per pixel, averaged over the film.
    pub drawn: f64,
    /// Samples per pixel of the tile with the most samples.
    pub longest: f64,
}

impl Shot {
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
        Self::of_frame(scene, settings, 1)
    }

    /// Prepares a frame.
    /// - `frame`: counted from 1;
    /// - errors: settings that do not fit the scene, or a missing frame.
    pub fn of_frame(scene: &Arc<Scene>, settings: Settings, frame: u32) -> Result<Self, PlanError> {
        let plan = plan(scene, &settings, Some(&[frame]))?;
        // The prepared frame and its first pass do not depend on the seed.
        let prepared = prepare(&Source::new(scene.clone()), &settings, frame, None)?;
        Ok(Self { prepared, settings, tiling: plan.tiling, rounds: plan.rounds })
    }

    /// Renders the image of a seed.
    ///
    /// # Panics
    /// If it cannot be rendered; this is for tests only.
    pub fn shot(&self, seed: u64, rule: Rule) -> Shot {
        let settings = Settings { seed, ..self.settings.clone() };
        let (cancel, progress) = (AtomicBool::new(false), AtomicU64::new(0));
        let rendered = frame(&settings, &self.rounds, self.tiling, rule, |rect, samples| {
            Ok(render_tile(&self.prepared, &settings, rect, samples, &cancel, &progress)?.tile)
        });
        let image = rendered.frame.resolve();
        let drawn: u64 = (self.tiling.rects().enumerate())
            .map(|(index, rect)| rect.area() * rendered.frame.tile(index).map_or(0, Tile::spp))
            .sum();
        let pixels = f64::from(self.tiling.width) * f64::from(self.tiling.height);
        let longest = (0..self.tiling.count()).filter_map(|index| rendered.frame.tile(index)).map(Tile::spp).max();
        Shot { error: image.error(), image, drawn: drawn as f64 / pixels, longest: longest.unwrap_or(0) as f64 }
    }
}

/// Renders a frame whose tiles end by a rule, as in the farm.
/// - `rounds`: samples per pixel at the end of each round.
/// - `draw`: function that draws the samples of a tile.
///
/// # Panics
/// If samples do not fit the earlier ones; this is for tests only.
pub fn frame(
    settings: &Settings,
    rounds: &[u32],
    tiling: Tiling,
    rule: Rule,
    draw: impl Fn(Rect, Range<u32>) -> Result<Tile, RenderError> + Sync,
) -> RenderedFrame {
    let decide = |end: RoundEnd<'_>| match rule {
        Rule::Settings => settings.verdict(end.tiles, end.before, end.rays as f64 / RAYS_A_SECOND, end.next),
        Rule::Peeking => peek(settings.stop, end.tiles, end.next),
    };
    by_rounds(tiling, rounds, draw, decide).unwrap_or_else(|error| panic!("{error}"))
}

/// Ends a tile when the error estimate from its own samples is small enough.
fn peek(stop: Stop, tiles: &[TileErrors], next: Option<u32>) -> (RoundVerdict, Stops) {
    let Stop::Error(most) = stop else { panic!("expected a stop criterion with an error") };
    let blocks = || tiles.iter().flat_map(|tile| &tile.blocks);
    let floor = FrameError::of(blocks().map(|it| it.block).collect()).floor;
    let is_enough = |tile: &TileErrors| {
        tile.blocks.iter().all(|it| it.block.relative(floor).is_none_or(|relative| relative <= most))
    };
    let stops = Stops { floors: [floor; 2], ends: vec![OPEN; tiles.len()], pace: Pace::default() };
    let Some(next) = next.filter(|_| !tiles.iter().all(is_enough)) else { return (RoundVerdict::Done, stops) };
    let steps = tiles.iter().map(|tile| if is_enough(tile) { tile.samples.end } else { next }).collect();
    (RoundVerdict::Steps(steps), stops)
}

/// A number and its standard error.
#[derive(Clone, Copy, Debug, Default)]
pub struct Measured {
    /// Value of the number.
    pub value: f64,
    /// Standard error of the number.
    pub error: f64,
}

impl Measured {
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
pub struct Verdict {
    /// Mean luminance over seeds minus the reference's, relative to the reference's, with the noise of both.
    pub bias: Measured,
    /// Fraction of the blocks' 95 % intervals, over all seeds, that contain the reference. The noise of the reference widens the
    /// intervals.
    pub coverage: Measured,
    /// True relmse, averaged over seeds, minus the noise of the reference.
    pub relmse: Measured,
    /// True relmse over claimed relmse.
    pub honesty: Measured,
    /// Largest claimed error of a block, at 95 %.
    pub worst: Measured,
    /// Samples drawn per pixel.
    pub drawn: Measured,
    /// Samples per pixel that count.
    pub counted: Measured,
    /// Samples per pixel of the tile with the most samples. All pixels would need this number if tiles did not end one by one.
    pub longest: Measured,
}

/// Statistics of one shot.
struct Said {
    mean: f64,
    covered: f64,
    relmse: f64,
    claimed: f64,
    worst: f64,
    drawn: f64,
    counted: f64,
    longest: f64,
}

impl Verdict {
    /// Compares the shots of many seeds with a reference.
    pub fn of(reference: &Reference, shots: impl Iterator<Item = Shot>) -> Self {
        let (noise, mean) = (reference.noise(), reference.mean_luminance());
        let said: Vec<Said> = shots.map(|shot| say(reference, &shot, noise)).collect();
        let over = |of: fn(&Said) -> f64| Measured::mean(&said.iter().map(of).collect::<Vec<_>>());
        let found = over(|it| it.mean);
        let (relmse, claimed) = (over(|it| it.relmse), over(|it| it.claimed));
        // This is a ratio of means, so the errors of true and claimed relmse are combined seed by seed.
        let ratio = relmse.value / claimed.value;
        let residuals: Vec<f64> = said.iter().map(|it| (it.relmse - ratio * it.claimed) / claimed.value).collect();
        Self {
            bias: Measured { value: found.value / mean.0 - 1.0, error: (found.error.powi(2) + mean.1).sqrt() / mean.0 },
            coverage: over(|it| it.covered),
            relmse,
            honesty: Measured { value: ratio, error: Measured::mean(&residuals).error },
            worst: over(|it| it.worst),
            drawn: over(|it| it.drawn),
            counted: over(|it| it.counted),
            longest: over(|it| it.longest),
        }
    }
}

fn say(reference: &Reference, shot: &Shot, noise: f64) -> Said {
    let Shot { image, error, drawn, longest } = shot;
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
    Said {
        mean: shot.mean(),
        covered: f64::from(covered as u32) / f64::from((lit as u32).max(1)),
        relmse: reference.compare(image, femc_film::convergence::BLOCK as usize).relmse - noise,
        claimed: reference.claimed(image),
        worst: error.worst,
        drawn: *drawn,
        longest: *longest,
        counted: image.mean_spp(),
    }
}
