//! `femc measure SCENE POINTS.toml`: measures illuminance and luminance at points, on grids and over surfaces.

mod trial;

pub use trial::{MeasurementCost, trial};

use super::client::{self, FarmClient};
use super::live_preview::PreviewTargets;
use super::readings;
use super::watch::{FollowMessages, follow};
use crate::args::{FormatArgs, IdentityArgs, ServerArgs, SettingsArgs};
use crate::clock::Clock;
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::{Printer, Progress, human, job as show, json};
use crate::request::points_file::{self, WorkPlaneArg};
use crate::request::{ImportedScene, ResolvedRequest};
use crate::threads;
use crate::values::{Frames, Override};
use clap::Args;
use femc_model::{Control, Digest, JobId, JobState};
use femc_pipeline::Prepared;
use femc_pipeline::measure::{
    DEFAULT_ERROR, FrameReadings, MAX_SAMPLES, MeasureRequest, MeasureSettings, Measured, MeasurementId, Place,
    ReadingRow, SummaryRow, check_objects, measure, resolve_places, work_plane,
};
use femc_reports::attempts::{csv, text_table, write_parquet};
use femc_reports::measure::{MeasureReport, reading_columns, summary_columns};
use rayon::iter::{IndexedParallelIterator as _, IntoParallelRefIterator as _, ParallelIterator as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// Measure illuminance and luminance at points, on grids and over the surfaces of objects
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc measure scenes/gallery.mgf --where height=0.75,spacing=1    # work plane: illuminance, uniformity\n  \
    femc measure scenes/gallery.mgf points.toml --by-lamp\n  \
    femc measure scenes/gallery.mgf points.toml --error 0.005 -o readings.parquet\n  \
    femc measure scenes/gallery.mgf --where spacing=0.25 -o plane.html    # a map with isolines\n  \
    femc measure scenes/gallery.mgf points.toml --server http://farm:7878    # on a farm: the same readings\n  \
    femc measure scenes/gallery.mgf points.toml --json | jq '.summaries[] | {part, mean, uniformity}'\n\n\
    POINTS.toml:\n  \
    error = 0.01                     # or spp = 4096; by-lamp = true; the flags --error, --spp and --by-lamp replace them\n\n  \
    [[points]]                       # quantity: illuminance, cylindrical, spherical (lx), or luminance (cd/m2)\n  \
    name = \"eyes\"\n  \
    quantity = \"cylindrical\"\n  \
    at = [[1.0, 2.0, 1.6], [2.0, 2.0, 1.6]]\n\n  \
    [[grid]]                         # points at the centers of cells; along x across is the normal\n  \
    name = \"desk\"\n  \
    corner = [0.5, 0.5, 0.75]\n  \
    along = [1.6, 0, 0]\n  \
    across = [0, 0.8, 0]\n  \
    count = [8, 4]\n\n  \
    [[area]]                         # means over the cells of an object's surfaces\n  \
    name = \"leaves\"\n  \
    object = \"plant\"\n  \
    side = \"both\"\n  \
    cells = 100\n\n\
    Paths are traced from each point until the 95 % confidence interval is as narrow as requested, without any bias. The light of \
    all reflections, of lamps behind glass and of fog counts.")]
