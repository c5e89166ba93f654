//! Structure of a job: templates of stages. Each template runs once per frame, once per shared content, or once per job.
//!
//! A stage is an array of tasks of one kind. Its needs state which outputs of which stages a task reads. A stage may close a
//! **loop**: its only task decides, with its result, whether the stages of the loop run for another round.

use serde::{Deserialize, Serialize};

use crate::{Chunks, JobSpec, Role, StageKind};

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

    /// Returns the maximum number of outputs that one task reads in a job of `frames` frames, if every task that can be divided has
    /// the maximum number of chunks.
    pub fn max_inputs(&self, frames: u64) -> u64 {
        let of_need = |template: &StageTemplate, need: &Need| {
            let Some(made) = self.stage(need.stage) else { return 0 };
            let of_frames = (template.scope, made.scope) == (Scope::Job, Scope::Frame);
            let tasks = u64::from(made.tasks()).saturating_mul(if of_frames { frames } else { 1 });
            let read = match need.reach {
                Reach::All => tasks,
                Reach::Same | Reach::Previous => 1,
                Reach::Fan(n) => tasks.min(u64::from(n)),
            };
            let rounds = if need.round == Round::Every { self.rounds(need.stage) } else { 1 };
            let parts = if made.kind.is_divided() { Chunks::MAX_PER_TASK } else { 1 };
            read.saturating_mul(u64::from(rounds) * u64::from(parts))
        };
        let of_task = |template: &StageTemplate| {
            template.needs.iter().fold(0, |sum: u64, need| sum.saturating_add(of_need(template, need)))
        };
        self.stages.iter().map(of_task).max().unwrap_or(0)
    }

    /// Encodes the graph. Equal graphs give equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        // Encoding numbers and lists to memory cannot fail.
        postcard::to_stdvec(self).unwrap_or_default()
    }

    /// Checks that a scheduler can run the graph.
    pub fn check(&self) -> Result<(), GraphError> {
        if self.stages.len() > Self::MAX_STAGES {
            return Err(GraphError::TooMany { what: "stages", limit: Self::MAX_STAGES as u64 });
        }
        if self.stages_of(Scope::Frame).next().is_none() {
            return Err(GraphError::Empty);
        }
        for (stage, template) in self.iter() {
            self.check_stage(stage, template)?;
        }
        self.check_last_or_every()?;
        for scope in Scope::ALL {
            if self.stages_of(scope).filter(|(_, template)| template.closes.is_some()).count() > 1 {
                return Err(GraphError::Loop { stage: 0, why: "a scope can have only one loop" });
            }
        }
        Ok(())
    }

    fn check_stage(&self, stage: u16, template: &StageTemplate) -> Result<(), GraphError> {
        let StageTemplate { kind, sizes, steps, needs, hints, outputs: makes, options, tags, .. } = template;
        let limits = [
            ("tasks in a stage", u64::from(sizes.tasks()), u64::from(Self::MAX_TASKS)),
            ("needs in a stage", needs.len() as u64, Self::MAX_NEEDS as u64),
            ("hints in a stage", hints.len() as u64, Self::MAX_NEEDS as u64),
            ("different sizes in a stage", sizes.runs().len() as u64, Self::MAX_RUNS as u64),
            ("rounds", steps.len() as u64, u64::from(Self::MAX_ROUNDS)),
            ("bytes in the options of a stage", options.len() as u64, Self::MAX_OPTIONS as u64),
            ("tags in a stage", tags.len() as u64, JobSpec::MAX_TAGS as u64),
            (
                "bytes in a tag of a stage",
                tags.iter().map(String::len).max().unwrap_or(0) as u64,
                JobSpec::MAX_NAME as u64,
            ),
        ];
        if let Some(&(what, _, limit)) = limits.iter().find(|(_, found, limit)| found > limit) {
            return Err(GraphError::TooMany { what, limit });
        }
        if sizes.tasks() == 0 || sizes.runs().iter().any(|&(tasks, units)| tasks == 0 || units > u64::from(u32::MAX)) {
            return Err(GraphError::Tasks { stage });
        }
        let ascends = steps.first().is_some_and(|&first| first > 0) && steps.windows(2).all(|pair| pair[0] < pair[1]);
        if kind.is_divided() == steps.is_empty() || (kind.is_divided() && !ascends) {
            return Err(GraphError::Steps { stage });
        }
        if (1..makes.len()).any(|place| makes[..place].contains(&makes[place])) {
            return Err(GraphError::DuplicateRole { stage });
        }
        if tags.iter().chain([options]).any(|text| text.contains(char::is_control)) {
            return Err(GraphError::ControlCharacters { stage });
        }
        self.check_loop(stage, template)?;
        if kind.is_divided() && steps.len() != self.rounds(stage) as usize {
            return Err(GraphError::Steps { stage });
        }
        hints.iter().try_for_each(|hint| self.check_hint(stage, template, hint))?;
        needs.iter().try_for_each(|need| self.check_need(stage, template, need))
    }

    fn check_hint(&self, stage: u16, template: &StageTemplate, hint: &Hint) -> Result<(), GraphError> {
        let fault = |why| Err(GraphError::Hint { stage, why });
        let Some(made) = self.stage(hint.stage) else { return fault("the job does not have the stage that it reads") };
        if (template.scope, made.scope) != (Scope::Frame, Scope::Frame) {
            return fault("only stages of frames can have hints, and they read stages of frames");
        }
        if !made.outputs.contains(&hint.role) {
            return fault("the stage that it reads does not make this output");
        }
        match hint.reach {
            Reach::Fan(0) => fault("a fan must be at least 1"),
            Reach::Previous => fault("a hint cannot be a chain"),
            Reach::Same if made.tasks() != template.tasks() => fault("one-to-one reading needs equal numbers of tasks"),
            Reach::Fan(n) if made.tasks().div_ceil(n) != template.tasks() => {
                fault("the number of tasks does not match the fan")
            }
            Reach::All | Reach::Same | Reach::Fan(_) => Ok(()),
        }
    }

    fn check_loop(&self, stage: u16, template: &StageTemplate) -> Result<(), GraphError> {
        let Some(Loop { first, rounds }) = template.closes else { return Ok(()) };
        let fault = |why| Err(GraphError::Loop { stage, why });
        if rounds == 0 || rounds > Self::MAX_ROUNDS {
            return fault("a loop must have 1 to 64 rounds");
        }
        if first > stage || template.tasks() != 1 || template.kind.is_divided() {
            return fault("the stage that closes a loop must be its last stage and have one task without chunks");
        }
        if self.iter().any(|(other, inner)| (first..=stage).contains(&other) && inner.scope != template.scope) {
            return fault("all stages of a loop must have the same scope");
        }
        Ok(())
    }

    /// Checks that all readers from another scope read an output of a loop in the same way: either the last round or every round.
    fn check_last_or_every(&self) -> Result<(), GraphError> {
        let beyond = |made: u16, &(reader, _): &(u16, &Need)| {
            let scope = |number| self.stage(number).map(|template| template.scope);
            self.is_looped(made) && scope(reader) != scope(made)
        };
        for (made, _) in self.iter() {
            for (stage, need) in self.readers(made).filter(|reader| beyond(made, reader)) {
                let mut others = self.readers(made).filter(|reader| beyond(made, reader));
                if others.any(|(_, other)| other.role == need.role && other.round != need.round) {
                    let why =
                        "readers in another scope must all read the last round of a loop's output, or all every round";
                    return Err(GraphError::Need { stage, why });
                }
            }
        }
        Ok(())
    }

    fn check_need(&self, stage: u16, template: &StageTemplate, need: &Need) -> Result<(), GraphError> {
        let fault = |why| Err(GraphError::Need { stage, why });
        let Some(made) = self.stage(need.stage) else { return fault("it needs a stage that does not exist") };
        let same_loop = template.scope == made.scope && self.is_looped(stage) && self.is_looped(need.stage);
        let is_before = need.round == Round::Previous;
        if !made.outputs.contains(&need.role) {
            return fault("it needs an output that the stage does not make");
        }
        let is_chain = need.reach == Reach::Previous && need.stage == stage;
        if (need.stage >= stage && !is_before && !is_chain) || (is_before && !same_loop) {
            return fault("it needs a later stage");
        }
        if !template.scope.may_read(made.scope) {
            return fault("it needs a stage of a scope that its own scope cannot read");
        }
        if need.round == Round::Every && same_loop {
            return fault("it needs future rounds of its own loop");
        }
        let of_frames = (template.scope, made.scope) == (Scope::Job, Scope::Frame);
        let tasks = if of_frames { None } else { Some(made.tasks()) };
        match (need.reach, tasks) {
            (Reach::Fan(0), _) => fault("a fan must be at least 1"),
            (Reach::Same | Reach::Previous, Some(tasks)) if tasks != template.tasks() => {
                fault("one-to-one reading needs equal numbers of tasks")
            }
            (Reach::Previous, _)
                if need.round == Round::Previous || template.kind.is_divided() || self.is_looped(stage) =>
            {
                fault("a chain cannot be in a loop, and its tasks cannot have chunks")
            }
            (Reach::Previous, None) => fault("a chain cannot read several frames"),
            (Reach::Fan(n), Some(tasks)) if tasks.div_ceil(n) != template.tasks() => {
                fault("the number of tasks does not match the fan")
            }
            (Reach::Same, None) => fault("one-to-one reading cannot read several frames"),
            _ => Ok(()),
        }
    }

    /// Checks that stages of the job that read stages of frames with [`Reach::Fan`] have the right number of tasks for `frames`
    /// frames.
    pub fn check_frames(&self, frames: u64) -> Result<(), GraphError> {
        for (stage, template) in self.stages_of(Scope::Job) {
            for need in &template.needs {
                let made = self.stage(need.stage).filter(|made| made.scope == Scope::Frame);
                let (Some(made), Reach::Fan(fan)) = (made, need.reach) else { continue };
                let read = u64::from(made.tasks()) * frames;
                let (found, wanted) = (template.tasks(), read.div_ceil(u64::from(fan.max(1))));
                if u64::from(found) != wanted {
                    return Err(GraphError::Fan { stage, found, wanted, read, fan });
                }
            }
        }
        Ok(())
    }
}

