//! A job in the ledger.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use femc_model::{
    Blocks, Control, Cut, Digest, Epoch, Failure, FrameRecord, FrameStop, Grains, Input, JobSpec, Need, Output, Scope,
    Stage, TaskKey, TaskResult, Tick, WorstFrame,
};
use serde::{Deserialize, Serialize};

use super::hints::Hints;
use super::shape::{Place, Shape};
use super::unit::Unit;
use crate::{Casualty, RangeSet};

/// User control of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Hold {
    /// The job may run.
    Free,
    /// The job is paused.
    Paused,
    /// The job is cancelled.
    Cancelled,
}

/// An output of a finished frame that stages of the job read: of the last round, or of every round if they read all rounds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Made {
    /// Number of the stage that made it.
    pub(super) stage: u16,
    pub(super) item: u32,
    pub(super) output: Output,
}

/// A finished frame, or the finished stages of the job, with the lease that finished it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Finished {
    /// Stage, key and epoch of the last task, so that a repeated completion gets the same answer.
    last: (Stage, u32, Epoch),
    /// Record of the frame, for `femc fetch`.
    pub(crate) record: FrameRecord,
    /// Number of its units of work.
    units: u64,
    /// Outputs that stages of the job read. They are kept as long as the job.
    pub(super) made: Vec<Made>,
}

impl Finished {
    fn artifacts(&self) -> impl Iterator<Item = Digest> + '_ {
        let outputs = self.record.outputs.iter().chain(self.made.iter().map(|made| &made.output));
        outputs.map(|output| output.artifact.digest)
    }
}

/// Identity of a shared job: the stages of one content, done by one build of the engine.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(crate) struct Shared {
    pub(crate) key: Digest,
    pub(crate) engine: String,
}

/// A job: its specification and its progress. A shared job has only one unit, its own stages, and no frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Job {
    pub(crate) spec: Box<JobSpec>,
    pub(crate) hold: Hold,
    pub(crate) doom: Option<Failure>,
    /// Time of the first lease of a completed task.
    pub(crate) began: Option<Tick>,
    pub(crate) ended: Option<Tick>,
    /// Unfinished frames with some result or failure, and the job's own stages under [`Stage::OF_JOB`]. All other frames need no
    /// memory.
    pub(crate) units: BTreeMap<u32, Unit>,
    pub(crate) finished: BTreeMap<u32, Finished>,
    /// Blocked frames, which stay blocked until a retry.
    pub(crate) blocked: BTreeSet<u32>,
    /// Relative error of the frame measured last. Statuses show that of the worst frame; the field remains because the log stores
    /// fields by position.
    relative_error: Option<f64>,
    /// Blocks of the frame measured last; it remains for the same reason.
    #[serde(deserialize_with = "femc_model::since_version_9")]
    blocks: Option<Blocks>,
    submitted: Tick,
    /// Calendar date of the submission: Unix time in milliseconds.
    #[serde(deserialize_with = "femc_model::since_version_10")]
    pub(crate) date: Option<u64>,
    /// Whether its ends are announced; not for jobs submitted before version 11 of the log.
    #[serde(deserialize_with = "femc_model::since_version_11")]
    announces: bool,
    /// Whether it has ended and the end is not announced to all recipients yet.
    #[serde(deserialize_with = "femc_model::since_version_11")]
    pub(crate) is_unannounced: bool,
    cut: Cut,
    pub(crate) shared: Option<Shared>,
    /// Number of frames that are neither finished nor blocked, by the key of their content.
    left: BTreeMap<Digest, u32>,
    /// Hints for tasks of the next frames.
    hints: Hints,
}

/// Returns the [`Shape`] of a frame number. The macro borrows all fields of the job except its units.
macro_rules! shape {
    ($job:expr, $frame:expr) => {{
        let scope = if $job.shared.is_some() { Scope::Content } else { Shape::scope_of($frame) };
        Shape {
            graph: &$job.spec.graph,
            scope,
            around: $job.spec.graph.loop_of(scope),
            cut: $job.cut,
            frames: if $job.shared.is_some() { &[] } else { &$job.spec.frames },
            finished: &$job.finished,
            blocked: &$job.blocked,
        }
    }};
}

