//! JSON of a job, and the reasons why its tasks wait.

use std::collections::BTreeMap;

use femc_model::{Failure, FrameProgress, FrameStop, JobState, JobStatus, Stage, WaitReason};
use serde::Serialize;

use super::words::counted_noun;

/// A job as JSON. State names are in lower case, so that scripts do not depend on the spelling in the program.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JobJson {
    job: u64,
    name: String,
    state: &'static str,
    owner: String,
    /// Path of the scene file within its bundle.
    scene: String,
    /// A line for users; empty: none.
    comment: String,
    labels: BTreeMap<String, String>,
    /// URL to which a message is posted when the job has ended.
    notify: Option<String>,
    priority: u8,
    frames: u32,
    frames_done: u32,
    frames_failed: u32,
    samples: u64,
    samples_most: u64,
    samples_per_second: f64,
    bad_samples: u64,
    /// Relative error of the worst frame so far; `None` also if no sample found light.
    relative_error: Option<f64>,
    /// Number of the worst frame.
    worst_frame: Option<u32>,
    /// Blocks of the worst frame, and those in which no sample found light.
    blocks: Option<u32>,
    unlit_blocks: Option<u32>,
    /// Target relative error of each frame; `None`: samples or time end the job.
    error_target: Option<f64>,
    /// Reason why the error of the worst frame is above the target; `None`: it is not.
    above_target: Option<&'static str>,
    seconds: f64,
    /// Time of submission: Unix seconds by the farm's clock.
    submitted: Option<f64>,
    /// Calendar date of submission in Unix seconds.
    submitted_date: Option<f64>,
    workers: u32,
    failure: Option<String>,
    active: Vec<ActiveJson>,
    /// Number of slow tasks that were also given to a second worker.
    copies: u64,
    quarantined: Vec<QuarantinedJson>,
    /// Resource that all tasks of the job wait for: `memory` or `store`.
    waits_for: Option<&'static str>,
    waits: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
struct ActiveJson {
    frame: u32,
    stage: &'static str,
    round: u32,
    rounds: u32,
    tiles_done: u32,
    tiles: u32,
    running: u32,
    samples: u64,
    relative_error: Option<f64>,
    blocks: Option<u32>,
    unlit_blocks: Option<u32>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
struct QuarantinedJson {
    task: String,
    frame: u32,
    attempts: u32,
    failure: String,
}

impl From<&JobStatus> for JobJson {
    fn from(job: &JobStatus) -> Self {
        Self {
            job: job.job.0,
            name: job.name.clone(),
            state: job.state.name(),
            owner: job.owner.clone(),
            scene: job.scene.clone(),
            comment: job.notes.comment.clone(),
            labels: job.notes.labels.clone(),
            notify: job.notes.notify.clone(),
            priority: job.priority,
            frames: job.frames_total,
            frames_done: job.frames_done,
            frames_failed: job.frames_failed,
            samples: job.samples_done,
            samples_most: job.samples_planned,
            samples_per_second: job.samples_per_second,
            bad_samples: job.bad_samples,
            relative_error: job.relative_error,
            worst_frame: job.worst_frame.map(|worst| worst.frame),
            blocks: job.blocks.map(|blocks| blocks.all),
            unlit_blocks: job.blocks.map(|blocks| blocks.unlit),
            error_target: job.error_target,
            above_target: above_target(job).map(FrameStop::name),
            seconds: job.seconds,
            submitted: job.submitted.map(|milliseconds| milliseconds as f64 / 1000.0),
            submitted_date: job.submitted_date.map(|milliseconds| milliseconds as f64 / 1000.0),
            workers: job.workers,
            failure: job.failure.as_ref().map(ToString::to_string),
            active: job.active.iter().map(ActiveJson::from).collect(),
            copies: job.copies,
            quarantined: job
                .quarantined
                .iter()
                .map(|q| QuarantinedJson {
                    task: q.task.to_string(),
                    frame: q.task.stage.frame,
                    attempts: q.attempts,
                    failure: q.failure.to_string(),
                })
                .collect(),
            waits_for: awaited_resource(job),
            waits: job.waits.iter().map(|it| describe_wait(job, it)).collect(),
        }
    }
}

/// Returns the resource that all tasks of a job wait for: `memory` or `store`, if the suitable workers are in a back-off because it
/// is lacking. `None`: some of the job is done, or it waits for another reason.
pub fn awaited_resource(job: &JobStatus) -> Option<&'static str> {
    let wanted = job.waits.iter().find_map(|wait| match wait {
        WaitReason::WorkersBackingOff { failure: Failure::Resources { .. }, .. } => Some("memory"),
        WaitReason::WorkersBackingOff { failure: Failure::Store { .. }, .. } => Some("store"),
        _ => None,
    });
    // Another worker may be suitable and merely busy: then the job does not wait for memory.
    let all_rest = job.workers == 0 && job.waits.contains(&WaitReason::AllWorkersBackingOff);
    wanted.filter(|_| all_rest && matches!(job.state, JobState::Queued | JobState::Running))
}

