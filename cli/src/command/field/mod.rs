//! `femc field SCENE -o solution.glb`: solves the finite-element first pass and writes it for glTF viewers.

mod document;
mod report;

use crate::args::{FormatArgs, SettingsArgs};
use crate::clock::Clock;
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::{Printer, human, json};
use crate::request::ImportedScene;
use crate::threads;
use crate::values::{ByteSize, Exposure, Frames, Override, ev};
use clap::Args;
use document::{GltfMetadata, Wireframe};
use femc_film::{LuminanceLevels, ToneCurve};
use femc_pipeline::radiosity::{
    GuideKind, Mesh, MeshContent, SolutionView, SolveOptions, TARGET_RESIDUAL, solution_meshes, solve,
};
use report::{FieldReport, LeafCounts, LinkCounts};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Solve the finite-element first pass and write it as glTF, for viewing
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc field scenes/cornell.mgf -o solution.glb    # open it in any glTF viewer\n  \
    femc field scenes/cornell.mgf -o solution.glb --error 0.02 --wire\n  \
    femc field scenes/roundabout.mgf --frame 12 --exposure 7 -o drive.glb\n  \
    femc field scenes/cornell.mgf -o solution.glb --json | jq .energy\n\n\
    The file contains one mesh per material and side, made of the elements' leaves. Colors are the luminance along the normal \
    times one scale, which scenes[0].extras states. The attributes _RADIANCE (cd/m2), _IRRADIANCE and _DIRECT (lx) contain the \
    unscaled values, _ELEMENT and _SURFACE the numbers of elements and surfaces. Mirrors, clear solids and fog are left out. \
    Statistics are written to a JSON file beside it.")]
pub struct FieldArgs {
    /// Scene file
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// File to write; statistics go to a .json beside it [default: the scene's name]
    #[arg(long, short, value_name = "FILE.glb")]
    out: Option<PathBuf>,
    /// Largest error of one link, relative to the light that its receiver gets
    #[arg(long, value_name = "E", default_value_t = SolveOptions::default().error, value_parser = parse_link_error)]
    error: f32,
    /// Frame of the clip
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    frame: u32,
    /// Memory limit for elements and links; when it is reached, refinement stops
    #[arg(long, value_name = "BYTES", default_value = "1GiB")]
    memory: ByteSize,
    /// Exposure of the colors: auto (the log-average luminance, weighted by the light that surfaces send, is middle gray), or an
    /// exposure value at ISO 100 (2^EV / 8 cd/m2 is middle gray; one more is half as bright)
    #[arg(long, value_name = "auto|EV", default_value = "auto", allow_hyphen_values = true)]
    exposure: Exposure,
    /// Draw the elements' edges
    #[arg(long)]
    wire: bool,
    /// Threads [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    threads: Option<u32>,
    /// Override a scalar of the scene, like medium.fog.sigma_s=0.03 (repeatable)
    #[arg(long, value_name = "SELECTOR=VALUE")]
    set: Vec<Override>,
    /// Folder that contains the includes, textures and lamps of the scene, at any depth [default: the scene's folder]
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    #[command(flatten)]
    format: FormatArgs,
}

/// Parses a share, > 0 and at most 10.
fn parse_link_error(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(share) if share > 0.0 && share <= 10.0 => Ok(share),
        _ => Err(format!("`{text}` is not a link error; write a number above 0 and up to 10, like 0.1 for 10 %")),
    }
}

