//! The stages of a frame, or of the job as a whole, and which stages read which.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use femc_model::{ChunkSize, Chunks, Graph, Input, Loop, Need, Reach, Round, Scope, Stage, StageTemplate, UnevenSteps};

use super::job::FinishedFrame;

/// A stage in one round: the number of the round, and of the stage.
pub(crate) type StageRound = (u32, u16);

/// The part of a job's graph that belongs to a frame, or to the job as a whole, with the state of the frames that it reads.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GraphView<'a> {
    pub(crate) graph: &'a Graph,
    pub(crate) scope: Scope,
    /// The loop of the scope, and the stage that closes it.
    pub(super) scope_loop: Option<(u16, Loop)>,
    pub(super) chunk_size: ChunkSize,
    pub(super) frames: &'a [u32],
    pub(super) finished: &'a BTreeMap<u32, FinishedFrame>,
    pub(super) blocked: &'a BTreeSet<u32>,
}

impl<'a> GraphView<'a> {
    /// Returns the scope of a frame number.
    pub(crate) fn scope_of(frame: u32) -> Scope {
        if frame == Stage::JOB_FRAME { Scope::Job } else { Scope::Frame }
    }

    pub(crate) fn template(&self, number: u16) -> Option<&'a StageTemplate> {
        self.graph.stage(number).filter(|template| template.scope == self.scope)
    }

    /// Returns the numbering of the sample chunks of a stage: with the planned steps, or with those of `uneven`.
    pub(super) fn chunks(&self, (round, number): StageRound, uneven: Option<&'a UnevenSteps>) -> Option<Chunks<'a>> {
        let template = self.template(number)?;
        Some(Chunks::new(template, round, uneven.filter(|_| template.kind.is_divided()), self.chunk_size))
    }

    pub(super) fn is_looped(&self, number: u16) -> bool {
        self.scope_loop.is_some_and(|(last, Loop { first, .. })| (first..=last).contains(&number))
    }

    pub(super) fn is_divided(&self, number: u16) -> bool {
        self.template(number).is_some_and(|template| template.kind.is_divided())
    }

    /// Returns the first stage of the loop whose tasks are divided into sample chunks. A decision may give each of its tasks its
    /// own steps.
    pub(super) fn main_stage(&self) -> Option<(u16, &'a StageTemplate)> {
        self.graph
            .stages_of(self.scope)
            .find(|(number, template)| template.kind.is_divided() && self.is_looped(*number))
    }

    /// Checks whether another round may follow this one.
    pub(crate) fn may_continue(&self, round: u32) -> bool {
        self.scope_loop.is_some_and(|(_, Loop { rounds, .. })| round + 1 < rounds)
    }

    /// Returns the rounds of another stage of the scope that a stage reads in one of its rounds.
    /// - `current`: present round of the loop, or its last round if it is over.
    pub(super) fn rounds_read(&self, (round, number): StageRound, need: &Need, current: u32) -> Range<u32> {
        let one = |round: u32| round..round + 1;
        match need.round {
            Round::Previous => round.saturating_sub(1)..round,
            Round::Every => 0..current + 1,
            Round::Same if !self.is_looped(need.stage) => one(0),
            Round::Same if self.is_looped(number) => one(round),
            Round::Same => one(current),
        }
    }

    /// Checks whether a stage of another scope reads this stage in this round.
    /// - `current`: present round of the loop, or its last round if it is over.
    pub(super) fn is_read_by_other_scope(&self, (round, number): StageRound, need: &Need, current: u32) -> bool {
        need.round == Round::Every || !self.is_looped(number) || round == current
    }

    /// Returns the tasks of another stage of the scope that a task reads.
    pub(super) fn tasks_read(&self, item: u32, need: &Need) -> Range<u32> {
        self.tasks_reached(need.stage, need.reach, item)
    }

    /// Returns the tasks of a stage within this reach of a task.
    pub(super) fn tasks_reached(&self, stage: u16, reach: Reach, item: u32) -> Range<u32> {
        let tasks = self.graph.stage(stage).map_or(0, StageTemplate::tasks);
        tasks_in_reach(reach, item, tasks)
    }

    /// Returns the tasks of a frame's stage that a task of the job reads, numbered through all frames, and the number of tasks per
    /// frame.
    pub(super) fn frame_tasks_read(&self, item: u32, need: &Need) -> (u32, Range<u64>) {
        let tasks = self.graph.stage(need.stage).map_or(1, StageTemplate::tasks).max(1);
        let all = u64::from(tasks) * self.frames.len() as u64;
        let range = match need.reach {
            Reach::All => 0..all,
            Reach::Same => u64::from(item)..u64::from(item) + 1,
            Reach::Fan(n) => u64::from(item) * u64::from(n)..(u64::from(item) + 1) * u64::from(n),
            Reach::Previous => u64::from(item).saturating_sub(1)..u64::from(item),
        };
        (tasks, range.start.min(all)..range.end.min(all))
    }

    /// Returns the tasks of the job that read a frame through this need; `None`: the need is not of a frame's stage.
    pub(super) fn readers_of_frame(&self, reader: u16, need: &Need, frame: u32) -> Option<Range<u32>> {
        let (made, tasks) = (self.graph.stage(need.stage)?, self.template(reader)?.tasks());
        let position = self.frames.binary_search(&frame).ok().filter(|_| made.scope != self.scope)? as u64;
        let (first, count) = (position * u64::from(made.tasks()), u64::from(made.tasks()));
        let (start, end) = match need.reach {
            Reach::All => (0, u64::from(tasks)),
            Reach::Same => (first, first + count),
            Reach::Fan(n) => (first / u64::from(n.max(1)), (first + count).div_ceil(u64::from(n.max(1)))),
            Reach::Previous => (first + 1, first + count + 1),
        };
        Some(start.min(tasks.into()) as u32..end.min(tasks.into()) as u32)
    }

    /// Returns the inputs of a task of the job that come from finished frames, in the order of the frames.
    pub(super) fn inputs_of_frames(&self, number: u16, item: u32, need: &Need) -> Vec<Input> {
        let (tasks, range) = self.frame_tasks_read(item, need);
        let positions = (range.start / u64::from(tasks)) as usize..range.end.div_ceil(u64::from(tasks)) as usize;
        let mut inputs = Vec::new();
        for position in positions {
            let Some(&frame) = self.frames.get(position) else { break };
            let made = self.finished.get(&frame).into_iter().flat_map(|finished| &finished.job_inputs);
            let of_need = made.filter(|made| (made.stage, made.output.role) == (need.stage, need.role));
            let is_read = |item: u32| range.contains(&(position as u64 * u64::from(tasks) + u64::from(item)));
            let of_need = of_need.filter(|made| is_read(made.item));
            inputs.extend(of_need.map(|made| Input { need: number, frame, item: made.item, output: made.output }));
        }
        inputs
    }

    /// Checks whether the frames that a task of the job reads are finished, or, where gaps are allowed, blocked.
    pub(super) fn are_frames_ready(&self, item: u32, need: &Need) -> bool {
        let is_ready = |frame: &u32| self.finished.contains_key(frame) || (need.gaps && self.blocked.contains(frame));
        let (tasks, range) = self.frame_tasks_read(item, need);
        if range == (0..u64::from(tasks) * self.frames.len() as u64) {
            let own = usize::from(self.finished.contains_key(&Stage::JOB_FRAME));
            let gaps =
                if need.gaps { self.blocked.iter().filter(|frame| **frame != Stage::JOB_FRAME).count() } else { 0 };
            return self.finished.len() - own + gaps == self.frames.len();
        }
        let positions = (range.start / u64::from(tasks)) as usize..range.end.div_ceil(u64::from(tasks)) as usize;
        self.frames.get(positions).is_some_and(|frames| frames.iter().all(is_ready))
    }
}

/// Returns those of `tasks` tasks that a task reads.
fn tasks_in_reach(reach: Reach, item: u32, tasks: u32) -> Range<u32> {
    match reach {
        Reach::All => 0..tasks,
        Reach::Same => item.min(tasks)..item.saturating_add(1).min(tasks),
        Reach::Fan(n) => item.saturating_mul(n).min(tasks)..item.saturating_add(1).saturating_mul(n).min(tasks),
        Reach::Previous => item.saturating_sub(1).min(tasks)..item.min(tasks),
    }
}

/// Returns those of `readers` tasks that read a task.
pub(super) fn readers_of(reach: Reach, item: u32, readers: u32) -> Range<u32> {
    let one = |item: u32| item.min(readers)..item.saturating_add(1).min(readers);
    match reach {
        Reach::All => 0..readers,
        Reach::Same => one(item),
        Reach::Fan(n) => one(item / n.max(1)),
        Reach::Previous => one(item.saturating_add(1)),
    }
}
