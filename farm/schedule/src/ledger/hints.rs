//! Hints: outputs of a frame that tasks of the next frame may read if they exist. They are kept beside the frame's own outputs
//! until the next frame is finished, too.

use std::collections::BTreeMap;

use femc_model::{Digest, Input, Output, Role, Stage, TaskResult, Work};
use serde::{Deserialize, Serialize};

use super::shape::Shape;

/// Outputs of a task in its last finished round, by key and role. A divided task has outputs for each of its runs.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct Left {
    round: u32,
    outputs: BTreeMap<(u32, Role), Output>,
}

/// Outputs of a frame's tasks, by stage and task.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct OfFrame {
    /// Build of the engine that made them; tasks of another build do not read them.
    engine: String,
    tasks: BTreeMap<(u16, u32), Left>,
}

/// Hints by frame, only of frames whose next frame is not finished.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Hints(BTreeMap<u32, OfFrame>);

impl Hints {
    /// Adds the outputs of a finished run of a task. Returns the artifacts that are no longer referenced.
    /// - `item`, `key`: the task, and the first key of the run.
    pub(super) fn note(
        &mut self,
        shape: &Shape<'_>,
        stage: &Stage,
        (item, key): (u32, u32),
        engine: &str,
        result: &TaskResult,
    ) -> Vec<Digest> {
        let mut replaced = Vec::new();
        for &output in result.outputs.iter().filter(|output| shape.graph.is_hint(stage.number, output.role)) {
            let new = || OfFrame { engine: engine.to_owned(), tasks: BTreeMap::new() };
            let left = self.0.entry(stage.frame).or_insert_with(new).tasks.entry((stage.number, item)).or_default();
            if stage.round < left.round {
                continue;
            }
            if stage.round > left.round {
                replaced.extend(left.outputs.values().map(|output| output.artifact.digest));
                *left = Left { round: stage.round, ..Left::default() };
            }
            let before = left.outputs.insert((key, output.role), output);
            replaced.extend(before.filter(|before| *before != output).map(|before| before.artifact.digest));
        }
        replaced
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Removes the hints of a frame. Returns the artifacts that are no longer referenced.
    pub(super) fn forget(&mut self, frame: u32) -> Vec<Digest> {
        self.0.remove(&frame).iter().flat_map(OfFrame::artifacts).collect()
    }

    /// Returns the hints from the previous frame for a task, for a worker of this build.
    /// - `number`, `item`: stage and number of the task that reads them.
    pub(super) fn of(&self, shape: &Shape<'_>, before: u32, (number, item): (u16, u32), engine: &str) -> Vec<Input> {
        let of_frame = self.0.get(&before).filter(|of_frame| of_frame.engine == engine);
        let (Some(of_frame), Some(template)) = (of_frame, shape.template(number)) else { return Vec::new() };
        let inputs = (0..).zip(&template.hints).flat_map(|(need, hint)| {
            let items = shape.reached(hint.stage, hint.reach, item);
            let tasks = of_frame.tasks.range((hint.stage, items.start)..(hint.stage, items.end));
            let outputs = tasks.flat_map(|(&(_, item), left)| left.outputs.iter().map(move |made| (item, made)));
            let of_role = outputs.filter(|(_, ((_, role), _))| *role == hint.role);
            of_role.map(move |(item, (_, &output))| Input { need, frame: before, item, output })
        });
        inputs.take(Work::MAX_HINTS).collect()
    }

    pub(super) fn artifacts(&self) -> impl Iterator<Item = Digest> + '_ {
        self.0.values().flat_map(OfFrame::artifacts)
    }
}

impl OfFrame {
    fn artifacts(&self) -> impl Iterator<Item = Digest> + '_ {
        self.tasks.values().flat_map(|left| left.outputs.values()).map(|output| output.artifact.digest)
    }
}