/// Returns the state in words: `running`, or `waits for memory` (see [`awaited_resource`]).
pub fn state_text(job: &JobStatus) -> String {
    awaited_resource(job).map_or_else(|| job.state.name().to_owned(), |wanted| format!("waits for {wanted}"))
}

/// Returns why the error of a job's worst frame is above its target; `None`: it is not, or there is no target.
pub fn above_target(job: &JobStatus) -> Option<FrameStop> {
    let (error, target) = job.relative_error.zip(job.error_target)?;
    job.worst_frame.filter(|_| error > target).map(|worst| worst.stop)
}

impl From<&FrameProgress> for ActiveJson {
    fn from(frame: &FrameProgress) -> Self {
        Self {
            frame: frame.frame,
            stage: frame.stage.name(),
            round: frame.round + 1,
            rounds: frame.rounds,
            tiles_done: frame.tiles_done,
            tiles: frame.tiles_total,
            running: frame.running,
            samples: frame.samples_done,
            relative_error: frame.relative_error,
            blocks: frame.blocks.map(|blocks| blocks.all),
            unlit_blocks: frame.blocks.map(|blocks| blocks.unlit),
        }
    }
}

/// Returns the name of a frame, or "the whole job".
pub fn frame_label(frame: u32) -> String {
    if frame == Stage::JOB_FRAME { "the whole job".to_owned() } else { format!("frame {frame}") }
}

fn has(n: u32) -> &'static str {
    if n == 1 { "has" } else { "have" }
}

