//! The first-pass-solve task: solves a first pass again, corrected by the ray hits of all blocks.

use femc_model::{Failure, Role, StageKind, StageTemplate};
use femc_pipeline::LinkedState;

use super::first_pass::{World, render_failure};
use super::solver_state::{read_rays, state_before_rays, states_from};
use super::{Product, Tools};
use crate::task_table::Task;

pub(super) fn first_pass_solve(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let world = World::prepare(task, tools)?;
    let corrected = solve_with_rays(task, tools, &world)?;
    let mut product = Product::default();
    product.put(stage, Role::SolverState, || tools.install(task, || corrected.encode_elements()));
    world.finish(task, product)
}

/// Solves with the ray hits of all blocks.
pub(super) fn solve_with_rays(task: &Task, tools: &Tools, world: &World) -> Result<Box<dyn LinkedState>, Failure> {
    let state = state_before_rays(task, tools, world)?;
    let rays = read_rays(task, tools, world)?;
    let solve = || state.apply(&world.prepared, rays, &task.cancel);
    let others = || Failure::LostInputs {
        digests: states_from(task, StageKind::FirstPassRays).iter().map(|artifact| artifact.digest).collect(),
        message: "the rays of the first pass belong to other elements".into(),
    };
    let corrected = tools.install(task, solve).map_err(render_failure)?.ok_or_else(others)?;
    let report = corrected.report();
    tracing::debug!(
        iterations = report.iterations,
        residual = report.residual,
        checked = report.ray_link_ratio,
        corrected = report.ray_correction,
        seconds = world.solving.seconds(),
        "settled"
    );
    Ok(corrected)
}
