//! Frame progress: the finished runs and the failures of each stage of a frame, or of the job's own stages.

use std::collections::BTreeMap;
use std::ops::Range;

use femc_model::{
    Blocks, Decision, Digest, Epoch, Failure, FrameRecord, Grains, Graph, Input, Loop, Output, Reach, Role, Round,
    Scope, Stage, Taken, TaskResult, Tick, Uneven,
};
use serde::{Deserialize, Serialize};
use smallvec::SmallVec;

use super::job::Job;
use super::shape::{Place, Shape, read_by};
use super::trouble::Trouble;
use crate::{Casualty, RangeSet};

/// A finished run of sample chunks, with its lease.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Row {
    end: u32,
    epoch: Epoch,
    /// Outputs that are still needed, in most cases one.
    outputs: SmallVec<[Output; 1]>,
}

/// Finished work of a stage in one round.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Array {
    /// Finished runs with outputs that are still needed, by their first key.
    rows: BTreeMap<u32, Row>,
    /// Finished sample chunks whose outputs are no longer needed.
    released: RangeSet,
    /// Number of bad samples of the runs that have any, by their first key.
    bad: BTreeMap<u32, u64>,
    /// Tasks that are completely done.
    whole: RangeSet,
}

impl Array {
    /// Creates the state before any work is done. Tasks without steps count as done.
    fn fresh(grains: &Grains<'_>) -> Self {
        let is_idle = |task: &u32| grains.of_task(*task).is_empty();
        let mut whole = RangeSet::default();
        let tasks = if grains.is_even() { 0..0 } else { 0..grains.tasks() };
        tasks.filter(is_idle).for_each(|task| whole.insert(task));
        Self { whole, ..Self::default() }
    }

    fn is_complete(&self, grains: &Grains<'_>) -> bool {
        self.whole.covers(&(0..grains.tasks()))
    }

    fn is_whole(&self, grains: &Grains<'_>, task: u32) -> bool {
        let keys = grains.of_task(task);
        if keys.len() == 1 && grains.stride() == 1 {
            return self.rows.contains_key(&keys.start) || self.released.contains(keys.start);
        }
        let done: usize = self.rows.range(keys.clone()).map(|(first, row)| (row.end - first) as usize).sum();
        done == keys.len()
            || done + keys.filter(|&key| self.released.contains(key)).count() == grains.of_task(task).len()
    }

    /// Checks whether some of these sample chunks are done.
    fn holds_any(&self, run: &Range<u32>) -> bool {
        let before = self.rows.range(..run.end).next_back();
        before.is_some_and(|(_, row)| row.end > run.start) || self.released.touches(run)
    }
}

/// Progress of a frame with a result or failure, or of the job's own stages.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Unit {
    /// Present round of its loop.
    pub(crate) round: u32,
    /// Whether its loop is over, or it has none.
    is_over: bool,
    /// Time of the first lease of a completed task.
    pub(crate) began: Tick,
    arrays: BTreeMap<Place, Array>,
    /// Steps of the rounds in which they differ between tasks.
    uneven: BTreeMap<u32, Uneven>,
    /// Failures by stage, round and key. Failures of join tasks are counted together for all rounds, so that a frame whose inputs
    /// are lost again and again ends.
    trouble: BTreeMap<(u16, u32, u32), Trouble>,
    /// Epoch of the task that decided how the loop continues after the previous round.
    decided: Option<Epoch>,
    /// Finished units of work in all rounds.
    pub(crate) units: u64,
    pub(crate) bad_samples: u64,
    pub(crate) busy_seconds: f64,
    pub(crate) relative_error: Option<f64>,
    #[serde(deserialize_with = "femc_model::since_version_9")]
    pub(crate) blocks: Option<Blocks>,
    /// Whether it was finished before and one of its results was lost.
    pub(crate) is_again: bool,
}

