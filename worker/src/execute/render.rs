//! The render task: one tile, one range of samples.

use std::sync::atomic::Ordering;

use femc_film::Rect;
use femc_model::{Failure, Phase, Role, StageTemplate, TaskSpec, TileRect};
use femc_pipeline::{FeaturePlan, Outputs, RenderError, RenderTask, StatisticsPlan};

use super::{Product, Tools, settings_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(crate) fn render(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let (key, TaskSpec { item, steps: samples, .. }) = (task.assignment.task, &task.assignment.spec);
    task.set_phase(Phase::Preparing);
    let preparing = Stopwatch::start();
    let inputs = task.frame_inputs();
    let (loaded, prepared) = tools.cache.frame(&task.spec, key.stage.frame, inputs, &task.client, &tools.fetch)?;
    task.account.set_preparation(preparing.elapsed());
    tracing::debug!(frame = key.stage.frame, seconds = preparing.seconds(), "the frame is ready");
    let grid = task.spec.grid;
    let rect = grid.rect(*item).filter(|_| prepared.camera.film == grid.film);
    let Some(TileRect { x, y, width, height }) = rect else {
        return Err(settings_failure("the job's film does not match its settings"));
    };
    let rect = Rect { x, y, width, height };
    task.set_phase(Phase::Working);
    let watch = Stopwatch::start();
    let (settings, range) = (&loaded.settings, samples.clone());
    let (cancel, progress) = (Some(&task.cancel), Some(&task.units));
    let rendered = tools.install(task, || {
        let makes = |role| stage.outputs.contains(&role);
        let statistics = makes(Role::Paths).then(|| StatisticsPlan::new(&prepared, settings, grid.tile));
        let (mut light, mut features) = (None, None);
        if makes(Role::Layers) {
            light = tools.cache.layers(&loaded, key.stage.frame, &prepared)?;
            features = FeaturePlan::from_settings(&prepared, settings).map_err(settings_failure)?;
        }
        let outputs =
            Outputs { layers: light.as_deref(), features: features.as_ref(), statistics: statistics.as_ref() };
        let made = RenderTask { prepared: &prepared, settings, rect, samples: range, cancel, progress }
            .render(outputs)
            .map(|rendered| {
                let layers = makes(Role::Layers).then(|| rendered.aovs.encode());
                let statistics = rendered.statistics.map(|it| it.encode());
                let (rays, shadow_rays) = (rendered.rays, rendered.shadow_rays);
                let bad = rendered.tile.bad_samples().total();
                task.account.rays.store(rays + shadow_rays, Ordering::Relaxed);
                tracing::debug!(?rect, ?samples, rays, shadow_rays, bad, seconds = watch.seconds(), "rendered");
                let thumbnail = makes(Role::Thumbnail).then(|| rendered.tile.thumbnail().encode_thumbnail());
                (bad, rendered.tile.encode(), thumbnail, statistics, layers)
            });
        made.map_err(|error| match error {
            RenderError::Cancelled => Failure::Cancelled,
            error @ (RenderError::Film(_) | RenderError::Untrusted(_)) => settings_failure(error),
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
