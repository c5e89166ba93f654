//! Properties of tasks that follow from the job's graph: how a job is cut into tasks, and which tasks read which. All other modules
//! know tasks by their keys only. Nothing here comes from the farm.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use femc_model::{
    Assignment, Decision, Digest, Epoch, JobId, JobSpec, Need, Reach, Round, Scope, Stage, TaskKey, TaskResult, Tick,
};
use femc_schedule::Fact;

/// Smallest unit of work that can be leased: a step of a task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct TaskStep {
    pub(crate) job: JobId,
    pub(crate) stage: Stage,
    /// Number of the task before it is cut.
    pub(crate) item: u32,
    pub(crate) step: u32,
}

/// Returns the steps that a lease covers.
pub(crate) fn steps_of_lease(lease: &Assignment) -> Vec<TaskStep> {
    let TaskKey { job, stage, .. } = lease.task;
    lease.spec.steps.clone().map(|step| TaskStep { job, stage, item: lease.spec.item, step }).collect()
}

/// Returns the number of steps of a task that can be cut, and 0 for other tasks.
pub(crate) fn chunk_steps(lease: &Assignment) -> u32 {
    if is_rendering(lease) { lease.spec.steps.len() as u32 } else { 0 }
}

/// Checks whether a lease renders something. Otherwise it joins rendered results.
pub(crate) fn is_rendering(lease: &Assignment) -> bool {
    lease.task.stage.kind.is_divided()
}

/// Returns the key that counts the task's failures. Failures of tasks that join add up over the rounds of their frame.
pub(crate) fn failure_key(task: TaskKey) -> TaskKey {
    let round = if task.stage.kind.is_divided() { task.stage.round } else { 0 };
    TaskKey { stage: Stage { round, ..task.stage }, ..task }
}

/// A result that the log counts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CountedResult<'a> {
    pub(crate) task: TaskKey,
    pub(crate) epoch: Epoch,
    pub(crate) result: &'a TaskResult,
    /// Time at which its lease was granted.
    pub(crate) granted: Tick,
}

impl CountedResult<'_> {
    /// Checks whether the result finishes its frame, or its shared stages.
    pub(crate) fn finishes(&self, spec: &JobSpec) -> bool {
        let Stage { number, .. } = self.task.stage;
        let is_over = !matches!(self.result.decision, Some(Decision::Continue | Decision::Steps(_)));
        // The last stage of a frame makes its image.
        let is_last = || spec.graph.stages_of(Scope::Frame).next_back().is_some_and(|(last, _)| last == number);
        is_over && if self.task.job.is_shared() { is_read_by_frames(spec, number) } else { is_last() }
    }
}

/// Returns the result that a record counts, if any.
pub(crate) fn counted_result(fact: &Fact) -> Option<CountedResult<'_>> {
    match fact {
        Fact::Done { task, epoch, result, leased, .. } => {
            Some(CountedResult { task: *task, epoch: *epoch, result, granted: *leased })
        }
        _ => None,
    }
}

/// Checks whether this is a shared stage that frames read. Such a stage has one task.
pub(crate) fn is_read_by_frames(spec: &JobSpec, number: u16) -> bool {
    let scope = |number| spec.graph.stage(number).map(|template| template.scope);
    scope(number) == Some(Scope::Content)
        && spec.graph.readers(number).any(|(reader, _)| scope(reader) == Some(Scope::Frame))
}

/// Returns the tasks that a task reads, by stage and number, in the round that it reads. Shared stages that a frame's task reads
/// are left out.
/// - `last`: current round of the frame's loop. Stages behind the loop read this round.
fn inputs_of(spec: &JobSpec, stage: &Stage, item: u32, last: u32) -> Vec<(Need, Stage, u32)> {
    let mut all = Vec::new();
    let Some(template) = spec.graph.stage(stage.number) else { return all };
    for need in &template.needs {
        let made = spec.graph.stage(need.stage).filter(|made| made.scope == template.scope);
        let Some(made) = made else { continue };
        let items = match need.reach {
            Reach::All => 0..made.tasks(),
            Reach::Same => item..item + 1,
            Reach::Fan(n) => item * n..((item + 1) * n).min(made.tasks()),
            Reach::Previous => item.saturating_sub(1)..item,
        };
        let round = match need.round {
            Round::Previous if stage.round == 0 => continue,
            Round::Previous => stage.round - 1,
            Round::Same if !spec.graph.is_looped(need.stage) => 0,
            Round::Same if !spec.graph.is_looped(stage.number) => last,
            Round::Same | Round::Every => stage.round,
        };
        let from = Stage { round, number: need.stage, kind: made.kind, ..*stage };
        all.extend(items.map(|item| (*need, from, item)));
    }
    all
}

/// Returns the steps that a round adds to each task of a stage.
fn round_steps(spec: &JobSpec, stage: &Stage) -> Range<u32> {
    spec.graph.stage(stage.number).map_or(0..0, |template| template.steps_of(stage.round))
}

