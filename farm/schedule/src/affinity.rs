//! Scene affinity: to read a scene and to make a frame ready takes a worker time, so it goes on with what it has at hand rather
//! than with what is first in the order of service or of frames: for a while, and never before a job of more priority.

use std::collections::VecDeque;

use femc_model::{JobId, Near, Reach, TaskKey, Tick, WorkerId};

use crate::Command;
use crate::ledger::Job;
use crate::scheduler::Scheduler;
use crate::shared::Content;

/// What a worker has ready, as far as one can tell from what it was given.
#[derive(Debug, Clone, Default)]
pub(crate) struct Locality {
    /// The latest at the end.
    frames: Vec<(JobId, u32)>,
    /// Tasks that it has done and that those of the frame behind may look at: by stage and number, the latest at the end.
    hint_sources: VecDeque<(JobId, u16, u32)>,
    /// Milliseconds of tasks that it was given out of turn, since one in turn.
    out_of_turn: u64,
}

impl Locality {
    /// Frames that count; a worker keeps more, for what it makes ready ahead.
    const FRAMES: usize = 2;
    /// Tasks that count.
    const HINT_SOURCES: usize = 256;

    /// It is given a task in turn, or out of turn one that takes so many milliseconds.
    fn note_turn(&mut self, out_of_turn: Option<u64>) {
        self.out_of_turn = out_of_turn.map_or(0, |milliseconds| self.out_of_turn.saturating_add(milliseconds));
    }

    fn has(&self, task: &TaskKey) -> bool {
        self.frames.contains(&(task.job, task.stage.frame))
    }

    fn has_job(&self, job: JobId) -> bool {
        self.frames.iter().any(|&(other, _)| other == job)
    }

    /// The worker has done a task that others may look at.
    pub(crate) fn add_hint_source(&mut self, job: JobId, stage: u16, item: u32) {
        self.hint_sources.retain(|other| *other != (job, stage, item));
        self.hint_sources.push_back((job, stage, item));
        if self.hint_sources.len() > Self::HINT_SOURCES {
            self.hint_sources.pop_front();
        }
    }

    /// The worker is given a task.
    pub(crate) fn note(&mut self, task: &TaskKey) {
        if task.stage.kind.row().near != Near::Frame {
            return;
        }
        let frame = (task.job, task.stage.frame);
        self.frames.retain(|other| *other != frame);
        self.frames.push(frame);
        if self.frames.len() > Self::FRAMES {
            self.frames.remove(0);
        }
    }
}

impl Scheduler {
    /// A worker goes on out of turn for so many times what a task is meant to take, at most.
    const OUT_OF_TURN: u64 = 4;

    /// Leases a worker the task whose turn it is, or one that it has at hand.
    pub(crate) fn assign_next(&mut self, id: WorkerId, first: TaskKey, now: Tick, out: &mut Vec<Command>) {
        let other = self.ready_nearby(id, &first, now);
        let task = other.unwrap_or(first);
        let task = self.ready_with_own_hint(id, &task).unwrap_or(task);
        let run = self.share(&task);
        let out_of_turn = other.map(|_| self.size(&task, self.units_of(&task, &run)).milliseconds);
        self.assign(task, &run, None, id, now, out);
        if let Some(worker) = self.table.workers.get_mut(&id) {
            worker.locality.note_turn(out_of_turn);
        }
    }

    /// A ready task of a frame that the worker has ready, or else of a scene that it has read, where `first`, whose turn it is,
    /// has neither; `None`: there is none, or it is time for `first`.
    fn ready_nearby(&mut self, id: WorkerId, first: &TaskKey, now: Tick) -> Option<TaskKey> {
        let locality = &self.table.workers.get(&id)?.locality;
        if first.stage.kind.row().near != Near::Frame
            || locality.has(first)
            || locality.out_of_turn >= Self::OUT_OF_TURN * self.config.task
        {
            return None;
        }
        let priority = self.ledger.jobs.get(&first.job)?.spec.priority;
        let is_scene_at_hand = locality.has_job(first.job);
        let mut own: Vec<(JobId, u32)> = locality.frames.iter().rev().copied().collect();
        own.retain(|&(job, _)| {
            let known = self.ledger.jobs.get(&job).filter(|known| known.spec.priority == priority);
            known.is_some_and(|known| self.may_work(id, job, known, now))
        });
        let same_frame = own.iter().find_map(|&(job, frame)| self.ready_near(id, job, Some(frame)));
        if same_frame.is_some() || is_scene_at_hand {
            return same_frame;
        }
        own.into_iter().find_map(|(job, _)| self.ready_of_scene(id, job))
    }

    /// A ready task of the same stage that may look at what the worker itself has left of the frame before.
    fn ready_with_own_hint(&self, id: WorkerId, task: &TaskKey) -> Option<TaskKey> {
        let (job, ready_tasks) = (self.ledger.jobs.get(&task.job)?, self.ready.get(&task.job)?);
        let template = job.spec.graph.stage(task.stage.number)?;
        let hint = template.hints.iter().find(|hint| hint.reach == Reach::Same)?;
        let keys = ready_tasks.open.get(task.stage.frame)?.of(&task.stage)?;
        let hint_sources = self.table.workers.get(&id)?.locality.hint_sources.iter().rev();
        let hint_sources = hint_sources.filter(|(of, stage, _)| (*of, *stage) == (task.job, hint.stage));
        let mut tasks = hint_sources.filter_map(|&(.., item)| {
            let index = job.keys_of(&task.stage, item).find(|&key| keys.contains(key))?;
            Some(TaskKey { index, ..*task })
        });
        tasks.find(|task| self.may_take(task, job, ready_tasks, id))
    }

    /// A ready task of a job of which the worker has the scene; opens a frame for it, if there may be one more.
    fn ready_of_scene(&mut self, id: WorkerId, job: JobId) -> Option<TaskKey> {
        loop {
            let task = self.ready_near(id, job, None);
            let (known, ready_tasks) = (self.ledger.jobs.get(&job)?, self.ready.get_mut(&job)?);
            if task.is_some() || !ready_tasks.may_open(id, &self.table) || !ready_tasks.open_next(known) {
                return task;
            }
        }
    }

    fn may_work(&self, id: WorkerId, job: JobId, known: &Job, now: Tick) -> bool {
        let (worker, ready_tasks) = (self.table.workers.get(&id), self.ready.get(&job));
        known.is_runnable()
            && worker.is_some_and(|worker| worker.has_tags(&known.spec.tags))
            && ready_tasks.is_some_and(|ready_tasks| !self.is_quarantined_for(known, ready_tasks, id, now))
    }

    /// The first ready task that wants its frame prepared, of one frame of the job, or of any, and that the worker may take.
    fn ready_near(&self, id: WorkerId, job: JobId, frame: Option<u32>) -> Option<TaskKey> {
        let (known, ready_tasks) = (self.ledger.jobs.get(&job)?, self.ready.get(&job)?);
        let engine = &*self.table.workers.get(&id)?.registration.engine;
        let is_for_it = |task: &TaskKey| {
            self.may_take(task, known, ready_tasks, id)
                && matches!(self.content(job, known, &task.stage, engine), Content::There)
                && !self.is_reserved_for_others(job, task.stage.frame, id)
        };
        match frame {
            Some(frame) => ready_tasks.open.get(frame)?.near(job).find(is_for_it),
            None => ready_tasks.open.ready().flat_map(|(_, open)| open.near(job)).find(is_for_it),
        }
    }
}
