//! `femc plan SCENE`: prints what would run, without running it.

use crate::args::{ExtrasArgs, FormatArgs, SettingsArgs};
use crate::clock::Clock;
use crate::command::measure::{self, MeasurementCost};
use crate::command::render::{PaintingArgs, request_painting_layers};
use crate::command::{client, sweep};
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::{Printer, human, json};
use crate::request::{JobFile, ResolvedRequest, is_job_file};
use crate::threads;
use clap::Args;
use femc_model::{Graph, Hint, Need, Reach, Round, Scope, StageTemplate};
use femc_pipeline::method_choice::MethodChoice;
use femc_pipeline::{OmittedFeature, PrepareError, Prepared, StopCondition, TargetKind, TargetRecord, TargetShape};
use femc_worker::ExtraOutputs;
use serde::Serialize;
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Show what would run: stages, tasks, estimated cost, and why stages are left out
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc plan scenes/roundabout.mgf --frames 1..24 --spp 64\n  \
    femc plan scene.mgf --json | jq .tasks\n  \
    femc plan fog.toml    # for a job with a [sweep]: what its variants share\n\n\
    The cost is measured by a short trial on this machine; with --no-trial nothing is rendered.")]
pub struct PlanArgs {
    /// Scene file, or JOB.toml
    #[arg(value_name = "SCENE")]
    pub scene: PathBuf,
    /// Do not estimate the cost: render no trial
    #[arg(long)]
    no_trial: bool,
    #[command(flatten)]
    painting: PaintingArgs,
    #[command(flatten)]
    extras: ExtrasArgs,
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    settings: SettingsArgs,
}

/// Whether a trial is rendered to estimate the cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trial {
    /// A short trial is rendered.
    Run,
    /// Nothing is rendered.
    Skip,
}

/// Approximate duration of a trial.
const TRIAL_DURATION: Duration = Duration::from_millis(300);
/// Time after which a pilot starts no further round.
const PILOT_DURATION: Duration = Duration::from_millis(1500);
/// Edge of the blocks of a trial, pixels.
const TRIAL_BLOCK: u32 = 8;
/// Minimum share of the indirect light that a target brings to be printed.
const MIN_LIGHT: f32 = 0.005;

#[derive(Serialize)]
struct PlanReport {
    scene: String,
    camera: String,
    film: [u32; 2],
    frames: Vec<u32>,
    method: femc_pipeline::Method,
    stop: StopCondition,
    tile: u32,
    tiles: usize,
    rounds: Vec<u32>,
    /// Graph, as it is submitted.
    graph: Graph,
    /// Tasks of all frames, if every round runs.
    tasks: u64,
    /// Number of different worlds among the frames, ignoring the camera. Frames of one world could share work.
    worlds: usize,
    /// Number of first-pass solutions that the frames share: one for each world, around its origin; 0 if the method has no first
    /// pass.
    first_passes: usize,
    /// Number of faces and curved surfaces, counting every instance.
    surfaces: u64,
    /// Blocks that a solution is cut into; 1: the solution is one task.
    first_pass_blocks: u32,
    samples_least: u64,
    samples_most: u64,
    cost: Option<PlanCost>,
    /// Measurement of light; `None`: not requested, or no trial.
    measurement: Option<MeasurementCost>,
    /// Whether frames have images, besides their measurements.
    has_images: bool,
    /// Reason for the method, if none was named and a pilot ran.
    choice: Option<MethodChoice>,
    left_out: Vec<OmittedFeature>,
}

/// Cost estimated from a trial on this machine.
#[derive(Serialize)]
pub struct PlanCost {
    /// Time to prepare a frame, s.
    pub prepare_seconds: f64,
    /// Time to solve a first pass and to learn targets, s; 0 if the method has none.
    pub first_pass_seconds: f64,
    /// Targets of the first frame's paths: openings and bright patches.
    targets: Vec<TargetRecord>,
    /// World position of the origin of the targets' positions, m.
    origin: [f64; 3],
    /// Camera samples per second.
    pub samples_per_second: f64,
    seconds_least: f64,
    seconds_most: f64,
    /// With `--error`: a pilot's estimate of samples per pixel and time.
    likely: Option<PilotEstimate>,
}

