//! Rendering of a task: samples of the pixels of a tile.

use crate::settings::{Method, Settings};
use femc_film::{AovTile, FilmError, Filter, Rect, Sample, Tile};
use femc_montecarlo::{Guidance, Packet, PathSample, PathSettings, PixelFilter, Recorder, Tracer, TracerCounters};
use femc_paths::LightStatistics;
use femc_prepared::Prepared;
use femc_radiosity::VerifyError;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Samples of a tile of a frame. [`Self::render`] renders them.
#[derive(Clone, Debug)]
pub struct RenderTask<'a> {
    /// Frame, prepared with `settings`.
    pub prepared: &'a Prepared,
    /// Settings of the frame.
    pub settings: &'a Settings,
    /// Pixels of the tile.
    pub rect: Rect,
    /// Samples of each pixel.
    pub samples: Range<u32>,
    /// Flag that cancels the rendering. It is checked before each sample. `None`: the rendering cannot be cancelled.
    pub cancel: Option<&'a AtomicBool>,
    /// Counter of finished camera samples.
    pub progress: Option<&'a AtomicU64>,
}

/// A tile, its outputs and its work.
#[derive(Debug)]
pub struct RenderedTile {
    /// Sums of the samples.
    pub tile: Tile,
    /// Layers of the light, and features.
    pub aovs: AovTile,
    /// Light statistics.
    pub statistics: Option<LightStatistics>,
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

/// Rows of pixels rendered by one thread, one after the other, and its tracer.
type TracedRows<'a, R> = (Vec<Tile>, RowTracer<'a, R>);

