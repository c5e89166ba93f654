//! Structure of a job: templates of stages. Each template runs once per frame, once per shared content, or once per job.
//!
//! A stage is an array of tasks of one kind. Its needs state which outputs of which stages a task reads. A stage may close a
//! **loop**: its only task decides, with its result, whether the stages of the loop run for another round.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::{Role, StageKind, tag};

/// Stages of a job. A stage is identified by its index here. It may read only earlier stages, or any stage of its own loop in the
/// previous round.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Graph {
    /// Stages in an order in which they can run.
    pub stages: Vec<StageTemplate>,
}

/// Template of a stage, instantiated once for each unit of its scope.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StageTemplate {
    /// Kind of the stage's tasks.
    pub kind: StageKind,
    /// Unit that runs this stage once: a frame, a job, or a shared content.
    pub scope: Scope,
    /// Number of tasks, and units of work per step of each task.
    pub sizes: TaskSizes,
    /// Total steps that each task has taken at the end of each round, strictly ascending. Empty if the kind's tasks are not divided
    /// into chunks: then a task is one step in each round.
    pub steps: Vec<u32>,
    /// Outputs that the stage's tasks read.
    pub needs: Vec<Need>,
    /// Optional inputs. A task reads them if they are available. They save time and change no byte of the results.
    pub hints: Vec<Hint>,
    /// Roles of the stage's outputs, each role once.
    pub outputs: Vec<Role>,
    /// Loop that the stage closes.
    pub closes: Option<Loop>,
    /// Options of the tasks, beside their inputs and the job's settings, in a format that the kind defines. Empty: no options.
    pub options: String,
    /// Tags that a worker must have for these tasks, in addition to the tags of the job.
    pub tags: Vec<String>,
}

/// Loop: stages that run in rounds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Loop {
    /// First stage of the loop. The last stage is the one that closes the loop.
    pub first: u16,
    /// Maximum number of rounds.
    pub rounds: u32,
}

/// Unit that runs a stage once.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Scope {
    /// The job.
    Job,
    /// Every frame.
    Frame,
    /// A shared content, such as a world. The stage runs once for all frames, and all jobs, that name the same key.
    Content,
}

impl Scope {
    /// All scopes.
    pub const ALL: [Self; 3] = [Self::Job, Self::Frame, Self::Content];

    /// Returns whether a stage of this scope may read a stage of scope `other`.
    pub const fn may_read(self, other: Self) -> bool {
        matches!(
            (self, other),
            (Self::Job, Self::Job | Self::Frame)
                | (Self::Frame, Self::Frame | Self::Content)
                | (Self::Content, Self::Content)
        )
    }
}

/// Outputs of one role of a stage that the tasks of another stage read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Need {
    /// Stage that makes the outputs.
    pub stage: u16,
    /// Role of the outputs.
    pub role: Role,
    /// Tasks of that stage whose outputs are read.
    pub reach: Reach,
    /// Round of that stage whose outputs are read.
    pub round: Round,
    /// Whether frames that cannot be finished may be missing. Used by stages of the job that read a stage of frames.
    pub gaps: bool,
}

/// Optional input from the preceding frame, in the order of the job's frames: the available outputs of one role, from the last
/// round of a stage. Only stages of frames have hints. No task waits for a hint, and lost hints are not recomputed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hint {
    /// Stage that makes the outputs: any stage of frames, including the one with the hint.
    pub stage: u16,
    /// Role of the outputs.
    pub role: Role,
    /// Tasks of that stage whose outputs are read.
    pub reach: Reach,
}

/// Tasks of a stage that a task reads. Where a stage of the job reads a stage of frames, the tasks are numbered consecutively over
/// all frames, in frame order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Reach {
    /// All tasks.
    All,
    /// The task with the same number.
    Same,
    /// Task `i` reads tasks `i * n` to `(i + 1) * n` (exclusive).
    Fan(u32),
    /// Task `i` reads task `i - 1`, which may belong to its own stage (a chain). The first task reads none.
    Previous,
}