/// Estimate of a pilot.
#[derive(Serialize)]
struct PilotEstimate {
    samples_a_pixel: f64,
    seconds: f64,
}

/// Runs `femc plan`.
pub fn run(mut args: PlanArgs, printer: Printer) -> Result<Exit, Failure> {
    let run = if args.no_trial { Trial::Skip } else { Trial::Run };
    let painting = args.painting.requested_painting()?;
    if painting.is_some() {
        request_painting_layers(&mut args.settings);
    }
    if is_job_file(&args.scene) && JobFile::load(&args.scene).map_err(usage)?.sweep.is_some() {
        return sweep::plan(&args.scene, &args.settings, run, args.format.json, printer);
    }
    let resolved = ResolvedRequest::open(&args.scene, args.settings, printer)?;
    let resolved = if run == Trial::Run { resolved.choose_method(printer)? } else { resolved };
    let (plan, frames) = (&resolved.plan, resolved.plan.frames.len() as u64);
    let rounds = plan.rounds.len();
    let least = match resolved.settings.stop {
        StopCondition::Spp(_) => rounds,
        StopCondition::Error(_) | StopCondition::Time(_) => 1,
    };
    let mut graph = plan.graph.clone();
    let outputs = args.extras.requested_outputs(resolved.rate(&plan.frames))?;
    ExtraOutputs { painting, ..outputs }.add_to(&mut graph, frames as u32);
    let (samples_least, samples_most) =
        (plan.samples_per_frame(least) * frames, plan.samples_per_frame(rounds) * frames);
    let first_passes = first_passes(&resolved)?;
    let measurement = match (&resolved.settings.measure, run) {
        (Some(request), Trial::Run) => Some(measure::trial(&resolved, request)?),
        _ => None,
    };
    let has_images = !resolved.settings.measure_only;
    let cost = match run {
        Trial::Run if has_images => Some(trial(&resolved, first_passes, samples_least, samples_most)?),
        Trial::Run | Trial::Skip => None,
    };
    let report = PlanReport {
        scene: args.scene.display().to_string(),
        camera: plan.camera.clone(),
        film: resolved.film(),
        frames: plan.frames.clone(),
        method: plan.method,
        stop: resolved.settings.stop,
        tile: plan.tiling.edge,
        tiles: plan.tiling.count(),
        rounds: plan.rounds.clone(),
        tasks: graph.tasks(Scope::Frame) * frames
            + graph.tasks(Scope::Job)
            + graph.tasks(Scope::Content) * first_passes as u64,
        graph,
        worlds: worlds(&resolved)?,
        first_passes,
        surfaces: femc_pipeline::count_surfaces(resolved.source.scene()),
        first_pass_blocks: femc_pipeline::planned_first_pass_blocks(&plan.graph),
        samples_least,
        samples_most,
        cost,
        measurement,
        has_images,
        choice: resolved.choice.clone(),
        left_out: plan.left_out.clone(),
    };
    if args.format.json {
        json::print(printer, &report)?;
    } else {
        print(printer, &report);
    }
    Ok(Exit::Done)
}

fn worlds(resolved: &ResolvedRequest) -> Result<usize, Failure> {
    let content = |&frame: &u32| Ok(femc_pipeline::frame_key(&resolved.source, &resolved.settings, frame)?.content);
    let contents: Result<BTreeSet<_>, PrepareError> = resolved.plan.frames.iter().map(content).collect();
    Ok(contents.map_err(failed)?.len())
}

fn first_passes(resolved: &ResolvedRequest) -> Result<usize, Failure> {
    let contents = client::first_pass_keys(resolved, &resolved.plan.frames)?;
    Ok(contents.iter().map(|(_, key)| key).collect::<BTreeSet<_>>().len())
}

/// Renders a few blocks spread over the first frame and measures the cost of a sample.
/// - `first_passes`: number of solutions that the frames share.
pub fn trial(
    resolved: &ResolvedRequest,
    first_passes: usize,
    samples_least: u64,
    samples_most: u64,
) -> Result<PlanCost, Failure> {
    threads::pool(resolved.threads)?.install(|| run_trial(resolved, first_passes, samples_least, samples_most))
}

