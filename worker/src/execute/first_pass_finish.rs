//! The first-pass-finish task: makes the light of a first pass in blocks from its last elements and guides. A first pass without
//! guides ends with rays, which this task applies.

use femc_model::{Failure, StageKind, StageTemplate};

use super::first_pass::{World, write_solution};
use super::first_pass_solve::solve_with_rays;
use super::solver_state::{damaged, linked_state, read_guides, states_from};
use super::{Product, Tools};
use crate::task_table::Task;

pub(super) fn first_pass_finish(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let world = World::prepare(task, tools)?;
    let solution = if states_from(task, StageKind::FirstPassRays).is_empty() {
        let state = linked_state(task, tools, &world)?;
        let guides = read_guides(task, tools, &world)?;
        let solution = tools.install(task, || state.solution(&world.prepared, guides));
        solution.map_err(|error| damaged(&states_from(task, StageKind::FirstPassGuides), error))?
    } else {
        let state = solve_with_rays(task, tools, &world)?;
        tools.install(task, || state.solution(&world.prepared))
    };
    let product = write_solution(task, stage, tools, &world, solution)?;
    world.finish(task, product)
}