/// Runs `femc field`.
pub fn run(args: FieldArgs, printer: Printer) -> Result<Exit, Failure> {
    let out = target(args.out.as_deref(), &args.scene)?;
    let pool = threads::pool(args.threads)?;
    let typed = SettingsArgs { frames: Some(Frames::single(args.frame)), set: args.set, ..SettingsArgs::default() };
    let named = |key: &str| (key == "frames").then(|| "--frame".to_owned());
    let resolved = ImportedScene::open(&args.scene, args.root.as_deref(), printer)?.resolve(&typed, &named)?;
    resolved.warn_of_caustics(printer);
    let prepared =
        pool.install(|| femc_pipeline::prepare_frame(&resolved.source, &resolved.settings, args.frame, None));
    let prepared = prepared.map_err(failed)?;

    printer.note(format!(
        "{}: solving frame {} with a link error of {}",
        args.scene.display(),
        args.frame,
        human::percent(args.error.into())
    ));
    let options = SolveOptions {
        error: args.error,
        memory: usize::try_from(args.memory.0).unwrap_or(usize::MAX),
        guides: GuideKind::None,
    };
    let begun = Clock.now();
    let solution = pool.install(|| solve(&prepared, &options, &AtomicBool::new(false)));
    let solution = solution.map_err(|_| failed("cancelled"))?;
    let seconds = Clock.since(begun).as_secs_f64();

    let look = SolutionView::new(&prepared, &solution.field);
    let meshes = solution_meshes(&look);
    if meshes.is_empty() {
        printer.warning(format!(
            "{}: no surface reflects or emits light, so the file has no meshes",
            args.scene.display()
        ));
    }
    let curve = curve(args.exposure, &meshes);
    let wireframe = if args.wire { Wireframe::Shown } else { Wireframe::Hidden };
    let (scale, scene) = (curve.exposure, args.scene.display().to_string());
    let metadata = GltfMetadata { prepared: &prepared, scale, ev: ev(curve), scene: resolved.name() };
    let file = document::glb(&meshes, wireframe, &metadata);
    let file = file.map_err(|error| failed(format!("{error}; use a larger --error")))?;
    femc_film::file::write_atomic(&out, &file).map_err(failed)?;

    let (solve_report, light, statistics) = (&solution.report, look.totals(), out.with_extension("json"));
    let report = FieldReport {
        scene,
        frame: args.frame,
        out: out.display().to_string(),
        statistics: statistics.display().to_string(),
        error: args.error,
        seconds,
        elements: solve_report.census.elements.into(),
        leaves: LeafCounts::from_report(solve_report, &light),
        links: LinkCounts::from_report(solve_report),
        refused: solve_report.inexact_links,
        rays: solve_report.rays,
        iterations: solve_report.iterations,
        residual: solve_report.residual,
        row_sum: solve_report.row_sum,
        imbalance: solve_report.imbalance,
        untrusted: solve_report.verify(&light).err().map(|reason| reason.to_string()),
        checked: solve_report.ray_link_ratio,
        corrected: solve_report.ray_correction,
        bytes: solve_report.bytes,
        energy: (&light).into(),
        irradiance: (&light).into(),
        area: light.area,
        exposure_ev: metadata.ev,
        scale,
        vertices: meshes.iter().map(|mesh| mesh.positions.len()).sum(),
        triangles: meshes.iter().map(|mesh| mesh.triangles.len()).sum(),
    };
    if let Some(reason) = &report.untrusted {
        printer.warning(format!(
            "the finite-element solution cannot be trusted: {reason}; `--method fem` and `--method femc` refuse it, use `--method pt`"
        ));
    }
    if report.residual > TARGET_RESIDUAL {
        printer.warning(format!(
            "light still changes by {} after {} iterations because surfaces and fog absorb very little: the solution is too dark",
            human::percent(report.residual.into()),
            report.iterations
        ));
    }
    let text = serde_json::to_string_pretty(&report).map_err(failed)? + "\n";
    femc_film::file::write_atomic(&statistics, text.as_bytes()).map_err(failed)?;
    if args.format.json {
        json::print(printer, &report)?;
    } else {
        report.print(printer);
    }
    Ok(Exit::Done)
}

/// Returns the file to write. Fails if its folder does not exist.
fn target(out: Option<&Path>, scene: &Path) -> Result<PathBuf, Failure> {
    let Some(out) = out else {
        return Ok(Path::new(scene.file_stem().unwrap_or_default()).with_extension("glb"));
    };
    let shown = out.display();
    if out.is_dir() {
        return Err(usage(format!("-o {shown} is a folder; give FILE.glb")));
    }
    if !out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("glb")) {
        return Err(usage(format!("-o {shown}: solutions are only written as binary glTF (.glb); give FILE.glb")));
    }
    match out.parent().filter(|folder| !folder.as_os_str().is_empty() && !folder.is_dir()) {
        Some(folder) => Err(usage(format!("-o {shown}: no folder {}; create it first", folder.display()))),
        None => Ok(out.to_owned()),
    }
}

/// Returns the tone curve whose exposure scales luminances to colors. Automatic exposure weights each surface by the light that it
/// sends, so that the nearly black backs of walls have no influence. Lamps are left out, because everything else would be dark
/// beside them.
fn curve(exposure: Exposure, meshes: &[Mesh]) -> ToneCurve {
    if exposure != Exposure::Auto {
        return exposure.curve(&LuminanceLevels::default());
    }
    let elements = meshes.iter().filter(|mesh| mesh.content == MeshContent::Elements);
    let lit: Vec<(f64, f64)> = elements
        .flat_map(Mesh::luminances)
        .map(|(luminance, area)| (f64::from(luminance), f64::from(area)))
        .filter(|&(luminance, area)| luminance > 0.0 && area > 0.0)
        .collect();
    let sent: f64 = lit.iter().map(|(luminance, area)| luminance * area).sum();
    ToneCurve::from_luminances(lit.iter().map(|&(luminance, area)| (luminance, luminance * area / sent)))
}