impl Unit {
    pub(super) fn new(shape: &Shape<'_>, began: Tick) -> Self {
        Self {
            round: 0,
            is_over: shape.around.is_none(),
            began,
            arrays: BTreeMap::new(),
            uneven: BTreeMap::new(),
            trouble: BTreeMap::new(),
            decided: None,
            units: 0,
            bad_samples: 0,
            busy_seconds: 0.0,
            relative_error: None,
            blocks: None,
            is_again: false,
        }
    }

    /// Creates the progress of a formerly finished frame of which a result was lost. It has not begun again.
    pub(super) fn again(shape: &Shape<'_>, record: &FrameRecord) -> Self {
        Self { busy_seconds: record.busy_seconds, is_again: true, ..Self::new(shape, Tick(u64::MAX)) }
    }

    /// Restarts it; its failures are kept.
    pub(super) fn restarted(&mut self, shape: &Shape<'_>) -> Vec<Digest> {
        let released = self.artifacts().collect();
        let trouble = std::mem::take(&mut self.trouble);
        *self = Self { busy_seconds: self.busy_seconds, trouble, ..Self::new(shape, self.began) };
        released
    }

    /// Returns the present stages, each in its rounds.
    pub(crate) fn places(&self, shape: &Shape<'_>) -> impl DoubleEndedIterator<Item = Place> {
        let (around, last, is_over) = (shape.around, self.round, self.is_over);
        let stages = shape.graph.of(shape.scope);
        stages.flat_map(move |(number, _)| rounds_of(number, around, last, is_over).map(move |round| (round, number)))
    }

    fn is_place(&self, shape: &Shape<'_>, place: Place) -> bool {
        let is_of_loop = shape.is_looped(place.1);
        let is_behind = shape.around.is_some_and(|(last, _)| place.1 > last);
        shape.template(place.1).is_some()
            && if is_of_loop { place.0 <= self.round } else { place.0 == 0 && (self.is_over || !is_behind) }
    }

    pub(crate) fn grains<'a>(&'a self, shape: &Shape<'a>, place: Place) -> Option<Grains<'a>> {
        grains(&self.uneven, shape, place)
    }

    /// Checks whether every task of a stage is done.
    pub(crate) fn is_complete(&self, shape: &Shape<'_>, place: Place) -> bool {
        let Some(grains) = self.grains(shape, place) else { return false };
        self.arrays.get(&place).is_some_and(|array| array.is_complete(&grains))
    }

    /// Checks whether everything is done.
    pub(super) fn is_finished(&self, shape: &Shape<'_>) -> bool {
        self.is_over && self.places(shape).all(|place| self.is_complete(shape, place))
    }

    /// Returns the number of finished tasks of a stage.
    pub(crate) fn tasks_done(&self, place: Place) -> u32 {
        self.arrays.get(&place).map_or(0, |array| array.whole.count())
    }

    /// Checks whether a task of a stage is done.
    pub(crate) fn is_done(&self, place: Place, item: u32) -> bool {
        self.are_done(place, item..item + 1)
    }

    /// Checks whether all of these tasks of a stage are done.
    fn are_done(&self, place: Place, items: Range<u32>) -> bool {
        items.is_empty() || self.arrays.get(&place).is_some_and(|array| array.whole.covers(&items))
    }

    /// Checks whether all inputs of a task exist.
    pub(crate) fn has_inputs(&self, shape: &Shape<'_>, place: Place, item: u32) -> bool {
        let Some(template) = shape.template(place.1) else { return false };
        template.needs.iter().all(|need| match shape.template(need.stage) {
            // Whether the outputs of a shared job exist depends on the worker: see `shared.rs`.
            None if shape.scope != Scope::Job => true,
            None => shape.are_frames_there(item, need),
            Some(_) => {
                let mut rounds = shape.rounds_read(place, need, self.round);
                rounds.all(|round| self.are_done((round, need.stage), shape.items_read(item, need)))
            }
        })
    }

