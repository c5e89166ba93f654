//! One tile, one range of samples.

use std::ops::Range;
use std::sync::atomic::Ordering;

use bytes::Bytes;
use femc_film::Rect;
use femc_model::{Artefact, Failure, Phase, TaskResult, TileRect, TileResult};
use femc_pipeline::RenderError;

use super::{Product, Tools};
use crate::clock::Stopwatch;
use crate::table::Task;

pub(crate) fn render(task: &Task, tile: u32, samples: Range<u32>, tools: &Tools) -> Result<Product, Failure> {
    let key = task.assignment.task;
    task.enter(Phase::Preparing);
    let preparing = Stopwatch::start();
    let (read, prepared) = tools.cache.frame(&task.spec, key.stage.frame, &task.client, &tools.fetch)?;
    task.account.prepared(preparing.elapsed());
    tracing::debug!(frame = key.stage.frame, seconds = preparing.seconds(), "the frame is ready");
    let grid = task.spec.grid;
    let rect = grid.rect(tile).filter(|_| prepared.camera.film == grid.film);
    let Some(TileRect { x, y, width, height }) = rect else {
        return Err(Failure::Settings { message: "the job's film is not that of its settings".into() });
    };
    let rect = Rect { x, y, width, height };
    task.enter(Phase::Working);
    let watch = Stopwatch::start();
    let (settings, range) = (&read.settings, samples.clone());
    let rendered = tools.install(task, || {
        femc_pipeline::render_tile(&prepared, settings, rect, range, &task.cancel, &task.samples).map(|rendered| {
            let (rays, shadow_rays, bad) = (rendered.rays, rendered.shadow_rays, rendered.tile.bad().total());
            task.account.rays.store(rays + shadow_rays, Ordering::Relaxed);
            tracing::debug!(?rect, samples = ?samples, rays, shadow_rays, bad, seconds = watch.seconds(), "rendered");
            (bad, Bytes::from(rendered.tile.encode()))
        })
    });
    let (bad_samples, bytes) = rendered.map_err(|error| match error {
        RenderError::Cancelled => Failure::Cancelled,
        RenderError::Film(error) => Failure::Settings { message: error.to_string() },
    })?;
    let result = TileResult {
        tile: Artefact::of(&bytes),
        samples: rect.area() * u64::from(samples.end - samples.start),
        bad_samples,
        seconds: watch.seconds(),
    };
    Ok(Product { result: TaskResult::Tile(result), artefacts: vec![bytes] })
}
