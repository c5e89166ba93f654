//! Scene affinity. Reading a scene and preparing a frame cost a worker time. So a worker prefers tasks of the scenes and frames
//! that it has ready to tasks that come first in the order of service or of frames. It does so for a limited time, and never before
//! a job of higher priority.

use std::collections::VecDeque;

use femc_model::{Affinity, JobId, Reach, TaskKey, Tick, WorkerId};

use crate::Command;
use crate::ledger::Job;
use crate::scheduler::Scheduler;
use crate::shared::ContentState;

/// Frames and outputs that a worker probably has ready, judged by the tasks that it was given.
#[derive(Debug, Clone, Default)]
pub(crate) struct Locality {
    /// Prepared frames, the latest at the end.
    frames: Vec<(JobId, u32)>,
    /// Completed tasks whose outputs are hints for tasks of the next frame: job, stage and task, the latest at the end.
    hint_sources: VecDeque<(JobId, u16, u32)>,
    /// Expected milliseconds of the tasks given out of turn since the last one in turn.
    out_of_turn: u64,
}

impl Locality {
    /// Number of frames that are remembered. A worker keeps more, for those that it prepares ahead.
    const FRAMES: usize = 2;
    /// Number of completed tasks that are remembered.
    const HINT_SOURCES: usize = 256;

    /// Notes that the worker gets a task in turn (`None`), or one out of turn that is expected to take these milliseconds.
    fn record_turn(&mut self, out_of_turn: Option<u64>) {
        self.out_of_turn = out_of_turn.map_or(0, |milliseconds| self.out_of_turn.saturating_add(milliseconds));
    }

    fn has_frame(&self, task: &TaskKey) -> bool {
        self.frames.contains(&(task.job, task.stage.frame))
    }

    fn has_job(&self, job: JobId) -> bool {
        self.frames.iter().any(|&(other, _)| other == job)
    }

    /// Notes that the worker has completed a task whose outputs are hints for other tasks.
    pub(crate) fn add_hint_source(&mut self, job: JobId, stage: u16, item: u32) {
        self.hint_sources.retain(|other| *other != (job, stage, item));
        self.hint_sources.push_back((job, stage, item));
        if self.hint_sources.len() > Self::HINT_SOURCES {
            self.hint_sources.pop_front();
        }
    }

    /// Notes that the worker gets a task.
    pub(crate) fn record_assignment(&mut self, task: &TaskKey) {
        if task.stage.kind.properties().affinity != Affinity::Frame {
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
    /// Limit of the time that a worker may work out of turn, as a multiple of the intended duration of a task.
    const OUT_OF_TURN: u64 = 4;

    /// Leases a worker the task whose turn it is, or one whose scene or frame it has ready.
    pub(crate) fn assign_next(&mut self, id: WorkerId, first: TaskKey, now: Tick, out: &mut Vec<Command>) {
        let other = self.ready_nearby(id, &first, now);
        let task = other.unwrap_or(first);
        let task = self.ready_with_own_hint(id, &task).unwrap_or(task);
        let run = self.lease_run(&task);
        let out_of_turn = other.map(|_| self.lease_size(&task, self.units_of(&task, &run)).milliseconds);
        self.assign_task(task, &run, None, id, now, out);
        if let Some(worker) = self.table.workers.get_mut(&id) {
            worker.locality.record_turn(out_of_turn);
        }
    }

    /// Returns a ready task of a frame that the worker has prepared, or else of a scene that it has read, if `first`, whose turn it
    /// is, has neither. `None`: there is no such task, or it is time for `first`.
    fn ready_nearby(&mut self, id: WorkerId, first: &TaskKey, now: Tick) -> Option<TaskKey> {
        let locality = &self.table.workers.get(&id)?.locality;
        if first.stage.kind.properties().affinity != Affinity::Frame
            || locality.has_frame(first)
            || locality.out_of_turn >= Self::OUT_OF_TURN * self.config.work_per_lease
        {
            return None;
        }
        let priority = self.ledger.jobs.get(&first.job)?.spec.priority;
        let has_scene = locality.has_job(first.job);
        let mut own: Vec<(JobId, u32)> = locality.frames.iter().rev().copied().collect();
        own.retain(|&(job, _)| {
            let known = self.ledger.jobs.get(&job).filter(|known| known.spec.priority == priority);
            known.is_some_and(|known| self.may_take_tasks_of(id, job, known, now))
        });
        let same_frame = own.iter().find_map(|&(job, frame)| self.ready_near(id, job, Some(frame)));
        if same_frame.is_some() || has_scene {
            return same_frame;
        }
        own.into_iter().find_map(|(job, _)| self.ready_of_scene(id, job))
    }

    /// Returns a ready task of the same stage that has a hint which the worker itself made in the previous frame.
    fn ready_with_own_hint(&self, id: WorkerId, task: &TaskKey) -> Option<TaskKey> {
        let (job, ready_tasks) = (self.ledger.jobs.get(&task.job)?, self.ready.get(&task.job)?);
        let template = job.spec.graph.stage(task.stage.number)?;
        let hint = template.hints.iter().find(|hint| hint.reach == Reach::Same)?;
        let ready_keys = ready_tasks.open.get(task.stage.frame)?.ready_keys(&task.stage)?;
        let hint_sources = self.table.workers.get(&id)?.locality.hint_sources.iter().rev();
        let hint_sources = hint_sources.filter(|(of, stage, _)| (*of, *stage) == (task.job, hint.stage));
        let mut tasks = hint_sources.filter_map(|&(.., item)| {
            let index = job.keys_of(&task.stage, item).find(|&key| ready_keys.contains(key))?;
            Some(TaskKey { index, ..*task })
        });
        tasks.find(|task| self.may_take(task, job, ready_tasks, id))
    }

    /// Returns a ready task of a job whose scene the worker has read. Opens a frame for it if another one may be open.
    fn ready_of_scene(&mut self, id: WorkerId, job: JobId) -> Option<TaskKey> {
        loop {
            let task = self.ready_near(id, job, None);
            let (known, ready_tasks) = (self.ledger.jobs.get(&job)?, self.ready.get_mut(&job)?);
            if task.is_some() || !ready_tasks.may_open(id, &self.table) || !ready_tasks.open_next(known) {
                return task;
            }
        }
    }

    fn may_take_tasks_of(&self, id: WorkerId, job: JobId, known: &Job, now: Tick) -> bool {
        let (worker, ready_tasks) = (self.table.workers.get(&id), self.ready.get(&job));
        known.is_runnable()
            && worker.is_some_and(|worker| worker.has_tags(&known.spec.tags))
            && ready_tasks.is_some_and(|ready_tasks| !self.is_quarantined_for(known, ready_tasks, id, now))
    }

    /// Returns the first ready task that needs a prepared frame and that the worker may take: of this frame of the job, or of any
    /// frame.
    fn ready_near(&self, id: WorkerId, job: JobId, frame: Option<u32>) -> Option<TaskKey> {
        let (known, ready_tasks) = (self.ledger.jobs.get(&job)?, self.ready.get(&job)?);
        let engine = &*self.table.workers.get(&id)?.registration.engine;
        let may_take = |task: &TaskKey| {
            self.may_take(task, known, ready_tasks, id)
                && matches!(self.content_state(job, known, &task.stage, engine), ContentState::Available)
                && !self.is_reserved_for_others(job, task.stage.frame, id)
        };
        match frame {
            Some(frame) => ready_tasks.open.get(frame)?.frame_affine_tasks(job).find(may_take),
            None => ready_tasks.open.ready().flat_map(|(_, open)| open.frame_affine_tasks(job)).find(may_take),
        }
    }
}