/// Round of a stage that a task reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Round {
    /// The task's own round, inside a loop. The last round, for a stage whose loop is over or a stage of another scope.
    Same,
    /// The previous round, inside a loop. The first round reads nothing.
    Previous,
    /// All rounds of a stage whose loop is over, or of a stage of another scope. No other reader there may read only the last round
    /// of the output.
    Every,
}

/// Tasks of a stage in order, with the units of work per step of each. Equal neighbors share an entry.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskSizes(Vec<(u32, u64)>);

impl TaskSizes {
    /// Makes `tasks` tasks of `units` units per step each.
    pub fn even(tasks: u32, units: u64) -> Self {
        std::iter::repeat_n(units, tasks.min(1) as usize).map(|units| (tasks, units)).collect()
    }

    /// Returns the number of tasks.
    pub fn tasks(&self) -> u32 {
        self.0.iter().fold(0, |sum, (tasks, _)| sum.saturating_add(*tasks))
    }

    /// Returns the units per step of a task; 0 past the last task.
    pub fn units(&self, task: u32) -> u64 {
        let mut left = task;
        for &(tasks, units) in &self.0 {
            if left < tasks {
                return units;
            }
            left -= tasks;
        }
        0
    }

    /// Returns the units per step, summed over all tasks.
    pub fn sum(&self) -> u64 {
        self.0.iter().fold(0, |sum, (tasks, units)| sum.saturating_add(u64::from(*tasks).saturating_mul(*units)))
    }

    /// Returns the greatest number of units per step of any task.
    pub fn max(&self) -> u64 {
        self.0.iter().map(|(_, units)| *units).max().unwrap_or(0)
    }

    /// Returns the entries: a number of tasks, and the units per step of each. Neighbors differ if [`TaskSizes::from_iter`] made
    /// them.
    pub fn runs(&self) -> &[(u32, u64)] {
        &self.0
    }
}

impl FromIterator<(u32, u64)> for TaskSizes {
    fn from_iter<I: IntoIterator<Item = (u32, u64)>>(runs: I) -> Self {
        let mut all: Vec<(u32, u64)> = Vec::new();
        for (tasks, units) in runs {
            match all.last_mut() {
                Some((before, same)) if *same == units => *before = before.saturating_add(tasks),
                _ => all.push((tasks, units)),
            }
        }
        Self(all)
    }
}

impl StageTemplate {
    /// Makes a stage without inputs.
    pub fn new(kind: StageKind, scope: Scope, sizes: TaskSizes, outputs: &[Role]) -> Self {
        Self {
            kind,
            scope,
            sizes,
            steps: Vec::new(),
            needs: Vec::new(),
            hints: Vec::new(),
            outputs: outputs.to_vec(),
            closes: None,
            options: String::new(),
            tags: Vec::new(),
        }
    }

    /// Sets the total steps of each task at the end of each round.
    pub fn with_steps(self, steps: &[u32]) -> Self {
        Self { steps: steps.to_vec(), ..self }
    }

    /// Adds a need with [`Round::Same`].
    pub fn with_input(self, stage: u16, role: Role, reach: Reach) -> Self {
        self.with_need(Need { stage, role, reach, round: Round::Same, gaps: false })
    }

    /// Adds a need.
    pub fn with_need(mut self, need: Need) -> Self {
        self.needs.push(need);
        self
    }

    /// Adds a hint.
    pub fn with_hint(mut self, stage: u16, role: Role, reach: Reach) -> Self {
        self.hints.push(Hint { stage, role, reach });
        self
    }

    /// Makes the stage close a loop.
    pub fn with_loop(self, first: u16, rounds: u32) -> Self {
        Self { closes: Some(Loop { first, rounds }), ..self }
    }

    /// Sets the options of the tasks.
    pub fn with_options(self, options: impl Into<String>) -> Self {
        Self { options: options.into(), ..self }
    }

