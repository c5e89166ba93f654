//! `femc fetch JOB -o DIR`: writes the finished frames of a job as files.

use super::client::{self, FarmClient};
use super::live_preview::PreviewTargets;
use super::preview::PreviewFrame;
use super::readings::{self, readings_path, table_path};
use super::render::{frame_name, layers_path, painted_name, statistics_path, still_name};
use super::watch::{FollowMessages, follow};
use crate::args::{FormatArgs, ServerArgs};
use crate::exit::{Exit, Failure, failed};
use crate::output::{Printer, human, job as show, json};
use clap::Args;
use femc_model::{Artifact, Digest, JobId, JobSpec, JobState, JobStatus, Role, StageKind};
use femc_worker::ExtraOutputs;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Write the finished frames of a job into a folder, with the same file names as `render`, and the job's clip, sheet and pictures
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc fetch 7 -o drive\n  \
    femc fetch 7 -o drive --partial    # also unfinished frames\n  \
    femc fetch 7 -o drive --wait       # wait until the job has ended\n  \
    femc watch 7; femc fetch 7 -o drive --json | jq -r '.files[]'\n\n\
    Existing files are not fetched again. A frame whose image is damaged or missing in the farm's store is reported and rendered\n  \
    again; if the job has failed or was cancelled, only after `femc retry`. The exit code is 1 while frames are missing.")]
pub struct FetchArgs {
    /// Job number, as printed by `submit`
    #[arg(value_name = "JOB")]
    job: u64,
    /// Folder for the frames
    #[arg(long, short, value_name = "DIR")]
    out: PathBuf,
    /// Also write unfinished frames, as NAME.NNNN.partial.exr, black where nothing is rendered yet
    #[arg(long)]
    partial: bool,
    /// First wait until the job has ended, and show its progress
    #[arg(long)]
    wait: bool,
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    server: ServerArgs,
}

#[derive(Serialize)]
struct FetchReport {
    job: u64,
    state: &'static str,
    frames: u32,
    files: Vec<String>,
    /// Tables of readings beside the frames.
    readings: Vec<String>,
    partial: Vec<String>,
    #[serde(flatten)]
    outputs: JobOutputs,
    /// Frames whose image is damaged or gone.
    lost: Vec<u32>,
}

/// Files that are made of all frames.
#[derive(Clone, Debug, Default, Serialize)]
struct JobOutputs {
    /// PNG files beside the frames.
    previews: Vec<String>,
    /// Painted pictures of the frames.
    painted: Vec<String>,
    contact_sheet: Option<String>,
    video: Option<String>,
    /// Number of these files that could not be fetched.
    #[serde(skip)]
    missing: u64,
}

/// Runs `femc fetch`.
pub fn run(args: &FetchArgs, printer: Printer) -> Result<Exit, Failure> {
    let (status, files, readings, partial, outputs, lost) = client::block_on(&args.server, async |farm| {
        let status = farm.status(JobId(args.job)).await?;
        if !JobSpec::is_valid_name(&status.name) {
            return Err(failed(format!(
                "job {} is named {:?}, which cannot be part of a file name",
                args.job, status.name
            )));
        }
        let status = if args.wait { wait_until_ended(args, farm, printer).await? } else { status };
        let spec = farm.spec(JobId(args.job)).await?;
        let has_images = spec.graph.stage_of_kind(StageKind::Image).is_some();
        let (mut files, mut readings, mut lost) = (Vec::new(), Vec::new(), Vec::new());
        for frame in farm.frames(JobId(args.job)).await? {
            let path = args.out.join(frame_name(&status.name, frame.frame));
            let mut has_sidecars = true;
            for (artifact, path) in [(frame.statistics(), statistics_path(&path)), (frame.layers(), layers_path(&path))]
            {
                if let Some(artifact) = artifact {
                    has_sidecars &= fetch_file(farm, &artifact, &path).await?;
                }
            }
            if let Some(artifact) = frame.readings() {
                if fetch_readings(farm, &artifact, &path).await? {
                    readings.push(table_path(&path));
                } else {
                    has_sidecars = false;
                }
            }
            match frame.image() {
                None if !has_images && has_sidecars => files.push(readings_path(&path)),
                Some(image) if has_sidecars && fetch_file(farm, &image, &path).await? => files.push(path),
                _ => lost.push(frame.frame),
            }
        }
        // Read the status again: a finished job that has lost an image runs again.
        let status = if lost.is_empty() { status } else { farm.status(JobId(args.job)).await? };
        for &frame in &lost {
            let name = frame_name(&status.name, frame);
            printer.warning(format!(
                "frame {frame} of job {} ({name}): its image or a file beside it is damaged or missing in the farm's store; {}",
                args.job,
                describe_recovery(&status)
            ));
        }
        let mut partial = Vec::new();
        for parts in if args.partial { farm.parts(JobId(args.job)).await? } else { Vec::new() } {
            let path = args.out.join(format!("{}.{:04}.partial.exr", status.name, parts.frame));
            let mut there = PreviewFrame::new(&parts)?;
            if there.add_parts(farm, &parts).await? {
                there.write(&path)?;
                partial.push(path);
            }
        }
        let outputs = fetch_job_outputs(farm, &status, &spec, (&args.out, printer)).await?;
        Ok((status, files, readings, partial, outputs, lost))
    })?;
    if args.format.json {
        let names = |paths: &[PathBuf]| paths.iter().map(|path| path.display().to_string()).collect();
        let (files, readings, partial) = (names(&files), names(&readings), names(&partial));
        let (state, frames) = (status.state.name(), status.frames_total);
        json::print(
            printer,
            &FetchReport { job: args.job, state, frames, files, readings, partial, outputs: outputs.clone(), lost },
        )?;
    } else {
        let frames = human::counted_noun(files.len() as u64, "frame");
        printer.result(format!("{frames} in {}", args.out.display()));
        outputs.contact_sheet.iter().for_each(|path| printer.result(format!("contact sheet: {path}")));
        outputs.video.iter().for_each(|path| printer.result(format!("clip: {path}")));
        partial.iter().for_each(|path| printer.result(format!("partial: {}", path.display())));
    }
    if files.len() < status.frames_total as usize {
        return Err(failed(format!(
            "{} of {} frames are finished, job {} is {}; fetch again later: fetched files are kept",
            files.len(),
            status.frames_total,
            args.job,
            status.state.name()
        )));
    }
    if outputs.missing > 0 {
        let what = human::counted_noun(outputs.missing, "picture or clip");
        return Err(failed(format!(
            "{what} of job {} cannot be fetched yet; fetch again later: fetched files are kept",
            args.job
        )));
    }
    Ok(Exit::Done)
}

