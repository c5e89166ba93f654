//! Frame progress: the finished runs and the failures of each stage of a frame, or of the job's own stages.

use std::collections::BTreeMap;
use std::ops::Range;

use femc_model::{
    BlockCounts, Chunks, Decision, Digest, Epoch, Failure, FrameRecord, Graph, Input, Loop, Output, Reach, Role, Round,
    Scope, Stage, StepsTaken, TaskResult, Tick, UnevenSteps,
};
use serde::{Deserialize, Serialize};
use smallvec::SmallVec;

use super::graph_view::{GraphView, StageRound, readers_of};
use super::job::Job;
use super::task_failures::TaskFailures;
use crate::{RangeSet, WorkerDeath};

/// A finished run of sample chunks, with its lease.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct FinishedRun {
    end: u32,
    epoch: Epoch,
    /// Outputs that are still needed, in most cases one.
    outputs: SmallVec<[Output; 1]>,
}

/// Finished work of a stage in one round.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct TaskArray {
    /// Finished runs with outputs that are still needed, by their first key.
    rows: BTreeMap<u32, FinishedRun>,
    /// Finished sample chunks whose outputs are no longer needed.
    released: RangeSet,
    /// Number of bad samples of the runs that have any, by their first key.
    bad_samples: BTreeMap<u32, u64>,
    /// Tasks that are completely done.
    done_tasks: RangeSet,
}

impl TaskArray {
    /// Creates the state before any work is done. Tasks without steps count as done.
    fn new(chunks: &Chunks<'_>) -> Self {
        let is_idle = |task: &u32| chunks.of_task(*task).is_empty();
        let mut whole = RangeSet::default();
        let tasks = if chunks.is_even() { 0..0 } else { 0..chunks.tasks() };
        tasks.filter(is_idle).for_each(|task| whole.insert(task));
        Self { done_tasks: whole, ..Self::default() }
    }

    fn is_complete(&self, chunks: &Chunks<'_>) -> bool {
        self.done_tasks.covers(&(0..chunks.tasks()))
    }

    fn is_task_done(&self, chunks: &Chunks<'_>, task: u32) -> bool {
        let keys = chunks.of_task(task);
        if keys.len() == 1 && chunks.stride() == 1 {
            return self.rows.contains_key(&keys.start) || self.released.contains(keys.start);
        }
        let done: usize = self.rows.range(keys.clone()).map(|(first, row)| (row.end - first) as usize).sum();
        done == keys.len()
            || done + keys.filter(|&key| self.released.contains(key)).count() == chunks.of_task(task).len()
    }

    /// Checks whether some of these sample chunks are done.
    fn has_any_of(&self, run: &Range<u32>) -> bool {
        let before = self.rows.range(..run.end).next_back();
        before.is_some_and(|(_, row)| row.end > run.start) || self.released.intersects(run)
    }
}

/// Progress of a frame with a result or failure, or of the job's own stages.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Progress {
    /// Present round of its loop.
    pub(crate) round: u32,
    /// Whether its loop is over, or it has none.
    is_over: bool,
    /// Time of the first lease of a completed task.
    pub(crate) began: Tick,
    arrays: BTreeMap<StageRound, TaskArray>,
    /// Steps of the rounds in which they differ between tasks.
    uneven: BTreeMap<u32, UnevenSteps>,
    /// Failures by stage, round and key. Failures of join tasks are counted together for all rounds, so that a frame whose inputs
    /// are lost again and again ends.
    failures: BTreeMap<(u16, u32, u32), TaskFailures>,
    /// Epoch of the task that decided how the loop continues after the previous round.
    decided_by: Option<Epoch>,
    /// Finished units of work in all rounds.
    pub(crate) units: u64,
    pub(crate) bad_samples: u64,
    pub(crate) busy_seconds: f64,
    pub(crate) relative_error: Option<f64>,
    #[serde(deserialize_with = "femc_model::since_version_9")]
    pub(crate) blocks: Option<BlockCounts>,
    /// Whether it was finished before and one of its results was lost.
    pub(crate) is_rerun: bool,
}

impl Progress {
    pub(super) fn new(view: &GraphView<'_>, began: Tick) -> Self {
        Self {
            round: 0,
            is_over: view.scope_loop.is_none(),
            began,
            arrays: BTreeMap::new(),
            uneven: BTreeMap::new(),
            failures: BTreeMap::new(),
            decided_by: None,
            units: 0,
            bad_samples: 0,
            busy_seconds: 0.0,
            relative_error: None,
            blocks: None,
            is_rerun: false,
        }
    }

