//! A first pass in blocks: the steps that one task does for all blocks, and the steps of each block.
//!
//! A worker builds the starting state of a step once from the outputs of the earlier steps and caches it (`Cache`), so that the
//! next block begins at once. The worker that has combined the rays of all blocks continues with that state and downloads nothing.

use std::sync::Arc;

use femc_model::{Artifact, Digest, Failure, Graph, Role, StageKind, Template};
use femc_pipeline::{Aimed, Damaged, Found, Method, Prepared, Settled, Sights, Underway, encode_solution};
use rayon::prelude::*;

use super::first_pass::{failed, log};
use super::union::{Lost, artifacts};
use super::{Product, Tools, unfit};
use crate::clock::Stopwatch;
use crate::table::Task;

/// Returns the number of blocks of a graph's first pass.
pub(super) fn blocks(graph: &Graph) -> u32 {
    let blocks = graph.stages.iter().filter(|stage| stage.kind == StageKind::FirstPassBlock);
    blocks.map(Template::tasks).max().unwrap_or(1)
}

/// Context of a step: the job's method and the world.
type World<'a> = (Method, &'a Arc<Prepared>);

pub(super) fn step(
    task: &Task,
    stage: &Template,
    tools: &Tools,
    world: World<'_>,
    watch: &Stopwatch,
) -> Result<Product, Failure> {
    let (block, blocks) = (task.assignment.work.item, stage.tasks());
    let makes = |role| stage.makes.contains(&role);
    let reads = |role| stage.needs.iter().any(|need| need.role == role);
    let mut product = Product::default();
    if makes(Role::Links) {
        let (method, prepared) = world;
        let begun = tools.install(task, || femc_pipeline::begin(prepared, method, &task.cancel));
        let begun = begun.map_err(failed)?;
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
        let aimed = aimed(task, tools, world)?;
        product.put(stage, Role::Rays, || tools.install(task, || aimed.cast(world.1, block, blocks).encode()));
    } else if makes(Role::Guides) {
        let settled = settled(task, tools, world)?;
        product.put(stage, Role::Guides, || tools.install(task, || settled.guides(world.1, block, blocks).encode()));
    } else if reads(Role::Rays) {
        settle(task, stage, tools, world, watch, &mut product)?;
    } else if makes(Role::Field) {
        let mut lost = Lost::default();
        let underway = underway(task, tools, world, &mut lost)?;
        let found = found(task, tools, &mut lost)?;
        solution(task, stage, tools, (world, watch), (&underway, found), &mut product)?;
    } else {
        return Err(unfit("invalid job graph: unknown first-pass step"));
    }
    if task.is_cancelled() { Err(Failure::Cancelled) } else { Ok(product) }
}

/// Combines the rays of all blocks. If no guides follow, it also writes the solution.
fn settle(
    task: &Task,
    stage: &Template,
    tools: &Tools,
    world: World<'_>,
    watch: &Stopwatch,
    product: &mut Product,
) -> Result<(), Failure> {
    let (method, prepared) = world;
    let aimed = aimed(task, tools, world)?;
    let sights = sights(task, tools)?;
    let settled = tools.install(task, || femc_pipeline::settle(&aimed, prepared, method, sights, &task.cancel));
    let rays = artifacts(task, Role::Rays);
    let others = || Failure::LostInputs {
        digests: rays.iter().map(|artifact| artifact.digest).collect(),
        message: "the rays of the first pass belong to other elements".into(),
    };
    let settled = settled.map_err(failed)?.ok_or_else(others)?;
    let (underway, report) = (settled.underway(), settled.underway().report());
    tracing::debug!(
        round = underway.round(),
        iterations = report.iterations,
        residual = report.residual,
        checked = report.checked,
        corrected = report.corrected,
        seconds = watch.seconds(),
        "settled"
    );
    if stage.makes.contains(&Role::Field) {
        return solution(task, stage, tools, (world, watch), (underway, Vec::new()), product);
    }
    let bytes = tools.install(task, || underway.encode_elements());
    // Later steps on this worker continue with the cached state.
    let elements = Artifact { digest: Digest::of(&bytes), bytes: bytes.len() as u64 };
    let of: Vec<Artifact> = [elements].into_iter().chain(artifacts(task, Role::Links)).chain(rays).collect();
    tools.cache.settled(&of, || Ok(settled))?;
    product.put(stage, Role::Elements, || bytes);
    Ok(())
}