/// Waits until the job has ended and returns its status.
async fn wait_until_ended(args: &FetchArgs, farm: &FarmClient, printer: Printer) -> Result<JobStatus, Failure> {
    let again = format!("`femc fetch {} -o {} --wait` waits again", args.job, args.out.display());
    let no_pictures = |_| PreviewTargets { on_terminal: false, file: None };
    let messages = FollowMessages { activity: "the fetch", resume_hint: again };
    let status = follow(farm, JobId(args.job), &messages, None, no_pictures, printer).await?;
    show::failure_lines(&status).iter().for_each(|line| printer.warning(line));
    Ok(status)
}

/// Describes what happens to a frame whose image is lost.
fn describe_recovery(status: &JobStatus) -> String {
    let job = status.job;
    match status.state {
        JobState::Queued | JobState::Running => "it is rendered again".to_owned(),
        JobState::Paused => format!("it is rendered again after `femc resume {job}`"),
        JobState::Failed | JobState::Cancelled => format!("it is rendered again after `femc retry {job}`"),
        // Either the image was stored again meanwhile, or it was damaged on the way.
        JobState::Done => "the store has it now: fetch again".to_owned(),
    }
}

/// Writes the outputs that are made of all frames, as far as they are finished.
async fn fetch_job_outputs(
    farm: &FarmClient,
    job: &JobStatus,
    spec: &JobSpec,
    (folder, printer): (&Path, Printer),
) -> Result<JobOutputs, Failure> {
    let (requested, mut outputs) = (ExtraOutputs::from_graph(&spec.graph), JobOutputs::default());
    let stills = spec.frames.iter().filter(|_| requested.stills);
    let stills = stills.map(|&frame| (Role::Still, still_name(&job.name, frame)));
    let sheet = requested.sheet.map(|name| (Role::Sheet, name));
    let video = requested.video.map(|video| (Role::Clip, video.name));
    let painted = spec.frames.iter().filter(|_| requested.painting.is_some());
    let painted = painted.map(|&frame| (Role::Painted, painted_name(&job.name, frame)));
    let wanted: Vec<(Role, String)> = stills.chain(painted).chain(sheet).chain(video).collect();
    if wanted.is_empty() {
        return Ok(outputs);
    }
    let made = farm.job_outputs(job.job).await?.map(|record| record.outputs).unwrap_or_default();
    let of = |role: Role| made.iter().filter(move |output| output.role == role).map(|output| output.artifact);
    // The farm lists stills and painted pictures in the order of the frames.
    let (mut all_stills, mut all_painted) = (of(Role::Still), of(Role::Painted));
    for (role, name) in wanted {
        let path = folder.join(&name);
        let found = match role {
            Role::Still => all_stills.next(),
            Role::Painted => all_painted.next(),
            _ => of(role).next(),
        };
        let is_there = match &found {
            Some(artifact) => fetch_file(farm, artifact, &path).await?,
            None => false,
        };
        if !is_there {
            outputs.missing += 1;
            if found.is_some() {
                printer
                    .warning(format!("{name} is damaged or missing in the farm's store; {}", describe_recovery(job)));
            }
            continue;
        }
        let path = path.display().to_string();
        match role {
            Role::Still => outputs.previews.push(path),
            Role::Painted => outputs.painted.push(path),
            Role::Sheet => outputs.contact_sheet = Some(path),
            _ => outputs.video = Some(path),
        }
    }
    Ok(outputs)
}

/// Writes one artifact, unless the file already has its bytes. Returns false if the artifact is damaged or gone.
async fn fetch_file(farm: &FarmClient, artifact: &Artifact, path: &Path) -> Result<bool, Failure> {
    if !std::fs::read(path).is_ok_and(|bytes| Digest::compute(&bytes) == artifact.digest) {
        let Some(bytes) = farm.get_if_present(artifact).await? else { return Ok(false) };
        femc_film::file::write_atomic(path, &bytes).map_err(failed)?;
    }
    Ok(true)
}

/// Writes the document and the table of a frame's readings. Returns false if the artifact is damaged or gone.
async fn fetch_readings(farm: &FarmClient, artifact: &Artifact, path: &Path) -> Result<bool, Failure> {
    let is_there = std::fs::read(readings_path(path)).is_ok_and(|bytes| Digest::compute(&bytes) == artifact.digest);
    if !is_there || !table_path(path).is_file() {
        let Some(bytes) = farm.get_if_present(artifact).await? else { return Ok(false) };
        readings::write(path, &bytes)?;
    }
    Ok(true)
}