    /// Creates the progress of a frame that was finished before one of its results was lost. Its rerun has not begun.
    pub(super) fn new_rerun(view: &GraphView<'_>, record: &FrameRecord) -> Self {
        Self { busy_seconds: record.busy_seconds, is_rerun: true, ..Self::new(view, Tick(u64::MAX)) }
    }

    /// Restarts it; its failures are kept.
    pub(super) fn restart(&mut self, view: &GraphView<'_>) -> Vec<Digest> {
        let released = self.artifacts().collect();
        let trouble = std::mem::take(&mut self.failures);
        *self = Self { busy_seconds: self.busy_seconds, failures: trouble, ..Self::new(view, self.began) };
        released
    }

    /// Returns the present stages, each in its rounds.
    pub(crate) fn stage_rounds(&self, view: &GraphView<'_>) -> impl DoubleEndedIterator<Item = StageRound> {
        let (scope_loop, last, is_over) = (view.scope_loop, self.round, self.is_over);
        let stages = view.graph.stages_of(view.scope);
        stages
            .flat_map(move |(number, _)| rounds_of(number, scope_loop, last, is_over).map(move |round| (round, number)))
    }

    fn has_stage_round(&self, view: &GraphView<'_>, stage_round: StageRound) -> bool {
        let is_of_loop = view.is_looped(stage_round.1);
        let is_behind = view.scope_loop.is_some_and(|(last, _)| stage_round.1 > last);
        view.template(stage_round.1).is_some()
            && if is_of_loop { stage_round.0 <= self.round } else { stage_round.0 == 0 && (self.is_over || !is_behind) }
    }

    pub(crate) fn chunks<'a>(&'a self, view: &GraphView<'a>, stage_round: StageRound) -> Option<Chunks<'a>> {
        chunks(&self.uneven, view, stage_round)
    }

    /// Checks whether every task of a stage is done.
    pub(crate) fn is_complete(&self, view: &GraphView<'_>, stage_round: StageRound) -> bool {
        let Some(chunks) = self.chunks(view, stage_round) else { return false };
        self.arrays.get(&stage_round).is_some_and(|array| array.is_complete(&chunks))
    }

    /// Checks whether everything is done.
    pub(super) fn is_finished(&self, view: &GraphView<'_>) -> bool {
        self.is_over && self.stage_rounds(view).all(|stage_round| self.is_complete(view, stage_round))
    }

    /// Returns the number of finished tasks of a stage.
    pub(crate) fn tasks_done(&self, stage_round: StageRound) -> u32 {
        self.arrays.get(&stage_round).map_or(0, |array| array.done_tasks.count())
    }

    /// Checks whether a task of a stage is done.
    pub(crate) fn is_done(&self, stage_round: StageRound, item: u32) -> bool {
        self.are_done(stage_round, item..item + 1)
    }

    /// Checks whether all of these tasks of a stage are done.
    fn are_done(&self, stage_round: StageRound, items: Range<u32>) -> bool {
        items.is_empty() || self.arrays.get(&stage_round).is_some_and(|array| array.done_tasks.covers(&items))
    }

    /// Checks whether all inputs of a task exist.
    pub(crate) fn has_inputs(&self, view: &GraphView<'_>, stage_round: StageRound, item: u32) -> bool {
        let Some(template) = view.template(stage_round.1) else { return false };
        template.needs.iter().all(|need| match view.template(need.stage) {
            // Whether the outputs of a shared job exist depends on the worker: see `shared.rs`.
            None if view.scope != Scope::Job => true,
            None => view.are_frames_ready(item, need),
            Some(_) => {
                let mut rounds = view.rounds_read(stage_round, need, self.round);
                rounds.all(|round| self.are_done((round, need.stage), view.tasks_read(item, need)))
            }
        })
    }