/// Describes why tasks of the job wait.
pub fn describe_wait(job: &JobStatus, wait: &WaitReason) -> String {
    match wait {
        WaitReason::Paused => "the job is paused".to_owned(),
        WaitReason::NoWorkers => "no worker is connected; start one with `femc worker --join URL`".to_owned(),
        WaitReason::NoWorkerWithTags(tags) => format!("no worker has all the tags {}", tags.join(", ")),
        WaitReason::WorkersBusy { workers: 1 } => "the only suitable worker is busy".to_owned(),
        WaitReason::WorkersBusy { workers } => format!("all {workers} suitable workers are busy"),
        WaitReason::WorkersDraining { workers: 1 } => {
            "the only suitable worker accepts no new tasks; see `femc workers`".to_owned()
        }
        WaitReason::WorkersDraining { workers } => {
            format!("all {workers} suitable workers accept no new tasks; see `femc workers`")
        }
        WaitReason::AllWorkersBackingOff => {
            "the suitable workers rest after a failure of memory, disk, store or network".to_owned()
        }
        WaitReason::WorkersSilent { workers, seconds } => {
            let (workers, verb) = (counted_noun(u64::from(*workers), "worker"), has(*workers));
            format!(
                "{workers} {verb} not responded for {seconds} s: stopped, disconnected or overloaded; see `femc workers`"
            )
        }
        WaitReason::WorkersBackingOff { workers: 1, seconds, failure } => {
            format!("1 worker rests for another {seconds} s after this failure: {failure}")
        }
        WaitReason::WorkersBackingOff { workers, seconds, failure } => {
            format!("{workers} workers rest, the first one for another {seconds} s, after this failure: {failure}")
        }
        WaitReason::WorkersQuarantined { workers, seconds } => format!(
            "tasks failed repeatedly on {}; the next attempt there is in {seconds} s",
            counted_noun(u64::from(*workers), "worker")
        ),
        WaitReason::WorkersAvoided { tasks } => format!(
            "the last attempt at {} failed on the workers that are free now; another worker must retry",
            counted_noun(u64::from(*tasks), "task")
        ),
        WaitReason::OtherBuild { frames } => format!(
            "the free workers have another engine build than the one that began {}; \
             rendering restarts one minute after the last worker with that build disconnects",
            counted_noun(u64::from(*frames), "frame")
        ),
        WaitReason::Regrouping { milliseconds } => {
            format!(
                "the coordinator has just started and waits until workers reconnect; \
                 it dispatches tasks in {milliseconds} ms"
            )
        }
        WaitReason::BehindJob(job) => format!("job {job} is ahead in the queue"),
        WaitReason::StageWaits { frame, stage, needs, tasks } => {
            let tasks = counted_noun(u64::from(*tasks), &format!("{} task", needs.name()));
            format!("the {} stage of {} waits for {tasks}", stage.name(), frame_label(*frame))
        }
        WaitReason::SharedStage { shared, stage, done, tasks, jobs } => {
            let jobs = counted_noun(u64::from(*jobs), "job");
            let stage = stage.name();
            format!(
                "frames wait for {shared}, which is computed once for {jobs}: \
                 {done} of {tasks} {stage} tasks are done"
            )
        }
        WaitReason::SharedQuarantined { shared, frames, tasks } => {
            let (frames, tasks) = (counted_noun(u64::from(*frames), "frame"), counted_noun(u64::from(*tasks), "task"));
            format!("{frames} cannot continue: {shared}, which they need, has {tasks} without attempts left")
        }
        WaitReason::InfrastructureFailures { tasks, message } => {
            format!(
                "attempts at {} failed because of their environment (store, network or memory) \
                 and will be retried: {message}",
                counted_noun(u64::from(*tasks), "task")
            )
        }
        WaitReason::ImageLost { frame: Stage::JOB_FRAME } => {
            "a still, the contact sheet or the clip is damaged or missing in the store; the job's own stages make it again"
                .to_owned()
        }
        WaitReason::ImageLost { frame } => {
            format!(
                "the finished image of frame {frame} is damaged or missing in the store; the frame is rendered again"
            )
        }
        WaitReason::Quarantined { frame: Stage::JOB_FRAME, tasks: 0 } => format!(
            "the job's own stages (stills, contact sheet, clip) wait for {} that failed; retry with `femc retry {}`",
            counted_noun(u64::from(job.frames_failed), "frame"),
            job.job
        ),
        WaitReason::Quarantined { frame, tasks } => {
            format!("{} cannot continue: {} without attempts left", frame_label(*frame), counted_noun(u64::from(*tasks), "task"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_model::{JobId, JobNotes};

    fn status() -> JobStatus {
        JobStatus {
            job: JobId(7),
            name: "walk".to_owned(),
            owner: "ann".to_owned(),
            scene: "walk.mgf".to_owned(),
            notes: JobNotes::default(),
            priority: 50,
            state: JobState::Failed,
            failure: None,
            frames_total: 10,
            frames_done: 7,
            frames_failed: 3,
            active: Vec::new(),
            workers: 0,
            samples_done: 0,
            samples_planned: 0,
            samples_per_second: 0.0,
            bad_samples: 0,
            relative_error: None,
            blocks: None,
            worst_frame: None,
            error_target: None,
            seconds: 0.0,
            quarantined: Vec::new(),
            stale_messages: 0,
            copies: 0,
            waits: Vec::new(),
            submitted: None,
            submitted_date: None,
        }
    }

    #[test]
    fn job_with_nothing_running_states_that_it_waits_for_memory() {
        let failure = Failure::Resources { message: "full".into() };
        let waits =
            vec![WaitReason::AllWorkersBackingOff, WaitReason::WorkersBackingOff { workers: 1, seconds: 3, failure }];
        let waiting = JobStatus { state: JobState::Running, workers: 0, waits, ..status() };
        assert_eq!((state_text(&waiting), awaited_resource(&waiting)), ("waits for memory".to_owned(), Some("memory")));
        for other in [
            JobStatus { workers: 1, ..waiting.clone() },
            JobStatus { state: JobState::Done, ..waiting.clone() },
            JobStatus { waits: vec![WaitReason::AllWorkersBackingOff], ..waiting.clone() },
            JobStatus {
                waits: vec![WaitReason::WorkersBusy { workers: 1 }, waiting.waits[1].clone()],
                ..waiting.clone()
            },
        ] {
            assert_eq!((state_text(&other), awaited_resource(&other)), (other.state.name().to_owned(), None));
        }
    }

    #[test]
    fn stages_of_the_whole_job_are_no_frame_in_what_a_job_waits_for() {
        let job = status();
        let said = |reason| describe_wait(&job, &reason);
        let waits = said(WaitReason::Quarantined { frame: Stage::JOB_FRAME, tasks: 0 });
        assert!(waits.contains("wait for 3 frames that failed") && waits.contains("`femc retry 7`"), "{waits}");
        let lost = said(WaitReason::ImageLost { frame: Stage::JOB_FRAME });
        assert!(lost.contains("clip") && !lost.contains("frame"), "{lost}");
        assert!(said(WaitReason::ImageLost { frame: 3 }).contains("image of frame 3"));
        assert!(
            said(WaitReason::Quarantined { frame: 3, tasks: 1 })
                .contains("frame 3 cannot continue: 1 task without attempts left")
        );
    }
}