    /// Sets the tags that a worker must have.
    pub fn with_tags(self, tags: &[&str]) -> Self {
        Self { tags: tags.iter().map(|tag| (*tag).to_owned()).collect(), ..self }
    }

    /// Returns the number of tasks in a round.
    pub fn tasks(&self) -> u32 {
        self.sizes.tasks()
    }

    /// Returns the steps that each task takes in a round where tasks do not differ. The range is empty past the last round. A stage
    /// that is not divided into chunks has one step.
    pub fn steps_of(&self, round: u32) -> Range<u32> {
        if !self.kind.is_divided() {
            return 0..1;
        }
        let round = round as usize;
        let start = round.checked_sub(1).and_then(|before| self.steps.get(before)).copied().unwrap_or(0);
        start..self.steps.get(round).copied().unwrap_or(start)
    }
}

impl Graph {
    /// Maximum number of stages.
    pub const MAX_STAGES: usize = 64;
    /// Maximum number of tasks of a stage.
    pub const MAX_TASKS: u32 = 1 << 16;
    /// Maximum number of rounds of a loop.
    pub const MAX_ROUNDS: u32 = 64;
    /// Maximum number of outputs that a task may read, counting each chunk: 2^20, about 60 bytes each in its assignment.
    pub const MAX_INPUTS: u64 = 1 << 20;
    /// Maximum number of needs of a stage.
    pub const MAX_NEEDS: usize = 16;
    /// Maximum number of entries in a stage's sizes.
    pub const MAX_RUNS: usize = 1 << 17;
    /// Maximum length of a stage's options in bytes.
    pub const MAX_OPTIONS: usize = 1 << 12;

    /// Returns the stage with this number.
    pub fn stage(&self, stage: u16) -> Option<&StageTemplate> {
        self.stages.get(usize::from(stage))
    }

    /// Returns the first stage of a kind, with its number.
    pub fn stage_of_kind(&self, kind: StageKind) -> Option<(u16, &StageTemplate)> {
        self.iter().find(|(_, template)| template.kind == kind)
    }

    /// Adds the tags of all kinds and roles of the graph, and the tags of versions that a stage already requires, to each stage. A
    /// worker that cannot read one stage of a graph can execute none of its tasks.
    pub fn add_known_tags(&mut self) {
        let kinds = StageKind::ALL.into_iter().filter(|kind| self.stage_of_kind(*kind).is_some());
        let is_made = |role: &Role| self.stages.iter().any(|template| template.outputs.contains(role));
        let roles = Role::ALL.into_iter().filter(is_made);
        let known = kinds.flat_map(|kind| kind.properties().tags).chain(roles.flat_map(|role| role.properties().tags));
        let is_required = |tag: &&str| self.stages.iter().any(|template| template.tags.iter().any(|own| own == tag));
        let known: Vec<&str> = known.copied().chain(tag::ALL.into_iter().filter(is_required)).collect();
        for template in &mut self.stages {
            for tag in &known {
                if !template.tags.iter().any(|own| own == tag) {
                    template.tags.push((*tag).to_owned());
                }
            }
        }
    }