/// Does the work of [`trial`] on the calling thread's pool.
fn run_trial(
    resolved: &ResolvedRequest,
    first_passes: usize,
    samples_least: u64,
    samples_most: u64,
) -> Result<PlanCost, Failure> {
    let (clock, plan) = (Clock, &resolved.plan);
    let frame = plan.frames.first().copied().unwrap_or(1);
    let begun = clock.now();
    let mut prepared =
        femc_pipeline::prepare_world(&resolved.source, &resolved.settings, frame, None).map_err(failed)?;
    let prepare_seconds = clock.since(begun).as_secs_f64();
    let (mut first_pass_seconds, mut targets) = (0.0, Vec::new());
    if plan.method.has_first_pass() {
        let world = femc_pipeline::first_pass_world(&resolved.source, &resolved.settings, frame, Some(&prepared));
        let (world, begun) = (world.map_err(failed)?, clock.now());
        let solution = femc_pipeline::solve_first_pass(&world, plan.method, &AtomicBool::new(false)).map_err(failed)?;
        let light = femc_pipeline::FrameLight::new(Arc::new(solution.field), prepared.brightness);
        femc_pipeline::attach_first_pass(&mut prepared, light).map_err(failed)?;
        let learned = femc_pipeline::attach_learned_targets(&mut prepared, plan.method).map_err(failed)?;
        targets = learned.map_or(Vec::new(), |learned| learned.targets);
        first_pass_seconds = clock.since(begun).as_secs_f64();
    }
    let begun = clock.now();
    let mut samples = 0;
    for round in 0.. {
        samples += render_blocks(resolved, &prepared, round);
        if clock.since(begun) >= TRIAL_DURATION {
            break;
        }
    }
    let samples_per_second = samples as f64 / clock.since(begun).as_secs_f64();
    let all_prepared = prepare_seconds * plan.frames.len() as f64 + first_pass_seconds * first_passes as f64;
    let budget = match resolved.settings.stop {
        StopCondition::Time(seconds) => Some(seconds * plan.frames.len() as f64),
        StopCondition::Spp(_) | StopCondition::Error(_) => None,
    };
    let seconds = |samples: u64| all_prepared + samples as f64 / samples_per_second;
    let seconds_most = budget.map_or(seconds(samples_most), |budget| budget.min(seconds(samples_most)));
    let seconds_least = budget.unwrap_or(seconds(samples_least)).min(seconds_most);
    let likely = pilot(resolved, &prepared, frame)?.map(|samples_a_pixel| {
        let [width, height] = resolved.film().map(f64::from);
        let samples = samples_a_pixel * width * height * plan.frames.len() as f64;
        PilotEstimate { samples_a_pixel, seconds: seconds(samples as u64).clamp(seconds_least, seconds_most) }
    });
    let origin = prepared.origin.into();
    Ok(PlanCost {
        prepare_seconds,
        first_pass_seconds,
        targets,
        origin,
        samples_per_second,
        seconds_least,
        seconds_most,
        likely,
    })
}

/// Returns the samples per pixel that a frame is likely to need to reach its error; `None` if it does not stop by error.
fn pilot(resolved: &ResolvedRequest, prepared: &Prepared, frame: u32) -> Result<Option<f64>, Failure> {
    if !matches!(resolved.settings.stop, StopCondition::Error(_)) {
        return Ok(None);
    }
    let small = femc_pipeline::pilot::film_size(resolved.film());
    let settings = femc_pipeline::Settings { size: Some(small), ..resolved.settings.clone() };
    let prepared = femc_pipeline::prepare_pilot(&resolved.source, &settings, frame, prepared).map_err(failed)?;
    let (clock, begun) = (Clock, Clock.now());
    femc_pipeline::pilot::estimate_samples(&prepared, &settings, || clock.since(begun) >= PILOT_DURATION)
        .map_err(failed)
}

