//! The first-pass-start task: creates the elements and links of a first pass in blocks.

use femc_model::{Failure, Role, StageTemplate};

use super::first_pass::{World, render_failure};
use super::{Product, Tools};
use crate::task_table::Task;

pub(super) fn first_pass_start(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let world = World::prepare(task, tools)?;
    world.check_memory(tools)?;
    let begin = || world.solver.begin(&world.prepared, &task.cancel);
    let state = tools.install(task, begin).map_err(render_failure)?;
    let report = state.report();
    tracing::debug!(
        elements = report.elements,
        links = report.links,
        lamp_links = report.lamp_links,
        rays = report.rays,
        seconds = world.solving.seconds(),
        "linked"
    );
    let mut product = Product::default();
    product.put(stage, Role::SolverState, || tools.install(task, || state.encode_start()));
    world.finish(task, product)
}