    /// Returns the inputs of a task, in order of need, frame and task.
    /// - `shared`: shared job of the frame's content.
    pub(crate) fn inputs(&self, shape: &Shape<'_>, place: Place, item: u32, shared: Option<&Job>) -> Vec<Input> {
        let mut inputs = Vec::new();
        let Some(template) = shape.template(place.1) else { return inputs };
        for (number, need) in template.needs.iter().enumerate() {
            let number = number as u16;
            if shape.template(need.stage).is_none() {
                let items = shape.items_read(item, need);
                let made = shared.into_iter().flat_map(|shared| shared.made(need));
                let made = made.filter(|(item, _)| items.contains(item));
                inputs.extend(made.map(|(item, output)| Input { need: number, frame: Stage::OF_JOB, item, output }));
                if shape.scope == Scope::Job {
                    inputs.extend(shape.inputs_of_frames(number, item, need));
                }
                continue;
            }
            for round in shape.rounds_read(place, need, self.round) {
                let from = (round, need.stage);
                let (Some(array), Some(grains)) = (self.arrays.get(&from), self.grains(shape, from)) else { continue };
                let keys = grains.of_tasks(&shape.items_read(item, need));
                for (&first, row) in array.rows.range(keys) {
                    let of_role = row.outputs.iter().filter(|output| output.role == need.role);
                    let (item, frame) = (grains.task(first), Stage::OF_JOB);
                    inputs.extend(of_role.map(|&output| Input { need: number, frame, item, output }));
                }
            }
        }
        inputs
    }

    /// Returns the number of steps taken so far by each divided task that the inputs of a task are made from.
    pub(crate) fn taken(&self, shape: &Shape<'_>, place: Place, item: u32) -> Taken {
        let cut_sources =
            if shape.is_cut(place.1) { None } else { self.cut_sources(shape, place, item..item + 1, &mut 0) };
        let Some((grains, items)) = cut_sources.and_then(|(place, items)| Some((self.grains(shape, place)?, items)))
        else {
            return Taken::default();
        };
        items.map(|item| grains.steps_of(item).end).collect()
    }

    /// Returns the divided tasks that these tasks of a stage are made from, and their stage in its round.
    /// - `seen`: visited stages, one bit each.
    fn cut_sources(
        &self,
        shape: &Shape<'_>,
        place: Place,
        items: Range<u32>,
        seen: &mut u64,
    ) -> Option<(Place, Range<u32>)> {
        const { assert!(Graph::MAX_STAGES <= u64::BITS as usize) };
        let is_new = *seen >> place.1 & 1 == 0;
        let template = shape.template(place.1).filter(|_| is_new && !items.is_empty())?;
        *seen |= 1 << place.1;
        if template.kind.is_cut() {
            return Some((place, items));
        }
        template.needs.iter().filter(|need| need.round != Round::Before).find_map(|need| {
            let round = shape.rounds_read(place, need, self.round).next_back()?;
            let [first, last] = [items.start, items.end - 1].map(|item| shape.items_read(item, need));
            self.cut_sources(shape, (round, need.stage), first.start..last.end, seen)
        })
    }

    /// Checks whether a result of this run of sample chunks would count: the run lies within one task, its round has begun, and
    /// none of it is done.
    pub(super) fn may_count(&self, shape: &Shape<'_>, place: Place, run: &Range<u32>) -> bool {
        let is_done = || self.arrays.get(&place).is_some_and(|array| array.holds_any(run));
        let is_of_one = |grains: Grains<'_>| !run.is_empty() && run.end <= grains.of_task(grains.task(run.start)).end;
        self.is_place(shape, place) && self.grains(shape, place).is_some_and(is_of_one) && !is_done()
    }

