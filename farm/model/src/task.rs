//! Units of work, and assignments of them to workers.

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize};

use crate::{Artifact, Epoch, JobId, Role, StageKind, StepsTaken};

/// Array of tasks that may run in parallel: one round of a template of the job's [`Graph`](crate::Graph), for one frame or for the
/// job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Stage {
    /// Frame number, or [`Stage::JOB_FRAME`] for a stage of the job.
    pub frame: u32,
    /// Round of its loop, from 0.
    pub round: u32,
    /// Number of the template in the graph.
    pub number: u16,
    /// Kind of the template.
    pub kind: StageKind,
}

impl Stage {
    /// Frame number of stages that run once for the whole job. No frame has this number.
    pub const JOB_FRAME: u32 = 0;
}

/// Identity of a task. There is no other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct TaskKey {
    /// The job.
    pub job: JobId,
    /// The stage of the job.
    pub stage: Stage,
    /// Number in the stage: the first of the lease's [`Chunks`](crate::Chunks).
    pub index: u32,
}

/// Writes the task's name: job, frame and round, kind and number of the stage, number in the stage, like `7/12.0/render.0/3`. No
/// two tasks have the same name.
impl fmt::Display for TaskKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Stage { frame, round, number, kind } = self.stage;
        write!(f, "{}/{frame}.{round}/{}.{number}/{}", self.job, kind.name(), self.index)
    }
}

/// Error for a text that is not the name of a task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected the name of a task: job/frame.round/stage.number/task, such as 7/12.0/render.0/3")]
pub struct ParseTaskKeyError;

/// Parses the printed form.
impl FromStr for TaskKey {
    type Err = ParseTaskKeyError;

    fn from_str(text: &str) -> Result<Self, ParseTaskKeyError> {
        let parts: Vec<&str> = text.split('/').collect();
        let [job, frame_round, stage, index] = parts[..] else { return Err(ParseTaskKeyError) };
        let two =
            |text: &'_ str| text.rsplit_once('.').map(|(a, b)| (a.to_owned(), b.to_owned())).ok_or(ParseTaskKeyError);
        let ((frame, round), (kind, number)) = (two(frame_round)?, two(stage)?);
        Ok(Self {
            job: job.parse().map_err(|_| ParseTaskKeyError)?,
            stage: Stage {
                frame: frame.parse().map_err(|_| ParseTaskKeyError)?,
                round: round.parse().map_err(|_| ParseTaskKeyError)?,
                number: number.parse().map_err(|_| ParseTaskKeyError)?,
                kind: StageKind::from_name(&kind).ok_or(ParseTaskKeyError)?,
            },
            index: index.parse().map_err(|_| ParseTaskKeyError)?,
        })
    }
}

/// One lease of one task, as sent to the worker.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Assignment {
    /// The task.
    pub task: TaskKey,
    /// Fencing token. Every message about this lease carries it.
    pub epoch: Epoch,
    /// Milliseconds after which the lease expires, unless a heartbeat renews it.
    pub lease: u64,
    /// Lease of another worker for the same task, if this lease is a copy of it. The first result counts.
    pub copy_of: Option<Epoch>,
    /// Content of the task: item, steps and inputs.
    pub spec: TaskSpec,
}

/// Content of a task. The job's graph and settings give the context.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TaskSpec {
    /// Number of the task in its stage, not counting chunks.
    pub item: u32,
    /// Steps of the task that the lease covers. For a render task: sample indices of each pixel.
    pub steps: Range<u32>,
    /// Inputs, in order of need, frame and task.
    pub inputs: Vec<Input>,
    /// Available hints from the preceding frame. [`Input::need`] is the number of the hint in the stage.
    pub hints: Vec<Input>,
    /// Total steps of each task of the divided stage from which the inputs are made. Empty if there is no such stage, and for a
    /// task that is itself divided into chunks.
    pub steps_taken: StepsTaken,
    /// Whether another round may follow this one.
    pub next_round: NextRound,
    /// Milliseconds since the first lease of the frame, or of the job's own stages. Used for a time budget. 0 if the task is
    /// divided into chunks.
    pub elapsed: u64,
    /// Seconds that workers have spent on the frame so far.
    pub busy_seconds: f64,
}

/// An output that a task reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Input {
    /// Number of the need of the stage, or of the hint.
    pub need: u16,
    /// Frame of the output, or [`Stage::JOB_FRAME`].
    pub frame: u32,
    /// Number of the task that made the output, not counting chunks. A task that was divided has several outputs.
    pub item: u32,
    /// Role and artifact of the output.
    pub output: Output,
}

/// Output of a task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Output {
    /// Role of the output. A role of an earlier version is replaced when it is read.
    #[serde(deserialize_with = "updated_role")]
    pub role: Role,
    /// Artifact that holds the output.
    pub artifact: Artifact,
}

fn updated_role<'de, D: Deserializer<'de>>(from: D) -> Result<Role, D::Error> {
    Role::deserialize(from).map(Role::updated)
}

impl TaskSpec {
    /// Maximum number of hints of a task.
    pub const MAX_HINTS: usize = 4_096;

    /// Returns every artifact that the task must read, besides the scene.
    pub fn artifacts(&self) -> impl Iterator<Item = Artifact> + '_ {
        self.inputs.iter().map(|input| input.output.artifact)
    }

    /// Returns every artifact that the task may read as a hint.
    pub fn hint_artifacts(&self) -> impl Iterator<Item = Artifact> + '_ {
        self.hints.iter().map(|hint| hint.output.artifact)
    }

    /// Returns the inputs of one role, in order.
    pub fn inputs_of_role(&self, role: Role) -> impl Iterator<Item = &Input> {
        self.inputs.iter().filter(move |input| input.output.role == role)
    }
}

/// Whether the plan has a round after this one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum NextRound {
    /// Another round may follow.
    Possible,
    /// This is the last round. The loop ends with the results so far.
    Impossible,
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn no_two_tasks_have_the_same_name() {
        let mut names = BTreeSet::new();
        let mut tasks = 0;
        for job in [JobId(1), JobId(11), JobId::shared(1)] {
            for (frame, round, index) in [(0, 0, 0), (0, 0, 11), (1, 0, 0), (1, 1, 1), (11, 0, 1), (0, 11, 1)] {
                for (number, kind) in [(0, StageKind::Reduce), (1, StageKind::Reduce), (11, StageKind::Image)] {
                    let task = TaskKey { job, stage: Stage { frame, round, number, kind }, index };
                    assert_eq!(task.to_string().parse(), Ok(task));
                    names.insert(task.to_string());
                    tasks += 1;
                }
            }
        }
        assert_eq!(names.len(), tasks, "{names:?}");
        assert!(names.contains("shared-1/1.1/reduce.1/1"), "{names:?}");
        for text in
            ["", "7", "7/1/render/0", "7/1.0/render.0", "7/1.0/nothing.0/0", "7/1.0/render.0/-1", "x/1.0/render.0/0"]
        {
            assert_eq!(text.parse::<TaskKey>(), Err(ParseTaskKeyError), "{text}");
        }
    }
}
