//! The learn task: the targets of a frame's paths, before its samples.

use std::sync::atomic::Ordering;

use femc_model::{Failure, Phase, Role, StageTemplate};
use femc_pipeline::MAX_LEARNING_BYTES;

use super::first_pass::render_failure;
use super::{Product, Tools, internal_failure, settings_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(super) fn learn(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let frame = task.assignment.task.stage.frame;
    task.set_phase(Phase::Preparing);
    let watch = Stopwatch::start();
    let (loaded, prepared) = tools.cache.frame(&task.spec, frame, task.frame_inputs(), &task.client, &tools.fetch)?;
    task.account.set_preparation(watch.elapsed());
    tools.memory.check_room(MAX_LEARNING_BYTES, "learning of targets (--method pt needs none)")?;
    task.set_phase(Phase::Working);
    let method = loaded.settings.method;
    let targets = tools.install(task, || femc_pipeline::learn_targets(&prepared, method, &task.cancel));
    let targets = targets
        .map_err(render_failure)?
        .ok_or_else(|| settings_failure("the job's graph learns targets, but its method has none"))?;
    let bytes = targets.encode().map_err(|error| internal_failure(&error))?;
    let (found, paths, rays) = (targets.targets.len(), targets.paths, targets.rays);
    tracing::debug!(frame, found, paths, rays, bytes = bytes.len(), seconds = watch.seconds(), "targets learned");
    task.account.rays.store(rays, Ordering::Relaxed);
    task.units.store(1, Ordering::Relaxed);
    if task.is_cancelled() { Err(Failure::Cancelled) } else { Ok(Product::of_one(stage, Role::Targets, bytes, &watch)) }
}