pub struct MeasureArgs {
    /// Scene file
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// File of points, grids and areas
    #[arg(value_name = "POINTS.toml", required_unless_present = "work_plane")]
    points: Option<PathBuf>,
    /// Measure the horizontal illuminance on a work plane over the scene: height above its lowest point, border without points, and
    /// distance of the points, m [default: height=0.75,border=0.5,spacing=0.5]
    #[arg(long = "where", value_name = "KEY=M,..", conflicts_with = "points", hide_default_value = true)]
    work_plane: Option<WorkPlaneArg>,
    /// Maximum relative error of each reading (95 % confidence) [default: 0.02]
    #[arg(long, value_name = "E", value_parser = parse_error, conflicts_with = "spp")]
    error: Option<f64>,
    /// Number of samples of each reading, instead of an error
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_SAMPLES)))]
    spp: Option<u32>,
    /// Measure the light of each lamp, too
    #[arg(long)]
    by_lamp: bool,
    /// Maximum path length in segments; 1: only light directly from lamps; 0: unlimited
    #[arg(long, value_name = "N", default_value_t = 0)]
    max_depth: u32,
    /// Frame of the clip
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    frame: u32,
    /// Key of the random numbers
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Threads [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    threads: Option<u32>,
    /// Override a scalar of the scene, like medium.fog.sigma_s=0.03 (repeatable)
    #[arg(long, value_name = "SELECTOR=VALUE")]
    set: Vec<Override>,
    /// Folder that contains the includes, textures and lamps of the scene, at any depth [default: the scene's folder]
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// File to write the readings to, in addition to the summary on stdout: .csv, .parquet, .json, or a page with maps and isolines of
    /// the grids (.html)
    #[arg(long, short, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Number of readings in the table
    #[arg(long, value_name = "N", default_value_t = 20)]
    lines: usize,
    /// Print the readings as CSV on stdout, with a header line
    #[arg(long, conflicts_with = "json")]
    csv: bool,
    /// Measure on the farm of this coordinator; a second run of the same command finds the job of the first [default: in this process]
    #[arg(long, value_name = "URL,..")]
    server: Option<String>,
    #[command(flatten)]
    identity: IdentityArgs,
    #[command(flatten)]
    format: FormatArgs,
}

/// Parses a relative error, above 0 and at most 1.
fn parse_error(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(error) if error > 0.0 && error <= 1.0 => Ok(error),
        _ => Err(format!("`{text}` is not a relative error; write a number above 0 and up to 1, like 0.02 for 2 %")),
    }
}

/// File format of the readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FileFormat {
    Csv,
    Parquet,
    Json,
    Page,
}

/// Runs `femc measure`.
pub fn run(args: &MeasureArgs, printer: Printer) -> Result<Exit, Failure> {
    let format = args.out.as_deref().map(file_format).transpose()?;
    let written = args.points.as_deref().map(points_file::load).transpose()?;
    let resolved = resolve(args, printer)?;
    let request = match (written, args.work_plane) {
        (Some(request), _) => request,
        (None, plane) => work_plane(resolved.source.scene(), &plane.map(|it| it.0).unwrap_or_default())
            .map_err(|error| usage(format!("--where: {error}")))?,
    };
    let request = args.apply_to(request);
    let begun = Clock.now();
    let readings = match &args.server {
        Some(server) => measure_on_farm(resolved, request.clone(), (args, server), printer)?,
        None => measure_here(&resolved, &request, args, printer)?,
    };
    let report = MeasureReport::new(args.scene.display().to_string(), Clock.since(begun).as_secs_f64(), readings);
    warn(&report, &request, printer);
    if let (Some(path), Some(format)) = (&args.out, format) {
        write(path, format, &report)?;
        printer.note(format!("wrote {}", path.display()));
    }
    if args.format.json {
        json::print(printer, &report)?;
    } else if args.csv {
        printer.result(csv(&reading_columns(), &report.readings));
    } else {
        print(&report, &request, args, printer);
    }
    Ok(Exit::Done)
}

fn resolve(args: &MeasureArgs, printer: Printer) -> Result<ResolvedRequest, Failure> {
    let frames = Some(Frames::single(args.frame));
    let typed = SettingsArgs {
        frames,
        set: args.set.clone(),
        seed: Some(args.seed),
        max_depth: Some(args.max_depth),
        ..SettingsArgs::default()
    };
    let named = |key: &str| (key == "frames").then(|| "--frame".to_owned());
    ImportedScene::open(&args.scene, args.root.as_deref(), printer)?.resolve(&typed, &named)
}

impl MeasureArgs {
    /// Replaces the accuracy of a request by the typed one.
    fn apply_to(&self, request: MeasureRequest) -> MeasureRequest {
        let (error, spp) = match (self.error, self.spp) {
            (None, None) => (request.error, request.spp),
            typed => typed,
        };
        MeasureRequest { error, spp, by_lamp: request.by_lamp || self.by_lamp, ..request }
    }