    /// Enters the result of a run of sample chunks; a repetition changes nothing. Returns artifacts that are no longer needed.
    pub(super) fn done(
        &mut self,
        shape: &Shape<'_>,
        stage: &Stage,
        run: &Range<u32>,
        (epoch, leased): (Epoch, Tick),
        result: &TaskResult,
    ) -> Vec<Digest> {
        let place = (stage.round, stage.number);
        let Some(grains) = grains(&self.uneven, shape, place).filter(|_| self.may_count(shape, place, run)) else {
            return Vec::new();
        };
        let item = grains.task(run.start);
        let (mut outputs, mut released) = (SmallVec::new(), Vec::new());
        for &output in &result.outputs {
            if self.is_needed(shape, place, item, output.role) {
                outputs.push(output);
            } else {
                released.push(output.artifact.digest);
            }
        }
        let array = self.arrays.entry(place).or_insert_with(|| Array::fresh(&grains));
        if outputs.is_empty() {
            array.released.add(run.clone());
        } else {
            array.rows.insert(run.start, Row { end: run.end, epoch, outputs });
        }
        if *run == grains.of_task(item) || array.is_whole(&grains, item) {
            array.whole.insert(item);
        }
        if result.bad_samples > 0 {
            array.bad.insert(run.start, result.bad_samples);
        }
        self.began = self.began.min(leased);
        self.busy_seconds += result.seconds;
        if result.blocks.is_some() || result.relative_error.is_some() {
            (self.relative_error, self.blocks) = (result.relative_error, result.blocks);
        }
        self.units += result.units;
        self.bad_samples += result.bad_samples;
        if stage.kind.is_cut() {
            self.trouble.retain(|(number, round, key), _| (*round, *number) != place || !run.contains(key));
        }
        if !self.close(shape, place, epoch, result.decision.as_ref(), &mut released) {
            self.release_inputs(shape, place, item, &mut released);
        }
        released
    }

    /// Continues or ends the loop if this task closes the present round. Returns whether it does.
    fn close(
        &mut self,
        shape: &Shape<'_>,
        (round, number): Place,
        epoch: Epoch,
        decision: Option<&Decision>,
        released: &mut Vec<Digest>,
    ) -> bool {
        let closes = shape.around.is_some_and(|(last, _)| last == number);
        if !closes || round != self.round || self.is_over {
            return false;
        }
        self.decided = Some(epoch);
        match decision {
            Some(Decision::Continue) if shape.may_go_on(round) => self.next_round(shape, None),
            Some(Decision::Steps(to)) if shape.may_go_on(round) => self.next_round(shape, Some(to)),
            _ => self.is_over = true,
        }
        let places: Vec<Place> = self.arrays.keys().copied().collect();
        for place in places {
            let tasks = shape.template(place.1).map_or(0, |template| template.tasks());
            self.release_unneeded(shape, place, 0..tasks, released);
        }
        true
    }

    /// Begins the next round.
    /// - `to`: number of steps of each task at the end of the round; `None`: as planned.
    fn next_round(&mut self, shape: &Shape<'_>, to: Option<&[u32]>) {
        self.round += 1;
        let Some((number, template)) = shape.main() else { return };
        if to.is_none() && !self.uneven.contains_key(&(self.round - 1)) {
            return;
        }
        let planned = vec![template.steps_of(self.round).end; template.tasks() as usize];
        let uneven = self.next_steps(shape, to.unwrap_or(&planned));
        self.uneven.insert(self.round, uneven);
        // A stage without remaining steps would never be entered by a result.
        let place = (self.round, number);
        if let Some(grains) = grains(&self.uneven, shape, place) {
            self.arrays.insert(place, Array::fresh(&grains));
        }
    }

    /// Returns the steps of the next round: never fewer than are already done.
    fn next_steps(&self, shape: &Shape<'_>, to: &[u32]) -> Uneven {
        let main = shape.main();
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
        Uneven { from, to }
    }

    /// Checks whether an output of a task is a result, or needed by a task that is not done.
    fn is_needed(&self, shape: &Shape<'_>, place: Place, item: u32, role: Role) -> bool {
        role.row().is_result
            || shape.graph.readers(place.1).filter(|(_, need)| need.role == role).any(|(reader, need)| {
                let Some(template) = shape.template(reader) else {
                    return shape.is_read_beyond(place, need, self.round);
                };
                let readers = read_by(need.reach, item, template.tasks());
                let is_open = |round: u32| !self.are_done((round, reader), readers.clone());
                match need.round {
                    Round::Before => {
                        let goes_on = !self.is_over && self.round <= place.0 + 1;
                        goes_on || (place.0 < self.round && is_open(place.0 + 1))
                    }
                    Round::Every => is_open(0),
                    Round::Same if !shape.is_looped(place.1) && shape.is_looped(reader) => {
                        !self.is_over || (0..self.round + 1).any(is_open)
                    }
                    Round::Same if shape.is_looped(place.1) && !shape.is_looped(reader) => {
                        place.0 == self.round && is_open(0)
                    }
                    Round::Same => is_open(place.0),
                }
            })
    }