/// Tracer of one thread.
enum RowTracer<'a, R> {
    /// Traces samples one after the other, with a recorder.
    Recorded(Box<Tracer<'a, R>>),
    /// Traces several samples side by side. The recorder ignores everything.
    Packet(Box<Packet<'a>>, R),
}

impl<'a, R: Recorder> RowTracer<'a, R> {
    fn new(task: &RenderTask<'a>, recorder: R) -> Self {
        let RenderTask { prepared, settings, .. } = *task;
        if R::IGNORES_ALL {
            Self::Packet(Box::new(Packet::new(|| frame_tracer(prepared, settings, ()))), recorder)
        } else {
            Self::Recorded(Box::new(frame_tracer(prepared, settings, recorder)))
        }
    }

    /// Returns the work done, and the recorder.
    fn finish(self) -> (TracerCounters, R) {
        match self {
            Self::Recorded(tracer) => (tracer.counters, tracer.recorder),
            Self::Packet(packet, recorder) => (packet.counters(), recorder),
        }
    }
}

/// Number of samples of a pixel between two progress updates.
const STEP: usize = 256;

impl<'a> RenderTask<'a> {
    /// Creates a task that cannot be cancelled and does not report progress.
    pub fn new(prepared: &'a Prepared, settings: &'a Settings, rect: Rect, samples: Range<u32>) -> Self {
        Self { prepared, settings, rect, samples, cancel: None, progress: None }
    }

    /// Renders the samples with a recorder for each run of rows of pixels. Returns the recorders in order, too.
    pub(crate) fn render_rows<R: Recorder + Send>(
        &self,
        recorder: impl Fn() -> R + Sync,
    ) -> Result<(RenderedTile, Vec<R>), RenderError> {
        // Adjacent rows share a tracer while the same thread renders them.
        let rows = (0..self.rect.height).into_par_iter().try_fold(
            || (Vec::new(), RowTracer::new(self, recorder())),
            |(mut strips, mut tracer), row| {
                strips.push(self.render_row(&mut tracer, row)?);
                Ok((strips, tracer))
            },
        );
        let runs: Vec<Result<TracedRows<'_, R>, RenderError>> = rows.collect();
        let (mut tiles, mut rays, mut shadow_rays, mut guided_vertices) =
            (Vec::with_capacity(self.rect.height as usize), 0, 0, 0);
        let mut recorders = Vec::with_capacity(runs.len());
        for run in runs {
            let (strips, tracer) = run?;
            let (counters, recorder) = tracer.finish();
            tiles.extend(strips);
            rays += counters.rays;
            shadow_rays += counters.shadow_rays;
            guided_vertices += counters.guided;
            recorders.push(recorder);
        }
        let mut tile = Tile::from_strips(self.rect, self.samples.clone(), tiles)?;
        tile.add_rays(rays + shadow_rays);
        let aovs = AovTile { light: None, features: None };
        Ok((RenderedTile { tile, aovs, statistics: None, rays, shadow_rays, guided_vertices }, recorders))
    }

    fn render_row<R: Recorder>(&self, tracer: &mut RowTracer<'a, R>, row: u32) -> Result<Tile, RenderError> {
        let strip = Rect { y: self.rect.y + row, height: 1, ..self.rect };
        let mut tile = Tile::new(strip, self.samples.clone())?;
        match tracer {
            RowTracer::Packet(packet, _) => self.render_packets(packet, &mut tile, strip)?,
            RowTracer::Recorded(tracer) => {
                for x in strip.x..strip.x + strip.width {
                    // Reports progress also within a pixel of very many samples.
                    for begin in self.samples.clone().step_by(STEP) {
                        let step = begin..self.samples.end.min(begin.saturating_add(STEP as u32));
                        let count = u64::from(step.end - step.start);
                        self.render_pixel(tracer, &mut tile, [x, strip.y], step)?;
                        self.report(count);
                    }
                }
            }
        }
        Ok(tile)
    }

    /// Counts finished samples.
    fn report(&self, count: u64) {
        if let Some(progress) = self.progress {
            progress.fetch_add(count, Ordering::Relaxed);
        }
    }

    fn is_cancelled(&self) -> bool {
        self.cancel.is_some_and(|cancel| cancel.load(Ordering::Relaxed))
    }

    /// Renders the samples of a row of pixels.
    fn render_packets(&self, packet: &mut Packet<'a>, tile: &mut Tile, strip: Rect) -> Result<(), RenderError> {
        let first = strip.y * self.prepared.camera.film[0];
        let pixels = first + strip.x..first + strip.x + strip.width;
        let samples = pixels.flat_map(|pixel| self.samples.clone().map(move |sample| (pixel, sample)));
        let mut finished = 0;
        packet.trace(
            samples.take_while(|_| !self.is_cancelled()),
            FilterAdapter(self.settings.filter),
            |(pixel, index), drawn| {
                tile.add(pixel - first, strip.y, index, &film_sample(&drawn));
                finished += 1;
                if finished == STEP as u64 {
                    self.report(std::mem::take(&mut finished));
                }
            },
        );
        self.report(finished);
        if self.is_cancelled() { Err(RenderError::Cancelled) } else { Ok(()) }
    }

    fn render_pixel<R: Recorder>(
        &self,
        tracer: &mut Tracer<'_, R>,
        tile: &mut Tile,
        [x, y]: [u32; 2],
        samples: Range<u32>,
    ) -> Result<(), RenderError> {
        let pixel = y * self.prepared.camera.film[0] + x;
        for index in samples {
            if self.is_cancelled() {
                return Err(RenderError::Cancelled);
            }
            let drawn = tracer.sample(pixel, index, FilterAdapter(self.settings.filter));
            let fault = tile.add(x, y, index, &film_sample(&drawn));
            tracer.recorder.end_sample(fault.is_none().then_some(drawn.color));
        }
        Ok(())
    }
}

/// Creates a tracer of a frame with its settings.
pub(crate) fn frame_tracer<'a, R: Recorder>(prepared: &'a Prepared, settings: &Settings, recorder: R) -> Tracer<'a, R> {
    let path = PathSettings { seed: settings.seed, max_depth: settings.max_depth, single_technique: None };
    let tracer = Tracer::with_recorder(prepared, path, recorder);
    match (settings.method, prepared.field()) {
        (Method::Fem, Some(field)) => tracer.with_field(field),
        (Method::Femc | Method::Femc1998, Some(field)) => tracer.with_guidance(Guidance::new(prepared, field)),
        _ => tracer.with_first_branches(prepared.first_branches),
    }
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