    /// Returns the failure of a part of the request.
    fn fault(&self, error: impl std::fmt::Display) -> Failure {
        match &self.points {
            Some(path) => usage(format!("{}: {error}", path.display())),
            None => usage(format!("--where: {error}")),
        }
    }
}

/// Measures all places in this process, and shows the progress.
fn measure_here(
    resolved: &ResolvedRequest,
    request: &MeasureRequest,
    args: &MeasureArgs,
    printer: Printer,
) -> Result<FrameReadings, Failure> {
    let scene = resolved.scene().digest().to_string();
    let settings = request.settings(args.max_depth, args.seed);
    let id = MeasurementId::new(request, &settings, (femc_worker::engine(), scene), args.frame);
    let pool = threads::pool(args.threads)?;
    let prepared = pool.install(|| {
        femc_pipeline::prepare_world(&resolved.source, &resolved.settings.of_measurement(), args.frame, None)
    });
    let prepared = prepared.map_err(failed)?;
    let places = resolve_places(&prepared, request).map_err(|error| args.fault(error))?;
    let measured = pool.install(|| read(&prepared, &places, &settings, printer));
    Ok(FrameReadings::new(id, args.seed, &measured))
}

/// Measures all places, and shows the progress.
fn read(prepared: &Prepared, places: &[Place], settings: &MeasureSettings, printer: Printer) -> Vec<Measured> {
    let (cancel, samples, done) = (AtomicBool::new(false), AtomicU64::new(0), AtomicU64::new(0));
    let progress = Mutex::new(Progress::new(printer, Clock));
    let read = |(number, place): (usize, &Place)| {
        let reading = measure(prepared, number as u32, place, settings, &cancel, &samples);
        let done = 1 + done.fetch_add(1, Ordering::Relaxed);
        let text = || format!("{done} of {} readings, {} samples", places.len(), samples.load(Ordering::Relaxed));
        progress.lock().unwrap_or_else(PoisonError::into_inner).update(done as f64 / places.len() as f64, text);
        Some(Measured { place: place.info.clone(), reading: reading? })
    };
    // Nothing cancels the readings.
    let measured = places.par_iter().enumerate().filter_map(read).collect();
    let mut progress = progress.into_inner().unwrap_or_else(PoisonError::into_inner);
    progress.finish();
    measured
}

/// Measures all places on a farm: submits a job that only measures, or finds it again, and waits for it.
fn measure_on_farm(
    resolved: ResolvedRequest,
    request: MeasureRequest,
    (args, server): (&MeasureArgs, &str),
    printer: Printer,
) -> Result<FrameReadings, Failure> {
    check_objects(resolved.scene(), &request).map_err(|error| args.fault(error))?;
    let resolved = resolved.only_measuring(request)?;
    let scene = resolved.parcel()?;
    let server = ServerArgs { server: server.to_owned(), identity: args.identity.clone() };
    client::block_on(&server, async |farm| {
        let spec = client::job_spec(&resolved, &scene, vec![args.frame])?;
        // A job of another build of the engine is not the same measurement.
        let key = [spec.key().as_bytes(), femc_worker::engine().as_bytes()].concat();
        let (job, _) = farm.submit(&scene, Digest::compute(&key), spec).await?;
        match farm.status(job).await?.state {
            JobState::Failed | JobState::Cancelled => farm.control(job, Control::Retry).await?,
            JobState::Paused => farm.control(job, Control::Resume).await?,
            JobState::Queued | JobState::Running | JobState::Done => {}
        }
        printer.note(format!("job {job} measures; `femc watch {job}` shows its progress, too"));
        wait_for_readings(farm, job, args.frame, printer).await
    })
}

