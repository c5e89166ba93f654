//! `femc fetch JOB -o DIR`: the finished frames of a job as files.

use super::client::{self, Farm};
use super::preview::Partial;
use super::render::frame_name;
use crate::args::{FormatArgs, ServerArgs};
use crate::exit::{Exit, Failure, failed};
use crate::output::{Say, human, job as show, json};
use clap::Args;
use femc_model::{Digest, FrameRecord, JobId, JobSpec, JobState, JobStatus};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Write the finished frames of a job into a folder, under the names that `render` gives them
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc fetch 7 -o drive\n  \
    femc fetch 7 -o drive --partial    # also what there is of the frames in work\n  \
    femc watch 7; femc fetch 7 -o drive --json | jq -r '.files[]'\n\n\
    Files that are there already are not fetched again. A frame whose image the farm's store has damaged or lost is named; it is\n  \
    rendered again, in a job that has failed or was cancelled after `femc retry`. The exit code is 1 while frames are missing.")]
pub struct FetchArgs {
    /// The job's number, as `submit` printed it
    #[arg(value_name = "JOB")]
    job: u64,
    /// Folder for the frames
    #[arg(long, short, value_name = "DIR")]
    out: PathBuf,
    /// Also what there is of the frames in work, as NAME.NNNN.partial.exr; what is not rendered yet is black
    #[arg(long)]
    partial: bool,
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    server: ServerArgs,
}

#[derive(Serialize)]
struct Report {
    job: u64,
    state: &'static str,
    frames: u32,
    files: Vec<String>,
    partial: Vec<String>,
    /// Frames whose image was damaged or gone.
    lost: Vec<u32>,
}

/// Fetch.
pub fn run(args: &FetchArgs, say: Say) -> Result<Exit, Failure> {
    let (status, files, partial, lost) = client::block_on(&args.server, async |farm| {
        let status = farm.status(JobId(args.job)).await?;
        if !JobSpec::names_files(&status.name) {
            return Err(failed(format!("job {} is called {:?}, and files cannot be called so", args.job, status.name)));
        }
        let (mut files, mut lost) = (Vec::new(), Vec::new());
        for frame in farm.frames(JobId(args.job)).await? {
            match file(farm, &status, &frame, &args.out).await? {
                Some(path) => files.push(path),
                None => lost.push(frame.frame),
            }
        }
        // As it is now: a job that was done goes on.
        let status = if lost.is_empty() { status } else { farm.status(JobId(args.job)).await? };
        for &frame in &lost {
            let name = frame_name(&status.name, frame);
            say.warning(format!(
                "frame {frame} of job {} ({name}): its image was damaged in the farm's store, or is gone; {}",
                args.job,
                what_follows(&status)
            ));
        }
        let mut partial = Vec::new();
        for parts in if args.partial { farm.parts(JobId(args.job)).await? } else { Vec::new() } {
            let path = args.out.join(format!("{}.{:04}.partial.exr", status.name, parts.frame));
            let mut there = Partial::new(&parts)?;
            if there.take(farm, &parts).await? {
                there.write(&path)?;
                partial.push(path);
            }
        }
        Ok((status, files, partial, lost))
    })?;
    if args.format.json {
        let names = |paths: &[PathBuf]| paths.iter().map(|path| path.display().to_string()).collect();
        let (files, partial) = (names(&files), names(&partial));
        let state = show::state(status.state);
        json::print(say, &Report { job: args.job, state, frames: status.frames_total, files, partial, lost })?;
    } else {
        let frames = human::count(files.len() as u64, "frame");
        say.result(format!("{frames} in {}", args.out.display()));
        partial.iter().for_each(|path| say.result(format!("in work: {}", path.display())));
    }
    if files.len() < status.frames_total as usize {
        return Err(failed(format!(
            "{} of {} frames are finished, job {} is {}; fetch again later, what is here stays",
            files.len(),
            status.frames_total,
            args.job,
            show::state(status.state)
        )));
    }
    Ok(Exit::Done)
}

/// What becomes of a frame whose image is lost.
fn what_follows(status: &JobStatus) -> String {
    let job = status.job;
    match status.state {
        JobState::Queued | JobState::Running => "it is rendered again".to_owned(),
        JobState::Paused => format!("it is rendered again after `femc resume {job}`"),
        JobState::Failed | JobState::Cancelled => format!("it is rendered again after `femc retry {job}`"),
        // Somebody has put the image there again meanwhile, or the harm was done on the way.
        JobState::Done => "the store has it now: fetch again".to_owned(),
    }
}

/// Write one frame, unless the file has its bytes already; `None`: the farm does not have it as it should be.
async fn file(farm: &Farm, job: &JobStatus, frame: &FrameRecord, folder: &Path) -> Result<Option<PathBuf>, Failure> {
    let path = folder.join(frame_name(&job.name, frame.frame));
    let there =
        std::fs::read(&path).is_ok_and(|bytes| Some(Digest::of(&bytes)) == frame.image().map(|image| image.digest));
    if !there {
        let Some(bytes) = farm.image(frame).await? else { return Ok(None) };
        femc_film::file::write_atomic(&path, &bytes).map_err(failed)?;
    }
    Ok(Some(path))
}
