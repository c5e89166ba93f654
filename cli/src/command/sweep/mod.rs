//! `femc sweep JOB.toml`: renders the variants of a job, on a farm or in this process.

mod contact;
mod drive;
mod folder;
mod measure;
mod plan;
mod report;
mod resolved;
mod sharing;

pub use plan::plan;

use super::client::{self, FarmClient};
use super::embedded::{self, EmbeddedFarm};
use super::interrupt::Interrupt;
use super::render::SidecarKinds;
use super::render::state::{ExistingState, RunIdentity, RunState};
use super::submit::unique_key;
use crate::args::{FormatArgs, NotesArgs, ServerArgs, SettingsArgs};
use crate::clock::Clock;
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::Printer;
use clap::Args;
use drive::QueuedJob;
use folder::SweepFolder;
use report::{JobReport, SweepReport};
use resolved::{PlannedVariant, ResolvedSweep};
use sharing::SharingCounts;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Render the variants of a job: a grid or a zip of selectors, cameras, frames and settings
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc sweep fog.toml                     # queue all variants on the farm; prints their jobs\n  \
    femc sweep fog.toml -o fog              # also wait, and collect the frames\n  \
    femc sweep fog.toml -o fog --local      # without a farm: render in this process\n  \
    femc sweep lamps.toml -o lamps --measure points.toml --measure-only    # a table of measured light, no images\n  \
    femc plan fog.toml                      # what is shared, and what that saves\n\n\
    [sweep] in the job file lists the axes; mode = \"zip\" pairs their values:\n  \
    [sweep]\n  \
    \"medium.fog.sigma_s\" = [0.01, 0.02, 0.05]\n  \
    \"material.lamp.ed\" = { from = 1e4, to = 1e5, steps = 4, scale = \"log\" }\n  \
    camera = [\"driver\", \"overview\"]\n  \
    [regions]                               # pixels x0, y0, x1, y1; x1 and y1 excluded\n  \
    sign = [120, 40, 136, 56]\n  \
    road = [100, 60, 156, 70]\n  \
    [contrasts]                             # Weber contrast: (sign - road) / road\n  \
    seen = [\"sign\", \"road\"]\n\n\
    DIR gets a folder for each variant, variants.csv and frames.csv (also as Parquet), contact.png, and sweep.json. With \
    measure = \"points.toml\" in the job file, or --measure, it also gets readings.csv: the measured light of all variants. Rerun the \
    command to resume after a stop: existing frames are kept, equal frames are rendered once and linked, and if a sweep gets \
    more values, only the new variants run. At most 4096 variants.")]
pub struct SweepArgs {
    /// Job file with a `[sweep]`
    #[arg(value_name = "JOB.toml")]
    job: PathBuf,
    /// Folder for the variants; the command waits for the jobs and collects their frames there
    #[arg(long, short, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Queue the jobs without waiting; rerun the command without this flag to collect
    #[arg(long, requires = "out", conflicts_with = "local")]
    detach: bool,
    /// Render in this process, with --workers and --threads, instead of on a farm
    #[arg(long, requires = "out")]
    local: bool,
    /// 0 to 100, greater first [default: the job file's, or 50]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=100))]
    priority: Option<u8>,
    /// Owner of the jobs [default: the user's name]
    #[arg(long, value_name = "NAME", conflicts_with = "local")]
    owner: Option<String>,
    #[command(flatten)]
    notes: NotesArgs,
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    server: ServerArgs,
    #[command(flatten)]
    settings: SettingsArgs,
}

