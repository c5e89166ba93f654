//! Tasks, leases, assignments and results.

use std::ops::Range;

use femc_model::{
    Assignment, BlockCounts, Decision, Epoch, FrameParts, Graph, Grid, Input, JobId, NextRound, Stage, TaskKey,
    TaskResult, TaskSpec,
};

use super::graph::{kind, kind_number, stage};
use super::{ConvertError, convert_all, convert_optional, required};
use crate::wire;

impl From<TaskKey> for wire::TaskKey {
    fn from(task: TaskKey) -> Self {
        let TaskKey { job, stage: Stage { frame, round, number, kind }, index } = task;
        Self { job: job.0, frame, round, stage: number.into(), kind: kind_number(kind), index }
    }
}

impl TryFrom<wire::TaskKey> for TaskKey {
    type Error = ConvertError;

    fn try_from(wire: wire::TaskKey) -> Result<Self, ConvertError> {
        let wire::TaskKey { job, frame, round, stage: number, kind: kind_value, index } = wire;
        let stage = Stage { frame, round, number: stage(number)?, kind: kind(kind_value)? };
        Ok(Self { job: JobId(job), stage, index })
    }
}

pub(super) fn to_lease(task: TaskKey, epoch: Epoch) -> Option<wire::Lease> {
    Some(wire::Lease { task: Some(task.into()), epoch: epoch.0 })
}

pub(super) fn from_lease(lease: Option<wire::Lease>) -> Result<(TaskKey, Epoch), ConvertError> {
    let lease = required("lease", lease)?;
    Ok((required("lease.task", lease.task)?.try_into()?, Epoch(lease.epoch)))
}

pub(super) fn to_range(range: &Range<u32>) -> Option<wire::Range> {
    Some(wire::Range { start: range.start, end: range.end })
}

pub(super) fn from_range(field: &'static str, range: Option<wire::Range>) -> Result<Range<u32>, ConvertError> {
    let wire::Range { start, end } = required(field, range)?;
    if start <= end { Ok(start..end) } else { Err(ConvertError::Range { field }) }
}

impl From<Assignment> for wire::Assignment {
    fn from(assignment: Assignment) -> Self {
        let Assignment { task, epoch, lease, copy_of, spec: work } = assignment;
        let copy_of = copy_of.map_or(0, |epoch| epoch.0);
        Self { lease: to_lease(task, epoch), lease_time: lease, work: Some(work.into()), copy_of }
    }
}

impl TryFrom<wire::Assignment> for Assignment {
    type Error = ConvertError;

    fn try_from(wire: wire::Assignment) -> Result<Self, ConvertError> {
        let (task, epoch) = from_lease(wire.lease)?;
        let copy_of = (wire.copy_of > 0).then_some(Epoch(wire.copy_of));
        let work = required("assignment.work", wire.work)?.try_into()?;
        Ok(Self { task, epoch, lease: wire.lease_time, copy_of, spec: work })
    }
}

impl From<TaskSpec> for wire::Work {
    fn from(
        TaskSpec { item, steps, inputs, hints, steps_taken: taken, next_round: more, elapsed, busy_seconds }: TaskSpec,
    ) -> Self {
        let [inputs, hints] = [inputs, hints].map(|all| all.into_iter().map(Into::into).collect());
        let taken = taken.numbers().to_vec();
        Self {
            item,
            steps: to_range(&steps),
            inputs,
            hints,
            more: more == NextRound::Possible,
            elapsed,
            busy_seconds,
            taken,
        }
    }
}

impl TryFrom<wire::Work> for TaskSpec {
    type Error = ConvertError;

    fn try_from(wire: wire::Work) -> Result<Self, ConvertError> {
        if wire.taken.len() > Graph::MAX_TASKS as usize {
            return Err(ConvertError::Range { field: "work.taken" });
        }
        Ok(Self {
            item: wire.item,
            steps: from_range("work.steps", wire.steps)?,
            inputs: convert_all(wire.inputs)?,
            hints: convert_all(wire.hints)?,
            steps_taken: wire.taken.into_iter().collect(),
            next_round: if wire.more { NextRound::Possible } else { NextRound::Impossible },
            elapsed: wire.elapsed,
            busy_seconds: finite_seconds(wire.busy_seconds)?,
        })
    }
}

