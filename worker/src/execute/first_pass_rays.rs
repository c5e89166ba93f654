//! The first-pass-rays task: casts the rays of one block of a first pass.

use femc_model::{Failure, Role, StageTemplate};

use super::first_pass::World;
use super::solver_state::state_before_rays;
use super::{Product, Tools};
use crate::task_table::Task;

pub(super) fn first_pass_rays(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let world = World::prepare(task, tools)?;
    let state = state_before_rays(task, tools, &world)?;
    let (block, blocks) = (task.assignment.spec.item, stage.tasks());
    let mut product = Product::default();
    product.put(stage, Role::SolverState, || tools.install(task, || state.cast(&world.prepared, block, blocks)));
    world.finish(task, product)
}
