//! The measure task: illuminance and luminance at some of the places of a request.

use std::sync::atomic::Ordering;

use femc_model::{Failure, Phase, Role, StageTemplate};
use femc_pipeline::measure::{
    MeasureRequest, MeasureSettings, MeasurementId, ReadingBlock, ReadingShare, resolve_places,
};

use super::{Product, Tools, settings_failure};
use crate::cache::LoadedScene;
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(super) fn measure(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let frame = task.assignment.task.stage.frame;
    task.set_phase(Phase::Preparing);
    let watch = Stopwatch::start();
    let (loaded, prepared) = tools.cache.measured_frame(&task.spec, frame, &task.client, &tools.fetch)?;
    task.account.set_preparation(watch.elapsed());
    let (request, settings, id) = measurement(&loaded, frame)?;
    task.set_phase(Phase::Working);
    let share = ReadingShare { task: task.assignment.spec.item, tasks: stage.tasks() };
    let block = tools.install(task, || {
        // Every task divides the surfaces anew. That is quick compared with its samples.
        let places = resolve_places(&prepared, request).map_err(settings_failure)?;
        ReadingBlock::measure(&prepared, &places, &settings, (id, share), &task.cancel, &task.units)
            .ok_or(Failure::Cancelled)
    })?;
    let rays = block.measured.iter().map(|it| it.reading.rays).sum();
    task.account.rays.store(rays, Ordering::Relaxed);
    tracing::debug!(frame, readings = block.measured.len(), rays, seconds = watch.seconds(), "measured");
    Ok(Product::of_one(stage, Role::ReadingBlock, block.encode(), &watch))
}

/// Returns the job's measurement: the request, its settings, and its identity in a frame.
pub(super) fn measurement(
    loaded: &LoadedScene,
    frame: u32,
) -> Result<(&MeasureRequest, MeasureSettings, MeasurementId), Failure> {
    let Some(request) = &loaded.settings.measure else {
        return Err(settings_failure("invalid job graph: a stage measures, but the settings name no measurement"));
    };
    let settings = request.settings(loaded.settings.max_depth, loaded.settings.seed);
    let id = MeasurementId::new(request, &settings, (crate::engine(), loaded.digest.clone()), frame);
    Ok((request, settings, id))
}
