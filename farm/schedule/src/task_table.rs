//! Tables of a job's frames and tasks. The rounds of a finished frame are not kept: each of its tasks is listed once.

use std::collections::BTreeMap;
use std::ops::Range;

use femc_model::{
    FrameProgress, FrameStatus, JobId, Phase, Refusal, Stage, TaskFilter, TaskKey, TaskPage, TaskState, TaskStatus,
    Tick,
};

use crate::ledger::{Job, StageRound};
use crate::scheduler::Scheduler;

impl Scheduler {
    /// Maximum number of tasks in an answer. A client that sorts tasks requests all of them.
    pub const MAX_TASKS: usize = 200_000;

    /// Returns every frame of a job, ascending. The job's own stages come first, if it has any.
    pub fn frame_table(&self, id: JobId) -> Result<Vec<FrameStatus>, Refusal> {
        let job = self.job(id)?;
        let active: BTreeMap<u32, FrameProgress> =
            self.active_frames(id, job).into_iter().map(|progress| (progress.frame, progress)).collect();
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
        Ok(frames_of_job(job).map(status).collect())
    }

    /// Returns a page of the tasks of a job that match the filter: `count` from `from` on, at most [`Self::MAX_TASKS`].
    pub fn tasks(
        &self,
        id: JobId,
        filter: TaskFilter,
        from: u64,
        count: usize,
        now: Tick,
    ) -> Result<TaskPage, Refusal> {
        let job = self.job(id)?;
        let window = from..from.saturating_add(count.min(Self::MAX_TASKS) as u64);
        let mut page = TaskPage::default();
        for frame in frames_of_job(job).filter(|frame| filter.frame.is_none_or(|only| only == *frame)) {
            let stage_rounds = stage_rounds(job, frame, filter.stage);
            let all: u64 = stage_rounds.iter().map(|(_, tasks)| u64::from(*tasks)).sum();
            // Without a filter on the state, frames outside the window are only counted.
            if filter.state.is_none() && (page.total + all <= window.start || page.total >= window.end) {
                page.total += all;
                continue;
            }
            for (stage_round, tasks) in stage_rounds {
                let statuses = self.tasks_of_stage(id, job, frame, stage_round, 0..tasks, now);
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
    fn tasks_of_stage(
        &self,
        id: JobId,
        job: &Job,
        frame: u32,
        (round, number): StageRound,
        items: Range<u32>,
        now: Tick,
    ) -> Vec<TaskStatus> {
        let (progress, view) = (job.progress(frame), job.graph_view(frame));
        let Some((template, chunks)) = view.template(number).zip(progress.chunks(&view, (round, number))) else {
            return Vec::new();
        };
        let stage = Stage { frame, round, number, kind: template.kind };
        let is_finished = job.finished.contains_key(&frame);
        let status = |item| {
            let is_done = is_finished || progress.is_done((round, number), item);
            let state = if is_done { TaskState::Done } else { TaskState::Waiting };
            let task = TaskKey { job: id, stage, index: item };
            TaskStatus {
                task,
                state,
                covers_all_rounds: is_finished,
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
        for ((stage_number, failed_round, key), failures) in progress.failed_tasks() {
            let is_here = stage_number == number && (failed_round == round || !template.kind.is_divided());
            let known = all.get_mut(chunks.task(key) as usize).filter(|it| is_here && is_open(it));
            if let Some(known) = known {
                known.attempts += failures.attempt_count();
                known.failure = Some(failures.failure.clone());
                if failures.is_quarantined() {
                    known.state = TaskState::Failed;
                }
            }
        }
        for ((task, _), lease) in self.table.leases_of_frame(id, frame).filter(|((task, _), _)| task.stage == stage) {
            let Some(known) = all.get_mut(chunks.task(task.index) as usize).filter(|it| is_open(it)) else { continue };
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
fn frames_of_job(job: &Job) -> impl Iterator<Item = u32> + '_ {
    job.has_job_stages().then_some(Stage::JOB_FRAME).into_iter().chain(job.frames().iter().copied())
}

/// Returns the stages of a frame, each in the rounds that have begun, with their numbers of tasks.
fn stage_rounds(job: &Job, frame: u32, only: Option<u16>) -> Vec<(StageRound, u32)> {
    let view = job.graph_view(frame);
    let mut stage_rounds: Vec<(StageRound, u32)> = if job.finished.contains_key(&frame) {
        view.graph.stages_of(view.scope).map(|(number, template)| ((0, number), template.tasks())).collect()
    } else {
        let tasks = |stage_round: StageRound| {
            (stage_round, view.template(stage_round.1).map_or(0, |template| template.tasks()))
        };
        job.progress(frame).stage_rounds(&view).map(tasks).collect()
    };
    stage_rounds.retain(|((_, number), _)| only.is_none_or(|only| only == *number));
    stage_rounds.sort_unstable_by_key(|((round, number), _)| (*number, *round));
    stage_rounds
}