    /// Returns the inputs of a task, in order of need, frame and task.
    /// - `shared`: shared job of the frame's content.
    pub(crate) fn inputs(
        &self,
        view: &GraphView<'_>,
        stage_round: StageRound,
        item: u32,
        shared: Option<&Job>,
    ) -> Vec<Input> {
        let mut inputs = Vec::new();
        let Some(template) = view.template(stage_round.1) else { return inputs };
        for (number, need) in template.needs.iter().enumerate() {
            let number = number as u16;
            if view.template(need.stage).is_none() {
                let items = view.tasks_read(item, need);
                let made = shared.into_iter().flat_map(|shared| shared.outputs_for(need));
                let made = made.filter(|(item, _)| items.contains(item));
                inputs.extend(made.map(|(item, output)| Input { need: number, frame: Stage::JOB_FRAME, item, output }));
                if view.scope == Scope::Job {
                    inputs.extend(view.inputs_of_frames(number, item, need));
                }
                continue;
            }
            for round in view.rounds_read(stage_round, need, self.round) {
                let from = (round, need.stage);
                let (Some(array), Some(chunks)) = (self.arrays.get(&from), self.chunks(view, from)) else { continue };
                let keys = chunks.of_tasks(&view.tasks_read(item, need));
                for (&first, row) in array.rows.range(keys) {
                    let of_role = row.outputs.iter().filter(|output| output.role == need.role);
                    let (item, frame) = (chunks.task(first), Stage::JOB_FRAME);
                    inputs.extend(of_role.map(|&output| Input { need: number, frame, item, output }));
                }
            }
        }
        inputs
    }

    /// Returns the number of steps taken so far by each divided task that the inputs of a task are made from.
    pub(crate) fn steps_taken(&self, view: &GraphView<'_>, stage_round: StageRound, item: u32) -> StepsTaken {
        let divided_sources = if view.is_divided(stage_round.1) {
            None
        } else {
            self.divided_sources(view, stage_round, item..item + 1, &mut 0)
        };
        let Some((chunks, items)) =
            divided_sources.and_then(|(stage_round, items)| Some((self.chunks(view, stage_round)?, items)))
        else {
            return StepsTaken::default();
        };
        items.map(|item| chunks.steps_of(item).end).collect()
    }

    /// Returns the divided tasks that these tasks of a stage are made from, and their stage in its round.
    /// - `seen`: visited stages, one bit each.
    fn divided_sources(
        &self,
        view: &GraphView<'_>,
        stage_round: StageRound,
        items: Range<u32>,
        seen: &mut u64,
    ) -> Option<(StageRound, Range<u32>)> {
        const { assert!(Graph::MAX_STAGES <= u64::BITS as usize) };
        let is_new = *seen >> stage_round.1 & 1 == 0;
        let template = view.template(stage_round.1).filter(|_| is_new && !items.is_empty())?;
        *seen |= 1 << stage_round.1;
        if template.kind.is_divided() {
            return Some((stage_round, items));
        }
        template.needs.iter().filter(|need| need.round != Round::Previous).find_map(|need| {
            let round = view.rounds_read(stage_round, need, self.round).next_back()?;
            let [first, last] = [items.start, items.end - 1].map(|item| view.tasks_read(item, need));
            self.divided_sources(view, (round, need.stage), first.start..last.end, seen)
        })
    }

    /// Checks whether a result of this run of sample chunks would count: the run lies within one task, its round has begun, and
    /// none of it is done.
    pub(super) fn may_count(&self, view: &GraphView<'_>, stage_round: StageRound, run: &Range<u32>) -> bool {
        let is_done = || self.arrays.get(&stage_round).is_some_and(|array| array.has_any_of(run));
        let is_of_one = |chunks: Chunks<'_>| !run.is_empty() && run.end <= chunks.of_task(chunks.task(run.start)).end;
        self.has_stage_round(view, stage_round) && self.chunks(view, stage_round).is_some_and(is_of_one) && !is_done()
    }

    /// Enters the result of a run of sample chunks; a repetition changes nothing. Returns artifacts that are no longer needed.
    pub(super) fn apply_result(
        &mut self,
        view: &GraphView<'_>,
        stage: &Stage,
        run: &Range<u32>,
        (epoch, leased): (Epoch, Tick),
        result: &TaskResult,
    ) -> Vec<Digest> {
        let stage_round = (stage.round, stage.number);
        let Some(chunks) = chunks(&self.uneven, view, stage_round).filter(|_| self.may_count(view, stage_round, run))
        else {
            return Vec::new();
        };
        let item = chunks.task(run.start);
        let (mut outputs, mut released) = (SmallVec::new(), Vec::new());
        for &output in &result.outputs {
            if self.is_needed(view, stage_round, item, output.role) {
                outputs.push(output);
            } else {
                released.push(output.artifact.digest);
            }
        }
        let array = self.arrays.entry(stage_round).or_insert_with(|| TaskArray::new(&chunks));
        if outputs.is_empty() {
            array.released.insert_range(run.clone());
        } else {
            array.rows.insert(run.start, FinishedRun { end: run.end, epoch, outputs });
        }
        if *run == chunks.of_task(item) || array.is_task_done(&chunks, item) {
            array.done_tasks.insert(item);
        }
        if result.bad_samples > 0 {
            array.bad_samples.insert(run.start, result.bad_samples);
        }
        self.began = self.began.min(leased);
        self.busy_seconds += result.seconds;
        if result.blocks.is_some() || result.relative_error.is_some() {
            (self.relative_error, self.blocks) = (result.relative_error, result.blocks);
        }
        self.units += result.units;
        self.bad_samples += result.bad_samples;
        if stage.kind.is_divided() {
            self.failures.retain(|(number, round, key), _| (*round, *number) != stage_round || !run.contains(key));
        }
        if !self.close_round(view, stage_round, epoch, result.decision.as_ref(), &mut released) {
            self.release_inputs(view, stage_round, item, &mut released);
        }
        released
    }

