//! The solution task: the finite-element solution of a frame as binary glTF, for viewers of its recorded light.

use std::sync::atomic::Ordering;

use femc_model::{Failure, Phase, Role, StageTemplate};
use femc_pipeline::gltf::{SolutionOptions, solution_model};

use super::{Product, Tools, settings_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(super) fn solution(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let frame = task.assignment.task.stage.frame;
    task.set_phase(Phase::Preparing);
    let watch = Stopwatch::start();
    let (_, prepared) = tools.cache.frame(&task.spec, frame, task.frame_inputs(), &task.client, &tools.fetch)?;
    task.account.set_preparation(watch.elapsed());
    let field = prepared
        .field()
        .ok_or_else(|| settings_failure("invalid job graph: a solution task must read the light of a first pass"))?;
    task.set_phase(Phase::Working);
    let bytes = tools.install(task, || solution_model(&prepared, field, &SolutionOptions::default()));
    let bytes = bytes.map_err(settings_failure)?;
    tracing::debug!(frame, bytes = bytes.len(), seconds = watch.seconds(), "solution written");
    task.units.store(1, Ordering::Relaxed);
    if task.is_cancelled() {
        Err(Failure::Cancelled)
    } else {
        Ok(Product::of_one(stage, Role::Solution, bytes, &watch))
    }
}
