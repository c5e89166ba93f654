//! The render task: one tile, one range of samples.

use std::sync::atomic::Ordering;

use femc_film::Rect;
use femc_model::{Failure, Phase, Role, Template, TileRect, Work};
use femc_pipeline::{FeaturePlan, RenderError, StatisticsPlan, render_beside, render_tile, render_with_statistics};

use super::{Product, Tools, unfit};
use crate::clock::Stopwatch;
use crate::table::Task;

pub(crate) fn render(task: &Task, stage: &Template, tools: &Tools) -> Result<Product, Failure> {
    let (key, Work { item, steps: samples, .. }) = (task.assignment.task, &task.assignment.work);
    task.enter(Phase::Preparing);
    let preparing = Stopwatch::start();
    let light = task.light();
    let (read, prepared) = tools.cache.frame(&task.spec, key.stage.frame, light, &task.client, &tools.fetch)?;
    task.account.prepared(preparing.elapsed());
    tracing::debug!(frame = key.stage.frame, seconds = preparing.seconds(), "the frame is ready");
    let grid = task.spec.grid;
    let rect = grid.rect(*item).filter(|_| prepared.camera.film == grid.film);
    let Some(TileRect { x, y, width, height }) = rect else {
        return Err(unfit("the job's film does not match its settings"));
    };
    let rect = Rect { x, y, width, height };
    task.enter(Phase::Working);
    let watch = Stopwatch::start();
    let (settings, range) = (&read.settings, samples.clone());
    let (cancel, units) = (&task.cancel, &task.units);
    let rendered = tools.install(task, || {
        let makes = |role| stage.makes.contains(&role);
        let statistics = makes(Role::Paths).then(|| StatisticsPlan::of(&prepared, settings, grid.tile));
        let outcome = match (makes(Role::Layers), &statistics) {
            (true, of) => {
                let light = tools.cache.layers(&read, key.stage.frame, &prepared)?;
                let features = FeaturePlan::of(&prepared, settings).map_err(unfit)?;
                let plans = (light.as_deref(), features.as_ref());
                render_beside(&prepared, settings, plans, of.as_ref(), rect, range, cancel, units)
                    .map(|(rendered, beside, of)| (rendered, of, Some(beside)))
            }
            (false, Some(of)) => render_with_statistics(&prepared, settings, of, rect, range, cancel, units)
                .map(|(rendered, of)| (rendered, Some(of), None)),
            (false, None) => {
                render_tile(&prepared, settings, rect, range, cancel, units).map(|rendered| (rendered, None, None))
            }
        };
        let made = outcome.map(|(rendered, statistics, layers)| {
            let (statistics, layers) = (statistics.map(|it| it.encode()), layers.map(|it| it.encode()));
            let (rays, shadow_rays, bad) = (rendered.rays, rendered.shadow_rays, rendered.tile.bad().total());
            task.account.rays.store(rays + shadow_rays, Ordering::Relaxed);
            tracing::debug!(?rect, ?samples, rays, shadow_rays, bad, seconds = watch.seconds(), "rendered");
            let thumbnail =
                stage.makes.contains(&Role::Thumbnail).then(|| rendered.tile.thumbnail().encode_thumbnail());
            (bad, rendered.tile.encode(), thumbnail, statistics, layers)
        });
        made.map_err(|error| match error {
            RenderError::Cancelled => Failure::Cancelled,
            error @ (RenderError::Film(_) | RenderError::Untrusted(_)) => unfit(error),
        })
    });
    let (bad_samples, bytes, thumbnail, statistics, layers) = rendered?;
    let mut product = Product::default();
    product.put(stage, Role::Tile, || bytes);
    product.put(stage, Role::Thumbnail, || thumbnail.unwrap_or_default());
    product.put(stage, Role::Layers, || layers.unwrap_or_default());
    product.put(stage, Role::Paths, || statistics.unwrap_or_default());
    let result = &mut product.result;
    (result.units, result.bad_samples) = (rect.area() * samples.len() as u64, bad_samples);
    result.seconds = watch.seconds();
    Ok(product)
}