/// Results that the log counts, with the graphs of their jobs.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    specs: BTreeMap<JobId, Box<JobSpec>>,
    done: BTreeMap<TaskStep, (TaskKey, Epoch)>,
    /// Steps that were lost and must be repeated, each with the time of the loss. A task that began earlier may have read them.
    lost: BTreeMap<TaskStep, Tick>,
    /// Current round of the loop of each frame, and whether the loop is over.
    rounds: BTreeMap<(JobId, u32), (u32, bool)>,
    /// Current or latest engine build of each frame.
    frame_builds: BTreeMap<(JobId, u32), String>,
    /// Instances of shared stages.
    instances: BTreeMap<JobId, InstanceKey>,
    /// Shared stages that were ever done, with their instance. They may be lost by now.
    finished_stages: BTreeSet<(InstanceKey, u16)>,
}

/// Instance of shared stages: a content, and the engine build that makes it.
pub(crate) type InstanceKey = (Digest, String);

impl Tally {
    /// Counts a result. Returns an earlier result of the same steps, if any.
    pub(crate) fn count(&mut self, counted: &CountedResult<'_>, steps: &[TaskStep]) -> Option<(TaskKey, Epoch)> {
        let key = (counted.task, counted.epoch);
        if let (Some(instance), Some(spec)) = (self.instances.get(&key.0.job), self.specs.get(&key.0.job))
            && is_read_by_frames(spec, key.0.stage.number)
        {
            self.finished_stages.insert((instance.clone(), key.0.stage.number));
        }
        let round = self.rounds.entry((key.0.job, key.0.stage.frame)).or_default();
        match &counted.result.decision {
            Some(Decision::Done) if key.0.stage.round == round.0 => round.1 = true,
            Some(Decision::Continue | Decision::Steps(_)) if key.0.stage.round == round.0 => round.0 += 1,
            _ => {}
        }
        steps.iter().filter_map(|unit| self.done.insert(*unit, key)).next()
    }

    /// Finds an input of a counted result that is not done now, and was not done when the task was leased.
    pub(crate) fn missing_input(&self, steps: &[TaskStep], leased: Tick) -> Option<TaskStep> {
        let first = steps.first()?;
        let spec = self.specs.get(&first.job)?;
        let read = inputs_of(spec, &first.stage, first.item, self.round(first)).into_iter();
        let mut needed = read.flat_map(|(_, stage, item)| {
            round_steps(spec, &stage).map(move |step| TaskStep { job: first.job, stage, item, step })
        });
        let was_there = |unit: &TaskStep| self.lost.get(unit).is_some_and(|&since| leased <= since);
        needed
            .find(|unit| !self.done.contains_key(unit) && !was_there(unit))
            .or_else(|| self.missing_shared_stage(spec, first))
    }

    /// Finds a shared stage that a frame's task reads and that the frame's build has never done.
    fn missing_shared_stage(&self, spec: &JobSpec, step: &TaskStep) -> Option<TaskStep> {
        let Stage { number, frame, .. } = step.stage;
        let template = spec.graph.stage(number).filter(|template| template.scope == Scope::Frame)?;
        let built = self.frame_builds.get(&(step.job, frame)).cloned().unwrap_or_default();
        let instance = (frame_content(spec, frame)?, built);
        let is_lacking = |need: &&Need| {
            is_read_by_frames(spec, need.stage) && !self.finished_stages.contains(&(instance.clone(), need.stage))
        };
        let need = template.needs.iter().find(is_lacking)?;
        let kind = spec.graph.stage(need.stage)?.kind;
        let stage = Stage { frame: Stage::JOB_FRAME, round: 0, number: need.stage, kind };
        Some(TaskStep { stage, item: 0, step: 0, ..*step })
    }

    /// Returns the current round of the loop of a task's frame.
    fn round(&self, step: &TaskStep) -> u32 {
        self.rounds.get(&(step.job, step.stage.frame)).map_or(0, |(round, _)| *round)
    }

    /// Applies a record that is not a result.
    pub(crate) fn apply(&mut self, fact: &Fact, now: Tick) {
        match fact {
            Fact::Submitted { job, spec, .. } => drop(self.specs.insert(*job, spec.clone())),
            Fact::SharedJobBegun { job, key, engine, spec, .. } => {
                self.specs.insert(*job, spec.clone());
                self.instances.insert(*job, (*key, engine.clone()));
            }
            Fact::BuildAssigned { job, frame, engine } => {
                drop(self.frame_builds.insert((*job, *frame), engine.clone()));
            }
            Fact::OutputsLost { task } => {
                let lost: Vec<TaskStep> =
                    self.done.iter().filter(|(_, (by, _))| by == task).map(|(unit, _)| *unit).collect();
                self.undo(&lost, now);
            }
            Fact::Restarted { job, frame } => {
                self.done.retain(|unit, _| (unit.job, unit.stage.frame) != (*job, *frame));
                self.rounds.remove(&(*job, *frame));
            }
            _ => {}
        }
    }