fn solution(
    task: &Task,
    stage: &Template,
    tools: &Tools,
    ((_, prepared), watch): (World<'_>, &Stopwatch),
    (underway, found): (&Underway, Vec<Found>),
    product: &mut Product,
) -> Result<(), Failure> {
    let solved = tools.install(task, || {
        let solution = underway.solution(prepared, found);
        solution.verify(prepared)?;
        let bytes = encode_solution(&solution);
        log(&solution.report, bytes.len(), watch);
        Ok((bytes, Arc::new(solution.field)))
    });
    let (bytes, field) = solved.map_err(failed)?;
    // The worker that solved the first pass need not download it.
    tools.cache.keep_field(Digest::of(&bytes), field);
    product.put(stage, Role::Field, || bytes);
    Ok(())
}

/// Returns the state from which the rays start.
fn aimed(task: &Task, tools: &Tools, world: World<'_>) -> Result<Arc<Aimed>, Failure> {
    let (method, prepared) = world;
    tools.cache.aimed(&read(task, &[Role::Elements, Role::Links, Role::Guides]), || {
        let mut lost = Lost::default();
        let underway = underway(task, tools, world, &mut lost)?;
        let found = found(task, tools, &mut lost)?;
        Ok(tools.install(task, || femc_pipeline::aim(underway, prepared, method, found)))
    })
}

/// Returns the state from which the guides start.
fn settled(task: &Task, tools: &Tools, world: World<'_>) -> Result<Arc<Settled>, Failure> {
    let of = read(task, &[Role::Elements, Role::Links, Role::Rays]);
    tools.cache.settled(&of, || {
        let mut lost = Lost::default();
        let underway = underway(task, tools, world, &mut lost)?;
        let sights = sights(task, tools)?;
        let settled = tools.install(task, || underway.settled(sights));
        settled.map_err(|error| damaged(&artifacts(task, Role::Rays), error))
    })
}

fn underway(task: &Task, tools: &Tools, (_, prepared): World<'_>, lost: &mut Lost) -> Result<Underway, Failure> {
    let [elements, links] = [Role::Elements, Role::Links].map(|role| artifacts(task, role));
    let [(elements, of_elements)] = &lost.fetch(task, &elements, tools)?[..] else {
        lost.verdict()?;
        return Err(unfit("invalid job graph: a first-pass step must read the elements of exactly one step"));
    };
    let [(links, of_links)] = &lost.fetch(task, &links, tools)?[..] else {
        lost.verdict()?;
        return Err(unfit("invalid job graph: a first-pass step must read the links of exactly one step"));
    };
    let decoded = tools.install(task, || Underway::decode(prepared, of_elements, of_links));
    decoded.map_err(|error| damaged(&[*elements, *links], error))
}

fn found(task: &Task, tools: &Tools, lost: &mut Lost) -> Result<Vec<Found>, Failure> {
    all(task, tools, lost, Role::Guides, Found::decode)
}

fn sights(task: &Task, tools: &Tools) -> Result<Vec<Sights>, Failure> {
    all(task, tools, &mut Lost::default(), Role::Rays, Sights::decode)
}

/// Downloads and decodes the outputs of one role from all blocks, in order. The error names all lost outputs.
fn all<T: Send>(
    task: &Task,
    tools: &Tools,
    lost: &mut Lost,
    role: Role,
    decode: fn(&[u8]) -> Result<T, Damaged>,
) -> Result<Vec<T>, Failure> {
    let here = lost.fetch(task, &artifacts(task, role), tools)?;
    let decoded: Vec<Result<T, Damaged>> =
        tools.install(task, || here.par_iter().map(|(_, bytes)| decode(bytes)).collect());
    let mut out = Vec::with_capacity(here.len());
    for ((artifact, _), decoded) in here.into_iter().zip(decoded) {
        lost.check(artifact, decoded.map(|decoded| out.push(decoded)));
    }
    lost.verdict()?;
    Ok(out)
}

/// Returns the task's inputs of these roles, in order.
fn read(task: &Task, roles: &[Role]) -> Vec<Artifact> {
    roles.iter().flat_map(|&role| artifacts(task, role)).collect()
}

fn damaged(artifacts: &[Artifact], error: Damaged) -> Failure {
    Failure::LostInputs {
        digests: artifacts.iter().map(|artifact| artifact.digest).collect(),
        message: error.to_string(),
    }
}