    /// Continues or ends the loop if this task closes the present round. Returns whether it does.
    fn close_round(
        &mut self,
        view: &GraphView<'_>,
        (round, number): StageRound,
        epoch: Epoch,
        decision: Option<&Decision>,
        released: &mut Vec<Digest>,
    ) -> bool {
        let closes = view.scope_loop.is_some_and(|(last, _)| last == number);
        if !closes || round != self.round || self.is_over {
            return false;
        }
        self.decided_by = Some(epoch);
        match decision {
            Some(Decision::Continue) if view.may_continue(round) => self.next_round(view, None),
            Some(Decision::Steps(to)) if view.may_continue(round) => self.next_round(view, Some(to)),
            _ => self.is_over = true,
        }
        let places: Vec<StageRound> = self.arrays.keys().copied().collect();
        for stage_round in places {
            let tasks = view.template(stage_round.1).map_or(0, |template| template.tasks());
            self.release_unneeded(view, stage_round, 0..tasks, released);
        }
        true
    }

    /// Begins the next round.
    /// - `to`: number of steps of each task at the end of the round; `None`: as planned.
    fn next_round(&mut self, view: &GraphView<'_>, to: Option<&[u32]>) {
        self.round += 1;
        let Some((number, template)) = view.main_stage() else { return };
        if to.is_none() && !self.uneven.contains_key(&(self.round - 1)) {
            return;
        }
        let planned = vec![template.steps_of(self.round).end; template.tasks() as usize];
        let uneven = self.next_steps(view, to.unwrap_or(&planned));
        self.uneven.insert(self.round, uneven);
        // A stage without remaining steps would never be entered by a result.
        let stage_round = (self.round, number);
        if let Some(chunks) = chunks(&self.uneven, view, stage_round) {
            self.arrays.insert(stage_round, TaskArray::new(&chunks));
        }
    }

    /// Returns the steps of the next round: never fewer than are already done.
    fn next_steps(&self, view: &GraphView<'_>, to: &[u32]) -> UnevenSteps {
        let main = view.main_stage();
        let tasks = main.map_or(0, |(_, template)| template.tasks());
        let before = |task: u32| {
            let planned = || main.map_or(0, |(_, template)| template.steps_of(self.round - 1).end);
            self.uneven
                .get(&(self.round - 1))
                .and_then(|uneven| uneven.to.get(task as usize))
                .copied()
                .unwrap_or_else(planned)
        };
        let from: Vec<u32> = (0..tasks).map(before).collect();
        let to = from.iter().enumerate().map(|(task, &from)| to.get(task).copied().unwrap_or(from).max(from)).collect();
        UnevenSteps { from, to }
    }

    /// Checks whether an output of a task is a result, or needed by a task that is not done.
    fn is_needed(&self, view: &GraphView<'_>, stage_round: StageRound, item: u32, role: Role) -> bool {
        role.properties().is_result
            || view.graph.readers(stage_round.1).filter(|(_, need)| need.role == role).any(|(reader, need)| {
                let Some(template) = view.template(reader) else {
                    return view.is_read_by_other_scope(stage_round, need, self.round);
                };
                let readers = readers_of(need.reach, item, template.tasks());
                let is_open = |round: u32| !self.are_done((round, reader), readers.clone());
                match need.round {
                    Round::Previous => {
                        let continues = !self.is_over && self.round <= stage_round.0 + 1;
                        continues || (stage_round.0 < self.round && is_open(stage_round.0 + 1))
                    }
                    Round::Every => is_open(0),
                    Round::Same if !view.is_looped(stage_round.1) && view.is_looped(reader) => {
                        !self.is_over || (0..self.round + 1).any(is_open)
                    }
                    Round::Same if view.is_looped(stage_round.1) && !view.is_looped(reader) => {
                        stage_round.0 == self.round && is_open(0)
                    }
                    Round::Same => is_open(stage_round.0),
                }
            })
    }

