//! The geometry task: the surfaces of a frame as binary glTF, for viewers of its recorded light.

use std::sync::atomic::Ordering;

use femc_model::{Failure, Phase, Role, StageTemplate};
use femc_pipeline::gltf::{GeometryOptions, scene_geometry};

use super::{Product, Tools, settings_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(super) fn geometry(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let frame = task.assignment.task.stage.frame;
    task.set_phase(Phase::Preparing);
    let watch = Stopwatch::start();
    let (loaded, prepared) = tools.cache.unlit_frame(&task.spec, frame, &task.client, &tools.fetch)?;
    task.account.set_preparation(watch.elapsed());
    task.set_phase(Phase::Working);
    let options = GeometryOptions { camera: loaded.settings.camera.clone(), ..GeometryOptions::default() };
    let bytes = tools.install(task, || scene_geometry(&prepared, &options)).map_err(settings_failure)?;
    tracing::debug!(frame, bytes = bytes.len(), seconds = watch.seconds(), "geometry written");
    task.units.store(1, Ordering::Relaxed);
    if task.is_cancelled() {
        Err(Failure::Cancelled)
    } else {
        Ok(Product::of_one(stage, Role::Geometry, bytes, &watch))
    }
}
