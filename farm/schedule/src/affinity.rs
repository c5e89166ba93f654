//! Scene affinity: to read a scene and to make a frame ready takes a worker time, so it goes on with what it has at hand rather
//! than with what is first in the order of service or of frames: for a while, and never before a job of more priority.

use femc_model::{JobId, StageKind, TaskKey, Tick, WorkerId};

use crate::Command;
use crate::builds::is_foreign;
use crate::deal::{is_avoided, is_shunned};
use crate::ledger::Job;
use crate::scheduler::Scheduler;

/// What a worker has ready, as far as one can tell from what it was given.
#[derive(Debug, Clone, Default)]
pub(crate) struct AtHand {
    /// The latest at the end.
    frames: Vec<(JobId, u32)>,
    /// Milliseconds of tasks that it was given out of turn, since one in turn.
    out_of_turn: u64,
}

impl AtHand {
    /// Frames that count; a worker keeps more, for what it makes ready ahead.
    const FRAMES: usize = 2;

    /// It is given a task in turn, or out of turn one that takes so many milliseconds.
    fn turn(&mut self, out_of_turn: Option<u64>) {
        self.out_of_turn = out_of_turn.map_or(0, |milliseconds| self.out_of_turn.saturating_add(milliseconds));
    }

    fn has(&self, task: &TaskKey) -> bool {
        self.frames.contains(&(task.job, task.stage.frame))
    }

    fn has_job(&self, job: JobId) -> bool {
        self.frames.iter().any(|&(other, _)| other == job)
    }

    /// The worker is given a task.
    pub(crate) fn note(&mut self, task: &TaskKey) {
        if task.stage.kind != StageKind::Render {
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
    pub(crate) fn serve(&mut self, id: WorkerId, first: TaskKey, now: Tick, out: &mut Vec<Command>) {
        let other = self.at_hand(id, &first, now);
        let task = other.unwrap_or(first);
        let run = self.share(&task);
        let out_of_turn = other.map(|_| self.size(&task, &run).milliseconds);
        self.assign(task, &run, None, id, now, out);
        if let Some(worker) = self.floor.workers.get_mut(&id) {
            worker.at_hand.turn(out_of_turn);
        }
    }

    /// A ready task that the worker can begin at once, where `first`, whose turn it is, needs a frame made ready; `None`: there
    /// is none, or it is time for `first`.
    fn at_hand(&self, id: WorkerId, first: &TaskKey, now: Tick) -> Option<TaskKey> {
        let at_hand = &self.floor.workers.get(&id)?.at_hand;
        if first.stage.kind != StageKind::Render
            || at_hand.has(first)
            || at_hand.out_of_turn >= Self::OUT_OF_TURN * self.config.task
        {
            return None;
        }
        let priority = self.ledger.jobs.get(&first.job)?.spec.priority;
        let own = |job: JobId| {
            let known = self.ledger.jobs.get(&job).filter(|known| known.spec.priority == priority)?;
            self.may_work(id, job, known, now).then_some((job, known))
        };
        let same_frame = || {
            at_hand.frames.iter().rev().find_map(|&(job, frame)| {
                let (job, known) = own(job)?;
                self.ready_render(id, job, known, Some(frame))
            })
        };
        let same_scene = || {
            let jobs = at_hand.frames.iter().rev().filter(|_| !at_hand.has_job(first.job));
            jobs.filter_map(|&(job, _)| own(job)).find_map(|(job, known)| self.ready_render(id, job, known, None))
        };
        same_frame().or_else(same_scene)
    }

    fn may_work(&self, id: WorkerId, job: JobId, known: &Job, now: Tick) -> bool {
        let (worker, desk) = (self.floor.workers.get(&id), self.desks.get(&job));
        known.is_runnable()
            && worker.is_some_and(|worker| worker.has_tags(&known.spec.tags))
            && desk.is_some_and(|desk| !is_shunned(known, desk, id, &self.floor, now))
    }

    /// The first ready task that renders something of one frame of the job, or of any, and that the worker may take.
    fn ready_render(&self, id: WorkerId, job: JobId, known: &Job, frame: Option<u32>) -> Option<TaskKey> {
        let desk = self.desks.get(&job)?;
        let may_take = |task: &TaskKey| {
            !is_avoided(task, known, desk, id, &self.floor)
                && !is_foreign(&self.ledger, &self.floor, job, task.stage.frame, id)
        };
        match frame {
            Some(frame) => desk.open.get(frame)?.renders(job, frame).find(may_take),
            None => desk.open.ready().flat_map(|(frame, open)| open.renders(job, frame)).find(may_take),
        }
    }
}