/// Waits until a job has ended, and returns its readings.
async fn wait_for_readings(
    farm: &FarmClient,
    job: JobId,
    frame: u32,
    printer: Printer,
) -> Result<FrameReadings, Failure> {
    let no_pictures = |_| PreviewTargets { on_terminal: false, file: None };
    let again = "the same command waits again".to_owned();
    let messages = FollowMessages { activity: "the measurement", resume_hint: again };
    let status = follow(farm, job, &messages, None, no_pictures, printer).await?;
    let record = farm.frames(job).await?.into_iter().find(|record| record.frame == frame);
    let Some(artifact) = record.and_then(|record| record.readings()) else {
        let mut lines = vec![format!("job {job} is {}", status.state.name())];
        lines.extend(show::failure_lines(&status));
        return Err(failed(lines.join("\n")));
    };
    let lost = || failed(format!("the readings of job {job} are damaged or missing in the farm's store; retry"));
    let bytes = farm.get_if_present(&artifact).await?.ok_or_else(lost)?;
    readings::parse(&format!("readings of job {job}"), &bytes)
}

fn warn(report: &MeasureReport, request: &MeasureRequest, printer: Printer) {
    if report.not_converged > 0 {
        let count = human::counted_noun(report.not_converged, "reading");
        let error = human::percent(request.error.unwrap_or(DEFAULT_ERROR));
        printer.warning(format!("{count} did not reach an error of {error} within {MAX_SAMPLES} samples"));
    }
    for row in report.summaries.iter().filter(|row| row.dark > 0 && row.lamp.is_none()) {
        let SummaryRow { part, dark, readings, lit_uniformity, .. } = row;
        let others = lit_uniformity
            .map_or_else(String::new, |it| format!("; the others have a uniformity of {}", human::number(it)));
        printer.note(format!(
            "`{part}`: {dark} of {readings} readings are dark: their points may lie within objects{others}"
        ));
    }
    if report.bad_samples > 0 {
        let count = human::counted_noun(report.bad_samples, "sample");
        printer.warning(format!("{count} were not finite and are left out"));
    }
}

fn file_format(path: &Path) -> Result<FileFormat, Failure> {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    match extension.as_str() {
        "csv" => Ok(FileFormat::Csv),
        "parquet" => Ok(FileFormat::Parquet),
        "json" => Ok(FileFormat::Json),
        "html" => Ok(FileFormat::Page),
        _ => Err(usage(format!("-o {}: give a file that ends in .csv, .parquet, .json or .html", path.display()))),
    }
}

fn write(path: &Path, format: FileFormat, report: &MeasureReport) -> Result<(), Failure> {
    let text = match format {
        FileFormat::Parquet => {
            return write_parquet(path, &reading_columns(), &report.readings).map_err(failed);
        }
        FileFormat::Csv => csv(&reading_columns(), &report.readings),
        FileFormat::Page => femc_reports::pages::measure::html(report)?,
        FileFormat::Json => serde_json::to_string_pretty(report).map_err(failed)?,
    };
    femc_film::file::write_atomic(path, format!("{text}\n").as_bytes()).map_err(failed)
}

/// Prints the readings of points, and the summaries.
fn print(report: &MeasureReport, request: &MeasureRequest, args: &MeasureArgs, printer: Printer) {
    let is_point = |row: &&ReadingRow| request.points.iter().any(|part| part.name == row.part);
    let points: Vec<ReadingRow> = report.readings.iter().filter(is_point).cloned().collect();
    if !points.is_empty() {
        printer.result(text_table(&reading_columns(), &points[..points.len().min(args.lines)]));
        if points.len() > args.lines {
            printer.note(format!("and {} more; --lines, --csv and --json list them", points.len() - args.lines));
        }
    }
    if !report.summaries.is_empty() {
        if !points.is_empty() {
            printer.result("");
        }
        printer.result(text_table(&summary_columns(), &report.summaries));
    }
    let rate = report.rays as f64 / report.seconds.max(1e-9);
    let seconds = human::seconds(report.seconds);
    printer.note(format!(
        "{} in {seconds}, {} rays/s",
        human::counted_noun(report.readings.len() as u64, "row"),
        human::quantity(rate)
    ));
}