/// Reason why a graph cannot run.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum GraphError {
    /// A quantity exceeds its limit.
    #[error("too many {what}: at most {limit}")]
    TooMany {
        /// Quantity that exceeds its limit.
        what: &'static str,
        /// Maximum permitted value.
        limit: u64,
    },
    /// The graph has no stage of frames.
    #[error("the job has no stages for its frames")]
    Empty,
    /// The stage has no tasks, has an empty entry in its sizes, or has more than `u32::MAX` units per step.
    #[error("stage {stage} has no tasks")]
    Tasks {
        /// Number of the stage in the graph.
        stage: u16,
    },
    /// The steps are missing where tasks are divided into chunks (or given where they are not), not ascending, or not one per
    /// round.
    #[error("the steps of stage {stage} must be ascending numbers from 1, one for each round")]
    Steps {
        /// Number of the stage in the graph.
        stage: u16,
    },
    /// A role occurs twice.
    #[error("stage {stage} makes two outputs with the same role")]
    DuplicateRole {
        /// Number of the stage in the graph.
        stage: u16,
    },
    /// A text contains control characters. Texts are shown on terminals and must not control them.
    #[error("the options or tags of stage {stage} contain control characters")]
    ControlCharacters {
        /// Number of the stage in the graph.
        stage: u16,
    },
    /// The loop is invalid.
    #[error("stage {stage}: {why}")]
    Loop {
        /// Number of the stage in the graph.
        stage: u16,
        /// Rule that the stage breaks.
        why: &'static str,
    },
    /// The hint can never be available.
    #[error("stage {stage} has an invalid hint about the previous frame: {why}")]
    Hint {
        /// Number of the stage in the graph.
        stage: u16,
        /// Rule that the stage breaks.
        why: &'static str,
    },
    /// The number of tasks of a stage of the job does not match the tasks of frames that it reads.
    #[error("stage {stage} has {found} tasks, but needs {wanted} to read {read} tasks of frames, {fan} per task")]
    Fan {
        /// Number of the stage in the graph.
        stage: u16,
        /// Number of tasks of the stage.
        found: u32,
        /// Number of tasks that the stage should have.
        wanted: u64,
        /// Number of tasks in all frames that the stage reads.
        read: u64,
        /// Number of tasks of frames that each of its tasks reads.
        fan: u32,
    },
    /// The need cannot be satisfied.
    #[error("stage {stage}: {why}")]
    Need {
        /// Number of the stage in the graph.
        stage: u16,
        /// Rule that the stage breaks.
        why: &'static str,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames() -> Graph {
        let render = StageTemplate::new(StageKind::Render, Scope::Frame, TaskSizes::even(10, 64), &[Role::Tile])
            .with_steps(&[4, 8]);
        let reduce =
            StageTemplate::new(StageKind::Reduce, Scope::Frame, TaskSizes::even(3, 1), &[Role::Pixels, Role::Sums])
                .with_input(0, Role::Tile, Reach::Fan(4))
                .with_need(Need {
                    stage: 1,
                    role: Role::Sums,
                    reach: Reach::Same,
                    round: Round::Previous,
                    gaps: false,
                });
        let image =
            StageTemplate::new(StageKind::Image, Scope::Frame, TaskSizes::even(1, 1), &[Role::Image, Role::Preview])
                .with_input(1, Role::Pixels, Reach::All)
                .with_loop(0, 2);
        Graph { stages: vec![render, reduce, image] }
    }

    fn with(change: impl FnOnce(&mut Vec<StageTemplate>)) -> Result<(), GraphError> {
        let mut graph = frames();
        change(&mut graph.stages);
        graph.check()
    }

    #[test]
    fn a_graph_of_frames_is_sound_and_says_what_it_is() {
        let graph = frames();
        assert_eq!(graph.check(), Ok(()));
        assert_eq!((graph.tasks(Scope::Frame), graph.tasks(Scope::Job), graph.has_job_stages()), (28, 0, false));
        assert_eq!(graph.readers(1).map(|(reader, _)| reader).collect::<Vec<_>>(), [1, 2]);
        assert!((0..3).all(|stage| graph.is_looped(stage) && graph.rounds(stage) == 2));
    }

    #[test]
    fn impossible_graphs_are_refused() {
        let need = |why| Err(GraphError::Need { stage: 1, why });
        assert_eq!(Graph::default().check(), Err(GraphError::Empty));
        assert_eq!(with(|all| all[0].sizes = TaskSizes::default()), Err(GraphError::Tasks { stage: 0 }));
        assert_eq!(with(|all| all[0].steps = vec![4, 4]), Err(GraphError::Steps { stage: 0 }));
        assert_eq!(with(|all| all[0].steps = vec![4]), Err(GraphError::Steps { stage: 0 }));
        assert_eq!(with(|all| all[1].steps = vec![4, 8]), Err(GraphError::Steps { stage: 1 }));
        assert_eq!(with(|all| all[1].needs[0].stage = 9), need("it needs a stage that does not exist"));
        assert_eq!(
            with(|all| all[1].needs[0].role = Role::Image),
            need("it needs an output that the stage does not make")
        );
        assert_eq!(with(|all| all[1].needs[1].round = Round::Same), need("it needs a later stage"));
        assert_eq!(with(|all| all[1].needs[0].reach = Reach::Fan(0)), need("a fan must be at least 1"));
        assert_eq!(
            with(|all| all[1].needs[0].reach = Reach::Fan(2)),
            need("the number of tasks does not match the fan")
        );
        assert_eq!(
            with(|all| all[1].needs[0].reach = Reach::Same),
            need("one-to-one reading needs equal numbers of tasks")
        );
        assert_eq!(with(|all| all[1].outputs.push(Role::Sums)), Err(GraphError::DuplicateRole { stage: 1 }));
        let look = |stage, role, reach| with(|all| all[1].hints = vec![Hint { stage, role, reach }]);
        let hint = |why| Err(GraphError::Hint { stage: 1, why });
        assert_eq!(look(2, Role::Image, Reach::All), Ok(()), "what comes later is there in the frame before");
        assert_eq!(look(1, Role::Sums, Reach::Same), Ok(()));
        assert_eq!(look(3, Role::Image, Reach::All), hint("the job does not have the stage that it reads"));
        assert_eq!(look(0, Role::Image, Reach::All), hint("the stage that it reads does not make this output"));
        assert_eq!(look(0, Role::Tile, Reach::Same), hint("one-to-one reading needs equal numbers of tasks"));
        assert_eq!(look(0, Role::Tile, Reach::Fan(3)), hint("the number of tasks does not match the fan"));
        assert_eq!(look(0, Role::Tile, Reach::Fan(0)), hint("a fan must be at least 1"));
        let of_job = |all: &mut Vec<StageTemplate>| {
            let own = StageTemplate::new(StageKind::Image, Scope::Job, TaskSizes::even(1, 1), &[]);
            all.push(own.with_hint(2, Role::Image, Reach::All));
        };
        assert!(matches!(with(of_job), Err(GraphError::Hint { stage: 3, .. })));
        let long = |all: &mut Vec<StageTemplate>| all[1].options = "x".repeat(Graph::MAX_OPTIONS + 1);
        assert!(matches!(with(long), Err(GraphError::TooMany { what: "bytes in the options of a stage", .. })));
        let many = |all: &mut Vec<StageTemplate>| all[1].tags = vec!["lab".into(); 65];
        assert!(matches!(with(many), Err(GraphError::TooMany { what: "tags in a stage", limit: 64 })));
        let long = |all: &mut Vec<StageTemplate>| all[1].tags = vec!["x".repeat(JobSpec::MAX_NAME + 1)];
        assert!(matches!(with(long), Err(GraphError::TooMany { what: "bytes in a tag of a stage", .. })));
        assert_eq!(with(|all| all[1].tags = vec!["a\u{1b}".into()]), Err(GraphError::ControlCharacters { stage: 1 }));
        assert_eq!(with(|all| all[1].options = "a\n".into()), Err(GraphError::ControlCharacters { stage: 1 }));
        assert!(matches!(with(|all| all[2].sizes = TaskSizes::even(2, 1)), Err(GraphError::Loop { stage: 2, .. })));
        assert!(with(|all| all[2].closes = Some(Loop { first: 0, rounds: 65 })).is_err());
        assert!(matches!(with(|all| all[0].sizes = TaskSizes::even(1 << 17, 1)), Err(GraphError::TooMany { .. })));
    }

    #[test]
    fn stage_in_a_loop_reads_earlier_outputs_within_its_reach() {
        let read = |reach| {
            with(|all| {
                let before =
                    StageTemplate::new(StageKind::Reduce, Scope::Frame, TaskSizes::even(6, 1), &[Role::Numbers]);
                all.insert(0, before);
                all.iter_mut().skip(1).flat_map(|it| &mut it.needs).for_each(|need| need.stage += 1);
                all[2].needs.push(Need { stage: 0, role: Role::Numbers, reach, round: Round::Same, gaps: false });
                all[3].closes = Some(Loop { first: 1, rounds: 2 });
            })
        };
        let need = |why| Err(GraphError::Need { stage: 2, why });
        assert_eq!((read(Reach::Fan(2)), read(Reach::All)), (Ok(()), Ok(())));
        assert_eq!(read(Reach::Fan(0)), need("a fan must be at least 1"));
        assert_eq!(read(Reach::Fan(6)), need("the number of tasks does not match the fan"));
        assert_eq!(read(Reach::Same), need("one-to-one reading needs equal numbers of tasks"));
    }

    #[test]
    fn other_scopes_read_the_last_round_of_an_output_or_every_round() {
        let read = |rounds: [Round; 2], roles: [Role; 2]| {
            let needs = rounds.into_iter().zip(roles);
            let needs = needs.map(|(round, role)| Need { stage: 1, role, reach: Reach::All, round, gaps: false });
            let own = StageTemplate::new(StageKind::Reduce, Scope::Job, TaskSizes::even(1, 1), &[Levels]);
            with(|all| all.push(StageTemplate { needs: needs.collect(), ..own }))
        };
        use {Role::*, Round::*};
        assert_eq!((read([Same, Same], [Sums; 2]), read([Every, Every], [Sums; 2])), (Ok(()), Ok(())));
        assert_eq!(read([Same, Every], [Sums, Pixels]), Ok(()));
        assert!(matches!(read([Same, Every], [Sums; 2]), Err(GraphError::Need { stage: 3, .. })));
    }

    #[test]
    fn sizes_join_equal_neighbors_and_find_each_task() {
        let sizes: TaskSizes = [(3, 64), (1, 32), (3, 64), (1, 32), (1, 32)].into_iter().collect();
        assert_eq!(sizes.runs().len(), 4);
        assert_eq!((0..10).map(|task| sizes.units(task)).collect::<Vec<_>>(), [64, 64, 64, 32, 64, 64, 64, 32, 32, 0]);
        assert_eq!((sizes.tasks(), sizes.sum(), sizes.max()), (9, 6 * 64 + 3 * 32, 64));
        assert_eq!(TaskSizes::even(0, 4).tasks(), 0);
    }
}
