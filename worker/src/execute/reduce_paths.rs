//! The reduce-paths task: combines the path statistics of a group of tiles.

use femc_model::{Failure, Phase, Role, StageTemplate};

use super::statistics::combine_statistics;
use super::{Product, Tools};
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(super) fn reduce_paths(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    task.set_phase(Phase::Working);
    let watch = Stopwatch::start();
    let all = combine_statistics(task, tools)?;
    let mut product = Product::default();
    product.put(stage, Role::Paths, || tools.install(task, || all.encode()));
    product.result.seconds = watch.seconds();
    Ok(product)
}
