//! Tables of a job's frames and tasks. The rounds of a finished frame are not kept: each of its tasks is listed once.

use std::collections::BTreeMap;
use std::ops::Range;

use femc_model::{
    FrameProgress, FrameStatus, JobId, Phase, Refusal, Stage, TaskFilter, TaskKey, TaskPage, TaskState, TaskStatus,
    Tick,
};

use crate::ledger::{Job, Place};
use crate::scheduler::Scheduler;

impl Scheduler {
    /// Maximum number of tasks in an answer. A client that sorts tasks requests all of them.
    pub const TASKS: usize = 200_000;

    /// Returns every frame of a job, ascending. The job's own stages come first, if it has any.
    pub fn frame_table(&self, id: JobId) -> Result<Vec<FrameStatus>, Refusal> {
        let job = self.job(id)?;
        let active: BTreeMap<u32, FrameProgress> =
            self.active(id, job).into_iter().map(|progress| (progress.frame, progress)).collect();
        let status = |frame: u32| {
            let record = job.finished.get(&frame).map(|finished| finished.record.clone());
            let progress = active.get(&frame).copied();
            let state = match (&record, &progress) {
                (Some(_), _) => TaskState::Done,
                (None, _) if job.blocked.contains(&frame) => TaskState::Failed,
                (None, Some(_)) => TaskState::Running,
                (None, None) => TaskState::Waiting,
            };
            FrameStatus { frame, state, progress, record, times: None }
        };
        Ok(units(job).map(status).collect())
    }

    /// Returns a page of the tasks of a job that match the filter: `count` from `from` on, at most [`Self::TASKS`].
    pub fn tasks(
        &self,
        id: JobId,
        filter: TaskFilter,
        from: u64,
        count: usize,
        now: Tick,
    ) -> Result<TaskPage, Refusal> {
        let job = self.job(id)?;
        let window = from..from.saturating_add(count.min(Self::TASKS) as u64);
        let mut page = TaskPage::default();
        for frame in units(job).filter(|frame| filter.frame.is_none_or(|only| only == *frame)) {
            let places = places(job, frame, filter.stage);
            let all: u64 = places.iter().map(|(_, tasks)| u64::from(*tasks)).sum();
            // Without a filter on the state, frames outside the window are only counted.
            if filter.state.is_none() && (page.total + all <= window.start || page.total >= window.end) {
                page.total += all;
                continue;
            }
            for (place, tasks) in places {
                let statuses = self.of_place(id, job, frame, place, 0..tasks, now);
                let wanted = statuses.into_iter().filter(|it| filter.state.is_none_or(|only| only == it.state));
                for task in wanted {
                    if window.contains(&page.total) {
                        page.tasks.push(task);
                    }
                    page.total += 1;
                }
            }
        }
        Ok(page)
    }

    /// Returns the tasks of a stage in one round.
    fn of_place(
        &self,
        id: JobId,
        job: &Job,
        frame: u32,
        (round, number): Place,
        items: Range<u32>,
        now: Tick,
    ) -> Vec<TaskStatus> {
        let (unit, shape) = (job.unit(frame), job.shape(frame));
        let Some((template, grains)) = shape.template(number).zip(unit.grains(&shape, (round, number))) else {
            return Vec::new();
        };
        let stage = Stage { frame, round, number, kind: template.kind };
        let is_finished = job.finished.contains_key(&frame);
        let status = |item| {
            let is_done = is_finished || unit.is_done((round, number), item);
            let state = if is_done { TaskState::Done } else { TaskState::Waiting };
            let task = TaskKey { job: id, stage, index: item };
            TaskStatus {
                task,
                state,
                is_of_all_rounds: is_finished,
                workers: Vec::new(),
                attempts: 0,
                seconds: None,
                failure: None,
                times: None,
            }
        };
        let mut all: Vec<TaskStatus> = items.map(status).collect();
        if is_finished {
            return all;
        }
        let is_open = |it: &TaskStatus| it.state != TaskState::Done;
        for ((of, trouble_round, key), trouble) in unit.troubles() {
            let is_here = of == number && (trouble_round == round || !template.kind.is_cut());
            let known = all.get_mut(grains.task(key) as usize).filter(|it| is_here && is_open(it));
            if let Some(known) = known {
                known.attempts += trouble.tries();
                known.failure = Some(trouble.failure.clone());
                if trouble.is_quarantined() {
                    known.state = TaskState::Failed;
                }
            }
        }
        for ((task, _), lease) in self.table.of_frame(id, frame).filter(|((task, _), _)| task.stage == stage) {
            let Some(known) = all.get_mut(grains.task(task.index) as usize).filter(|it| is_open(it)) else { continue };
            let seconds = now.since(lease.granted) as f64 / 1000.0;
            let is_queued = lease.phase == Phase::Waiting && known.state != TaskState::Running;
            known.state = if is_queued { TaskState::Queued } else { TaskState::Running };
            known.attempts += 1;
            known.seconds = Some(known.seconds.map_or(seconds, |longest| longest.max(seconds)));
            let name = self.table.workers.get(&lease.worker).map(|worker| worker.registration.name.clone());
            known.workers.extend(name.filter(|name| !known.workers.contains(name)));
        }
        all
    }
}

/// Returns the frames of a job, preceded by its own stages, if it has any.
fn units(job: &Job) -> impl Iterator<Item = u32> + '_ {
    job.has_job_stages().then_some(Stage::OF_JOB).into_iter().chain(job.frames().iter().copied())
}

/// Returns the stages of a frame, each in the rounds that have begun, with their numbers of tasks.
fn places(job: &Job, frame: u32, only: Option<u16>) -> Vec<(Place, u32)> {
    let shape = job.shape(frame);
    let mut places: Vec<(Place, u32)> = if job.finished.contains_key(&frame) {
        shape.graph.of(shape.scope).map(|(number, template)| ((0, number), template.tasks())).collect()
    } else {
        let tasks = |place: Place| (place, shape.template(place.1).map_or(0, |template| template.tasks()));
        job.unit(frame).places(&shape).map(tasks).collect()
    };
    places.retain(|((_, number), _)| only.is_none_or(|only| only == *number));
    places.sort_unstable_by_key(|((round, number), _)| (*number, *round));
    places
}
