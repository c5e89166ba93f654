//! Preparation of frames and rendering of tiles.

use crate::first_pass::{first_pass_world, scale_field, solve_first_pass};
use crate::settings::{Method, Settings};
use femc_film::{FilmError, Filter, Rect, Sample, Tile};
use femc_layers::Feature;
use femc_montecarlo::{PathSample, PathSettings, PixelFilter, Recorder, Tracer};
use femc_prepared::{FrameSpec, PrepareError, Prepared, SceneSource};
use femc_radiosity::VerifyError;
use femc_scene::FrameKey;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Prepares frame `frame` (from 1) of `source`, which has the overrides applied, for rendering. Solves its first pass if the method
/// has one. `previous`: any other frame; common parts are shared.
pub fn prepare_frame(
    source: &SceneSource,
    settings: &Settings,
    frame: u32,
    previous: Option<&Prepared>,
) -> Result<Prepared, PrepareError> {
    let mut prepared = prepare_world(source, settings, frame, previous)?;
    if settings.method.has_first_pass() && prepared.field.is_none() {
        let world = first_pass_world(source, settings, frame, Some(&prepared))?;
        let solution = solve_first_pass(&world, settings.method, &AtomicBool::new(false));
        let solution = solution.map_err(|error| PrepareError::FirstPass { reason: error.to_string() })?;
        prepared.field = Some(scale_field(Arc::new(solution.field), prepared.brightness));
    }
    Ok(prepared)
}

/// Prepares a frame as [`prepare_frame`] does, but without the first pass: [`solve_first_pass`](crate::solve_first_pass()) solves
/// it, [`attach_first_pass`](crate::attach_first_pass) applies a solution.
pub fn prepare_world(
    source: &SceneSource,
    settings: &Settings,
    frame: u32,
    previous: Option<&Prepared>,
) -> Result<Prepared, PrepareError> {
    femc_prepared::prepare_frame(source, &frame_spec(settings, frame), previous)
}

/// Returns the key of the inputs from which [`prepare_frame`] makes the frame, including the next frame if the frame has motion
/// vectors.
pub fn frame_key(source: &SceneSource, settings: &Settings, frame: u32) -> Result<FrameKey, PrepareError> {
    let key = femc_prepared::frame_key(source, &frame_spec(settings, frame))?;
    if !settings.features.contains(&Feature::Motion) || frame >= source.scene().frame_count() {
        return Ok(key);
    }
    Ok(key.with_next(&femc_prepared::frame_key(source, &frame_spec(settings, frame + 1))?))
}

pub(crate) fn frame_spec(settings: &Settings, frame: u32) -> FrameSpec {
    FrameSpec { camera: settings.camera.clone(), size: settings.size, frame, filter_radius: settings.filter.radius() }
}

/// A tile and its work.
#[derive(Debug)]
pub struct RenderedTile {
    /// Sums of the samples.
    pub tile: Tile,
    /// Number of closest-hit rays.
    pub rays: u64,
    /// Number of shadow rays.
    pub shadow_rays: u64,
    /// Number of vertices at which the guide of a first pass sampled a share of the directions.
    pub guided_vertices: u64,
}

/// Reason why a tile was not rendered.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The caller cancelled the rendering.
    #[error("cancelled")]
    Cancelled,
    /// The tile's pixels or samples exceed the film's limits.
    #[error(transparent)]
    Film(#[from] FilmError),
    /// The solution of the first pass cannot be trusted.
    #[error("the finite-element solution cannot be trusted: {0}; use `--method pt`")]
    Untrusted(#[from] VerifyError),
}

/// Renders samples `samples` of the pixels `rect` on the calling thread's rayon pool. `progress` counts finished camera samples.
/// `cancel` is checked before each sample.
pub fn render_tile(
    prepared: &Prepared,
    settings: &Settings,
    rect: Rect,
    samples: Range<u32>,
    cancel: &AtomicBool,
    progress: &AtomicU64,
) -> Result<RenderedTile, RenderError> {
    render_rows(prepared, settings, rect, samples, cancel, progress, || ()).map(|(rendered, _)| rendered)
}

/// Rows of pixels rendered by one thread, one after the other, and its tracer.
type TracedRows<'a, R> = (Vec<Tile>, Tracer<'a, R>);