    /// Releases the outputs of these tasks that are no longer needed. A stage reads itself only in other rounds, or as a chain; the
    /// outputs of a chain are not released.
    fn release_unneeded(
        &mut self,
        view: &GraphView<'_>,
        stage_round: StageRound,
        items: Range<u32>,
        released: &mut Vec<Digest>,
    ) {
        let Some((keys, stride)) = self.chunks(view, stage_round).map(|it| (it.of_tasks(&items), it.stride())) else {
            return;
        };
        let Some(mut array) = self.arrays.remove(&stage_round) else { return };
        let emptied = array.rows.extract_if(keys, |&first, row| {
            row.outputs.retain(|output| {
                let is_needed = self.is_needed(view, stage_round, first / stride, output.role);
                released.extend((!is_needed).then_some(output.artifact.digest));
                is_needed
            });
            row.outputs.is_empty()
        });
        let mut emptied = emptied.map(|(first, row)| first..row.end).peekable();
        while let Some(mut run) = emptied.next() {
            while let Some(next) = emptied.next_if(|next| next.start == run.end) {
                run.end = next.end;
            }
            array.released.insert_range(run);
        }
        self.arrays.insert(stage_round, array);
    }

    /// Releases the inputs of a task that are no longer needed.
    fn release_inputs(&mut self, view: &GraphView<'_>, stage_round: StageRound, item: u32, released: &mut Vec<Digest>) {
        let needs = view.template(stage_round.1).map_or(&[][..], |template| &template.needs);
        for need in needs.iter().filter(|need| view.template(need.stage).is_some()) {
            if need.reach == Reach::All && !self.is_complete(view, stage_round) {
                continue;
            }
            for round in view.rounds_read(stage_round, need, self.round) {
                self.release_unneeded(view, (round, need.stage), view.tasks_read(item, need), released);
            }
        }
    }

    /// Returns the runs of sample chunks that made one of these artifacts, if it is still needed.
    pub(crate) fn producers(&self, lost: &[Digest]) -> Vec<(StageRound, u32)> {
        let has_lost = |row: &FinishedRun| row.outputs.iter().any(|output| lost.contains(&output.artifact.digest));
        let rows = self
            .arrays
            .iter()
            .flat_map(|(&stage_round, array)| array.rows.iter().map(move |(&first, row)| (stage_round, first, row)));
        rows.filter(|(.., row)| has_lost(row)).map(|(stage_round, first, _)| (stage_round, first)).collect()
    }

    /// Marks the run that begins with this key as not done, because its outputs are lost, together with the producers of its
    /// missing inputs. Its other outputs stay in the store, where some task may be reading them; the repetition makes the same
    /// ones.
    pub(super) fn apply_loss(&mut self, view: &GraphView<'_>, stage_round: StageRound, first: u32) {
        if let Some(end) = self.arrays.get(&stage_round).and_then(|array| array.rows.get(&first)).map(|row| row.end) {
            self.undo(view, stage_round, first..end);
        }
    }

    fn undo(&mut self, view: &GraphView<'_>, stage_round: StageRound, run: Range<u32>) {
        let Some(template) = view.template(stage_round.1) else { return };
        let (Some(chunks), Some(array)) = (chunks(&self.uneven, view, stage_round), self.arrays.get_mut(&stage_round))
        else {
            return;
        };
        let item = chunks.task(run.start);
        let was_whole = array.is_task_done(&chunks, item);
        let units = |run: &Range<u32>| if template.kind.is_divided() { chunks.units(run) } else { 0 };
        let (mut undone, mut bad) = (0, 0);
        let rows: Vec<u32> = array.rows.range(run.clone()).map(|(&first, _)| first).collect();
        for first in rows {
            let Some(row) = array.rows.remove(&first) else { continue };
            undone += units(&(first..row.end));
        }
        let released: Vec<u32> = run.clone().filter(|&key| array.released.contains(key)).collect();
        for key in released {
            array.released.remove_range(key..key + 1);
            undone += units(&(key..key + 1));
        }
        let refused: Vec<u32> = array.bad_samples.range(run).map(|(&first, _)| first).collect();
        refused.into_iter().filter_map(|first| array.bad_samples.remove(&first)).for_each(|count| bad += count);
        if was_whole && !array.is_task_done(&chunks, item) {
            array.done_tasks.remove_range(item..item + 1);
        }
        self.units -= undone;
        self.bad_samples -= bad;
        for need in template.needs.iter().filter(|need| view.template(need.stage).is_some()) {
            for round in view.rounds_read(stage_round, need, self.round) {
                for item in view.tasks_read(item, need) {
                    self.undo_released(view, (round, need.stage), item, need.role);
                }
            }
        }
    }