    /// Removes steps that must be repeated, with the inputs that they read, if these were not kept.
    fn undo(&mut self, steps: &[TaskStep], now: Tick) {
        let Some(first) = steps.first().copied() else { return };
        let Some(spec) = self.specs.get(&first.job) else { return };
        let read = inputs_of(spec, &first.stage, first.item, self.round(&first)).into_iter();
        let gone = read.filter(|(need, stage, item)| !self.is_retained(spec, first.job, need, stage, *item));
        let gone: Vec<(Stage, u32)> = gone.map(|(_, stage, item)| (stage, item)).collect();
        self.done.retain(|unit, _| !steps.contains(unit));
        self.lost.extend(steps.iter().map(|unit| (*unit, now)));
        for (stage, item) in gone {
            let of_task = |unit: &TaskStep| (unit.job, unit.stage, unit.item) == (first.job, stage, item);
            let whole: Vec<TaskStep> = self.done.keys().filter(|unit| of_task(unit)).copied().collect();
            self.undo(&whole, now);
        }
    }

    /// Checks whether an output is kept after a task has read it: another task has yet to read it, or the next round is not over.
    fn is_retained(&self, spec: &JobSpec, job: JobId, need: &Need, made: &Stage, item: u32) -> bool {
        let (round, is_over) = self.rounds.get(&(job, made.frame)).copied().unwrap_or_default();
        if need.round == Round::Previous && !is_over && round <= made.round + 1 {
            return true;
        }
        let readers = || spec.graph.readers(made.number).filter(|(_, other)| other.role == need.role);
        let is_before = !spec.graph.is_looped(made.number);
        if is_before && !is_over && readers().any(|(number, _)| spec.graph.is_looped(number)) {
            // Each round reads a stage before the loop.
            return true;
        }
        let mut tasks = readers().flat_map(|(number, other)| {
            let template = spec.graph.stage(number);
            // A stage behind the loop reads the loop's last round and has a single round itself.
            let is_behind = spec.graph.is_looped(made.number) && !spec.graph.is_looped(number);
            let template = template.filter(|_| !is_behind || made.round == round);
            let round = if is_behind { 0 } else { made.round + u32::from(other.round == Round::Previous) };
            let stage = template.map(|template| Stage { round, number, kind: template.kind, ..*made });
            let items = 0..template.map_or(0, |template| template.tasks());
            items.filter_map(move |reader| Some((stage?, reader)))
        });
        tasks.any(|(stage, reader)| {
            let reads =
                inputs_of(spec, &stage, reader, round).iter().any(|(_, from, number)| (from, *number) == (made, item));
            let mut steps = round_steps(spec, &stage).map(|step| TaskStep { job, stage, item: reader, step });
            reads && stage.round <= round && steps.any(|unit| !self.done.contains_key(&unit))
        })
    }
}

/// Returns the content of a frame.
pub(crate) fn frame_content(spec: &JobSpec, frame: u32) -> Option<Digest> {
    spec.content_key(spec.frames.iter().position(|&other| other == frame)?)
}

/// Returns the tasks that may be lost along with a result: the task itself, the tasks that it read, and so on.
pub(crate) fn transitive_inputs(spec: &JobSpec, stage: &Stage, item: u32) -> BTreeSet<(Stage, u32)> {
    let (mut all, mut left) = (BTreeSet::new(), vec![(*stage, item)]);
    let rounds = (0..spec.graph.stages.len() as u16).map(|number| spec.graph.rounds(number)).max().unwrap_or(1);
    while let Some((stage, item)) = left.pop() {
        if all.insert((stage, item)) {
            // Any round may have been the last one.
            let read = (0..rounds).flat_map(|last| inputs_of(spec, &stage, item, last));
            left.extend(read.map(|(_, stage, item)| (stage, item)));
        }
    }
    all
}

/// Returns the job that a record is about.
pub(crate) fn fact_job(fact: &Fact) -> Option<JobId> {
    match fact {
        Fact::CoordinatorStarted { .. }
        | Fact::Drained { .. }
        | Fact::TimeCharged { .. }
        | Fact::Metered { .. }
        | Fact::WorkerReturned { .. } => None,
        Fact::Submitted { job, .. }
        | Fact::SharedJobBegun { job, .. }
        | Fact::Restarted { job, .. }
        | Fact::JobFailed { job, .. }
        | Fact::Controlled { job, .. }
        | Fact::BuildAssigned { job, .. }
        | Fact::Announced { job, .. }
        | Fact::JobRemoved { job } => Some(*job),
        Fact::Done { task, .. }
        | Fact::Failed { task, .. }
        | Fact::WorkerDied { task, .. }
        | Fact::OutputsLost { task } => Some(task.job),
        Fact::Logged(record) => Some(record.task.job),
    }
}