    /// Releases the outputs of these tasks that are no longer needed. A stage reads itself only in other rounds, or as a chain; the
    /// outputs of a chain are not released.
    fn release_unneeded(&mut self, shape: &Shape<'_>, place: Place, items: Range<u32>, released: &mut Vec<Digest>) {
        let Some((keys, stride)) = self.grains(shape, place).map(|it| (it.of_tasks(&items), it.stride())) else {
            return;
        };
        let Some(mut array) = self.arrays.remove(&place) else { return };
        let emptied = array.rows.extract_if(keys, |&first, row| {
            row.outputs.retain(|output| {
                let is_needed = self.is_needed(shape, place, first / stride, output.role);
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
            array.released.add(run);
        }
        self.arrays.insert(place, array);
    }

    /// Releases the inputs of a task that are no longer needed.
    fn release_inputs(&mut self, shape: &Shape<'_>, place: Place, item: u32, released: &mut Vec<Digest>) {
        let needs = shape.template(place.1).map_or(&[][..], |template| &template.needs);
        for need in needs.iter().filter(|need| shape.template(need.stage).is_some()) {
            if need.reach == Reach::All && !self.is_complete(shape, place) {
                continue;
            }
            for round in shape.rounds_read(place, need, self.round) {
                self.release_unneeded(shape, (round, need.stage), shape.items_read(item, need), released);
            }
        }
    }

    /// Returns the runs of sample chunks that made one of these artifacts, if it is still needed.
    pub(crate) fn producers(&self, lost: &[Digest]) -> Vec<(Place, u32)> {
        let is_hurt = |row: &Row| row.outputs.iter().any(|output| lost.contains(&output.artifact.digest));
        let rows = self
            .arrays
            .iter()
            .flat_map(|(&place, array)| array.rows.iter().map(move |(&first, row)| (place, first, row)));
        rows.filter(|(.., row)| is_hurt(row)).map(|(place, first, _)| (place, first)).collect()
    }

    /// Marks the run that begins with this key as not done, because its outputs are lost, together with the producers of its
    /// missing inputs. Its other outputs stay in the store, where some task may be reading them; the repetition makes the same
    /// ones.
    pub(super) fn lost(&mut self, shape: &Shape<'_>, place: Place, first: u32) {
        if let Some(end) = self.arrays.get(&place).and_then(|array| array.rows.get(&first)).map(|row| row.end) {
            self.undo(shape, place, first..end);
        }
    }

    fn undo(&mut self, shape: &Shape<'_>, place: Place, run: Range<u32>) {
        let Some(template) = shape.template(place.1) else { return };
        let (Some(grains), Some(array)) = (grains(&self.uneven, shape, place), self.arrays.get_mut(&place)) else {
            return;
        };
        let item = grains.task(run.start);
        let was_whole = array.is_whole(&grains, item);
        let units = |run: &Range<u32>| if template.kind.is_cut() { grains.units(run) } else { 0 };
        let (mut forgotten, mut bad) = (0, 0);
        let rows: Vec<u32> = array.rows.range(run.clone()).map(|(&first, _)| first).collect();
        for first in rows {
            let Some(row) = array.rows.remove(&first) else { continue };
            forgotten += units(&(first..row.end));
        }
        let released: Vec<u32> = run.clone().filter(|&key| array.released.contains(key)).collect();
        for key in released {
            array.released.remove(key..key + 1);
            forgotten += units(&(key..key + 1));
        }
        let refused: Vec<u32> = array.bad.range(run).map(|(&first, _)| first).collect();
        refused.into_iter().filter_map(|first| array.bad.remove(&first)).for_each(|count| bad += count);
        if was_whole && !array.is_whole(&grains, item) {
            array.whole.remove(item..item + 1);
        }
        self.units -= forgotten;
        self.bad_samples -= bad;
        for need in template.needs.iter().filter(|need| shape.template(need.stage).is_some()) {
            for round in shape.rounds_read(place, need, self.round) {
                for item in shape.items_read(item, need) {
                    self.undo_released(shape, (round, need.stage), item, need.role);
                }
            }
        }
    }

    /// Marks a finished task as not done if its output of this role no longer exists.
    fn undo_released(&mut self, shape: &Shape<'_>, place: Place, item: u32, role: Role) {
        let Some(keys) = self.grains(shape, place).map(|grains| grains.of_task(item)) else { return };
        let Some(array) = self.arrays.get(&place) else { return };
        let lacks = |row: &Row| row.outputs.iter().all(|output| output.role != role);
        if array.released.touches(&keys) || array.rows.range(keys.clone()).any(|(_, row)| lacks(row)) {
            self.undo(shape, place, keys);
        }
    }

    /// Returns the keys of a stage that are neither done nor quarantined.
    pub(crate) fn open_keys(&self, shape: &Shape<'_>, place: Place) -> RangeSet {
        let Some(grains) = self.grains(shape, place).filter(|_| self.is_place(shape, place)) else {
            return RangeSet::default();
        };
        let mut open = RangeSet::default();
        if grains.is_even() {
            open.add(grains.all());
        } else {
            (0..grains.tasks()).for_each(|task| open.add(grains.of_task(task)));
        }
        if let Some(array) = self.arrays.get(&place) {
            array.rows.iter().for_each(|(&first, row)| open.remove(first..row.end));
            array.released.ranges().for_each(|run| open.remove(run));
        }
        for (number, round, key) in self.quarantined().map(|(name, _)| name) {
            if number == place.1 && (round == place.0 || !shape.is_cut(number)) {
                open.remove(key..key + 1);
            }
        }
        open
    }

    /// Returns the tasks that can run, by stage: neither done nor quarantined, with all inputs.
    pub(crate) fn open(&self, shape: &Shape<'_>) -> Vec<(Place, RangeSet)> {
        let mut all = Vec::new();
        for place in self.places(shape).filter(|&place| !self.is_complete(shape, place)) {
            let (Some(template), Some(grains)) = (shape.template(place.1), self.grains(shape, place)) else { continue };
            let mut keys = self.open_keys(shape, place);
            if template.needs.iter().all(|need| need.reach == Reach::All) {
                if !keys.is_empty() && !self.has_inputs(shape, place, 0) {
                    continue;
                }
            } else {
                let items: Vec<u32> =
                    keys.ranges().flat_map(|run| grains.task(run.start)..grains.task(run.end - 1) + 1).collect();
                let unready = items.into_iter().filter(|&item| !self.has_inputs(shape, place, item));
                unready.for_each(|item| keys.remove(grains.of_tasks(&(item..item + 1))));
            }
            if !keys.is_empty() {
                all.push((place, keys));
            }
        }
        all
    }

    /// Returns the keys of the tasks that can run now that this task is done, by stage.
    pub(crate) fn runnable_after(&self, shape: &Shape<'_>, stage: &Stage, key: u32) -> Vec<(Place, RangeSet)> {
        let mut all = Vec::new();
        let from = (stage.round, stage.number);
        let Some(grains) = self.grains(shape, from) else { return all };
        let item = grains.task(key);
        if !self.are_done(from, item..item + 1) {
            return all;
        }
        for (reader, need) in shape.graph.readers(stage.number) {
            let Some(template) = shape.template(reader) else { continue };
            if need.reach == Reach::All && !self.is_complete(shape, from) {
                continue;
            }
            for round in rounds_of(reader, shape.around, self.round, self.is_over) {
                let place = (round, reader);
                if !shape.rounds_read(place, need, self.round).contains(&stage.round) {
                    continue;
                }
                let keys = self.runnable_among(shape, place, read_by(need.reach, item, template.tasks()));
                if !keys.is_empty() {
                    all.push((place, keys));
                }
            }
        }
        all
    }

    /// Returns the keys of the job's own tasks that can run now that this frame has ended, by stage.
    pub(crate) fn runnable_after_frame(&self, shape: &Shape<'_>, frame: u32) -> Vec<(Place, RangeSet)> {
        let mut all = Vec::new();
        for place in self.places(shape) {
            let needs = shape.template(place.1).map_or(&[][..], |template| &template.needs);
            let fed = needs.iter().filter_map(|need| shape.reads_frame(place.1, need, frame));
            for fed in fed.collect::<Vec<_>>() {
                let keys = self.runnable_among(shape, place, fed);
                if !keys.is_empty() {
                    all.push((place, keys));
                }
            }
        }
        all
    }

    /// Returns the keys of those of these tasks that can run.
    fn runnable_among(&self, shape: &Shape<'_>, place: Place, items: Range<u32>) -> RangeSet {
        // In most cases none of them can run.
        let mut ready = items.filter(|&item| self.has_inputs(shape, place, item)).peekable();
        let Some(grains) = self.grains(shape, place).filter(|_| ready.peek().is_some()) else {
            return RangeSet::default();
        };
        let (mut keys, open) = (RangeSet::default(), self.open_keys(shape, place));
        for key in ready.flat_map(|item| grains.of_task(item)).filter(|&key| open.contains(key)) {
            keys.insert(key);
        }
        keys
    }

    /// Counts a failed attempt of a task.
    pub(super) fn failed(&mut self, stage: &Stage, key: u32, until: Epoch, failure: &Failure) {
        let trouble = self.trouble.entry(name(stage, key)).or_insert_with(|| Trouble::new(failure.clone()));
        trouble.failed(until, failure);
    }

    /// Checks whether this lease of a task was over when the task's last failure was counted.
    pub(crate) fn is_over_for(&self, stage: &Stage, key: u32, epoch: Epoch) -> bool {
        self.trouble.get(&name(stage, key)).is_some_and(|trouble| trouble.is_over(epoch))
    }

    /// Counts the death of a worker for these tasks, one or more of which it died of.
    pub(super) fn died(&mut self, stage: &Stage, keys: impl Iterator<Item = u32>, casualty: &Casualty) {
        for key in keys {
            let failure = Failure::Killed { deaths: 0, worker: String::new() };
            self.trouble.entry(name(stage, key)).or_insert_with(|| Trouble::new(failure)).died(casualty);
        }
    }

    pub(super) fn lives(&mut self, instance: u64) {
        self.trouble.retain(|_, trouble| trouble.lives(instance));
    }

    pub(super) fn presumed_dead(&self) -> impl Iterator<Item = u64> + '_ {
        self.trouble.values().flat_map(Trouble::presumed_dead)
    }

    pub(super) fn clear_trouble(&mut self) {
        self.trouble.clear();
    }

    /// Returns the first key of a run that has failed before.
    pub(crate) fn first_trouble(&self, stage: &Stage, run: &Range<u32>) -> Option<u32> {
        let keys = name(stage, run.start)..name(stage, run.end);
        self.trouble.range(keys).next().map(|(&(.., key), _)| key)
    }

    /// Checks whether a task is quarantined.
    pub(crate) fn is_put_aside(&self, stage: &Stage, key: u32) -> bool {
        self.trouble.get(&name(stage, key)).is_some_and(Trouble::is_quarantined)
    }

    /// Returns the tasks with failed attempts, by stage, round and key.
    pub(crate) fn troubles(&self) -> impl Iterator<Item = ((u16, u32, u32), &Trouble)> + '_ {
        self.trouble.iter().map(|(&name, trouble)| (name, trouble))
    }

    /// Returns the quarantined tasks, by stage, round and key.
    pub(crate) fn quarantined(&self) -> impl Iterator<Item = ((u16, u32, u32), &Trouble)> + '_ {
        self.trouble.iter().filter(|(_, trouble)| trouble.is_quarantined()).map(|(&name, trouble)| (name, trouble))
    }

