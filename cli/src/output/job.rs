//! Jobs, for people and for machines.

use super::{Say, Snapshot, human};
use crate::exit::Exit;
use femc_model::{FrameProgress, JobState, JobStatus, Stage, Wait};
use femc_pipeline::Stop;
use serde::Serialize;

/// A job as JSON: the names of states in lower case, so that scripts compare words, not a program's spelling.
#[derive(Debug, Serialize)]
pub struct JobJson {
    job: u64,
    name: String,
    state: &'static str,
    owner: String,
    priority: u8,
    frames: u32,
    frames_done: u32,
    frames_failed: u32,
    samples: u64,
    samples_most: u64,
    samples_per_second: f64,
    bad_samples: u64,
    relative_error: Option<f64>,
    seconds: f64,
    workers: u32,
    failure: Option<String>,
    active: Vec<ActiveJson>,
    /// Late tasks that were given to a second worker.
    copies: u64,
    quarantined: Vec<QuarantinedJson>,
    waits: Vec<String>,
}

#[derive(Debug, Serialize)]
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
}

#[derive(Debug, Serialize)]
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
            state: state(job.state),
            owner: job.owner.clone(),
            priority: job.priority,
            frames: job.frames_total,
            frames_done: job.frames_done,
            frames_failed: job.frames_failed,
            samples: job.samples_done,
            samples_most: job.samples_planned,
            samples_per_second: job.samples_per_second,
            bad_samples: job.bad_samples,
            relative_error: job.relative_error,
            seconds: job.seconds,
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
            waits: job.waits.iter().map(|it| wait(job, it)).collect(),
        }
    }
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
        }
    }
}

/// The state in one word.
pub fn state(state: JobState) -> &'static str {
    match state {
        JobState::Queued => "queued",
        JobState::Running => "running",
        JobState::Paused => "paused",
        JobState::Done => "done",
        JobState::Failed => "failed",
        JobState::Cancelled => "cancelled",
    }
}

/// The frame of this number, or the whole job.
fn unit(frame: u32) -> String {
    if frame == Stage::OF_JOB { "the whole job".to_owned() } else { format!("frame {frame}") }
}

/// The exit code of a job that has ended; `None` while it goes on.
pub fn exit(state: JobState) -> Option<Exit> {
    match state {
        JobState::Queued | JobState::Running | JobState::Paused => None,
        JobState::Done => Some(Exit::Done),
        JobState::Failed | JobState::Cancelled => Some(Exit::Failed),
    }
}

fn has(count: u32) -> &'static str {
    if count == 1 { "has" } else { "have" }
}