impl Job {
    pub(super) fn new(spec: Box<JobSpec>, shared: Option<Shared>, cut: Cut, now: Tick) -> Self {
        let mut left = BTreeMap::new();
        let mut first = 0;
        for (end, key) in spec.contents.iter().filter(|_| shared.is_none()) {
            *left.entry(*key).or_default() += end - std::mem::replace(&mut first, *end);
        }
        Self {
            spec,
            hold: Hold::Free,
            doom: None,
            began: None,
            ended: None,
            units: BTreeMap::new(),
            finished: BTreeMap::new(),
            blocked: BTreeSet::new(),
            relative_error: None,
            blocks: None,
            submitted: now,
            date: None,
            announces: false,
            is_unannounced: false,
            cut,
            shared,
            left,
            hints: Hints::default(),
        }
    }

    /// Sets the calendar date of the submission, Unix time in milliseconds.
    pub(super) fn submitted_at(self, date: Option<u64>) -> Self {
        Self { date, ..self }
    }

    /// Sets whether its ends are announced.
    pub(super) fn announcing(self, announces: bool) -> Self {
        Self { announces, ..self }
    }

    /// Returns its frames, ascending.
    pub(crate) fn frames(&self) -> &[u32] {
        if self.shared.is_some() { &[] } else { &self.spec.frames }
    }

    /// Returns the key of a frame's content.
    pub(crate) fn content(&self, frame: u32) -> Option<Digest> {
        if self.spec.contents.is_empty() {
            return None;
        }
        self.spec.content(self.frames().binary_search(&frame).ok()?)
    }

    /// Returns the contents of the frames for which `is_meant` holds.
    pub(crate) fn contents_of(&self, is_meant: impl Fn(u32) -> bool) -> BTreeSet<Digest> {
        let mut first = 0;
        let runs = self.spec.contents.iter().map(|(end, key)| (std::mem::replace(&mut first, *end)..*end, key));
        let frames = |run: Range<u32>| self.frames().get(run.start as usize..run.end as usize).unwrap_or_default();
        runs.filter(|(run, _)| frames(run.clone()).iter().any(|&frame| is_meant(frame))).map(|(_, key)| *key).collect()
    }

    /// Checks whether the frame is blocked or has a quarantined task.
    pub(crate) fn has_trouble(&self, frame: u32) -> bool {
        let unit = self.units.get(&frame);
        self.blocked.contains(&frame) || unit.is_some_and(|unit| unit.quarantined().next().is_some())
    }

    /// Checks whether frames with this content still have to be finished.
    pub(crate) fn needs(&self, key: &Digest) -> bool {
        self.left.get(key).is_some_and(|&left| left > 0)
    }

    /// Checks whether some of its frames with this content are blocked.
    pub(crate) fn has_blocked_frames_of(&self, key: &Digest) -> bool {
        self.blocked.iter().any(|&frame| self.content(frame).as_ref() == Some(key))
    }

