//! A job in the ledger.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use femc_model::{
    BlockCounts, ChunkSize, Chunks, Control, Digest, Epoch, Failure, FrameRecord, FrameStop, Input, JobSpec, Need,
    Output, Scope, Stage, TaskKey, TaskResult, Tick, WorstFrame,
};
use serde::{Deserialize, Serialize};

use super::graph_view::{GraphView, StageRound};
use super::hints::Hints;
use super::progress::Progress;
use crate::{RangeSet, WorkerDeath};

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
pub(crate) struct FrameOutput {
    /// Number of the stage that made it.
    pub(super) stage: u16,
    pub(super) item: u32,
    pub(super) output: Output,
}

/// A finished frame, or the finished stages of the job, with the lease that finished it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct FinishedFrame {
    /// Stage, key and epoch of the last task, so that a repeated completion gets the same answer.
    last_lease: (Stage, u32, Epoch),
    /// Record of the frame, for `femc fetch`.
    pub(crate) record: FrameRecord,
    /// Number of its units of work.
    units: u64,
    /// Outputs that stages of the job read. They are kept as long as the job.
    pub(super) job_inputs: Vec<FrameOutput>,
}

impl FinishedFrame {
    fn artifacts(&self) -> impl Iterator<Item = Digest> + '_ {
        let outputs = self.record.outputs.iter().chain(self.job_inputs.iter().map(|made| &made.output));
        outputs.map(|output| output.artifact.digest)
    }
}

/// Identity of a shared job: the stages of one content, done by one build of the engine.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(crate) struct SharedKey {
    pub(crate) key: Digest,
    pub(crate) engine: String,
}

/// A job: its specification and its progress. A shared job has only one unit, its own stages, and no frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Job {
    pub(crate) spec: Box<JobSpec>,
    pub(crate) hold: Hold,
    pub(crate) failure: Option<Failure>,
    /// Time of the first lease of a completed task.
    pub(crate) began: Option<Tick>,
    pub(crate) ended: Option<Tick>,
    /// Unfinished frames with some result or failure, and the job's own stages under [`Stage::JOB_FRAME`]. All other frames need no
    /// memory.
    pub(crate) unfinished: BTreeMap<u32, Progress>,
    pub(crate) finished: BTreeMap<u32, FinishedFrame>,
    /// Blocked frames, which stay blocked until a retry.
    pub(crate) blocked: BTreeSet<u32>,
    /// Relative error of the frame measured last. Statuses show that of the worst frame; the field remains because the log stores
    /// fields by position.
    relative_error: Option<f64>,
    /// Blocks of the frame measured last; it remains for the same reason.
    #[serde(deserialize_with = "femc_model::since_version_9")]
    blocks: Option<BlockCounts>,
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
    chunk_size: ChunkSize,
    pub(crate) shared: Option<SharedKey>,
    /// Number of frames that are neither finished nor blocked, by the key of their content.
    open_frames: BTreeMap<Digest, u32>,
    /// Hints for tasks of the next frames.
    hints: Hints,
}

/// Returns the [`GraphView`] of a frame number. The macro borrows all fields of the job except the progress of its frames.
macro_rules! graph_view {
    ($job:expr, $frame:expr) => {{
        let scope = if $job.shared.is_some() { Scope::Content } else { GraphView::scope_of($frame) };
        GraphView {
            graph: &$job.spec.graph,
            scope,
            scope_loop: $job.spec.graph.loop_of(scope),
            chunk_size: $job.chunk_size,
            frames: if $job.shared.is_some() { &[] } else { &$job.spec.frames },
            finished: &$job.finished,
            blocked: &$job.blocked,
        }
    }};
}

impl Job {
    pub(super) fn new(spec: Box<JobSpec>, shared: Option<SharedKey>, cut: ChunkSize, now: Tick) -> Self {
        let mut left = BTreeMap::new();
        let mut first = 0;
        for (end, key) in spec.contents.iter().filter(|_| shared.is_none()) {
            *left.entry(*key).or_default() += end - std::mem::replace(&mut first, *end);
        }
        Self {
            spec,
            hold: Hold::Free,
            failure: None,
            began: None,
            ended: None,
            unfinished: BTreeMap::new(),
            finished: BTreeMap::new(),
            blocked: BTreeSet::new(),
            relative_error: None,
            blocks: None,
            submitted: now,
            date: None,
            announces: false,
            is_unannounced: false,
            chunk_size: cut,
            shared,
            open_frames: left,
            hints: Hints::default(),
        }
    }

