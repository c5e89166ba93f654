//! A first pass in blocks: the steps that one task does for all blocks, and the steps of each block.
//!
//! A worker builds the starting state of a step once from the outputs of the earlier steps and caches it (`Cache`), so that the
//! next block begins at once. The worker that has combined the rays of all blocks continues with that state and downloads nothing.

use std::sync::Arc;

use femc_model::{Artifact, Digest, Failure, Graph, Role, StageKind, StageTemplate};
use femc_pipeline::{
    BlockOutput, BlockPhase, GuideState, LinkedState, Prepared, RayState, Solution, Solver, StepDecodeError,
    encode_solution,
};
use rayon::prelude::*;

use super::first_pass::{log, render_failure};
use super::inputs::{LostInputs, artifacts};
use super::{Product, Tools, settings_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

/// Returns the number of blocks of a graph's first pass.
pub(super) fn blocks(graph: &Graph) -> u32 {
    let blocks = graph.stages.iter().filter(|stage| stage.kind == StageKind::FirstPassBlock);
    blocks.map(StageTemplate::tasks).max().unwrap_or(1)
}

/// Context of a step: the solver of the job's method, and the world.
type World<'a> = (&'a dyn Solver, &'a Arc<Prepared>);

pub(super) fn step(
    task: &Task,
    stage: &StageTemplate,
    tools: &Tools,
    world: World<'_>,
    watch: &Stopwatch,
) -> Result<Product, Failure> {
    let (block, blocks) = (task.assignment.spec.item, stage.tasks());
    let makes = |role| stage.outputs.contains(&role);
    let reads = |role| stage.needs.iter().any(|need| need.role == role);
    let mut product = Product::default();
    if makes(Role::Links) {
        let (solver, prepared) = world;
        let begun = tools.install(task, || solver.begin(prepared, &task.cancel));
        let begun = begun.map_err(render_failure)?;
        let report = begun.report();
        tracing::debug!(
            elements = report.elements,
            links = report.links,
            lamp_links = report.lamp_links,
            rays = report.rays,
            seconds = watch.seconds(),
            "linked"
        );
        product.put(stage, Role::Elements, || tools.install(task, || begun.encode_elements()));
        product.put(stage, Role::Links, || tools.install(task, || begun.encode_links()));
    } else if makes(Role::Rays) {
        let aimed = state_before_rays(task, tools, world)?;
        product.put(stage, Role::Rays, || tools.install(task, || aimed.cast(world.1, block, blocks)));
    } else if makes(Role::Guides) {
        let settled = state_after_rays(task, tools, world)?;
        product.put(stage, Role::Guides, || tools.install(task, || settled.guides(world.1, block, blocks)));
    } else if reads(Role::Rays) {
        combine_rays(task, stage, tools, world, watch, &mut product)?;
    } else if makes(Role::Field) {
        let mut lost = LostInputs::default();
        let underway = linked_state(task, tools, world, &mut lost)?;
        let found = read_guides(task, tools, world.0, &mut lost)?;
        let solution = tools.install(task, || underway.solution(world.1, found));
        let solution = solution.map_err(|error| damaged(&artifacts(task, Role::Guides), error))?;
        write_solution(task, stage, tools, (world, watch), solution, &mut product)?;
    } else {
        return Err(settings_failure("invalid job graph: unknown first-pass step"));
    }
    if task.is_cancelled() { Err(Failure::Cancelled) } else { Ok(product) }
}

/// Combines the rays of all blocks. If no guides follow, it also writes the solution.
fn combine_rays(
    task: &Task,
    stage: &StageTemplate,
    tools: &Tools,
    world: World<'_>,
    watch: &Stopwatch,
    product: &mut Product,
) -> Result<(), Failure> {
    let (solver, prepared) = world;
    let aimed = state_before_rays(task, tools, world)?;
    let ray_hits = read_ray_hits(task, tools, solver)?;
    let settled = tools.install(task, || aimed.apply(prepared, ray_hits, &task.cancel));
    let rays = artifacts(task, Role::Rays);
    let others = || Failure::LostInputs {
        digests: rays.iter().map(|artifact| artifact.digest).collect(),
        message: "the rays of the first pass belong to other elements".into(),
    };
    let settled = settled.map_err(render_failure)?.ok_or_else(others)?;
    let report = settled.report();
    tracing::debug!(
        iterations = report.iterations,
        residual = report.residual,
        checked = report.ray_link_ratio,
        corrected = report.ray_correction,
        seconds = watch.seconds(),
        "settled"
    );
    if stage.outputs.contains(&Role::Field) {
        let solution = tools.install(task, || settled.solution(prepared));
        return write_solution(task, stage, tools, (world, watch), solution, product);
    }
    let bytes = tools.install(task, || settled.encode_elements());
    // Later steps on this worker continue with the cached state.
    let elements = Artifact { digest: Digest::compute(&bytes), bytes: bytes.len() as u64 };
    let inputs: Vec<Artifact> = [elements].into_iter().chain(artifacts(task, Role::Links)).chain(rays).collect();
    tools.cache.state_after_rays(&inputs, || Ok(settled))?;
    product.put(stage, Role::Elements, || bytes);
    Ok(())
}

fn write_solution(
    task: &Task,
    stage: &StageTemplate,
    tools: &Tools,
    ((_, prepared), watch): (World<'_>, &Stopwatch),
    solution: Solution,
    product: &mut Product,
) -> Result<(), Failure> {
    let solved = tools.install(task, || {
        solution.verify(prepared)?;
        let bytes = encode_solution(&solution);
        log(&solution.report, bytes.len(), watch);
        Ok((bytes, Arc::new(solution.field)))
    });
    let (bytes, field) = solved.map_err(render_failure)?;
    // The worker that solved the first pass need not download it.
    tools.cache.insert_field(Digest::compute(&bytes), field);
    product.put(stage, Role::Field, || bytes);
    Ok(())
}

/// Returns the state from which the rays start.
fn state_before_rays(task: &Task, tools: &Tools, world: World<'_>) -> Result<Arc<dyn RayState>, Failure> {
    let (solver, prepared) = world;
    tools.cache.state_before_rays(&inputs_of_roles(task, &[Role::Elements, Role::Links, Role::Guides]), || {
        let mut lost = LostInputs::default();
        let underway = linked_state(task, tools, world, &mut lost)?;
        let found = read_guides(task, tools, solver, &mut lost)?;
        let aimed = tools.install(task, || underway.before_rays(prepared, found));
        aimed.map_err(|error| damaged(&artifacts(task, Role::Guides), error))
    })
}

/// Returns the state from which the guides start.
fn state_after_rays(task: &Task, tools: &Tools, world: World<'_>) -> Result<Arc<dyn GuideState>, Failure> {
    let inputs = inputs_of_roles(task, &[Role::Elements, Role::Links, Role::Rays]);
    tools.cache.state_after_rays(&inputs, || {
        let mut lost = LostInputs::default();
        let underway = linked_state(task, tools, world, &mut lost)?;
        let ray_hits = read_ray_hits(task, tools, world.0)?;
        let settled = tools.install(task, || underway.after_rays(ray_hits));
        settled.map_err(|error| damaged(&artifacts(task, Role::Rays), error))
    })
}

fn linked_state(
    task: &Task,
    tools: &Tools,
    (solver, prepared): World<'_>,
    lost: &mut LostInputs,
) -> Result<Box<dyn LinkedState>, Failure> {
    let [elements, links] = [Role::Elements, Role::Links].map(|role| artifacts(task, role));
    let [(elements, of_elements)] = &lost.fetch(task, &elements, tools)?[..] else {
        lost.finish()?;
        return Err(settings_failure(
            "invalid job graph: a first-pass step must read the elements of exactly one step",
        ));
    };
    let [(links, of_links)] = &lost.fetch(task, &links, tools)?[..] else {
        lost.finish()?;
        return Err(settings_failure("invalid job graph: a first-pass step must read the links of exactly one step"));
    };
    let decoded = tools.install(task, || solver.decode(prepared, of_elements, of_links));
    decoded.map_err(|error| damaged(&[*elements, *links], error))
}

fn read_guides(
    task: &Task,
    tools: &Tools,
    solver: &dyn Solver,
    lost: &mut LostInputs,
) -> Result<Vec<BlockOutput>, Failure> {
    read_outputs(task, tools, lost, Role::Guides, |bytes| solver.decode_block(BlockPhase::Guides, bytes))
}

fn read_ray_hits(task: &Task, tools: &Tools, solver: &dyn Solver) -> Result<Vec<BlockOutput>, Failure> {
    let decode = |bytes: &[u8]| solver.decode_block(BlockPhase::Rays, bytes);
    read_outputs(task, tools, &mut LostInputs::default(), Role::Rays, decode)
}

/// Downloads and decodes the outputs of one role from all blocks, in order. The error names all lost outputs.
fn read_outputs(
    task: &Task,
    tools: &Tools,
    lost: &mut LostInputs,
    role: Role,
    decode: impl Fn(&[u8]) -> Result<BlockOutput, StepDecodeError> + Sync,
) -> Result<Vec<BlockOutput>, Failure> {
    let here = lost.fetch(task, &artifacts(task, role), tools)?;
    let decoded: Vec<Result<BlockOutput, StepDecodeError>> =
        tools.install(task, || here.par_iter().map(|(_, bytes)| decode(bytes)).collect());
    let mut out = Vec::with_capacity(here.len());
    for ((artifact, _), decoded) in here.into_iter().zip(decoded) {
        lost.check(artifact, decoded.map(|decoded| out.push(decoded)));
    }
    lost.finish()?;
    Ok(out)
}

/// Returns the task's inputs of these roles, in order.
fn inputs_of_roles(task: &Task, roles: &[Role]) -> Vec<Artifact> {
    roles.iter().flat_map(|&role| artifacts(task, role)).collect()
}

fn damaged(artifacts: &[Artifact], error: StepDecodeError) -> Failure {
    Failure::LostInputs {
        digests: artifacts.iter().map(|artifact| artifact.digest).collect(),
        message: error.to_string(),
    }
}