/// Renders a tile as [`render_tile`] does, to the bit, with a recorder for each run of rows of pixels. Returns the recorders in
/// order, too.
pub fn render_rows<R: Recorder + Send>(
    prepared: &Prepared,
    settings: &Settings,
    rect: Rect,
    samples: Range<u32>,
    cancel: &AtomicBool,
    progress: &AtomicU64,
    recorder: impl Fn() -> R + Sync,
) -> Result<(RenderedTile, Vec<R>), RenderError> {
    let path = PathSettings { seed: settings.seed, max_depth: settings.max_depth, single_technique: None };
    // Adjacent rows share a tracer while the same thread renders them.
    let tracer = || {
        let tracer = Tracer::with_recorder(prepared, path, recorder());
        match (settings.method, prepared.field.as_deref()) {
            (Method::Fem, Some(field)) => tracer.with_field(field),
            (Method::Femc, Some(field)) => tracer.with_guide(field),
            _ => tracer,
        }
    };
    let render_row = |tracer: &mut Tracer<'_, R>, row: u32| -> Result<Tile, RenderError> {
        let strip = Rect { y: rect.y + row, height: 1, ..rect };
        let mut tile = Tile::new(strip, samples.clone())?;
        for x in strip.x..strip.x + strip.width {
            // Reports progress also within a pixel of very many samples.
            for begin in samples.clone().step_by(STEP) {
                let step = begin..samples.end.min(begin.saturating_add(STEP as u32));
                let count = u64::from(step.end - step.start);
                render_pixel(prepared, settings, tracer, &mut tile, [x, strip.y], step, cancel)?;
                progress.fetch_add(count, Ordering::Relaxed);
            }
        }
        Ok(tile)
    };
    let rows = (0..rect.height).into_par_iter().try_fold(
        || (Vec::new(), tracer()),
        |(mut strips, mut tracer), row| {
            strips.push(render_row(&mut tracer, row)?);
            Ok((strips, tracer))
        },
    );
    let runs: Vec<Result<TracedRows<'_, R>, RenderError>> = rows.collect();
    let (mut tiles, mut rays, mut shadow_rays, mut guided) = (Vec::with_capacity(rect.height as usize), 0, 0, 0);
    let mut recorders = Vec::with_capacity(runs.len());
    for run in runs {
        let (strips, tracer) = run?;
        tiles.extend(strips);
        rays += tracer.counters.rays;
        shadow_rays += tracer.counters.shadow_rays;
        guided += tracer.counters.guided;
        recorders.push(tracer.recorder);
    }
    let mut tile = Tile::from_strips(rect, samples, tiles)?;
    tile.add_rays(rays + shadow_rays);
    Ok((RenderedTile { tile, rays, shadow_rays, guided_vertices: guided }, recorders))
}

/// Converts a sample for the film.
#[inline]
pub(crate) fn film_sample(drawn: &PathSample) -> Sample {
    Sample { color: drawn.color, albedo: drawn.albedo, depth: drawn.depth }
}

/// Adapter of a film's filter for the tracer.
#[derive(Clone, Copy)]
pub struct FilterAdapter(pub Filter);

impl PixelFilter for FilterAdapter {
    #[inline]
    fn sample(self, u: [f32; 2]) -> [f32; 2] {
        self.0.sample(u)
    }

    #[inline]
    fn density(self, offset: [f32; 2]) -> f32 {
        self.0.density(offset)
    }
}

/// Number of samples of a pixel between two progress updates.
const STEP: usize = 256;

fn render_pixel<R: Recorder>(
    prepared: &Prepared,
    settings: &Settings,
    tracer: &mut Tracer<'_, R>,
    tile: &mut Tile,
    [x, y]: [u32; 2],
    samples: Range<u32>,
    cancel: &AtomicBool,
) -> Result<(), RenderError> {
    let pixel = y * prepared.camera.film[0] + x;
    for index in samples {
        if cancel.load(Ordering::Relaxed) {
            return Err(RenderError::Cancelled);
        }
        let drawn = tracer.sample(pixel, index, FilterAdapter(settings.filter));
        let fault = tile.add(x, y, index, &film_sample(&drawn));
        tracer.recorder.end_sample(fault.is_none().then_some(drawn.color));
    }
    Ok(())
}
