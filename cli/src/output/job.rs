//! Text and JSON about jobs.

use super::{Printer, ProgressSnapshot, human};
use crate::exit::Exit;
use femc_model::{AttemptTimes, FrameProgress, FrameRecord, FrameStop, JobState, JobStatus, Stage};
use femc_pipeline::StopCondition;
pub use femc_service::view::{JobJson, describe_wait};
use femc_service::view::{above_target, frame_label, state_text};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Returns the exit code of a job that has ended; `None` if it has not.
pub fn exit_code(state: JobState) -> Option<Exit> {
    match state {
        JobState::Queued | JobState::Running | JobState::Paused => None,
        JobState::Done => Some(Exit::Done),
        JobState::Failed | JobState::Cancelled => Some(Exit::Failed),
    }
}

/// Returns the progress of a job, for the progress display.
/// - `stop`: stopping rule of the job, if known; without it the remaining time is estimated from finished frames only.
pub fn progress_snapshot(job: &JobStatus, stop: Option<StopCondition>) -> ProgressSnapshot {
    let in_work: f64 = job.active.iter().map(|frame| finished_fraction(frame, stop)).sum();
    let open = f64::from(job.frames_total.saturating_sub(job.frames_done));
    ProgressSnapshot {
        frames_done: u64::from(job.frames_done),
        frames: u64::from(job.frames_total),
        tiles_done: job.active.iter().map(|frame| u64::from(frame.tiles_done)).sum(),
        tiles: job.active.iter().map(|frame| u64::from(frame.tiles_total)).sum(),
        samples: job.samples_done,
        fraction: (f64::from(job.frames_done) + in_work.min(open)) / f64::from(job.frames_total.max(1)),
        relative_error: job.relative_error,
        worst_frame: job.worst_frame.map(|worst| worst.frame).filter(|_| job.frames_total > 1),
        blocks: job.blocks,
    }
}

/// Returns the finished part of a frame in progress, 0..1. If the goal is an error, it is estimated from the error of the previous
/// round, which is proportional to one over the square root of the samples.
fn finished_fraction(frame: &FrameProgress, stop: Option<StopCondition>) -> f64 {
    let of_round = f64::from(frame.tiles_done) / f64::from(frame.tiles_total.max(1));
    match (stop, frame.relative_error) {
        (Some(StopCondition::Spp(_)), _) => of_round / f64::from(frame.rounds.max(1)),
        (Some(StopCondition::Error(goal)), Some(reached)) if reached > goal && reached.is_finite() => {
            // Each round doubles the samples: the current round began at 2^(round - 1) times the samples of the first round and
            // ends at 2^round times.
            let begun = (goal / reached).powi(2);
            (begun * (1.0 + of_round)).min(0.95)
        }
        _ => 0.0,
    }
}

/// Returns the table of `femc jobs`.
pub fn table(jobs: &[JobStatus]) -> String {
    let rows: Vec<Vec<String>> = jobs
        .iter()
        .map(|job| {
            vec![
                job.job.to_string(),
                job.name.clone(),
                state_text(job),
                format!("{}/{}", job.frames_done, job.frames_total),
                job.priority.to_string(),
                job.owner.clone(),
                job.workers.to_string(),
                human::seconds(job.seconds),
                age(job).unwrap_or_default(),
            ]
        })
        .collect();
    human::table(&["job", "name", "state", "frames", "priority", "owner", "workers", "time", "age"], &rows)
}

/// Returns the time since the job was submitted; `None`: not known.
fn age(job: &JobStatus) -> Option<String> {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).ok()?;
    let age = now.saturating_sub(Duration::from_millis(job.submitted_date.or(job.submitted)?));
    Some(human::seconds(age.as_secs_f64()))
}