    /// Sets the calendar date of the submission, Unix time in milliseconds.
    pub(super) fn with_date(self, date: Option<u64>) -> Self {
        Self { date, ..self }
    }

    /// Sets whether its ends are announced.
    pub(super) fn with_announcements(self, announces: bool) -> Self {
        Self { announces, ..self }
    }

    /// Returns its frames, ascending.
    pub(crate) fn frames(&self) -> &[u32] {
        if self.shared.is_some() { &[] } else { &self.spec.frames }
    }

    /// Returns the key of a frame's content.
    pub(crate) fn content_key(&self, frame: u32) -> Option<Digest> {
        if self.spec.contents.is_empty() {
            return None;
        }
        self.spec.content_key(self.frames().binary_search(&frame).ok()?)
    }

    /// Returns the contents of the frames for which `is_meant` holds.
    pub(crate) fn contents_of(&self, is_meant: impl Fn(u32) -> bool) -> BTreeSet<Digest> {
        let mut first = 0;
        let runs = self.spec.contents.iter().map(|(end, key)| (std::mem::replace(&mut first, *end)..*end, key));
        let frames = |run: Range<u32>| self.frames().get(run.start as usize..run.end as usize).unwrap_or_default();
        runs.filter(|(run, _)| frames(run.clone()).iter().any(|&frame| is_meant(frame))).map(|(_, key)| *key).collect()
    }

    /// Checks whether the frame is blocked or has a quarantined task.
    pub(crate) fn has_failures(&self, frame: u32) -> bool {
        let progress = self.unfinished.get(&frame);
        self.blocked.contains(&frame) || progress.is_some_and(|progress| progress.quarantined().next().is_some())
    }

    /// Checks whether frames with this content still have to be finished.
    pub(crate) fn needs_content(&self, key: &Digest) -> bool {
        self.open_frames.get(key).is_some_and(|&left| left > 0)
    }

    /// Checks whether some of its frames with this content are blocked.
    pub(crate) fn has_blocked_frames_of(&self, key: &Digest) -> bool {
        self.blocked.iter().any(|&frame| self.content_key(frame).as_ref() == Some(key))
    }

