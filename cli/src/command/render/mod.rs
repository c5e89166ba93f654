//! `femc render SCENE`: runs the farm's coordinator and workers inside this process.

mod clip;
mod drive;
mod existing;
mod layers;
mod painting;
mod report;
mod report_file;
mod sidecars;
pub mod state;
mod target;

pub use sidecars::{SidecarKinds, Sidecars, layers_path, statistics_path};

pub use painting::{PaintingArgs, request_painting_layers};
pub use target::{frame_name, painted_name, still_name};

use super::readings::readings_path;
use crate::args::{ExtrasArgs, FormatArgs, SettingsArgs};
use crate::clock::Clock;
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::{Printer, human, json};
use crate::request::{ResolvedRequest, picture};
use crate::values::Exposure;
use clap::Args;
use drive::{RenderRequest, RenderResult};
use existing::ExpectedMetadata;
use report::{FrameReport, RenderReport};
use report_file::ReportFile;
use state::{ExistingState, RunIdentity, RunState, StateMatch};
use std::collections::BTreeMap;
use std::path::PathBuf;
use target::Target;

/// Render frames on this machine; rerun the command to resume after a stop
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc render scenes/cornell-fog.mgf -o cornell.exr --spp 64\n  \
    femc render scenes/cornell-fog.mgf -o cornell.png --exposure 7    # tone-mapped, EV 7 at ISO 100\n  \
    femc render scenes/roundabout.mgf -o drive --frames 1..24 --size 160x90 --spp 8 --video drive.mp4\n  \
    femc render scene.mgf -o out --error 0.02 --set medium.fog.sigma_s=0.05 --json\n  \
    femc render scenes/cornell-fog.mgf -o again.exr --replay cornell.exr    # the same pixels\n  \
    femc render scenes/cornell-fog.mgf -o cornell.exr --report cornell.html    # where the time went\n  \
    femc render scenes/cornell-fog.mgf -o cornell.exr --layers direct,indirect --layer fog='C.*V.*'\n  \
    femc render scenes/glossy.mgf -o glossy.exr --style oil    # also writes glossy.painted.png\n\n\
    A second run with the same OUT and settings renders what is missing: finished frames are kept, and an interrupted frame \
    keeps its samples. Frames whose scene or settings differ are rendered again.")]
pub struct RenderArgs {
    /// Scene file, or JOB.toml
    #[arg(value_name = "SCENE")]
    pub scene: PathBuf,
    /// A name ending in .exr or .png: one frame; else a folder for `<scene>.0001.exr` ... [default: the scene's name]
    #[arg(long, short, value_name = "OUT")]
    pub out: Option<PathBuf>,
    /// Exposure of PNG files and clips: auto (the log-average luminance is middle gray), or an exposure value at ISO 100
    /// (2^EV / 8 cd/m2 is middle gray; one more is half as bright) [default: auto]
    #[arg(long, value_name = "auto|EV", allow_hyphen_values = true)]
    pub exposure: Option<Exposure>,
    /// Also write the usage of the tasks: a page if FILE ends in .html (`femc report`), one row per attempt if in .csv, .json or
    /// .parquet
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Render the frame in FILE, EXR or PNG, again: with its settings and, if it had a time budget, the same samples for each tile
    #[arg(long, value_name = "FILE", conflicts_with_all = ["camera", "size", "frames", "spp", "error", "time", "method",
        "max_depth", "filter", "seed", "set", "stats"])]
    pub replay: Option<PathBuf>,
    /// Start from scratch and ignore existing frames and state
    #[arg(long)]
    pub fresh: bool,
    /// Print an address that shows the run in a browser, and open it if this machine has a desktop
    #[arg(long)]
    pub watch: bool,
    #[command(flatten)]
    pub painting: PaintingArgs,
    #[command(flatten)]
    pub extras: ExtrasArgs,
    #[command(flatten)]
    pub format: FormatArgs,
    #[command(flatten)]
    pub settings: SettingsArgs,
}

