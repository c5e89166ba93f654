//! `femc pause|resume|cancel|retry|delete JOB..` and `femc priority JOB N`: control jobs.

use super::client::{self, FarmClient};
use crate::args::{SelectArgs, ServerArgs};
use crate::exit::{Exit, Failure, usage};
use crate::output::{Printer, human, job as show};
use crate::values::Frames;
use clap::Args;
use femc_model::{Control, JobId, JobState, JobStatus, WaitReason};

/// Jobs and their farm.
#[derive(Debug, Args)]
pub struct ControlArgs {
    /// Job numbers, as printed by `submit`
    #[arg(value_name = "JOB", required_unless_present_any = ["owner", "name", "labels"], conflicts_with_all = ["owner", "name", "labels"])]
    jobs: Vec<u64>,
    #[command(flatten)]
    select: SelectArgs,
    #[command(flatten)]
    server: ServerArgs,
}

/// Jobs, their farm, and some of their frames.
#[derive(Debug, Args)]
pub struct RetryArgs {
    #[command(flatten)]
    jobs: ControlArgs,
    /// Only these frames: K, A..B or A..B+STEP, with commas between several; a paused job stays paused
    #[arg(long, value_name = "FRAMES", conflicts_with_all = ["owner", "name", "labels"])]
    frames: Option<Frames>,
}

/// A job, its farm and a priority.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  femc priority 7 90")]
pub struct PriorityArgs {
    /// Job number, as printed by `submit`
    #[arg(value_name = "JOB")]
    job: u64,
    /// 0 to 100, greater first
    #[arg(value_name = "N", value_parser = clap::value_parser!(u8).range(0..=100))]
    priority: u8,
    #[command(flatten)]
    server: ServerArgs,
}

/// Applies `control` to each job, even if it fails for others.
pub fn run(args: &ControlArgs, control: &Control, printer: Printer) -> Result<Exit, Failure> {
    control_selected(args, control, None, printer)
}

/// Retries failed tasks, of all frames or of some.
pub fn retry(args: &RetryArgs, printer: Printer) -> Result<Exit, Failure> {
    control_selected(&args.jobs, &Control::Retry, args.frames.as_ref(), printer)
}

fn control_selected(
    args: &ControlArgs,
    control: &Control,
    frames: Option<&Frames>,
    printer: Printer,
) -> Result<Exit, Failure> {
    client::block_on(&args.server, async |farm| {
        let jobs =
            if args.select.is_empty() { args.jobs.clone() } else { select_jobs(&args.select, control, farm).await? };
        if jobs.is_empty() {
            return Err(usage(
                "no job with this owner, name and label is in a state that allows this; `femc jobs` lists all jobs",
            ));
        }
        control_jobs(farm, &jobs, control, frames, printer).await
    })
}

/// Returns the numbers of the frames. Fails if one of them does not belong to the job.
async fn resolve_frames(farm: &FarmClient, job: JobId, frames: &Frames) -> Result<Vec<u32>, Failure> {
    let there = farm.spec(job).await?.frames;
    frames.select_from(&there).map_err(|frame| {
        let (first, last) = (there.first().unwrap_or(&0), there.last().unwrap_or(&0));
        let count = human::counted_noun(there.len() as u64, "frame");
        usage(format!("job {job} has no frame {frame}: it has {count}, from {first} to {last}"))
    })
}

/// Changes the priority.
pub fn prioritize(args: &PriorityArgs, printer: Printer) -> Result<Exit, Failure> {
    let control = Control::Priority(args.priority);
    client::block_on(&args.server, async |farm| control_jobs(farm, &[args.job], &control, None, printer).await)
}

/// Returns the selected jobs to which `control` can be applied.
async fn select_jobs(select: &SelectArgs, control: &Control, farm: &FarmClient) -> Result<Vec<u64>, Failure> {
    let can = |job: &JobStatus| match control {
        Control::Retry | Control::RetryFrames(_) => {
            matches!(job.state, JobState::Failed | JobState::Cancelled) || !job.quarantined.is_empty()
        }
        Control::Resume => job.state == JobState::Paused,
        Control::Pause | Control::Cancel | Control::Priority(_) => !job.state.has_ended(),
        Control::Delete => job.state.has_ended(),
    };
    let jobs = farm.listing().await?.jobs;
    Ok(jobs.iter().filter(|job| select.matches(job) && can(job)).map(|job| job.job.0).collect())
}

/// Applies `control` to the jobs.
/// - `frames`: frames to which a retry is limited; `None`: all.
async fn control_jobs(
    farm: &FarmClient,
    jobs: &[u64],
    control: &Control,
    frames: Option<&Frames>,
    printer: Printer,
) -> Result<Exit, Failure> {
    let done = match (control, frames) {
        (Control::Pause, _) => "is paused; `femc resume` resumes it".to_owned(),
        (Control::Resume, _) => "is resumed".to_owned(),
        (Control::Cancel, _) => {
            "is cancelled; finished frames are kept, and `femc retry` renders the others".to_owned()
        }
        (Control::Retry, Some(frames)) => format!("retries its failed or unfinished tasks of the frames {frames}"),
        (Control::Retry | Control::RetryFrames(_), _) => "retries its failed or unfinished tasks".to_owned(),
        (Control::Priority(priority), _) => format!("has priority {priority}"),
        (Control::Delete, _) => "is deleted".to_owned(),
    };
    let mut failures = Vec::new();
    for &job in jobs {
        let steered = async {
            let control = match frames {
                None => control.clone(),
                Some(frames) => Control::RetryFrames(resolve_frames(farm, JobId(job), frames).await?),
            };
            farm.control(JobId(job), control).await
        };
        match steered.await {
            Ok(()) => {
                printer.note(format!("job {job} {done}"));
                lost_images(farm, job, control).await.iter().for_each(|line| printer.note(line));
            }
            Err(failure) => failures.push((job, failure)),
        }
    }
    let Some((_, last)) = failures.pop() else { return Ok(Exit::Done) };
    failures.iter().for_each(|(job, failure)| printer.warning(format!("job {job}: {failure}")));
    Err(last)
}

/// Returns lines about lost images that a retry renders again.
async fn lost_images(farm: &FarmClient, job: u64, control: &Control) -> Vec<String> {
    if *control != Control::Retry {
        return Vec::new();
    }
    // The retry is done, even if the farm no longer answers.
    let Ok(status) = farm.status(JobId(job)).await else { return Vec::new() };
    let lost = status.waits.iter().filter(|wait| matches!(wait, WaitReason::ImageLost { .. }));
    lost.map(|wait| show::describe_wait(&status, wait)).collect()
}