    /// Returns the contents of the frames that still have to be finished.
    pub(crate) fn contents(&self) -> impl Iterator<Item = Digest> + '_ {
        self.open_frames.iter().filter(|(_, left)| **left > 0).map(|(key, _)| *key)
    }

    /// Notes whether a frame still has to be finished.
    fn count_open_frame(&mut self, frame: u32, is_left: bool) {
        let Some(left) = self.content_key(frame).and_then(|key| self.open_frames.get_mut(&key)) else { return };
        *left = if is_left { *left + 1 } else { left.saturating_sub(1) };
    }

    /// Returns the granularity at which its tasks are divided.
    pub(crate) fn chunk_size(&self) -> ChunkSize {
        self.chunk_size
    }

    /// Returns the part of the graph that belongs to this frame, or to the job as a whole.
    pub(crate) fn graph_view(&self, frame: u32) -> GraphView<'_> {
        graph_view!(self, frame)
    }

    /// Returns the tags that a worker needs for a stage's tasks, in addition to the job's tags.
    pub(crate) fn tags_of(&self, number: u16) -> &[String] {
        self.spec.graph.stage(number).map_or(&[], |template| &template.tags)
    }

    /// Returns the progress of the frame; an empty one if it has not begun.
    pub(crate) fn progress(&self, frame: u32) -> Cow<'_, Progress> {
        match self.unfinished.get(&frame) {
            Some(progress) => Cow::Borrowed(progress),
            None => Cow::Owned(self.new_progress(frame)),
        }
    }

    /// Returns the numbering of the sample chunks of a stage.
    pub(crate) fn chunks(&self, stage: &Stage) -> Option<Chunks<'_>> {
        let (view, stage_round) = (self.graph_view(stage.frame), (stage.round, stage.number));
        match self.unfinished.get(&stage.frame) {
            Some(progress) => progress.chunks(&view, stage_round),
            None => view.chunks(stage_round, None),
        }
    }

    /// Returns the progress of a frame that has not begun.
    pub(crate) fn new_progress(&self, frame: u32) -> Progress {
        Progress::new(&self.graph_view(frame), Tick(u64::MAX))
    }

    /// Checks whether it is a shared job that has ended without being done. Only a retry can finish it.
    pub(crate) fn is_stuck(&self) -> bool {
        self.shared.is_some() && self.has_ended() && !self.is_done()
    }

    /// Returns the bytes of the artifacts that it keeps for others, whether it is finished or not, and of its description.
    pub(crate) fn bytes(&self) -> u64 {
        let made = self.finished.values().flat_map(|finished| &finished.job_inputs).map(|made| made.output);
        let in_progress = self.unfinished.values().flat_map(|progress| progress.outputs().map(|(.., output)| output));
        let artifacts: u64 = made.chain(in_progress).map(|output| output.artifact.bytes).sum();
        let stages = self.spec.graph.stages.iter();
        let stages: usize = stages.map(|it| it.options.len() + size_of_val(it.sizes.runs())).sum();
        artifacts + (self.spec.settings.len() + stages) as u64
    }

    /// Returns the time of its submission.
    pub(crate) fn submitted(&self) -> Tick {
        self.submitted
    }

    /// Returns the time when it ended, or when it was submitted if it has not ended.
    pub(crate) fn end_or_submission(&self) -> Tick {
        self.ended.unwrap_or(self.submitted)
    }

    /// Returns the outputs of a finished shared job for one need of a frame's task.
    pub(crate) fn outputs_for(&self, need: &Need) -> impl Iterator<Item = (u32, Output)> + use<'_> {
        let (stage, role) = (need.stage, need.role);
        let made = self.finished.values().flat_map(|finished| &finished.job_inputs);
        made.filter(move |made| (made.stage, made.output.role) == (stage, role)).map(|made| (made.item, made.output))
    }

    /// Returns the units of work in finished frames.
    pub(crate) fn finished_units(&self) -> u64 {
        self.finished.values().map(|finished| finished.units).sum()
    }

    /// Checks whether it has stages that are done once for the whole job.
    pub(crate) fn has_job_stages(&self) -> bool {
        self.shared.is_some() || self.spec.graph.has_job_stages()
    }

    /// Returns the frame with the greatest relative error so far, with its error and blocks. A frame without light comes after all
    /// others.
    pub(crate) fn worst_frame(&self) -> Option<(WorstFrame, Option<f64>, Option<BlockCounts>)> {
        let rounds = self.spec.graph.loop_of(Scope::Frame).map_or(1, |(_, scope_loop)| scope_loop.rounds);
        let finished = self.finished.iter().map(|(&frame, FinishedFrame { record, .. })| {
            let stop = match record.rounds {
                Some(taken) if taken >= rounds => FrameStop::Limit,
                Some(_) => FrameStop::Estimate,
                None => FrameStop::Unknown,
            };
            (WorstFrame { frame, stop }, record.relative_error, record.blocks)
        });
        let in_progress = self.unfinished.iter().map(|(&frame, progress)| {
            (WorstFrame { frame, stop: FrameStop::Rendering }, progress.relative_error, progress.blocks)
        });
        let is_measured = |(worst, error, blocks): &(WorstFrame, Option<f64>, Option<BlockCounts>)| {
            worst.frame != Stage::JOB_FRAME && (error.is_some() || blocks.is_some())
        };
        let size = |error: Option<f64>| error.unwrap_or(-1.0);
        finished.chain(in_progress).filter(is_measured).reduce(|worst, next| {
            let order = size(next.1).total_cmp(&size(worst.1)).then(worst.0.frame.cmp(&next.0.frame));
            if order.is_gt() { next } else { worst }
        })
    }

    /// Returns the number of finished frames.
    pub(crate) fn frames_done(&self) -> usize {
        self.finished.len() - usize::from(self.finished.contains_key(&Stage::JOB_FRAME))
    }

    /// Returns the number of blocked frames.
    pub(crate) fn frames_blocked(&self) -> usize {
        self.blocked.len() - usize::from(self.blocked.contains(&Stage::JOB_FRAME))
    }

    /// Checks whether everything is finished.
    pub(crate) fn is_done(&self) -> bool {
        self.finished.len() == self.frames().len() + usize::from(self.has_job_stages())
    }

    /// Checks whether every frame and the job's own stages are finished or blocked, or the job is cancelled or has failed as a
    /// whole.
    pub(crate) fn has_ended(&self) -> bool {
        self.hold == Hold::Cancelled
            || self.failure.is_some()
            || self.finished.len() + self.blocked.len() == self.frames().len() + usize::from(self.has_job_stages())
    }

    /// Checks whether the job is cancelled or has failed as a whole: only a retry continues it.
    pub(crate) fn is_aborted(&self) -> bool {
        self.hold == Hold::Cancelled || self.failure.is_some()
    }

    /// Checks whether its tasks may be leased.
    pub(crate) fn is_runnable(&self) -> bool {
        self.hold == Hold::Free && !self.has_ended()
    }

    /// Checks whether the frame belongs to the job and is neither finished nor blocked.
    pub(crate) fn is_open(&self, frame: u32) -> bool {
        let is_there =
            if frame == Stage::JOB_FRAME { self.has_job_stages() } else { self.frames().binary_search(&frame).is_ok() };
        is_there && !self.finished.contains_key(&frame) && !self.blocked.contains(&frame)
    }

    /// Checks whether the stage belongs to the job, its frame is open, and its round has begun.
    fn is_current(&self, stage: &Stage) -> bool {
        self.is_open(stage.frame)
            && self.graph_view(stage.frame).template(stage.number).is_some_and(|template| template.kind == stage.kind)
            && stage.round <= self.unfinished.get(&stage.frame).map_or(0, |progress| progress.round)
    }

    fn begin(&mut self, frame: u32, began: Tick) -> &mut Progress {
        self.began.get_or_insert(began);
        let view = graph_view!(self, frame);
        self.unfinished.entry(frame).or_insert_with(|| Progress::new(&view, began))
    }

    pub(super) fn apply_result(
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
        let view = graph_view!(self, frame);
        let Some(progress) = self.unfinished.get_mut(&frame) else { return Vec::new() };
        let mut released = progress.apply_result(&view, &task.stage, &(task.index..end), (epoch, leased), result);
        if frame != Stage::JOB_FRAME && (result.blocks.is_some() || result.relative_error.is_some()) {
            (self.relative_error, self.blocks) = (result.relative_error, result.blocks);
        }
        if progress.is_finished(&view) {
            let last = (task.stage, task.index, epoch);
            let finished = finish_frame(&view, progress, frame, last, now);
            self.finished.insert(frame, finished);
            self.unfinished.remove(&frame);
            self.count_open_frame(frame, false);
            released.extend(self.release_hints(frame));
        }
        self.update_blocked(frame);
        released
    }

    /// Returns the task that a key belongs to.
    pub(crate) fn task_of_key(&self, stage: &Stage, key: u32) -> Option<u32> {
        self.chunks(stage).map(|chunks| chunks.task(key))
    }

    /// Keeps the outputs of a completed task as hints for the next frame. Returns the artifacts that are no longer referenced.
    pub(super) fn add_hints(&mut self, task: &TaskKey, end: u32, engine: &str, result: &TaskResult) -> Vec<Digest> {
        let (stage, view) = (&task.stage, graph_view!(self, task.stage.frame));
        let stage_round = (stage.round, stage.number);
        let progress = self.unfinished.get(&stage.frame);
        let counts = || progress.is_none_or(|progress| progress.may_count(&view, stage_round, &(task.index..end)));
        let Some(chunks) = view.chunks(stage_round, None).filter(|_| self.is_current(stage) && counts()) else {
            return Vec::new();
        };
        self.hints.insert(&view, stage, (chunks.task(task.index), task.index), engine, result)
    }

    /// Returns the keys of a task.
    pub(crate) fn keys_of(&self, stage: &Stage, item: u32) -> Range<u32> {
        self.chunks(stage).map_or(0..0, |chunks| chunks.of_task(item))
    }

    /// Returns the hints from the previous frame for a task, for a worker of this build.
    pub(crate) fn hint_inputs(&self, stage: &Stage, item: u32, engine: &str) -> Vec<Input> {
        if self.hints.is_empty() {
            return Vec::new();
        }
        let index = self.frames().binary_search(&stage.frame).ok().and_then(|place| place.checked_sub(1));
        let before = index.and_then(|place| self.frames().get(place));
        let hints =
            |&before| self.hints.inputs_for(&self.graph_view(stage.frame), before, (stage.number, item), engine);
        before.map(hints).unwrap_or_default()
    }

    /// Removes hints when a frame is finished: those of the previous frame, and its own if the next frame is finished or there is
    /// none. Returns the artifacts that are no longer referenced.
    fn release_hints(&mut self, frame: u32) -> Vec<Digest> {
        if self.hints.is_empty() {
            return Vec::new();
        }
        let Ok(index) = self.frames().binary_search(&frame) else { return Vec::new() };
        let before = index.checked_sub(1).map(|before| self.frames()[before]);
        let is_last = self.frames().get(index + 1).is_none_or(|behind| self.finished.contains_key(behind));
        let unseen: Vec<u32> = before.into_iter().chain(is_last.then_some(frame)).collect();
        unseen.into_iter().flat_map(|frame| self.hints.remove(frame)).collect()
    }

    pub(super) fn apply_failure(&mut self, task: &TaskKey, until: Epoch, failure: &Failure, now: Tick) -> Vec<Digest> {
        if self.is_current(&task.stage) {
            self.begin(task.stage.frame, now).add_failure(&task.stage, task.index, until, failure);
            self.update_blocked(task.stage.frame);
        }
        Vec::new()
    }

    /// Returns the keys of a run that are neither done nor quarantined.
    pub(crate) fn open_keys(&self, stage: &Stage, keys: &Range<u32>) -> RangeSet {
        if !self.is_current(stage) {
            return RangeSet::default();
        }
        let view = self.graph_view(stage.frame);
        let mut open = self.progress(stage.frame).open_keys(&view, (stage.round, stage.number));
        open.remove_range(0..keys.start);
        open.remove_range(keys.end..u32::MAX);
        open
    }

    /// Checks whether the task is quarantined.
    pub(crate) fn is_quarantined(&self, task: &TaskKey) -> bool {
        self.unfinished.get(&task.stage.frame).is_some_and(|progress| progress.is_quarantined(&task.stage, task.index))
    }

    /// Checks whether all inputs of a task exist.
    pub(crate) fn has_inputs(&self, task: &TaskKey) -> bool {
        let (progress, view) = (self.progress(task.stage.frame), self.graph_view(task.stage.frame));
        let stage_round = (task.stage.round, task.stage.number);
        let chunks = progress.chunks(&view, stage_round);
        chunks.is_some_and(|chunks| progress.has_inputs(&view, stage_round, chunks.task(task.index)))
    }

    /// Checks whether some of these keys of the task's stage still have to be done.
    pub(crate) fn needs_any_of(&self, task: &TaskKey, keys: &Range<u32>) -> bool {
        !self.has_ended() && !self.open_keys(&task.stage, keys).is_empty()
    }

    pub(super) fn apply_death(&mut self, task: &TaskKey, end: u32, death: &WorkerDeath, now: Tick) -> Vec<Digest> {
        let keys: Vec<u32> = self.open_keys(&task.stage, &(task.index..end)).iter().collect();
        if self.is_current(&task.stage) {
            self.begin(task.stage.frame, now).add_death(&task.stage, keys.into_iter(), death);
            self.update_blocked(task.stage.frame);
        }
        Vec::new()
    }

    pub(super) fn withdraw_deaths(&mut self, instance: u64) {
        self.unfinished.values_mut().for_each(|progress| progress.withdraw_deaths(instance));
    }

    pub(super) fn apply_loss(&mut self, task: &TaskKey) -> Vec<Digest> {
        let view = graph_view!(self, task.stage.frame);
        if let Some(progress) = self.unfinished.get_mut(&task.stage.frame) {
            progress.apply_loss(&view, (task.stage.round, task.stage.number), task.index);
        }
        // The task that makes it may be quarantined, and all remaining tasks may need it.
        self.update_blocked(task.stage.frame);
        Vec::new()
    }

    /// Returns the finished frames that have this artifact as a result, or as an output that the job's own stages read.
    pub(crate) fn frames_with_artifact(&self, digest: &Digest) -> impl Iterator<Item = u32> + use<'_> {
        let digest = *digest;
        let has = move |finished: &FinishedFrame| finished.artifacts().any(|artifact| artifact == digest);
        self.finished.iter().filter(move |(_, finished)| has(finished)).map(|(&frame, _)| frame)
    }

    /// Restarts the frame: discards its progress except for the time spent. The job may have been done before.
    pub(super) fn restart_frame(&mut self, frame: u32) -> Vec<Digest> {
        self.blocked.remove(&Stage::JOB_FRAME);
        let mut released = self.hints.remove(frame);
        if let Some(finished) = self.finished.remove(&frame) {
            let progress = Progress::new_rerun(&graph_view!(self, frame), &finished.record);
            self.unfinished.insert(frame, progress);
            self.count_open_frame(frame, true);
            if !self.has_ended() {
                self.ended = None;
            }
            // Its outputs are kept: it will make the same ones again, and the job's own tasks may be reading them.
            return released;
        }
        let view = graph_view!(self, frame);
        released.extend(self.unfinished.get_mut(&frame).map(|progress| progress.restart(&view)).unwrap_or_default());
        self.update_blocked(frame);
        released
    }

    /// Restarts the job's own stages if they may have been done without a blocked frame that is now retried.
    fn restart_job_stages(&mut self) -> Vec<Digest> {
        if !self.spec.graph.has_gaps() {
            return Vec::new();
        }
        let released = self.restart_frame(Stage::JOB_FRAME);
        self.unfinished.entry(Stage::JOB_FRAME).and_modify(|own| own.is_rerun = false);
        released
    }

    pub(super) fn fail(&mut self, failure: &Failure) -> Vec<Digest> {
        self.failure = Some(failure.clone());
        Vec::new()
    }

    pub(super) fn apply_control(&mut self, control: &Control) -> Vec<Digest> {
        match control {
            Control::Pause => self.hold = Hold::Paused,
            Control::Resume => self.hold = Hold::Free,
            Control::Cancel => self.hold = Hold::Cancelled,
            Control::Retry => {
                self.hold = Hold::Free;
                self.failure = None;
                self.ended = None;
                let has_gaps = self.frames_blocked() > 0;
                let blocked: Vec<u32> = self.blocked.iter().copied().collect();
                for frame in blocked {
                    self.unblock(frame);
                }
                self.unfinished.values_mut().for_each(Progress::clear_failures);
                if has_gaps {
                    return self.restart_job_stages();
                }
            }
            Control::RetryFrames(frames) => return self.retry_frames(frames),
            Control::Priority(priority) => self.spec.priority = *priority,
            // Deletion is a separate fact: `JobRemoved`.
            Control::Delete => {}
        }
        Vec::new()
    }

    /// Discards the failures of these frames.
    fn retry_frames(&mut self, frames: &[u32]) -> Vec<Digest> {
        let mut have_gaps = false;
        for &frame in frames {
            have_gaps |= self.unblock(frame);
            if let Some(progress) = self.unfinished.get_mut(&frame) {
                progress.clear_failures();
            }
        }
        if !have_gaps {
            return Vec::new();
        }
        self.blocked.remove(&Stage::JOB_FRAME);
        let released = self.restart_job_stages();
        if !self.has_ended() {
            self.ended = None;
        }
        released
    }

    /// Blocks the frame until a retry.
    fn block(&mut self, frame: u32) {
        if self.blocked.insert(frame) {
            self.count_open_frame(frame, false);
        }
    }

    /// Unblocks the frame. Returns whether it was blocked.
    fn unblock(&mut self, frame: u32) -> bool {
        let was_blocked = self.blocked.remove(&frame);
        if was_blocked {
            self.count_open_frame(frame, true);
        }
        was_blocked
    }

    /// Blocks its frames of this content for which `is_affected` holds, because the shared job of the content is stuck.
    pub(super) fn block_for_shared(&mut self, key: &Digest, is_affected: impl Fn(u32) -> bool, now: Tick) {
        if !self.needs_content(key) {
            return;
        }
        let is_open =
            |frame: &u32| self.is_open(*frame) && self.content_key(*frame).as_ref() == Some(key) && is_affected(*frame);
        let frames: Vec<u32> = self.frames().iter().copied().filter(is_open).collect();
        for frame in frames {
            self.block(frame);
            self.update_blocked(frame);
        }
        self.update_ended(now);
    }

    /// Returns the frames of this content that are blocked only by the shared job.
    pub(crate) fn frames_blocked_by_shared(&self, key: &Digest) -> impl Iterator<Item = u32> + use<'_> {
        let key = *key;
        let has_trouble =
            |frame| self.unfinished.get(frame).is_some_and(|progress| progress.quarantined().next().is_some());
        let blocked = self.blocked.iter().filter(move |frame| self.content_key(**frame) == Some(key));
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
        self.blocked.remove(&Stage::JOB_FRAME);
        let released = self.restart_job_stages();
        if !self.has_ended() {
            self.ended = None;
        }
        released
    }

    /// Blocks the frame if none of its tasks can run. If all frames have ended, does so for the job's own stages, too.
    fn update_blocked(&mut self, frame: u32) {
        let progress = self.unfinished.get(&frame).filter(|_| frame != Stage::JOB_FRAME);
        if progress.is_some_and(|progress| progress.is_blocked(&self.graph_view(frame))) {
            self.block(frame);
        }
        if self.is_open(Stage::JOB_FRAME) && self.frames_done() + self.frames_blocked() == self.frames().len() {
            let own = self.progress(Stage::JOB_FRAME);
            if own.runnable(&self.graph_view(Stage::JOB_FRAME)).is_empty() {
                self.blocked.insert(Stage::JOB_FRAME);
            }
        }
    }

    pub(super) fn update_ended(&mut self, now: Tick) {
        if self.has_ended() && self.ended.is_none() {
            self.ended = Some(now);
            self.is_unannounced = self.announces;
        }
        // A paused job that is done must not stay paused if one of its results is lost later.
        if self.is_done() {
            self.hold = Hold::Free;
        }
    }

    pub(super) fn for_each_artifact(&self, mut visit: impl FnMut(Digest)) {
        visit(self.spec.bundle);
        self.unfinished.values().flat_map(Progress::artifacts).for_each(&mut visit);
        self.hints.artifacts().for_each(&mut visit);
        self.finished.values().flat_map(FinishedFrame::artifacts).for_each(visit);
    }

    /// Checks whether the ledger holds this completion.
    pub(crate) fn has_completion(&self, task: &TaskKey, epoch: Epoch) -> bool {
        if let Some(finished) = self.finished.get(&task.stage.frame) {
            return finished.last_lease == (task.stage, task.index, epoch);
        }
        let view = self.graph_view(task.stage.frame);
        let progress = self.unfinished.get(&task.stage.frame);
        progress.is_some_and(|progress| progress.has_completion(&view, &task.stage, task.index, epoch))
    }
}