    /// Marks a finished task as not done if its output of this role no longer exists.
    fn undo_released(&mut self, view: &GraphView<'_>, stage_round: StageRound, item: u32, role: Role) {
        let Some(keys) = self.chunks(view, stage_round).map(|chunks| chunks.of_task(item)) else { return };
        let Some(array) = self.arrays.get(&stage_round) else { return };
        let lacks = |row: &FinishedRun| row.outputs.iter().all(|output| output.role != role);
        if array.released.intersects(&keys) || array.rows.range(keys.clone()).any(|(_, row)| lacks(row)) {
            self.undo(view, stage_round, keys);
        }
    }

    /// Returns the keys of a stage that are neither done nor quarantined.
    pub(crate) fn open_keys(&self, view: &GraphView<'_>, stage_round: StageRound) -> RangeSet {
        let Some(chunks) = self.chunks(view, stage_round).filter(|_| self.has_stage_round(view, stage_round)) else {
            return RangeSet::default();
        };
        let mut open = RangeSet::default();
        if chunks.is_even() {
            open.insert_range(chunks.all_keys());
        } else {
            (0..chunks.tasks()).for_each(|task| open.insert_range(chunks.of_task(task)));
        }
        if let Some(array) = self.arrays.get(&stage_round) {
            array.rows.iter().for_each(|(&first, row)| open.remove_range(first..row.end));
            array.released.ranges().for_each(|run| open.remove_range(run));
        }
        for (number, round, key) in self.quarantined().map(|(name, _)| name) {
            if number == stage_round.1 && (round == stage_round.0 || !view.is_divided(number)) {
                open.remove_range(key..key + 1);
            }
        }
        open
    }

    /// Returns the tasks that can run, by stage: neither done nor quarantined, with all inputs.
    pub(crate) fn runnable(&self, view: &GraphView<'_>) -> Vec<(StageRound, RangeSet)> {
        let mut all = Vec::new();
        for stage_round in self.stage_rounds(view).filter(|&place| !self.is_complete(view, place)) {
            let (Some(template), Some(chunks)) = (view.template(stage_round.1), self.chunks(view, stage_round)) else {
                continue;
            };
            let mut keys = self.open_keys(view, stage_round);
            if template.needs.iter().all(|need| need.reach == Reach::All) {
                if !keys.is_empty() && !self.has_inputs(view, stage_round, 0) {
                    continue;
                }
            } else {
                let items: Vec<u32> =
                    keys.ranges().flat_map(|run| chunks.task(run.start)..chunks.task(run.end - 1) + 1).collect();
                let unready = items.into_iter().filter(|&item| !self.has_inputs(view, stage_round, item));
                unready.for_each(|item| keys.remove_range(chunks.of_tasks(&(item..item + 1))));
            }
            if !keys.is_empty() {
                all.push((stage_round, keys));
            }
        }
        all
    }

    /// Returns the keys of the tasks that can run now that this task is done, by stage.
    pub(crate) fn runnable_after(&self, view: &GraphView<'_>, stage: &Stage, key: u32) -> Vec<(StageRound, RangeSet)> {
        let mut all = Vec::new();
        let from = (stage.round, stage.number);
        let Some(chunks) = self.chunks(view, from) else { return all };
        let item = chunks.task(key);
        if !self.are_done(from, item..item + 1) {
            return all;
        }
        for (reader, need) in view.graph.readers(stage.number) {
            let Some(template) = view.template(reader) else { continue };
            if need.reach == Reach::All && !self.is_complete(view, from) {
                continue;
            }
            for round in rounds_of(reader, view.scope_loop, self.round, self.is_over) {
                let stage_round = (round, reader);
                if !view.rounds_read(stage_round, need, self.round).contains(&stage.round) {
                    continue;
                }
                let keys = self.runnable_among(view, stage_round, readers_of(need.reach, item, template.tasks()));
                if !keys.is_empty() {
                    all.push((stage_round, keys));
                }
            }
        }
        all
    }

