//! Solver states of a first pass in blocks, as inputs of its steps.
//!
//! All steps make outputs of one role. The kind of the stage that made an input says what it holds: elements and links, elements
//! alone, or ray hits. A worker builds the state before the rays of a round once and caches it (`Cache`), so that the next block
//! begins at once.

use std::sync::Arc;

use bytes::Bytes;
use femc_model::{Artifact, Failure, Input, Role, StageKind};
use femc_pipeline::{BlockOutput, LinkedState, RayState, StepDecodeError};
use rayon::prelude::*;

use super::first_pass::World;
use super::inputs::LostInputs;
use super::{Tools, settings_failure};
use crate::task_table::Task;

/// Returns the solver states among the task's inputs that tasks of this kind have made, in order.
pub(super) fn states_from(task: &Task, kind: StageKind) -> Vec<Artifact> {
    let (graph, number) = (&task.spec.graph, task.assignment.task.stage.number);
    let needs = graph.stage(number).map_or(&[][..], |stage| &stage.needs);
    let is_from = |input: &&Input| {
        let need = needs.get(usize::from(input.need));
        need.and_then(|need| graph.stage(need.stage)).is_some_and(|made| made.kind == kind)
    };
    let states = task.assignment.spec.inputs_of_role(Role::SolverState);
    states.filter(is_from).map(|input| input.output.artifact).collect()
}

/// Returns the artifacts of elements and links: of the latest solution, if there is one, and of the start.
pub(super) fn linked_artifacts(task: &Task) -> Vec<Artifact> {
    [StageKind::FirstPassSolve, StageKind::FirstPassStart]
        .into_iter()
        .flat_map(|kind| states_from(task, kind))
        .collect()
}

/// Returns the state from which the rays start.
pub(super) fn state_before_rays(task: &Task, tools: &Tools, world: &World) -> Result<Arc<dyn RayState>, Failure> {
    tools.cache.state_before_rays(&linked_artifacts(task), || {
        let state = linked_state(task, tools, world)?;
        Ok(tools.install(task, || state.before_rays(&world.prepared)))
    })
}

/// Returns the latest elements, with their links.
pub(super) fn linked_state(task: &Task, tools: &Tools, world: &World) -> Result<Box<dyn LinkedState>, Failure> {
    let [starts, solutions] =
        [StageKind::FirstPassStart, StageKind::FirstPassSolve].map(|kind| states_from(task, kind));
    let mut lost = LostInputs::default();
    let (started, solved) = (lost.fetch(task, &starts, tools)?, lost.fetch(task, &solutions, tools)?);
    lost.finish()?;
    let (start, start_bytes) = match (&started[..], &solved[..]) {
        ([(start, bytes)], [] | [_]) => (start, bytes),
        // Earlier versions have started with two outputs.
        ([_, _], _) => return Err(damaged(&starts, StepDecodeError::Damaged("it has two parts"))),
        _ => {
            return Err(settings_failure(
                "invalid job graph: a first-pass step must read one start, and at most one solution",
            ));
        }
    };
    let latest = solved.first().map(|(_, bytes)| &bytes[..]);
    let decoded = tools.install(task, || world.solver.decode(&world.prepared, start_bytes, latest));
    let read: Vec<Artifact> = solved.iter().map(|(artifact, _)| *artifact).chain([*start]).collect();
    decoded.map_err(|error| damaged(&read, error))
}

/// Downloads and decodes the results of the rays of all blocks, in order. The error names all lost outputs.
pub(super) fn read_rays(task: &Task, tools: &Tools, world: &World) -> Result<Vec<BlockOutput>, Failure> {
    let mut lost = LostInputs::default();
    let here = lost.fetch(task, &states_from(task, StageKind::FirstPassRays), tools)?;
    let decode = |(_, bytes): &(Artifact, Bytes)| world.solver.decode_rays(bytes);
    let decoded: Vec<Result<BlockOutput, StepDecodeError>> =
        tools.install(task, || here.par_iter().map(decode).collect());
    let mut out = Vec::with_capacity(here.len());
    for ((artifact, _), decoded) in here.into_iter().zip(decoded) {
        lost.check(artifact, decoded.map(|decoded| out.push(decoded)));
    }
    lost.finish()?;
    Ok(out)
}

/// Returns the failure of a task whose inputs cannot be decoded, or belong to another world or version. They are made again.
pub(super) fn damaged(artifacts: &[Artifact], error: StepDecodeError) -> Failure {
    Failure::LostInputs {
        digests: artifacts.iter().map(|artifact| artifact.digest).collect(),
        message: error.to_string(),
    }
}
