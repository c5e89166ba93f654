//! Hints: outputs of a frame that tasks of the next frame may read if they exist. They are kept beside the frame's own outputs
//! until the next frame is finished, too.

use std::collections::BTreeMap;

use femc_model::{Digest, Input, Output, Role, Stage, TaskResult, TaskSpec};
use serde::{Deserialize, Serialize};

use super::graph_view::GraphView;

/// Outputs of a task in its last finished round, by key and role. A divided task has outputs for each of its runs.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct TaskOutputs {
    round: u32,
    outputs: BTreeMap<(u32, Role), Output>,
}

/// Outputs of a frame's tasks, by stage and task.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct FrameOutputs {
    /// Build of the engine that made them; tasks of another build do not read them.
    engine: String,
    tasks: BTreeMap<(u16, u32), TaskOutputs>,
}

/// Hints by frame, only of frames whose next frame is not finished.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Hints(BTreeMap<u32, FrameOutputs>);

impl Hints {
    /// Adds the outputs of a finished run of a task. Returns the artifacts that are no longer referenced.
    /// - `item`, `key`: the task, and the first key of the run.
    pub(super) fn insert(
        &mut self,
        view: &GraphView<'_>,
        stage: &Stage,
        (item, key): (u32, u32),
        engine: &str,
        result: &TaskResult,
    ) -> Vec<Digest> {
        let mut replaced = Vec::new();
        for &output in result.outputs.iter().filter(|output| view.graph.is_hint(stage.number, output.role)) {
            let new = || FrameOutputs { engine: engine.to_owned(), tasks: BTreeMap::new() };
            let outputs_of_task =
                self.0.entry(stage.frame).or_insert_with(new).tasks.entry((stage.number, item)).or_default();
            if stage.round < outputs_of_task.round {
                continue;
            }
            if stage.round > outputs_of_task.round {
                replaced.extend(outputs_of_task.outputs.values().map(|output| output.artifact.digest));
                *outputs_of_task = TaskOutputs { round: stage.round, ..TaskOutputs::default() };
            }
            let before = outputs_of_task.outputs.insert((key, output.role), output);
            replaced.extend(before.filter(|before| *before != output).map(|before| before.artifact.digest));
        }
        replaced
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Removes the hints of a frame. Returns the artifacts that are no longer referenced.
    pub(super) fn remove(&mut self, frame: u32) -> Vec<Digest> {
        self.0.remove(&frame).iter().flat_map(FrameOutputs::artifacts).collect()
    }

    /// Returns the hints from the previous frame for a task, for a worker of this build.
    /// - `number`, `item`: stage and number of the task that reads them.
    pub(super) fn inputs_for(
        &self,
        view: &GraphView<'_>,
        before: u32,
        (number, item): (u16, u32),
        engine: &str,
    ) -> Vec<Input> {
        let frame_outputs = self.0.get(&before).filter(|of_frame| of_frame.engine == engine);
        let (Some(of_frame), Some(template)) = (frame_outputs, view.template(number)) else { return Vec::new() };
        let inputs = (0..).zip(&template.hints).flat_map(|(need, hint)| {
            let items = view.tasks_reached(hint.stage, hint.reach, item);
            let tasks = of_frame.tasks.range((hint.stage, items.start)..(hint.stage, items.end));
            let outputs = tasks.flat_map(|(&(_, item), left)| left.outputs.iter().map(move |made| (item, made)));
            let of_role = outputs.filter(|(_, ((_, role), _))| *role == hint.role);
            of_role.map(move |(item, (_, &output))| Input { need, frame: before, item, output })
        });
        inputs.take(TaskSpec::MAX_HINTS).collect()
    }

    pub(super) fn artifacts(&self) -> impl Iterator<Item = Digest> + '_ {
        self.0.values().flat_map(FrameOutputs::artifacts)
    }
}

impl FrameOutputs {
    fn artifacts(&self) -> impl Iterator<Item = Digest> + '_ {
        self.tasks.values().flat_map(|left| left.outputs.values()).map(|output| output.artifact.digest)
    }
}
