//! The units of work and what a worker is told about one.

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::{Artifact, Epoch, JobId, Role, StageKind, Taken};

/// An array of tasks that may run side by side: one round of a template of the job's [`Graph`](crate::Graph), of one frame or of
/// the job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Stage {
    /// Frame number; of a stage of the job [`Stage::OF_JOB`].
    pub frame: u32,
    /// Round of its loop, from 0.
    pub round: u32,
    /// Number of the template.
    pub number: u16,
    /// What its tasks do: the template's kind.
    pub kind: StageKind,
}

impl Stage {
    /// The frame number of what is done once for the whole job: no frame has it.
    pub const OF_JOB: u32 = 0;
}

/// A task's identity; there is no other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct TaskKey {
    /// The job.
    pub job: JobId,
    /// The stage of the job.
    pub stage: Stage,
    /// Number within the stage: the first of the lease's [`Grains`](crate::Grains).
    pub index: u32,
}

/// The task's name: job, frame and round, kind and number of the stage, number in the stage, like `7/12.0/render.0/3`. No two tasks
/// have the same.
impl fmt::Display for TaskKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Stage { frame, round, number, kind } = self.stage;
        write!(f, "{}/{frame}.{round}/{}.{number}/{}", self.job, kind.name(), self.index)
    }
}

/// A text that is no name of a task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "a task is named by job, frame and round, kind and number of its stage, and its number there, like 7/12.0/render.0/3"
)]
pub struct NoTaskKey;

/// As it is printed.
impl FromStr for TaskKey {
    type Err = NoTaskKey;

    fn from_str(text: &str) -> Result<Self, NoTaskKey> {
        let parts: Vec<&str> = text.split('/').collect();
        let [job, unit, stage, index] = parts[..] else { return Err(NoTaskKey) };
        let two = |text: &'_ str| text.rsplit_once('.').map(|(a, b)| (a.to_owned(), b.to_owned())).ok_or(NoTaskKey);
        let ((frame, round), (kind, number)) = (two(unit)?, two(stage)?);
        Ok(Self {
            job: job.parse().map_err(|_| NoTaskKey)?,
            stage: Stage {
                frame: frame.parse().map_err(|_| NoTaskKey)?,
                round: round.parse().map_err(|_| NoTaskKey)?,
                number: number.parse().map_err(|_| NoTaskKey)?,
                kind: StageKind::named(&kind).ok_or(NoTaskKey)?,
            },
            index: index.parse().map_err(|_| NoTaskKey)?,
        })
    }
}

/// One lease of one task, as the worker gets it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Assignment {
    /// The task.
    pub task: TaskKey,
    /// The fence: every message about this lease carries it.
    pub epoch: Epoch,
    /// Milliseconds after which the lease ends, unless a heartbeat renews it.
    pub lease: u64,
    /// The lease of another worker that does the same, where this is its copy: the first that is done counts.
    pub copy_of: Option<Epoch>,
    /// Content of the task: item, steps and inputs.
    pub work: Work,
}

/// The content of a task; what it is a part of, the job's graph and settings say.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Work {
    /// Number of the task in its stage, before tasks are cut.
    pub item: u32,
    /// The steps of it that the lease covers: of a render task, sample indices of each pixel.
    pub steps: Range<u32>,
    /// What it reads, in order of need, frame and task.
    pub inputs: Vec<Input>,
    /// What it may look at of the frame before, as far as it is there, by the number of the stage's hint.
    pub hints: Vec<Input>,
    /// Steps that each task of the stage that is cut has taken in all, of those that its inputs are made of; empty where there
    /// are none, and of a task that is cut itself.
    pub taken: Taken,
    /// Whether another round may follow this one.
    pub more: More,
    /// Milliseconds since the first lease of the frame, or of the job's own stages: for a time budget; 0 where tasks are cut.
    pub elapsed: u64,
    /// Seconds that workers spent on it until now.
    pub busy_seconds: f64,
}

/// An output that a task reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Input {
    /// Which of the stage's needs it is for, or of its hints.
    pub need: u16,
    /// The frame that it is of, or [`Stage::OF_JOB`].
    pub frame: u32,
    /// The task that has made it, by its number before tasks are cut; one that was cut has several.
    pub item: u32,
    /// Role and artifact of the output.
    pub output: Output,
}

/// What a task has made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Output {
    /// Role of the output.
    pub role: Role,
    /// Artifact that holds the output.
    pub artifact: Artifact,
}

impl Work {
    /// Most that a task is given of the frame before.
    pub const MAX_HINTS: usize = 4_096;

    /// Every artifact that is read for it, beside the scene.
    pub fn artifacts(&self) -> impl Iterator<Item = Artifact> + '_ {
        self.inputs.iter().map(|input| input.output.artifact)
    }

    /// Every artifact that it may look at.
    pub fn hinted(&self) -> impl Iterator<Item = Artifact> + '_ {
        self.hints.iter().map(|hint| hint.output.artifact)
    }

    /// What is read of one role, in order.
    pub fn of_role(&self, role: Role) -> impl Iterator<Item = &Input> {
        self.inputs.iter().filter(move |input| input.output.role == role)
    }
}

/// Whether the plan has a round after this one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum More {
    /// Another round may follow.
    Rounds,
    /// This is the last: the loop ends with what there is.
    Last,
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
            assert_eq!(text.parse::<TaskKey>(), Err(NoTaskKey), "{text}");
        }
    }
}