    /// Returns the stages with their numbers.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = (u16, &StageTemplate)> {
        self.stages.iter().enumerate().map(|(stage, template)| (stage as u16, template))
    }

    /// Returns the stages of a scope with their numbers.
    pub fn stages_of(&self, scope: Scope) -> impl DoubleEndedIterator<Item = (u16, &StageTemplate)> {
        self.iter().filter(move |(_, template)| template.scope == scope)
    }

    /// Returns whether the graph has a stage that runs once for the whole job.
    pub fn has_job_stages(&self) -> bool {
        self.stages_of(Scope::Job).next().is_some()
    }

    /// Returns whether the graph has a stage that runs once per shared content.
    pub fn has_content_stages(&self) -> bool {
        self.stages_of(Scope::Content).next().is_some()
    }

    /// Returns whether this is a stage of frames that reads a stage of a shared content.
    pub fn reads_content(&self, stage: u16) -> bool {
        let needs = self.stage(stage).filter(|template| template.scope == Scope::Frame).map(|template| &template.needs);
        let is_content = |need: &Need| self.stage(need.stage).is_some_and(|made| made.scope == Scope::Content);
        needs.is_some_and(|needs| needs.iter().any(is_content))
    }

    /// Returns whether some stage of the job accepts missing frames.
    pub fn has_gaps(&self) -> bool {
        self.stages_of(Scope::Job).any(|(_, template)| template.needs.iter().any(|need| need.gaps))
    }

    /// Returns the loop of a scope and the stage that closes it.
    pub fn loop_of(&self, scope: Scope) -> Option<(u16, Loop)> {
        self.stages_of(scope).find_map(|(stage, template)| Some((stage, template.closes?)))
    }

    /// Returns whether a stage is in the loop of its scope.
    pub fn is_looped(&self, stage: u16) -> bool {
        let scope = self.stage(stage).map(|template| template.scope);
        let scope_loop = scope.and_then(|scope| self.loop_of(scope));
        scope_loop.is_some_and(|(last, Loop { first, .. })| (first..=last).contains(&stage))
    }

    /// Returns whether a stage closes a loop.
    pub fn closes_loop(&self, stage: u16) -> bool {
        self.stage(stage).is_some_and(|template| template.closes.is_some())
    }

    /// Returns the maximum number of rounds in which a stage runs.
    pub fn rounds(&self, stage: u16) -> u32 {
        let scope = self.stage(stage).map(|template| template.scope);
        let scope_loop = scope.and_then(|scope| self.loop_of(scope)).filter(|_| self.is_looped(stage));
        scope_loop.map_or(1, |(_, Loop { rounds, .. })| rounds)
    }

    /// Returns the readers of a stage's outputs: the number and the need of each reading stage.
    pub fn readers(&self, stage: u16) -> impl Iterator<Item = (u16, &Need)> {
        let needs = self.iter().flat_map(|(reader, template)| template.needs.iter().map(move |need| (reader, need)));
        needs.filter(move |(_, need)| need.stage == stage)
    }

    /// Returns whether some stage has a hint.
    pub fn has_hints(&self) -> bool {
        self.stages.iter().any(|template| !template.hints.is_empty())
    }

    /// Returns whether the next frame may use this output of a stage as a hint.
    pub fn is_hint(&self, stage: u16, role: Role) -> bool {
        let mut hints = self.stages.iter().flat_map(|template| &template.hints);
        hints.any(|hint| (hint.stage, hint.role) == (stage, role))
    }

    /// Returns the first stage of frames whose tasks are divided into chunks. The progress of a frame is shown in its units.
    pub fn main_stage(&self) -> Option<(u16, &StageTemplate)> {
        self.stages_of(Scope::Frame).find(|(_, template)| template.kind.is_divided())
    }

    /// Returns the number of tasks of one frame, or of the job, if every round runs.
    pub fn tasks(&self, scope: Scope) -> u64 {
        self.stages_of(scope).map(|(stage, template)| u64::from(template.tasks()) * u64::from(self.rounds(stage))).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_join_equal_neighbors_and_find_each_task() {
        let sizes: TaskSizes = [(3, 64), (1, 32), (3, 64), (1, 32), (1, 32)].into_iter().collect();
        assert_eq!(sizes.runs().len(), 4);
        assert_eq!((0..10).map(|task| sizes.units(task)).collect::<Vec<_>>(), [64, 64, 64, 32, 64, 64, 64, 32, 32, 0]);
        assert_eq!((sizes.tasks(), sizes.sum(), sizes.max()), (9, 6 * 64 + 3 * 32, 64));
        assert_eq!(TaskSizes::even(0, 4).tasks(), 0);
    }
}
