//! The join-readings task: all readings of a frame as one document.

use femc_model::{Failure, Phase, Role, StageTemplate};
use femc_pipeline::measure::{FrameReadings, ReadingBlock, join_blocks};

use super::inputs::{LostInputs, artifacts};
use super::measure::measurement;
use super::{Product, Tools, internal_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(super) fn join_readings(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    task.set_phase(Phase::Preparing);
    let watch = Stopwatch::start();
    let loaded = tools.cache.scene(&task.spec, &task.client, &tools.fetch)?;
    let (_, settings, id) = measurement(&loaded, task.assignment.task.stage.frame)?;
    task.account.set_preparation(watch.elapsed());
    task.set_phase(Phase::Working);
    let (mut lost, inputs) = (LostInputs::default(), artifacts(task, Role::ReadingBlock));
    let mut blocks = Vec::with_capacity(inputs.len());
    for (artifact, bytes) in lost.fetch(task, &inputs, tools)? {
        lost.check(artifact, ReadingBlock::decode(&bytes).map(|block| blocks.push(block)));
    }
    lost.finish()?;
    let document = match join_blocks(&id, blocks) {
        Ok(measured) => FrameReadings::new(id, settings.seed, &measured),
        Err((at, error)) => {
            // The block is measured again.
            if let Some(artifact) = inputs.get(at) {
                lost.check(*artifact, Err(&error));
            }
            lost.finish()?;
            return Err(internal_failure(&error));
        }
    };
    let bytes = serde_json::to_vec(&document).map_err(|error| internal_failure(&error))?;
    tracing::debug!(inputs = inputs.len(), bytes = bytes.len(), seconds = watch.seconds(), "joined the readings");
    Ok(Product::of_one(stage, Role::Readings, bytes, &watch))
}