/// Runs `femc render`.
pub fn run(mut args: RenderArgs, printer: Printer) -> Result<Exit, Failure> {
    let begun = Clock.now();
    let style = args.painting.style()?;
    if let Some(style) = &style {
        if let (Some(paper), Some(path)) = (style.transparency_warning(), &args.painting.style) {
            printer.warning(format!("--style {}: {paper}", path.display()));
        }
        request_painting_layers(&mut args.settings);
    }
    args.extras.check()?;
    let report_file = args.report.as_deref().map(ReportFile::from_path).transpose()?;
    let resolved = match &args.replay {
        Some(frame) => ResolvedRequest::replay(&args.scene, frame, args.settings, printer)?,
        None => ResolvedRequest::open(&args.scene, args.settings, printer)?.choose_method(printer)?,
    };
    if resolved.settings.measure_only {
        return Err(usage(
            "measure-only: `femc render` makes images; `femc measure` and `femc submit` can only measure",
        ));
    }
    let target = Target::parse(args.out.as_deref(), &resolved.name(), resolved.plan.frames.len())?;
    check_pictures(&target, &args.extras, args.exposure, style.is_some())?;
    let exposure = args.exposure.unwrap_or_default();
    let frames = target.frames(&resolved, printer)?;
    let expected = ExpectedMetadata::new(&resolved, exposure)?;
    let mut done: BTreeMap<u32, FrameReport> = if args.fresh {
        BTreeMap::new()
    } else {
        frames.iter().filter_map(|&frame| Some((frame, expected.existing_frame(frame, &target.path(frame))?))).collect()
    };
    let missing: Vec<u32> = frames.iter().copied().filter(|frame| !done.contains_key(frame)).collect();
    let mut report = RenderReport {
        scene: args.scene.display().to_string(),
        out: target.display(),
        size: resolved.film(),
        rendered: missing.len(),
        ..RenderReport::default()
    };
    if missing.is_empty() {
        printer.note(format!("{}: already finished with this scene and these settings", target.display()));
        if report_file.is_some() {
            printer.warning("--report: nothing was rendered, so there is no report; --fresh renders all frames again");
        }
    } else {
        resolved.explain_method(printer);
        resolved.warn_of_lost_light(printer);
        let existing = if args.fresh { ExistingState::Discard } else { ExistingState::Keep };
        let request = RenderRequest {
            resolved: &resolved,
            target: &target,
            exposure,
            frames: &frames,
            missing,
            watch: args.watch,
            scene: resolved.parcel()?,
            wants_record: report_file.is_some(),
        };
        let RenderResult { frames, record } = render(&request, existing, printer)?;
        if let (Some(report_file), Some(record)) = (report_file, record) {
            report.report = Some(report_file.write(record)?);
        }
        done.extend(frames.into_iter().map(|frame| (frame.frame, frame)));
    }
    report.add_frames(done.into_values().collect());
    report.bad = existing::bad_samples(&report.frames);
    report.seconds = Clock.since(begun).as_secs_f64();
    if let ([file], true) = (report.files.as_slice(), target.is_picture()) {
        let attributes = picture::attributes(file.as_ref());
        report.exposure_ev = attributes.and_then(|attributes| attributes.get(picture::EV)?.parse().ok());
    }
    if target.is_picture() {
        for file in &report.files {
            let shown = layers::write_pngs(file.as_ref(), &resolved.settings.layers, None, exposure)?;
            report.previews.extend(shown.iter().map(|path| path.display().to_string()));
        }
    }
    if resolved.settings.has_layers() {
        let files = report.files.iter().map(|file| layers_path(file.as_ref()).display().to_string());
        report.layers = files.collect();
    }
    if resolved.settings.measure.is_some() {
        let files = report.files.iter().map(|file| readings_path(file.as_ref()).display().to_string());
        report.readings = files.collect();
    }
    if let Some(style) = &style {
        report.painted = args.painting.paint(
            style,
            &report.files,
            exposure,
            resolved.threads.unwrap_or(0),
            &target.checkpoint(),
            printer,
        )?;
        report.painted.iter().for_each(|file| printer.note(format!("wrote {file}")));
    }
    clip::write(&resolved, &mut report, &args.extras, exposure, printer)?;
    report.warn(printer);
    if args.format.json {
        json::print(printer, &report)?;
    } else {
        report.print(printer);
    }
    Ok(Exit::Done)
}

/// Checks that no output needs EXR files if the frame is a PNG, and that an exposure is only given for pictures.
fn check_pictures(
    target: &Target,
    extras: &ExtrasArgs,
    exposure: Option<Exposure>,
    is_painted: bool,
) -> Result<(), Failure> {
    let ExtrasArgs { video, preview, contact_sheet } = extras;
    let wants_more = *preview || video.is_some() || contact_sheet.is_some();
    if target.is_picture() && wants_more {
        let out = target.display();
        return Err(usage(format!(
            "-o {out} is a picture, but --preview, --video and --contact-sheet need EXR files; give NAME.exr or a folder"
        )));
    }
    if exposure.is_some() && !target.is_picture() && !wants_more && !is_painted {
        return Err(usage(
            "--exposure is only for pictures, not for EXR files; give -o NAME.png, --preview, --video, --contact-sheet or --style",
        ));
    }
    Ok(())
}

/// Renders the missing frames. Resumes from the state beside the output if its scene and settings are the same.
fn render(request: &RenderRequest<'_>, existing: ExistingState, printer: Printer) -> Result<RenderResult, Failure> {
    let RenderRequest { resolved, target, frames, missing, scene, .. } = request;
    let identity = RunIdentity {
        engine: femc_worker::engine().to_owned(),
        bundle: scene.digest().to_string(),
        settings: serde_json::to_value(&resolved.settings).map_err(failed)?,
    };
    let (state, state_match) = RunState::open(&target.state_folder(), &identity, existing)?;
    let (out, all) = (target.display(), human::counted_noun(frames.len() as u64, "frame"));
    let others = missing.iter().filter(|&&frame| target.path(frame).exists()).count();
    match state_match {
        StateMatch::Same => {
            printer.note(format!("{out}: resuming, {} of {all} finished", frames.len() - missing.len()));
        }
        StateMatch::Absent if others == 0 => {}
        StateMatch::Absent | StateMatch::Other => {
            printer.note(format!(
                "{out}: the existing frames have another scene, other settings or another build of the engine; \
                rendering them again"
            ));
        }
    }
    let made = drive::run(request, &state, printer)?;
    state.remove().map_err(|e| failed(format!("{}: {e}", target.state_folder().display())))?;
    Ok(made)
}