impl From<Input> for wire::Input {
    fn from(Input { need, frame, item, output }: Input) -> Self {
        Self { need: need.into(), frame, item, output: Some(output.into()) }
    }
}

impl TryFrom<wire::Input> for Input {
    type Error = ConvertError;

    fn try_from(wire: wire::Input) -> Result<Self, ConvertError> {
        let need_index = wire.need.try_into().map_err(|_| ConvertError::Range { field: "input.need" })?;
        let output = required("input.output", wire.output)?.try_into()?;
        Ok(Self { need: need_index, frame: wire.frame, item: wire.item, output })
    }
}

impl From<BlockCounts> for wire::Blocks {
    fn from(BlockCounts { all, unlit }: BlockCounts) -> Self {
        Self { all, unlit }
    }
}

impl TryFrom<wire::Blocks> for BlockCounts {
    type Error = ConvertError;

    fn try_from(wire::Blocks { all, unlit }: wire::Blocks) -> Result<Self, ConvertError> {
        let is_sound = unlit <= all;
        is_sound.then_some(Self { all, unlit }).ok_or(ConvertError::Range { field: "blocks.unlit" })
    }
}

impl From<TaskResult> for wire::TaskResult {
    fn from(result: TaskResult) -> Self {
        use wire::task_result::Decision as Wire;
        let TaskResult { outputs, units, bad_samples, relative_error, blocks, decision, seconds } = result;
        let outputs = outputs.into_iter().map(Into::into).collect();
        let decision = decision.map(|decision| match decision {
            Decision::Continue => Wire::NextRound(wire::Empty {}),
            Decision::Steps(steps) => Wire::Steps(wire::Steps { steps }),
            Decision::Done => Wire::Done(wire::Empty {}),
        });
        let blocks = blocks.map(Into::into);
        Self { outputs, units, bad_samples, relative_error, blocks, decision, seconds }
    }
}

impl TryFrom<wire::TaskResult> for TaskResult {
    type Error = ConvertError;

    fn try_from(wire: wire::TaskResult) -> Result<Self, ConvertError> {
        use wire::task_result::Decision as Wire;
        let wire::TaskResult { outputs, units, bad_samples, relative_error, blocks, decision, seconds } = wire;
        if outputs.len() > Self::MAX_OUTPUTS {
            return Err(ConvertError::Range { field: "result.outputs" });
        }
        let decision = match decision {
            Some(Wire::Steps(wire::Steps { steps })) if steps.len() > Graph::MAX_TASKS as usize => {
                return Err(ConvertError::Range { field: "result.steps" });
            }
            Some(Wire::Steps(wire::Steps { steps })) => Some(Decision::Steps(steps)),
            Some(Wire::NextRound(_)) => Some(Decision::Continue),
            Some(Wire::Done(_)) => Some(Decision::Done),
            None => None,
        };
        let (outputs, seconds, blocks) = (convert_all(outputs)?, finite_seconds(seconds)?, convert_optional(blocks)?);
        Ok(Self { outputs, units, bad_samples, relative_error, blocks, decision, seconds })
    }
}

/// Checks that a number of seconds is finite. Seconds are summed, and a single NaN would make the sum useless.
pub(super) fn finite_seconds(seconds: f64) -> Result<f64, ConvertError> {
    let is_sound = seconds.is_finite() && seconds >= 0.0;
    is_sound.then_some(seconds).ok_or(ConvertError::Range { field: "seconds" })
}

impl From<FrameParts> for wire::FrameParts {
    fn from(FrameParts { frame, grid, outputs }: FrameParts) -> Self {
        let Grid { film: [film_width, film_height], tile } = grid;
        Self { frame, film_width, film_height, tile, outputs: outputs.into_iter().map(Into::into).collect() }
    }
}

impl TryFrom<wire::FrameParts> for FrameParts {
    type Error = ConvertError;

    fn try_from(wire: wire::FrameParts) -> Result<Self, ConvertError> {
        let grid = Grid { film: [wire.film_width, wire.film_height], tile: wire.tile };
        Ok(Self { frame: wire.frame, grid, outputs: convert_all(wire.outputs)? })
    }
}