/// Renders one sample per pixel in 16 blocks spread over the film. Returns the number of samples.
fn render_blocks(resolved: &ResolvedRequest, prepared: &Prepared, round: u32) -> u64 {
    let [width, height] = resolved.film();
    let (across, down) = (width.div_ceil(TRIAL_BLOCK).min(4), height.div_ceil(TRIAL_BLOCK).min(4));
    let mut samples = 0;
    for index in 0..across * down {
        let (i, j) = (index % across, index / across);
        let x = (width.saturating_sub(TRIAL_BLOCK) as u64 * u64::from(i) / u64::from(across.max(2) - 1)) as u32;
        let y = (height.saturating_sub(TRIAL_BLOCK) as u64 * u64::from(j) / u64::from(down.max(2) - 1)) as u32;
        let rect = femc_film::Rect { x, y, width: TRIAL_BLOCK.min(width - x), height: TRIAL_BLOCK.min(height - y) };
        let task = femc_pipeline::RenderTask::new(prepared, &resolved.settings, rect, round..round + 1);
        samples += task.render(femc_pipeline::Outputs::default()).map_or(0, |_| rect.area());
    }
    samples
}

fn print(printer: Printer, report: &PlanReport) {
    let PlanReport { camera, film: [width, height], frames, tile, tiles, .. } = report;
    printer.result(format!("{}: camera {camera}, {width}x{height} pixels, {}", report.scene, frames_text(frames)));
    printer.result(format!("\n{}", table(&report.graph)));
    let spp = match (report.stop, report.rounds.as_slice()) {
        (StopCondition::Spp(n), _) => format!("{n} samples a pixel"),
        (StopCondition::Time(s), _) => format!("as many samples as a time of {} per frame allows", human::seconds(s)),
        (StopCondition::Error(e), [first, .., last]) => {
            let (rounds, error) = (report.rounds.len(), human::percent(e));
            format!(
                "{first} to {last} samples a pixel in {rounds} rounds, until every block's relative error is {error}"
            )
        }
        (_, rounds) => format!("{rounds:?} samples a pixel"),
    };
    if report.has_images {
        printer.result(format!("\n{} of {tile} pixels; {spp}", human::counted_noun(*tiles as u64, "tile")));
    }
    let every = if report.rounds.len() > 1 && report.has_images { " if every round runs" } else { "" };
    printer.result(format!("{}{every}", human::counted_noun(report.tasks, "task")));
    match report.worlds {
        _ if frames.len() < 2 => {}
        1 => printer.result("all frames share one world: only the view changes"),
        worlds if worlds == frames.len() => printer.result("every frame has its own world"),
        worlds => {
            printer
                .result(format!("the frames have {worlds} worlds; between frames of one world, only the view changes"));
        }
    }
    if let Some(MethodChoice { method: femc_pipeline::Method::Femc, reason, .. }) = &report.choice {
        printer.result(format!("a first pass guides the paths: {reason}"));
    }
    if report.first_passes > 0 {
        printer.result(match (report.first_passes, frames.len()) {
            (1, 1) => "the first pass is solved before the frame's samples".to_owned(),
            (1, all) => format!("the first pass is solved once, and all {all} frames share it"),
            (solutions, all) if solutions == all => "every frame has its own first pass".to_owned(),
            (solutions, all) => format!("the first pass is solved {solutions} times, and {all} frames share them"),
        });
        let surfaces = human::counted_noun(report.surfaces, "surface");
        printer.result(match report.first_pass_blocks {
            1 => format!("the first pass is one task: for {surfaces}, blocks would cost more than they save"),
            blocks => format!("its rays are cast in {blocks} blocks, because the scene has {surfaces}"),
        });
    }
    if let Some(cost) = &report.cost {
        for target in cost.targets.iter().filter(|target| target.light >= MIN_LIGHT) {
            printer.result(target_text(target, cost.origin));
        }
        let range = match (report.stop, &cost.likely) {
            (StopCondition::Error(_), likely) => {
                let (least, most) = (human::seconds(cost.seconds_least), human::seconds(cost.seconds_most));
                let likely = likely.as_ref().map_or(String::new(), |likely| {
                    let (seconds, samples) = (human::seconds(likely.seconds), likely.samples_a_pixel.round());
                    format!("likely {seconds} (a pilot needs {samples} samples a pixel); ")
                });
                format!("{likely}{least} for the first round, {most} if all {} rounds are needed,", report.rounds.len())
            }
            (StopCondition::Spp(_) | StopCondition::Time(_), _) => human::seconds(cost.seconds_most),
        };
        let rate = human::quantity(cost.samples_per_second);
        printer.result(format!("estimated cost: {range} on this machine ({rate} samples/s in a short trial)"));
    }
    if let Some(measurement) = &report.measurement {
        let seconds = human::seconds(measurement.seconds);
        printer.result(format!("measurement: {}; estimated cost: {seconds} on this machine", measurement.text()));
    }
    if !report.left_out.is_empty() {
        printer.result(format!("\n{}", printer.style_heading("left out")));
        for left in &report.left_out {
            printer.result(format!("  {}: {}", left.what, left.reason));
        }
    }
}

