//! `femc submit SCENE|JOB.toml`: queues a job.

use super::client;
use super::render::{PaintingArgs, request_painting_layers};
use crate::args::{ExtrasArgs, FormatArgs, NotesArgs, ServerArgs, SettingsArgs, job_name};
use crate::exit::{Exit, Failure};
use crate::output::{Printer, human, json};
use crate::request::ResolvedRequest;
use clap::Args;
use femc_model::Digest;
use femc_worker::ExtraOutputs;
use serde::Serialize;
use std::hash::{BuildHasher as _, RandomState};
use std::path::PathBuf;

/// Queue a job on the farm, with all files that its scene needs; prints the job's number
///
/// Only files that the farm lacks are uploaded: after an edit the changed files, not the textures.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc submit scenes/roundabout.mgf --frames 1..120 --size 192x108 --spp 24\n  \
    femc submit job.toml --priority 80\n  \
    femc submit scene.mgf --frames 1,5,9 --name draft --comment 'before the change of lamps' --label shot=12\n  \
    femc submit scenes/roundabout.mgf --frames 1..48 --style oil    # `femc fetch` also gets FRAME.painted.png\n  \
    femc submit scenes/roundabout.mgf --frames 1..48 --video drive.mp4 --contact-sheet drive.png    # `femc fetch` also gets them\n  \
    femc submit scenes/gallery.mgf --measure points.toml            # `femc fetch` also gets FRAME.readings.csv and .json\n  \
    femc submit scenes/gallery.mgf --measure points.toml --measure-only\n  \
    job=$(femc submit scene.mgf | tail -1); femc watch $job && femc fetch $job -o out\n\n\
    Any worker makes clips in .png or .gif; other formats need a worker with ffmpeg (and so the tag ffmpeg). A failed frame is a \
    gray card in the clip.\n\n\
    On a farm, workers have their own threads: --workers and --threads have no effect.")]
pub struct SubmitArgs {
    /// Scene file, or JOB.toml
    #[arg(value_name = "SCENE|JOB.toml")]
    scene: PathBuf,
    /// Name of the job and of its files [default: that of the scene file]
    #[arg(long, value_name = "NAME", value_parser = job_name)]
    name: Option<String>,
    #[command(flatten)]
    notes: NotesArgs,
    /// 0 to 100, greater first [default: 50]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=100))]
    priority: Option<u8>,
    /// Tags that workers need to run the job, all of them
    #[arg(long, value_name = "A,B", value_delimiter = ',')]
    tags: Vec<String>,
    /// Owner of the job [default: the user's name]
    #[arg(long, value_name = "NAME")]
    owner: Option<String>,
    #[command(flatten)]
    painting: PaintingArgs,
    #[command(flatten)]
    extras: ExtrasArgs,
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    server: ServerArgs,
    #[command(flatten)]
    settings: SettingsArgs,
}

#[derive(Serialize)]
struct SubmitReport {
    job: u64,
    /// `None`: the farm went away before it answered.
    owner: Option<String>,
    scene_bytes: u64,
    sent_bytes: u64,
}

/// Runs `femc submit`.
pub fn run(mut args: SubmitArgs, printer: Printer) -> Result<Exit, Failure> {
    let painting = args.painting.requested_painting()?;
    if painting.is_some() {
        request_painting_layers(&mut args.settings);
    }
    let resolved = ResolvedRequest::open(&args.scene, args.settings, printer)?.choose_method(printer)?;
    resolved.explain_method(printer);
    let notes = args.notes.merge_over(resolved.notes.clone())?;
    resolved.warn_of_lost_light(printer);
    let outputs = ExtraOutputs { painting, ..args.extras.requested_outputs(resolved.rate(&resolved.plan.frames))? };
    let scene = resolved.parcel()?;
    let count = human::counted_noun(resolved.plan.frames.len() as u64, "frame");
    let wanted = args.owner.clone();
    let (job, sent, owner) = client::block_on(&args.server, async |farm| {
        let mut spec = client::job_spec(&resolved, &scene, resolved.plan.frames.clone())?;
        outputs.add_to(&mut spec.graph, spec.frames.len() as u32);
        spec.priority = args.priority.unwrap_or(spec.priority);
        spec.owner = args.owner.unwrap_or(spec.owner);
        spec.name = args.name.unwrap_or(spec.name);
        spec.notes = notes;
        if !args.tags.is_empty() {
            spec.tags = args.tags;
        }
        let (job, sent) = farm.submit(&scene, unique_key(), spec).await?;
        // The job exists now. Its number is printed even if a later call fails, so that the job is not submitted twice.
        Ok((job, sent, farm.status(job).await.ok().map(|status| status.owner)))
    })?;
    if let (Some(wanted), Some(owner)) = (wanted, &owner)
        && wanted != *owner
    {
        printer.warning(format!(
            "--owner {wanted} is ignored: this farm knows who submits, and job {job} belongs to {owner}; omit --owner, \
             or submit it with {wanted}'s identity"
        ));
    }
    if args.format.json {
        json::print(printer, &SubmitReport { job: job.0, owner, scene_bytes: scene.size(), sent_bytes: sent })?;
    } else {
        let [size, sent] = [scene.size(), sent].map(|bytes| human::quantity(bytes as f64));
        let path = resolved.path.display();
        printer.note(format!("{path}: {count}, {size}B of scene, {sent}B sent; `femc watch {job}` shows its progress"));
        printer.result(job);
    }
    Ok(Exit::Done)
}

/// Returns a new unique key. With it every `femc submit` creates a job of its own, even of an equal scene.
pub fn unique_key() -> Digest {
    let number = || RandomState::new().hash_one(std::process::id()).to_le_bytes();
    Digest::compute(&[number(), number()].concat())
}