/// Runs `femc sweep`.
pub fn run(args: &SweepArgs, printer: Printer) -> Result<Exit, Failure> {
    let begun = Clock.now();
    let mut sweep = ResolvedSweep::open(&args.job, &args.settings, printer)?;
    for variant in &mut sweep.variants {
        let spec = &mut variant.spec;
        spec.priority = args.priority.unwrap_or(spec.priority);
        spec.owner = args.owner.clone().unwrap_or_else(|| std::mem::take(&mut spec.owner));
        spec.notes = args.notes.merge_over(std::mem::take(&mut spec.notes))?;
    }
    let sweep = sweep;
    let Some(out) = &args.out else { return queue_only(&sweep, args, printer) };
    if out.is_file() {
        return Err(usage(format!("-o {} is a file; give a folder", out.display())));
    }
    let state = lock(&sweep, out)?;
    let mut folder = SweepFolder::open(out, SidecarKinds::from_settings(&sweep.first.settings))?;
    if let Some(other) = folder.other_engine() {
        let (path, own) = (out.display(), femc_worker::engine());
        printer.note(format!(
            "{path}: its frames are from another build of the engine ({other}, this is {own}); rendering them again"
        ));
    }
    let sharing = SharingCounts::count(&sweep, Some(&folder));
    sharing.note(printer);
    folder.set_variants(&sweep);
    let missing = drive::link_existing_frames(&sweep, &mut folder)?;
    let mut report = SweepReport::new(&sweep, out, sharing);
    let mut troubles = Vec::new();
    if missing.is_empty() {
        folder.save()?;
    } else if args.local {
        troubles = render_locally(&sweep, missing, &mut folder, &state, &mut report, printer)?;
    } else {
        troubles = client::block_on(&args.server, async |farm| {
            let mut queued = drive::queue_jobs(&sweep, missing.clone(), &mut folder, farm).await?;
            drive::resume_jobs(&queued, farm).await?;
            report.jobs = jobs(&queued);
            report.note_jobs(printer);
            if args.detach {
                return Ok(Vec::new());
            }
            let mut interrupt = Interrupt::listen()?;
            drive::collect(&mut queued, &mut folder, farm, &mut interrupt, printer).await
        })?;
    }
    if args.detach {
        return report.print_jobs(args.format.json, printer);
    }
    // Link equal frames of other variants, whose originals exist now.
    let left = drive::link_existing_frames(&sweep, &mut folder)?;
    let measured = measure::measure(&sweep, &folder)?;
    measure::frames(&sweep, &measured).write(out, "frames")?;
    measure::variants(&sweep, &measured).write(out, "variants")?;
    report.readings = measure::measured_parts(&sweep, &folder)?;
    if !report.readings.is_empty() {
        measure::readings(&sweep, &report.readings).write(out, "readings")?;
    }
    report.contact_sheet = contact::write(&sweep, &folder, printer)?;
    report.seconds = Clock.since(begun).as_secs_f64();
    if left.is_empty() {
        folder.clear_orders();
        folder.save()?;
        state.remove().map_err(|e| failed(format!("{}: {e}", out.display())))?;
        report.print(&sweep, args.format.json, printer)?;
        return Ok(Exit::Done);
    }
    folder.save()?;
    let frames: usize = left.iter().map(|(_, frames)| frames.len()).sum();
    troubles.push(format!("{frames} frames are missing in {}; rerun the command to retry them", out.display()));
    Err(failed(troubles.join("\n")))
}

/// Locks the folder against other processes. Removes the log of an embedded farm if it belongs to another scene.
fn lock(sweep: &ResolvedSweep, out: &Path) -> Result<RunState, Failure> {
    let identity = RunIdentity {
        engine: femc_worker::engine().to_owned(),
        bundle: sweep.scene.digest().to_string(),
        settings: serde_json::Value::Null,
    };
    Ok(RunState::open(&out.join(".femc"), &identity, ExistingState::Keep)?.0)
}

/// Renders in this process.
fn render_locally(
    sweep: &ResolvedSweep,
    missing: Vec<(&PlannedVariant, Vec<u32>)>,
    folder: &mut SweepFolder,
    state: &RunState,
    report: &mut SweepReport,
    printer: Printer,
) -> Result<Vec<String>, Failure> {
    client::runtime()?.block_on(async {
        let mut interrupt = Interrupt::listen()?;
        let settings = embedded::EmbeddedConfig::with_files(
            state.log(),
            state.artifacts(),
            sweep.first.workers,
            sweep.first.threads,
        );
        let (mut embedded, farm) = EmbeddedFarm::start(settings).await?;
        let outcome = async {
            let mut queued = drive::queue_jobs(sweep, missing, folder, &farm).await?;
            drive::cancel_others(&queued, &farm).await?;
            drive::resume_jobs(&queued, &farm).await?;
            report.jobs = jobs(&queued);
            drive::collect(&mut queued, folder, &farm, &mut interrupt, printer).await
        };
        let outcome = tokio::select! {
            outcome = outcome => outcome,
            broken = embedded.wait_for_failure() => return Err(broken),
        };
        drop(farm);
        embedded.stop().await;
        outcome
    })
}

/// Queues whole variants, without fetching them. Variants with exactly the same frames share a job.
fn queue_only(sweep: &ResolvedSweep, args: &SweepArgs, printer: Printer) -> Result<Exit, Failure> {
    let mut report = SweepReport::new(sweep, Path::new(""), SharingCounts::count(sweep, None));
    report.jobs = client::block_on(&args.server, async |farm: &FarmClient| {
        let (mut known, mut jobs) = (BTreeMap::new(), Vec::new());
        for variant in &sweep.variants {
            let keys: Vec<&str> = variant.frames.iter().map(|planning| planning.key.as_str()).collect();
            let job = match known.get(&keys) {
                Some(job) => *job,
                None => farm.submit(&sweep.scene, unique_key(), variant.spec.clone()).await?.0.0,
            };
            known.insert(keys, job);
            jobs.push(JobReport { variant: variant.name.clone(), job });
        }
        Ok(jobs)
    })?;
    report.note_jobs(printer);
    report.print_jobs(args.format.json, printer)
}

fn jobs(queued: &[QueuedJob<'_>]) -> Vec<JobReport> {
    queued.iter().map(|queued| JobReport { variant: queued.variant.name.clone(), job: queued.job.0 }).collect()
}
