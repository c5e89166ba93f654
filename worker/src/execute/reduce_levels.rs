//! The reduce-levels task: adds up luminance levels, of groups of tiles or of frames.

use femc_film::LuminanceLevels;
use femc_model::{Failure, Phase, Role, StageTemplate};

use super::inputs::for_each_input;
use super::{Product, Tools};
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(super) fn reduce_levels(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    task.set_phase(Phase::Working);
    let watch = Stopwatch::start();
    let mut sum = LuminanceLevels::default();
    for_each_input(task, Role::Levels, tools, |bytes| LuminanceLevels::decode(bytes).map(|levels| sum.merge(&levels)))?;
    tracing::debug!(blocks = sum.blocks(), seconds = watch.seconds(), "counted");
    Ok(Product::of_one(stage, Role::Levels, sum.encode(), &watch))
}