    /// Returns the contents of the frames that still have to be finished.
    pub(crate) fn contents(&self) -> impl Iterator<Item = Digest> + '_ {
        self.left.iter().filter(|(_, left)| **left > 0).map(|(key, _)| *key)
    }

    /// Notes whether a frame still has to be finished.
    fn note_left(&mut self, frame: u32, is_left: bool) {
        let Some(left) = self.content(frame).and_then(|key| self.left.get_mut(&key)) else { return };
        *left = if is_left { *left + 1 } else { left.saturating_sub(1) };
    }

    /// Returns the granularity at which its tasks are divided.
    pub(crate) fn cut(&self) -> Cut {
        self.cut
    }

    /// Returns the part of the graph that belongs to this frame, or to the job as a whole.
    pub(crate) fn shape(&self, frame: u32) -> Shape<'_> {
        shape!(self, frame)
    }

    /// Returns the tags that a worker needs for a stage's tasks, in addition to the job's tags.
    pub(crate) fn tags_of(&self, number: u16) -> &[String] {
        self.spec.graph.stage(number).map_or(&[], |template| &template.tags)
    }

    /// Returns the progress of the frame; an empty one if it has not begun.
    pub(crate) fn unit(&self, frame: u32) -> Cow<'_, Unit> {
        match self.units.get(&frame) {
            Some(unit) => Cow::Borrowed(unit),
            None => Cow::Owned(self.fresh(frame)),
        }
    }

    /// Returns the numbering of the sample chunks of a stage.
    pub(crate) fn grains(&self, stage: &Stage) -> Option<Grains<'_>> {
        let (shape, place) = (self.shape(stage.frame), (stage.round, stage.number));
        match self.units.get(&stage.frame) {
            Some(unit) => unit.grains(&shape, place),
            None => shape.grains(place, None),
        }
    }

    /// Returns the progress of a frame that has not begun.
    pub(crate) fn fresh(&self, frame: u32) -> Unit {
        Unit::new(&self.shape(frame), Tick(u64::MAX))
    }

    /// Checks whether it is a shared job that has ended without being done. Only a retry can finish it.
    pub(crate) fn is_stuck(&self) -> bool {
        self.shared.is_some() && self.has_ended() && !self.is_done()
    }

    /// Returns the bytes of the artifacts that it keeps for others, whether it is finished or not, and of its description.
    pub(crate) fn bytes(&self) -> u64 {
        let made = self.finished.values().flat_map(|finished| &finished.made).map(|made| made.output);
        let in_work = self.units.values().flat_map(|unit| unit.outputs().map(|(.., output)| output));
        let artifacts: u64 = made.chain(in_work).map(|output| output.artifact.bytes).sum();
        let stages = self.spec.graph.stages.iter();
        let stages: usize = stages.map(|it| it.options.len() + size_of_val(it.sizes.runs())).sum();
        artifacts + (self.spec.settings.len() + stages) as u64
    }

    /// Returns the time of its submission.
    pub(crate) fn submitted(&self) -> Tick {
        self.submitted
    }

    /// Returns the time when it ended, or when it was submitted if it has not ended.
    pub(crate) fn dated(&self) -> Tick {
        self.ended.unwrap_or(self.submitted)
    }

    /// Returns the outputs of a finished shared job for one need of a frame's task.
    pub(crate) fn made(&self, need: &Need) -> impl Iterator<Item = (u32, Output)> + use<'_> {
        let (stage, role) = (need.stage, need.role);
        let made = self.finished.values().flat_map(|finished| &finished.made);
        made.filter(move |made| (made.stage, made.output.role) == (stage, role)).map(|made| (made.item, made.output))
    }

    /// Returns the units of work in finished frames.
    pub(crate) fn finished_units(&self) -> u64 {
        self.finished.values().map(|finished| finished.units).sum()
    }

    /// Checks whether it has stages that are done once for the whole job.
    pub(crate) fn has_job_stages(&self) -> bool {
        self.shared.is_some() || self.spec.graph.has_job()
    }

    /// Returns the frame with the greatest relative error so far, with its error and blocks. A frame without light comes after all
    /// others.
    pub(crate) fn worst_frame(&self) -> Option<(WorstFrame, Option<f64>, Option<Blocks>)> {
        let rounds = self.spec.graph.loop_of(Scope::Frame).map_or(1, |(_, around)| around.rounds);
        let finished = self.finished.iter().map(|(&frame, Finished { record, .. })| {
            let stop = match record.rounds {
                Some(taken) if taken >= rounds => FrameStop::Limit,
                Some(_) => FrameStop::Estimate,
                None => FrameStop::Unknown,
            };
            (WorstFrame { frame, stop }, record.relative_error, record.blocks)
        });
        let in_work = self
            .units
            .iter()
            .map(|(&frame, unit)| (WorstFrame { frame, stop: FrameStop::Rendering }, unit.relative_error, unit.blocks));
        let is_measured = |(worst, error, blocks): &(WorstFrame, Option<f64>, Option<Blocks>)| {
            worst.frame != Stage::OF_JOB && (error.is_some() || blocks.is_some())
        };
        let size = |error: Option<f64>| error.unwrap_or(-1.0);
        finished.chain(in_work).filter(is_measured).reduce(|worst, next| {
            let order = size(next.1).total_cmp(&size(worst.1)).then(worst.0.frame.cmp(&next.0.frame));
            if order.is_gt() { next } else { worst }
        })
    }

    /// Returns the number of finished frames.
    pub(crate) fn frames_done(&self) -> usize {
        self.finished.len() - usize::from(self.finished.contains_key(&Stage::OF_JOB))
    }

    /// Returns the number of blocked frames.
    pub(crate) fn frames_blocked(&self) -> usize {
        self.blocked.len() - usize::from(self.blocked.contains(&Stage::OF_JOB))
    }

    /// Checks whether everything is finished.
    pub(crate) fn is_done(&self) -> bool {
        self.finished.len() == self.frames().len() + usize::from(self.has_job_stages())
    }

    /// Checks whether every frame and the job's own stages are finished or blocked, or the job is cancelled or has failed as a
    /// whole.
    pub(crate) fn has_ended(&self) -> bool {
        self.hold == Hold::Cancelled
            || self.doom.is_some()
            || self.finished.len() + self.blocked.len() == self.frames().len() + usize::from(self.has_job_stages())
    }

    /// Checks whether the job is cancelled or has failed as a whole: only a retry continues it.
    pub(crate) fn is_over(&self) -> bool {
        self.hold == Hold::Cancelled || self.doom.is_some()
    }

    /// Checks whether its tasks may be leased.
    pub(crate) fn is_runnable(&self) -> bool {
        self.hold == Hold::Free && !self.has_ended()
    }

    /// Checks whether the frame belongs to the job and is neither finished nor blocked.
    pub(crate) fn is_open(&self, frame: u32) -> bool {
        let is_there =
            if frame == Stage::OF_JOB { self.has_job_stages() } else { self.frames().binary_search(&frame).is_ok() };
        is_there && !self.finished.contains_key(&frame) && !self.blocked.contains(&frame)
    }

    /// Checks whether the stage belongs to the job, its frame is open, and its round has begun.
    fn is_current(&self, stage: &Stage) -> bool {
        self.is_open(stage.frame)
            && self.shape(stage.frame).template(stage.number).is_some_and(|template| template.kind == stage.kind)
            && stage.round <= self.units.get(&stage.frame).map_or(0, |unit| unit.round)
    }

    fn begin(&mut self, frame: u32, began: Tick) -> &mut Unit {
        self.began.get_or_insert(began);
        let shape = shape!(self, frame);
        self.units.entry(frame).or_insert_with(|| Unit::new(&shape, began))
    }

    pub(super) fn done(
        &mut self,
        task: &TaskKey,
        end: u32,
        (epoch, leased): (Epoch, Tick),
        result: &TaskResult,
        now: Tick,
    ) -> Vec<Digest> {
        let frame = task.stage.frame;
        if !self.is_current(&task.stage) {
            return Vec::new();
        }
        self.begin(frame, leased);
        let shape = shape!(self, frame);
        let Some(unit) = self.units.get_mut(&frame) else { return Vec::new() };
        let mut released = unit.done(&shape, &task.stage, &(task.index..end), (epoch, leased), result);
        if frame != Stage::OF_JOB && (result.blocks.is_some() || result.relative_error.is_some()) {
            (self.relative_error, self.blocks) = (result.relative_error, result.blocks);
        }
        if unit.is_finished(&shape) {
            let last = (task.stage, task.index, epoch);
            let finished = finished(&shape, unit, frame, last, now);
            self.finished.insert(frame, finished);
            self.units.remove(&frame);
            self.note_left(frame, false);
            released.extend(self.forget_hints(frame));
        }
        self.note_block(frame);
        released
    }

    /// Returns the task that a key belongs to.
    pub(crate) fn item(&self, stage: &Stage, key: u32) -> Option<u32> {
        self.grains(stage).map(|grains| grains.task(key))
    }

    /// Keeps the outputs of a completed task as hints for the next frame. Returns the artifacts that are no longer referenced.
    pub(super) fn note_hints(&mut self, task: &TaskKey, end: u32, engine: &str, result: &TaskResult) -> Vec<Digest> {
        let (stage, shape) = (&task.stage, shape!(self, task.stage.frame));
        let place = (stage.round, stage.number);
        let unit = self.units.get(&stage.frame);
        let counts = || unit.is_none_or(|unit| unit.may_count(&shape, place, &(task.index..end)));
        let Some(grains) = shape.grains(place, None).filter(|_| self.is_current(stage) && counts()) else {
            return Vec::new();
        };
        self.hints.note(&shape, stage, (grains.task(task.index), task.index), engine, result)
    }

    /// Returns the keys of a task.
    pub(crate) fn keys_of(&self, stage: &Stage, item: u32) -> Range<u32> {
        self.grains(stage).map_or(0..0, |grains| grains.of_task(item))
    }

    /// Returns the hints from the previous frame for a task, for a worker of this build.
    pub(crate) fn hints(&self, stage: &Stage, item: u32, engine: &str) -> Vec<Input> {
        if self.hints.is_empty() {
            return Vec::new();
        }
        let place = self.frames().binary_search(&stage.frame).ok().and_then(|place| place.checked_sub(1));
        let before = place.and_then(|place| self.frames().get(place));
        let hints = |&before| self.hints.of(&self.shape(stage.frame), before, (stage.number, item), engine);
        before.map(hints).unwrap_or_default()
    }

    /// Removes hints when a frame is finished: those of the previous frame, and its own if the next frame is finished or there is
    /// none. Returns the artifacts that are no longer referenced.
    fn forget_hints(&mut self, frame: u32) -> Vec<Digest> {
        if self.hints.is_empty() {
            return Vec::new();
        }
        let Ok(place) = self.frames().binary_search(&frame) else { return Vec::new() };
        let before = place.checked_sub(1).map(|before| self.frames()[before]);
        let is_last = self.frames().get(place + 1).is_none_or(|behind| self.finished.contains_key(behind));
        let unseen: Vec<u32> = before.into_iter().chain(is_last.then_some(frame)).collect();
        unseen.into_iter().flat_map(|frame| self.hints.forget(frame)).collect()
    }

    pub(super) fn failed(&mut self, task: &TaskKey, until: Epoch, failure: &Failure, now: Tick) -> Vec<Digest> {
        if self.is_current(&task.stage) {
            self.begin(task.stage.frame, now).failed(&task.stage, task.index, until, failure);
            self.note_block(task.stage.frame);
        }
        Vec::new()
    }

    /// Returns the keys of a run that are neither done nor quarantined.
    pub(crate) fn open_keys(&self, stage: &Stage, keys: &Range<u32>) -> RangeSet {
        if !self.is_current(stage) {
            return RangeSet::default();
        }
        let shape = self.shape(stage.frame);
        let mut open = self.unit(stage.frame).open_keys(&shape, (stage.round, stage.number));
        open.remove(0..keys.start);
        open.remove(keys.end..u32::MAX);
        open
    }

    /// Checks whether the task is quarantined.
    pub(crate) fn is_put_aside(&self, task: &TaskKey) -> bool {
        self.units.get(&task.stage.frame).is_some_and(|unit| unit.is_put_aside(&task.stage, task.index))
    }

    /// Checks whether all inputs of a task exist.
    pub(crate) fn has_inputs(&self, task: &TaskKey) -> bool {
        let (unit, shape) = (self.unit(task.stage.frame), self.shape(task.stage.frame));
        let place = (task.stage.round, task.stage.number);
        let grains = unit.grains(&shape, place);
        grains.is_some_and(|grains| unit.has_inputs(&shape, place, grains.task(task.index)))
    }

    /// Checks whether some of these keys of the task's stage still have to be done.
    pub(crate) fn wants(&self, task: &TaskKey, keys: &Range<u32>) -> bool {
        !self.has_ended() && !self.open_keys(&task.stage, keys).is_empty()
    }

    pub(super) fn died(&mut self, task: &TaskKey, end: u32, casualty: &Casualty, now: Tick) -> Vec<Digest> {
        let keys: Vec<u32> = self.open_keys(&task.stage, &(task.index..end)).iter().collect();
        if self.is_current(&task.stage) {
            self.begin(task.stage.frame, now).died(&task.stage, keys.into_iter(), casualty);
            self.note_block(task.stage.frame);
        }
        Vec::new()
    }

    pub(super) fn lives(&mut self, instance: u64) {
        self.units.values_mut().for_each(|unit| unit.lives(instance));
    }

    pub(super) fn lost(&mut self, task: &TaskKey) -> Vec<Digest> {
        let shape = shape!(self, task.stage.frame);
        if let Some(unit) = self.units.get_mut(&task.stage.frame) {
            unit.lost(&shape, (task.stage.round, task.stage.number), task.index);
        }
        // The task that makes it may be quarantined, and all remaining tasks may need it.
        self.note_block(task.stage.frame);
        Vec::new()
    }

    /// Returns the finished frames that have this artifact as a result, or as an output that the job's own stages read.
    pub(crate) fn made_by(&self, digest: &Digest) -> impl Iterator<Item = u32> + use<'_> {
        let digest = *digest;
        let has = move |finished: &Finished| finished.artifacts().any(|artifact| artifact == digest);
        self.finished.iter().filter(move |(_, finished)| has(finished)).map(|(&frame, _)| frame)
    }

    /// Restarts the frame: discards its progress except for the time spent. The job may have been done before.
    pub(super) fn restarted(&mut self, frame: u32) -> Vec<Digest> {
        self.blocked.remove(&Stage::OF_JOB);
        let mut released = self.hints.forget(frame);
        if let Some(finished) = self.finished.remove(&frame) {
            let again = Unit::again(&shape!(self, frame), &finished.record);
            self.units.insert(frame, again);
            self.note_left(frame, true);
            if !self.has_ended() {
                self.ended = None;
            }
            // Its outputs are kept: it will make the same ones again, and the job's own tasks may be reading them.
            return released;
        }
        let shape = shape!(self, frame);
        released.extend(self.units.get_mut(&frame).map(|unit| unit.restarted(&shape)).unwrap_or_default());
        self.note_block(frame);
        released
    }

    /// Restarts the job's own stages if they may have been done without a blocked frame that is now retried.
    fn fill_gaps(&mut self) -> Vec<Digest> {
        if !self.spec.graph.has_gaps() {
            return Vec::new();
        }
        let released = self.restarted(Stage::OF_JOB);
        self.units.entry(Stage::OF_JOB).and_modify(|own| own.is_again = false);
        released
    }

    pub(super) fn doomed(&mut self, failure: &Failure) -> Vec<Digest> {
        self.doom = Some(failure.clone());
        Vec::new()
    }

    pub(super) fn controlled(&mut self, control: &Control) -> Vec<Digest> {
        match control {
            Control::Pause => self.hold = Hold::Paused,
            Control::Resume => self.hold = Hold::Free,
            Control::Cancel => self.hold = Hold::Cancelled,
            Control::Retry => {
                self.hold = Hold::Free;
                self.doom = None;
                self.ended = None;
                let has_gaps = self.frames_blocked() > 0;
                let blocked: Vec<u32> = self.blocked.iter().copied().collect();
                for frame in blocked {
                    self.unblock(frame);
                }
                self.units.values_mut().for_each(Unit::clear_trouble);
                if has_gaps {
                    return self.fill_gaps();
                }
            }
            Control::RetryFrames(frames) => return self.frames_retried(frames),
            Control::Priority(priority) => self.spec.priority = *priority,
            // Deletion is a separate fact: `Forgotten`.
            Control::Delete => {}
        }
        Vec::new()
    }

    /// Discards the failures of these frames.
    fn frames_retried(&mut self, frames: &[u32]) -> Vec<Digest> {
        let mut have_gaps = false;
        for &frame in frames {
            have_gaps |= self.unblock(frame);
            if let Some(unit) = self.units.get_mut(&frame) {
                unit.clear_trouble();
            }
        }
        if !have_gaps {
            return Vec::new();
        }
        self.blocked.remove(&Stage::OF_JOB);
        let released = self.fill_gaps();
        if !self.has_ended() {
            self.ended = None;
        }
        released
    }

    /// Blocks the frame until a retry.
    fn block(&mut self, frame: u32) {
        if self.blocked.insert(frame) {
            self.note_left(frame, false);
        }
    }

    /// Unblocks the frame. Returns whether it was blocked.
    fn unblock(&mut self, frame: u32) -> bool {
        let was_blocked = self.blocked.remove(&frame);
        if was_blocked {
            self.note_left(frame, true);
        }
        was_blocked
    }

    /// Blocks its frames of this content for which `is_of_it` holds, because the shared job of the content is stuck.
    pub(super) fn block_for_shared(&mut self, key: &Digest, is_of_it: impl Fn(u32) -> bool, now: Tick) {
        if !self.needs(key) {
            return;
        }
        let is_open =
            |frame: &u32| self.is_open(*frame) && self.content(*frame).as_ref() == Some(key) && is_of_it(*frame);
        let frames: Vec<u32> = self.frames().iter().copied().filter(is_open).collect();
        for frame in frames {
            self.block(frame);
            self.note_block(frame);
        }
        self.note_end(now);
    }

    /// Returns the frames of this content that are blocked only by the shared job.
    pub(crate) fn frames_blocked_by_shared(&self, key: &Digest) -> impl Iterator<Item = u32> + use<'_> {
        let key = *key;
        let has_trouble = |frame| self.units.get(frame).is_some_and(|unit| unit.quarantined().next().is_some());
        let blocked = self.blocked.iter().filter(move |frame| self.content(**frame) == Some(key));
        blocked.filter(move |frame| !has_trouble(frame)).copied()
    }

    /// Unblocks the frames that were blocked only by the shared job of this content, which is retried.
    pub(super) fn unblock_for_shared(&mut self, key: &Digest) -> Vec<Digest> {
        let frames: Vec<u32> = self.frames_blocked_by_shared(key).collect();
        if frames.is_empty() {
            return Vec::new();
        }
        for frame in frames {
            self.unblock(frame);
        }
        self.blocked.remove(&Stage::OF_JOB);
        let released = self.fill_gaps();
        if !self.has_ended() {
            self.ended = None;
        }
        released
    }

    /// Blocks the frame if none of its tasks can run. If all frames have ended, does so for the job's own stages, too.
    fn note_block(&mut self, frame: u32) {
        let unit = self.units.get(&frame).filter(|_| frame != Stage::OF_JOB);
        if unit.is_some_and(|unit| unit.is_blocked(&self.shape(frame))) {
            self.block(frame);
        }
        if self.is_open(Stage::OF_JOB) && self.frames_done() + self.frames_blocked() == self.frames().len() {
            let own = self.unit(Stage::OF_JOB);
            if own.open(&self.shape(Stage::OF_JOB)).is_empty() {
                self.blocked.insert(Stage::OF_JOB);
            }
        }
    }

    pub(super) fn note_end(&mut self, now: Tick) {
        if self.has_ended() && self.ended.is_none() {
            self.ended = Some(now);
            self.is_unannounced = self.announces;
        }
        // A paused job that is done must not stay paused if one of its results is lost later.
        if self.is_done() {
            self.hold = Hold::Free;
        }
    }

    pub(super) fn each_artifact(&self, mut see: impl FnMut(Digest)) {
        see(self.spec.bundle);
        self.units.values().flat_map(Unit::artifacts).for_each(&mut see);
        self.hints.artifacts().for_each(&mut see);
        self.finished.values().flat_map(Finished::artifacts).for_each(see);
    }

    /// Checks whether the ledger holds this completion.
    pub(crate) fn holds(&self, task: &TaskKey, epoch: Epoch) -> bool {
        if let Some(finished) = self.finished.get(&task.stage.frame) {
            return finished.last == (task.stage, task.index, epoch);
        }
        let shape = self.shape(task.stage.frame);
        let unit = self.units.get(&task.stage.frame);
        unit.is_some_and(|unit| unit.holds(&shape, &task.stage, task.index, epoch))
    }
}

