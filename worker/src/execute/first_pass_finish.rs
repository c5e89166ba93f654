//! The first-pass-finish task: applies the last rays of a first pass in blocks, and makes its light.

use femc_model::{Failure, StageKind, StageTemplate};

use super::first_pass::{World, write_solution};
use super::first_pass_solve::solve_with_rays;
use super::solver_state::{linked_state, states_from};
use super::{Product, Tools};
use crate::task_table::Task;

pub(super) fn first_pass_finish(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let world = World::prepare(task, tools)?;
    // In earlier versions, another task has applied the rays.
    let is_solved = states_from(task, StageKind::FirstPassRays).is_empty();
    let state = if is_solved { linked_state(task, tools, &world)? } else { solve_with_rays(task, tools, &world)? };
    let solution = tools.install(task, || state.solution(&world.prepared));
    let product = write_solution(task, stage, tools, &world, solution)?;
    world.finish(task, product)
}