/// Returns text like `paths are guided through an opening of 0.05 m x 2.06 m at (0.98, -0.3, 1): 31 % of the indirect light`.
/// - `origin`: world position of the origin of the target's positions, m.
fn target_text(target: &TargetRecord, origin: [f64; 3]) -> String {
    let meters = |value: f32| format!("{} m", (f64::from(value) * 100.0).round() / 100.0);
    let size = match target.shape {
        TargetShape::Parallelogram { edges, .. } => {
            let [a, b] = edges.map(|edge| meters(edge.iter().map(|at| at * at).sum::<f32>().sqrt()));
            format!("{a} x {b}")
        }
        TargetShape::Ball { radius, .. } => format!("radius {}", meters(radius)),
    };
    let position = origin.iter().zip(target.shape.center()).map(|(origin, at)| origin + f64::from(at));
    // The sum makes 0 of -0.
    let position: Vec<String> = position.map(|at| ((at * 100.0).round() / 100.0 + 0.0).to_string()).collect();
    let kind = match target.kind {
        TargetKind::Opening => "through an opening",
        TargetKind::Patch => "to a bright patch",
    };
    let light = human::percent(f64::from(target.light));
    format!("paths are guided {kind} of {size} at ({}): {light} of the indirect light", position.join(", "))
}

/// Returns a table with a line for each stage.
fn table(graph: &Graph) -> String {
    let row = |(stage, template): (u16, &StageTemplate)| {
        let per = match template.scope {
            Scope::Job => "job",
            Scope::Frame => "frame",
            Scope::Content => "content",
        };
        vec![
            stage.to_string(),
            template.kind.name().to_owned(),
            per.to_owned(),
            template.tasks().to_string(),
            graph.rounds(stage).to_string(),
            joined(template.needs.iter().map(need_text).chain(template.hints.iter().map(hint_text))),
            joined(template.outputs.iter().map(|role| role.name().to_owned())),
            template.tags.join(", "),
        ]
    };
    let rows: Vec<Vec<String>> = graph.iter().map(row).collect();
    human::table(&["stage", "kind", "per", "tasks", "rounds", "reads", "makes", "tags"], &rows)
}

fn joined(all: impl Iterator<Item = String>) -> String {
    all.collect::<Vec<_>>().join(", ")
}

fn reach_text(reach: Reach) -> String {
    match reach {
        Reach::All => "all".to_owned(),
        Reach::Same => "its own".to_owned(),
        Reach::Fan(tasks) => format!("{tasks} each"),
        Reach::Previous => "previous".to_owned(),
    }
}

/// Returns text like `numbers of 0 (all of the previous frame, if present)`.
fn hint_text(hint: &Hint) -> String {
    format!("{} of {} ({} of the previous frame, if present)", hint.role.name(), hint.stage, reach_text(hint.reach))
}

/// Returns text like `tile of 0 (64 each)`.
fn need_text(need: &Need) -> String {
    let reach = reach_text(need.reach);
    let round = match need.round {
        Round::Same => "",
        Round::Previous => " of the previous round",
        Round::Every => " of every round",
    };
    let gaps = if need.gaps { ", if available" } else { "" };
    format!("{} of {} ({reach}{round}{gaps})", need.role.name(), need.stage)
}

/// Returns text like `frame 3`, `120 frames (1..120)`.
fn frames_text(frames: &[u32]) -> String {
    match frames {
        [one] => format!("frame {one}"),
        [first, .., last] => format!("{} frames ({first}..{last})", frames.len()),
        [] => "no frame".to_owned(),
    }
}