/// Why tasks of the job wait.
pub fn wait(job: &JobStatus, wait: &Wait) -> String {
    match wait {
        Wait::Paused => "the job is paused".to_owned(),
        Wait::NoWorkers => "no worker is there; start one with `femc worker --join URL`".to_owned(),
        Wait::NoWorkerWithTags(tags) => format!("no worker has all the tags {}", tags.join(", ")),
        Wait::WorkersBusy { workers: 1 } => "the only worker that may take it is busy".to_owned(),
        Wait::WorkersBusy { workers } => format!("all {workers} workers that may take it are busy"),
        Wait::WorkersDraining { workers: 1 } => {
            "the only worker that may take it takes no more tasks; `femc workers` tells more".to_owned()
        }
        Wait::WorkersDraining { workers } => {
            format!("all {workers} workers that may take it take no more tasks; `femc workers` tells more")
        }
        Wait::WorkersResting => {
            "the workers that may take it rest after a failure of memory, disk, store or network".to_owned()
        }
        Wait::WorkersSilent { workers, seconds } => {
            let (workers, verb) = (human::count(u64::from(*workers), "worker"), has(*workers));
            format!(
                "{workers} {verb} not been heard of for {seconds} s: stopped, cut off or overloaded; `femc workers` tells which"
            )
        }
        Wait::WorkersInTrouble { workers: 1, seconds, failure } => {
            format!("1 worker rests for {seconds} s more, after this: {failure}")
        }
        Wait::WorkersInTrouble { workers, seconds, failure } => {
            format!("{workers} workers rest, the first for {seconds} s more, after this: {failure}")
        }
        Wait::WorkersQuarantined { workers, seconds } => format!(
            "tasks kept failing on {}: the next try there in {seconds} s",
            human::count(u64::from(*workers), "worker")
        ),
        Wait::WorkersAvoided { tasks } => format!(
            "{} failed last on the workers with room, and another worker is to try next",
            human::count(u64::from(*tasks), "task")
        ),
        Wait::OtherBuild { frames } => format!(
            "{} begun by another build of the engine than that of the workers with room; a minute after its last worker has left they begin anew",
            human::count(u64::from(*frames), "frame")
        ),
        Wait::Regrouping { milliseconds } => {
            format!("the coordinator hears the workers out after its start; tasks go out in {milliseconds} ms")
        }
        Wait::BehindJob(job) => format!("job {job} goes first"),
        Wait::StageWaits { frame, stage, needs, tasks } => {
            let tasks = human::count(u64::from(*tasks), &format!("{} task", needs.name()));
            format!("the {} stage of {} waits for {tasks}", stage.name(), unit(*frame))
        }
        Wait::SharedStage { shared, stage, done, tasks, jobs } => {
            let jobs = human::count(u64::from(*jobs), "job");
            let stage = stage.name();
            format!("frames wait for {shared}, which is done once for {jobs}: {done} of {tasks} {stage} tasks are done")
        }
        Wait::SharedQuarantined { shared, frames, tasks } => {
            let (frames, tasks) = (human::count(u64::from(*frames), "frame"), human::count(u64::from(*tasks), "task"));
            format!("{frames} cannot go on: {shared}, which they need, has {tasks} out of attempts")
        }
        Wait::Mishaps { tasks, message } => {
            format!("{} could not be done until now: {message}", human::count(u64::from(*tasks), "task"))
        }
        Wait::ImageLost { frame: Stage::OF_JOB } => {
            "a still, the contact sheet or the clip was damaged in the store, or is gone: the job's own stages make them again"
                .to_owned()
        }
        Wait::ImageLost { frame } => {
            format!(
                "the finished image of frame {frame} was damaged in the store, or is gone: the frame is rendered again"
            )
        }
        Wait::Quarantined { frame: Stage::OF_JOB, tasks: 0 } => format!(
            "the job's own stages (stills, contact sheet, clip) wait for {} that failed; `femc retry {}` tries again",
            human::count(u64::from(job.frames_failed), "frame"),
            job.job
        ),
        Wait::Quarantined { frame, tasks } => {
            format!("{} cannot go on: {} out of attempts", unit(*frame), human::count(u64::from(*tasks), "task"))
        }
    }
}

/// How far a job is, for the progress display.
/// - `stop`: the job's stopping rule where it is known; without it the time left is told from finished frames alone.
pub fn snapshot(job: &JobStatus, stop: Option<Stop>) -> Snapshot {
    let in_work: f64 = job.active.iter().map(|frame| part_done(frame, stop)).sum();
    let open = f64::from(job.frames_total.saturating_sub(job.frames_done));
    Snapshot {
        frames_done: u64::from(job.frames_done),
        frames: u64::from(job.frames_total),
        tiles_done: job.active.iter().map(|frame| u64::from(frame.tiles_done)).sum(),
        tiles: job.active.iter().map(|frame| u64::from(frame.tiles_total)).sum(),
        samples: job.samples_done,
        fraction: (f64::from(job.frames_done) + in_work.min(open)) / f64::from(job.frames_total.max(1)),
        relative_error: job.relative_error,
    }
}

/// The part of a frame in work that is done, 0..1. With an error as the goal, from the error of the round before:
/// it falls with the square root of the samples.
fn part_done(frame: &FrameProgress, stop: Option<Stop>) -> f64 {
    let of_round = f64::from(frame.tiles_done) / f64::from(frame.tiles_total.max(1));
    match (stop, frame.relative_error) {
        (Some(Stop::Spp(_)), _) => of_round / f64::from(frame.rounds.max(1)),
        (Some(Stop::Error(goal)), Some(reached)) if reached > goal && reached.is_finite() => {
            // The rounds double: this one began at 2^(round - 1) first rounds and ends at 2^round.
            let begun = (goal / reached).powi(2);
            (begun * (1.0 + of_round)).min(0.95)
        }
        _ => 0.0,
    }
}