    /// Returns the keys of the job's own tasks that can run now that this frame has ended, by stage.
    pub(crate) fn runnable_after_frame(&self, view: &GraphView<'_>, frame: u32) -> Vec<(StageRound, RangeSet)> {
        let mut all = Vec::new();
        for stage_round in self.stage_rounds(view) {
            let needs = view.template(stage_round.1).map_or(&[][..], |template| &template.needs);
            let readers = needs.iter().filter_map(|need| view.readers_of_frame(stage_round.1, need, frame));
            for readers in readers.collect::<Vec<_>>() {
                let keys = self.runnable_among(view, stage_round, readers);
                if !keys.is_empty() {
                    all.push((stage_round, keys));
                }
            }
        }
        all
    }

    /// Returns the keys of the tasks among `items` that can run.
    fn runnable_among(&self, view: &GraphView<'_>, stage_round: StageRound, items: Range<u32>) -> RangeSet {
        // In most cases none of them can run.
        let mut ready = items.filter(|&item| self.has_inputs(view, stage_round, item)).peekable();
        let Some(chunks) = self.chunks(view, stage_round).filter(|_| ready.peek().is_some()) else {
            return RangeSet::default();
        };
        let (mut keys, open) = (RangeSet::default(), self.open_keys(view, stage_round));
        for key in ready.flat_map(|item| chunks.of_task(item)).filter(|&key| open.contains(key)) {
            keys.insert(key);
        }
        keys
    }

    /// Counts a failed attempt of a task.
    pub(super) fn add_failure(&mut self, stage: &Stage, key: u32, until: Epoch, failure: &Failure) {
        let failures =
            self.failures.entry(failure_key(stage, key)).or_insert_with(|| TaskFailures::new(failure.clone()));
        failures.add_failure(until, failure);
    }

    /// Checks whether this lease of a task was over when the task's last failure was counted.
    pub(crate) fn is_lease_over(&self, stage: &Stage, key: u32, epoch: Epoch) -> bool {
        self.failures.get(&failure_key(stage, key)).is_some_and(|failures| failures.is_lease_over(epoch))
    }

    /// Counts the death of a worker for the tasks that it was running. At least one of them caused the death.
    pub(super) fn add_death(&mut self, stage: &Stage, keys: impl Iterator<Item = u32>, death: &WorkerDeath) {
        for key in keys {
            let failure = Failure::Killed { deaths: 0, worker: String::new() };
            self.failures.entry(failure_key(stage, key)).or_insert_with(|| TaskFailures::new(failure)).add_death(death);
        }
    }

    pub(super) fn withdraw_deaths(&mut self, instance: u64) {
        self.failures.retain(|_, trouble| trouble.withdraw_deaths(instance));
    }