/// Creates the record of a frame whose stages are all done.
fn finish_frame(
    view: &GraphView<'_>,
    progress: &Progress,
    frame: u32,
    last: (Stage, u32, Epoch),
    now: Tick,
) -> FinishedFrame {
    let is_read = |stage_round: StageRound, output: &Output| {
        let mut beyond = view.graph.readers(stage_round.1).filter(|(reader, _)| view.template(*reader).is_none());
        beyond
            .any(|(_, need)| need.role == output.role && view.is_read_by_other_scope(stage_round, need, progress.round))
    };
    let results = progress.outputs().filter(|(.., output)| output.role.properties().is_result);
    let inputs = progress.outputs().filter(|(stage_round, _, output)| is_read(*stage_round, output));
    let inputs = inputs.filter_map(|(stage_round, first, output)| {
        let item = progress.chunks(view, stage_round)?.task(first);
        Some(FrameOutput { stage: stage_round.1, item, output })
    });
    let steps = view.graph.stages_of(Scope::Frame).find(|(_, template)| template.kind.is_divided());
    let pixels = steps.map_or(0, |(_, template)| template.sizes.sum()).max(1);
    FinishedFrame {
        last_lease: last,
        units: progress.units,
        job_inputs: inputs.collect(),
        record: FrameRecord {
            frame,
            outputs: results.map(|(.., output)| output).collect(),
            spp: (progress.units / pixels) as u32,
            relative_error: progress.relative_error,
            blocks: progress.blocks,
            bad_samples: progress.bad_samples,
            busy_seconds: progress.busy_seconds,
            seconds: now.since(progress.began) as f64 / 1000.0,
            rounds: Some(progress.round + 1),
            times: None,
        },
    }
}