/// Returns text about the error of a job's worst frame, like
/// `relative error 7.10 % in frame 3, above the target of 5.00 %: still rendering`; `None`: no frame was measured.
pub fn error_text(job: &JobStatus) -> Option<String> {
    let mut text = super::error::error_text(job.relative_error, job.blocks)?;
    if let Some(worst) = job.worst_frame {
        text += &format!(" in frame {}", worst.frame);
    }
    let Some(target) = job.error_target.filter(|_| job.relative_error.is_some()) else { return Some(text) };
    let target = human::percent(target);
    text += &match above_target(job) {
        None => format!(", within the target of {target}"),
        Some(FrameStop::Unknown) => format!(", above the target of {target}"),
        Some(FrameStop::Rendering) => format!(", above the target of {target}: still rendering"),
        Some(FrameStop::Limit) => {
            format!(", above the target of {target}: the frame has reached the limit of samples")
        }
        Some(FrameStop::Estimate) => {
            format!(", above the target of {target}: an estimate stopped the frame, and may miss the target slightly")
        }
    };
    Some(text)
}

/// Returns the finished frame whose attempts took the most processor time.
pub fn find_slowest(frames: &[FrameRecord]) -> Option<(u32, AttemptTimes)> {
    let times = frames.iter().filter(|record| record.frame != Stage::JOB_FRAME);
    let times = times.filter_map(|record| Some((record.frame, record.times?)));
    times.reduce(|slowest, next| if next.1.processor > slowest.1.processor { next } else { slowest })
}

/// Returns text about the slowest frame, like `frame 3: 8.10 s of processor time, 9.20 s at workers, 42.0 s waiting`.
pub fn slowest_text(frame: u32, times: &AttemptTimes) -> String {
    let [processor, wall, waiting] = [times.processor, times.wall, times.waiting].map(human::seconds);
    format!("frame {frame}: {processor} of processor time, {wall} at workers, {waiting} waiting")
}

/// Returns a full description of one job.
pub fn describe(printer: Printer, job: &JobStatus) -> String {
    let mut lines = vec![printer.style_heading(&format!("job {} ({}): {}", job.job, job.name, state_text(job)))];
    let mut frames = format!("frames   {} of {} done", job.frames_done, job.frames_total);
    if job.frames_failed > 0 {
        frames += &printer.style_error(&format!(", {} failed", job.frames_failed));
    }
    lines.push(frames);
    let mut samples = format!("samples  {}", human::quantity(job.samples_done as f64));
    if job.samples_per_second > 0.0 {
        samples += &format!(", {} a second", human::quantity(job.samples_per_second));
    }
    lines.push(samples);
    lines.extend(error_text(job).map(|error| format!("error    {error}")));
    if job.bad_samples > 0 {
        lines.push(printer.style_warning(&format!(
            "         {} left out: not finite",
            human::counted_noun(job.bad_samples, "sample")
        )));
    }
    lines.push(format!(
        "time     {}, {} active",
        human::seconds(job.seconds),
        human::counted_noun(job.workers.into(), "worker")
    ));
    if !job.notes.comment.is_empty() {
        lines.push(format!("comment  {}", job.notes.comment));
    }
    if !job.notes.labels.is_empty() {
        let labels: Vec<String> = job.notes.labels.iter().map(|(name, value)| format!("{name}={value}")).collect();
        lines.push(format!("labels   {}", labels.join(", ")));
    }
    lines.extend(age(job).map(|age| format!("age      {age} since it was submitted")));
    if job.copies > 0 {
        lines.push(format!("copies   {} given to a second worker", human::counted_noun(job.copies, "late task")));
    }
    for frame in &job.active {
        lines.push(format!(
            "{}: {}, round {} of {}, {} of {} {} done, {} running",
            frame_label(frame.frame),
            frame.stage.name(),
            frame.round + 1,
            frame.rounds,
            frame.tiles_done,
            frame.tiles_total,
            if frame.frame == Stage::JOB_FRAME { "tasks" } else { "tiles" },
            frame.running
        ));
    }
    lines.extend(failure_lines(job).into_iter().map(|line| printer.style_error(&line)));
    lines.join("\n")
}

/// Returns lines about why a job has failed, or why some of its tasks are quarantined.
pub fn failure_lines(job: &JobStatus) -> Vec<String> {
    let whole = job.failure.iter().map(|failure| format!("failed: {failure}"));
    let tasks = job
        .quarantined
        .iter()
        .map(|q| format!("task {} failed {}: {}", q.task, human::counted_noun(q.attempts.into(), "time"), q.failure));
    whole.chain(tasks).collect()
}