    pub(super) fn presumed_dead(&self) -> impl Iterator<Item = u64> + '_ {
        self.failures.values().flat_map(TaskFailures::presumed_dead)
    }

    pub(super) fn clear_failures(&mut self) {
        self.failures.clear();
    }

    /// Returns the first key of a run that has failed before.
    pub(crate) fn first_failed_key(&self, stage: &Stage, run: &Range<u32>) -> Option<u32> {
        let keys = failure_key(stage, run.start)..failure_key(stage, run.end);
        self.failures.range(keys).next().map(|(&(.., key), _)| key)
    }

    /// Checks whether a task is quarantined.
    pub(crate) fn is_quarantined(&self, stage: &Stage, key: u32) -> bool {
        self.failures.get(&failure_key(stage, key)).is_some_and(TaskFailures::is_quarantined)
    }

    /// Returns the tasks with failed attempts, by stage, round and key.
    pub(crate) fn failed_tasks(&self) -> impl Iterator<Item = ((u16, u32, u32), &TaskFailures)> + '_ {
        self.failures.iter().map(|(&name, trouble)| (name, trouble))
    }

    /// Returns the quarantined tasks, by stage, round and key.
    pub(crate) fn quarantined(&self) -> impl Iterator<Item = ((u16, u32, u32), &TaskFailures)> + '_ {
        self.failures.iter().filter(|(_, trouble)| trouble.is_quarantined()).map(|(&name, trouble)| (name, trouble))
    }

    /// Checks whether none of its tasks can run without a retry.
    pub(super) fn is_blocked(&self, view: &GraphView<'_>) -> bool {
        self.quarantined().next().is_some() && self.runnable(view).is_empty()
    }

    /// Returns all artifacts that it needs.
    pub(crate) fn artifacts(&self) -> impl Iterator<Item = Digest> + '_ {
        self.outputs().map(|(.., output)| output.artifact.digest)
    }

    /// Returns its existing outputs, with the place of the stage and the first key.
    pub(super) fn outputs(&self) -> impl Iterator<Item = (StageRound, u32, Output)> + '_ {
        let rows = self
            .arrays
            .iter()
            .flat_map(|(&stage_round, array)| array.rows.iter().map(move |(&first, row)| (stage_round, first, row)));
        rows.flat_map(|(stage_round, first, row)| row.outputs.iter().map(move |&output| (stage_round, first, output)))
    }

    /// Returns the outputs for a preview: results and outputs that may become results, with each sample once. Outputs that were
    /// merged into others are not needed any more. The sums of earlier rounds are left out if this round includes them. Outputs of
    /// earlier rounds are kept if a later stage reads all rounds of them.
    pub(crate) fn preview_outputs(&self, view: &GraphView<'_>) -> Vec<Output> {
        let is_carried = |(round, number): StageRound, role: Role| {
            view.graph.readers(number).any(|(_, need)| (need.role, need.round) == (role, Round::Previous))
                && round < self.round
        };
        let has_successor = |(round, number): StageRound, first: u32| {
            self.arrays.get(&(round + 1, number)).is_some_and(|array| array.rows.contains_key(&first))
        };
        let is_shown = |&(stage_round, first, output): &(StageRound, u32, Output)| {
            let is_of_now =
                stage_round.0 == self.round && !is_read_by_next_round_only(view, stage_round.1, output.role);
            is_of_now
                || has_reader_of_all_rounds(view, stage_round.1, output.role)
                || (is_carried(stage_round, output.role)
                    && stage_round.0 + 1 == self.round
                    && !has_successor(stage_round, first))
        };
        self.outputs().filter(is_shown).map(|(.., output)| output).collect()
    }

    /// Checks whether it holds this completion.
    pub(super) fn has_completion(&self, view: &GraphView<'_>, stage: &Stage, key: u32, epoch: Epoch) -> bool {
        let stage_round = (stage.round, stage.number);
        let row = self.arrays.get(&stage_round).and_then(|array| array.rows.get(&key));
        let has_decided = || self.decided_by == Some(epoch) && self.decider(view) == Some((stage_round, key));
        view.template(stage.number).is_some_and(|template| template.kind == stage.kind)
            && (row.is_some_and(|row| row.epoch == epoch) || has_decided())
    }

    /// Returns the task that decided last, which closed the previous round or the last one.
    fn decider(&self, view: &GraphView<'_>) -> Option<(StageRound, u32)> {
        let (number, _) = view.scope_loop?;
        Some(((self.round.checked_sub(u32::from(!self.is_over))?, number), 0))
    }
}

/// Returns the present rounds of a stage.
/// - `scope_loop`: loop of its scope;
/// - `last`: present round of the loop.
fn rounds_of(number: u16, scope_loop: Option<(u16, Loop)>, last: u32, is_over: bool) -> Range<u32> {
    match scope_loop {
        Some((end, it)) if (it.first..=end).contains(&number) => 0..last + 1,
        Some((end, _)) if number > end && !is_over => 0..0,
        _ => 0..1,
    }
}

fn chunks<'a>(
    uneven: &'a BTreeMap<u32, UnevenSteps>,
    view: &GraphView<'a>,
    stage_round: StageRound,
) -> Option<Chunks<'a>> {
    view.chunks(stage_round, uneven.get(&stage_round.0).filter(|_| view.is_looped(stage_round.1)))
}

/// Checks whether only the next round reads an output.
fn is_read_by_next_round_only(view: &GraphView<'_>, number: u16, role: Role) -> bool {
    let mut readers = view.graph.readers(number).filter(|(_, need)| need.role == role).peekable();
    readers.peek().is_some() && readers.all(|(_, need)| need.round == Round::Previous)
}

/// Checks whether a later stage reads all rounds of an output of a stage.
fn has_reader_of_all_rounds(view: &GraphView<'_>, number: u16, role: Role) -> bool {
    view.graph.readers(number).any(|(_, need)| (need.role, need.round) == (role, Round::Every))
}

/// Returns the key under which the failures of a task are counted.
fn failure_key(stage: &Stage, key: u32) -> (u16, u32, u32) {
    (stage.number, if stage.kind.is_divided() { stage.round } else { 0 }, key)
}