    /// Checks whether none of its tasks can run without a retry.
    pub(super) fn is_blocked(&self, shape: &Shape<'_>) -> bool {
        self.quarantined().next().is_some() && self.open(shape).is_empty()
    }

    /// Returns all artifacts that it needs.
    pub(crate) fn artifacts(&self) -> impl Iterator<Item = Digest> + '_ {
        self.outputs().map(|(.., output)| output.artifact.digest)
    }

    /// Returns its existing outputs, with the place of the stage and the first key.
    pub(super) fn outputs(&self) -> impl Iterator<Item = (Place, u32, Output)> + '_ {
        let rows = self
            .arrays
            .iter()
            .flat_map(|(&place, array)| array.rows.iter().map(move |(&first, row)| (place, first, row)));
        rows.flat_map(|(place, first, row)| row.outputs.iter().map(move |&output| (place, first, output)))
    }

    /// Returns the outputs for a preview: results and outputs that may become results, with each sample once. Outputs that were
    /// merged into others are not needed any more. The sums of earlier rounds are left out if this round includes them.
    pub(crate) fn shown(&self, shape: &Shape<'_>) -> Vec<Output> {
        let is_carried = |(round, number): Place, role: Role| {
            shape.graph.readers(number).any(|(_, need)| (need.role, need.round) == (role, Round::Before))
                && round < self.round
        };
        let has_successor = |(round, number): Place, first: u32| {
            self.arrays.get(&(round + 1, number)).is_some_and(|array| array.rows.contains_key(&first))
        };
        let is_shown = |&(place, first, output): &(Place, u32, Output)| {
            let is_of_now = place.0 == self.round && !is_before_only(shape, place.1, output.role);
            is_of_now || (is_carried(place, output.role) && place.0 + 1 == self.round && !has_successor(place, first))
        };
        self.outputs().filter(is_shown).map(|(.., output)| output).collect()
    }

    /// Checks whether it holds this completion.
    pub(super) fn holds(&self, shape: &Shape<'_>, stage: &Stage, key: u32, epoch: Epoch) -> bool {
        let place = (stage.round, stage.number);
        let row = self.arrays.get(&place).and_then(|array| array.rows.get(&key));
        let has_decided = || self.decided == Some(epoch) && self.decider(shape) == Some((place, key));
        shape.template(stage.number).is_some_and(|template| template.kind == stage.kind)
            && (row.is_some_and(|row| row.epoch == epoch) || has_decided())
    }

    /// Returns the task that decided last, which closed the previous round or the last one.
    fn decider(&self, shape: &Shape<'_>) -> Option<(Place, u32)> {
        let (number, _) = shape.around?;
        Some(((self.round.checked_sub(u32::from(!self.is_over))?, number), 0))
    }
}

/// Returns the present rounds of a stage.
/// - `around`: loop of its scope;
/// - `last`: present round of the loop.
fn rounds_of(number: u16, around: Option<(u16, Loop)>, last: u32, is_over: bool) -> Range<u32> {
    match around {
        Some((end, it)) if (it.first..=end).contains(&number) => 0..last + 1,
        Some((end, _)) if number > end && !is_over => 0..0,
        _ => 0..1,
    }
}

fn grains<'a>(uneven: &'a BTreeMap<u32, Uneven>, shape: &Shape<'a>, place: Place) -> Option<Grains<'a>> {
    shape.grains(place, uneven.get(&place.0).filter(|_| shape.is_looped(place.1)))
}

/// Checks whether only the next round reads an output.
fn is_before_only(shape: &Shape<'_>, number: u16, role: Role) -> bool {
    let mut readers = shape.graph.readers(number).filter(|(_, need)| need.role == role).peekable();
    readers.peek().is_some() && readers.all(|(_, need)| need.round == Round::Before)
}

/// Returns the key under which the failures of a task are counted.
fn name(stage: &Stage, key: u32) -> (u16, u32, u32) {
    (stage.number, if stage.kind.is_cut() { stage.round } else { 0 }, key)
}