/// The table of `femc jobs`.
pub fn table(jobs: &[JobStatus]) -> String {
    let rows: Vec<Vec<String>> = jobs
        .iter()
        .map(|job| {
            vec![
                job.job.to_string(),
                job.name.clone(),
                state(job.state).to_owned(),
                format!("{}/{}", job.frames_done, job.frames_total),
                job.priority.to_string(),
                job.owner.clone(),
                job.workers.to_string(),
                human::seconds(job.seconds),
            ]
        })
        .collect();
    human::table(&["job", "name", "state", "frames", "priority", "owner", "workers", "time"], &rows)
}

/// All about one job.
pub fn describe(say: Say, job: &JobStatus) -> String {
    let mut lines = vec![say.heading(&format!("job {} ({}): {}", job.job, job.name, state(job.state)))];
    let mut frames = format!("frames   {} of {} done", job.frames_done, job.frames_total);
    if job.frames_failed > 0 {
        frames += &say.bad(&format!(", {} failed", job.frames_failed));
    }
    lines.push(frames);
    let mut samples = format!("samples  {}", human::quantity(job.samples_done as f64));
    if job.samples_per_second > 0.0 {
        samples += &format!(", {} a second", human::quantity(job.samples_per_second));
    }
    if let Some(error) = job.relative_error {
        samples += &format!(", relative error {}", human::percent(error));
    }
    lines.push(samples);
    if job.bad_samples > 0 {
        lines.push(say.doubtful(&format!("         {} left out: not finite", human::count(job.bad_samples, "sample"))));
    }
    lines.push(format!(
        "time     {}, {} at it",
        human::seconds(job.seconds),
        human::count(job.workers.into(), "worker")
    ));
    if job.copies > 0 {
        lines.push(format!("copies   {} given to a second worker", human::count(job.copies, "late task")));
    }
    for frame in &job.active {
        lines.push(format!(
            "{}: {}, round {} of {}, {} of {} {} done, {} running",
            unit(frame.frame),
            frame.stage.name(),
            frame.round + 1,
            frame.rounds,
            frame.tiles_done,
            frame.tiles_total,
            if frame.frame == Stage::OF_JOB { "tasks" } else { "tiles" },
            frame.running
        ));
    }
    lines.extend(trouble(job).into_iter().map(|line| say.bad(&line)));
    lines.join("\n")
}

/// Why a job has failed, or some task of it is out of attempts.
pub fn trouble(job: &JobStatus) -> Vec<String> {
    let whole = job.failure.iter().map(|failure| format!("failed: {failure}"));
    let tasks = job
        .quarantined
        .iter()
        .map(|q| format!("task {} failed {}: {}", q.task, human::count(q.attempts.into(), "time"), q.failure));
    whole.chain(tasks).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_model::JobId;

    #[test]
    fn stages_of_the_whole_job_are_no_frame_in_what_a_job_waits_for() {
        let job = JobStatus {
            job: JobId(7),
            name: "walk".to_owned(),
            owner: "ann".to_owned(),
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
            seconds: 0.0,
            quarantined: Vec::new(),
            stale_messages: 0,
            copies: 0,
            waits: Vec::new(),
        };
        let said = |reason| wait(&job, &reason);
        let waits = said(Wait::Quarantined { frame: Stage::OF_JOB, tasks: 0 });
        assert!(waits.contains("wait for 3 frames that failed") && waits.contains("`femc retry 7`"), "{waits}");
        let lost = said(Wait::ImageLost { frame: Stage::OF_JOB });
        assert!(lost.contains("clip") && !lost.contains("frame"), "{lost}");
        assert!(said(Wait::ImageLost { frame: 3 }).contains("image of frame 3"));
        assert!(
            said(Wait::Quarantined { frame: 3, tasks: 1 }).contains("frame 3 cannot go on: 1 task out of attempts")
        );
    }
}