/// Creates the record of a frame whose stages are all done.
fn finished(shape: &Shape<'_>, unit: &Unit, frame: u32, last: (Stage, u32, Epoch), now: Tick) -> Finished {
    let is_read = |place: Place, output: &Output| {
        let mut beyond = shape.graph.readers(place.1).filter(|(reader, _)| shape.template(*reader).is_none());
        beyond.any(|(_, need)| need.role == output.role && shape.is_read_beyond(place, need, unit.round))
    };
    let results = unit.outputs().filter(|(.., output)| output.role.row().is_result);
    let made = unit.outputs().filter(|(place, _, output)| is_read(*place, output));
    let made = made.filter_map(|(place, first, output)| {
        let item = unit.grains(shape, place)?.task(first);
        Some(Made { stage: place.1, item, output })
    });
    let steps = shape.graph.of(Scope::Frame).find(|(_, template)| template.kind.is_cut());
    let pixels = steps.map_or(0, |(_, template)| template.sizes.sum()).max(1);
    Finished {
        last,
        units: unit.units,
        made: made.collect(),
        record: FrameRecord {
            frame,
            outputs: results.map(|(.., output)| output).collect(),
            spp: (unit.units / pixels) as u32,
            relative_error: unit.relative_error,
            blocks: unit.blocks,
            bad_samples: unit.bad_samples,
            busy_seconds: unit.busy_seconds,
            seconds: now.since(unit.began) as f64 / 1000.0,
            rounds: Some(unit.round + 1),
            times: None,
        },
    }
}
