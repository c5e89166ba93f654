//! `femc check SCENE`: what is wrong with a scene.

use crate::args::FormatArgs;
use crate::exit::{Exit, Failure};
use crate::output::{Say, human, json};
use crate::request::{beside, load};
use clap::Args;
use femc_import::{Oddity, Warning};
use femc_scene::check::{Fault, FaultKind, Severity, check};
use femc_scene::{Location, Scene};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// List the faults of a scene with file and line; exit code 1 if one is an error
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc check scenes/roundabout.mgf\n  \
    femc check scene.mgf --json | jq '.faults[] | select(.severity == \"error\")'\n  \
    femc check scene.mgf --quiet && femc render scene.mgf")]
pub struct CheckArgs {
    /// Scene file
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    #[command(flatten)]
    format: FormatArgs,
}

#[derive(Serialize)]
struct Report {
    scene: String,
    errors: usize,
    warnings: usize,
    notes: usize,
    faults: Vec<Line>,
}

/// A fault of the import or of the scene.
#[derive(Serialize)]
struct Line {
    severity: Severity,
    kind: String,
    file: String,
    line: u32,
    message: String,
    #[serde(skip_serializing_if = "String::is_empty")]
    advice: String,
}

/// Load, check, list.
pub fn run(args: &CheckArgs, say: Say) -> Result<Exit, Failure> {
    let loaded = match load(&args.scene) {
        Ok(loaded) => loaded,
        Err(failure) => {
            if args.format.json && failure.exit == Exit::Failed {
                json::print(say, &unreadable(&args.scene, &failure))?;
            }
            return Err(failure);
        }
    };
    let faults = lines(&args.scene, &loaded.scene, &loaded.warnings);
    let count = |severity| faults.iter().filter(|line| line.severity == severity).count();
    let report = Report {
        scene: args.scene.display().to_string(),
        errors: count(Severity::Error),
        warnings: count(Severity::Warning),
        notes: count(Severity::Note),
        faults,
    };
    if args.format.json {
        json::print(say, &report)?;
    } else {
        print(say, &report);
    }
    Ok(if report.errors > 0 { Exit::Failed } else { Exit::Done })
}

/// A scene that cannot be imported has one error.
fn unreadable(path: &Path, failure: &Failure) -> Report {
    let (place, message) = failure.message.split_once(": ").unwrap_or(("", &failure.message));
    let mut parts = place.split(':');
    let file = parts.next().unwrap_or_default().to_owned();
    let line = parts.next().and_then(|line| line.parse().ok()).unwrap_or(0);
    let fault = Line {
        severity: Severity::Error,
        kind: "import".to_owned(),
        file,
        line,
        message: message.to_owned(),
        advice: String::new(),
    };
    Report { scene: path.display().to_string(), errors: 1, warnings: 0, notes: 0, faults: vec![fault] }
}

/// Warnings of the import and faults of the scene, in order of place; what both say is said once.
fn lines(path: &Path, scene: &Scene, warnings: &[Warning]) -> Vec<Line> {
    let faults = check(scene);
    let index = |file: &str| scene.files.iter().position(|name| name == file).unwrap_or(usize::MAX);
    let mut keyed: Vec<((usize, u32), Line)> = Vec::new();
    for Warning { at, oddity } in warnings {
        let place = (index(&at.file), at.line);
        let said_by = same_as(oddity);
        let again = |fault: &Fault| {
            let Location { file, line, .. } = fault.location;
            (file as usize, line) == place && Some(fault.kind) == said_by
        };
        if !faults.iter().any(again) {
            let line = Line {
                severity: Severity::Warning,
                kind: "import".to_owned(),
                file: beside(path, &at.file),
                line: at.line,
                message: oddity.to_string(),
                advice: String::new(),
            };
            keyed.push((place, line));
        }
    }
    for Fault { severity, kind, location, message, advice } in faults {
        let file = scene.files.get(location.file as usize).map_or("", String::as_str);
        let line = Line { severity, kind: kebab(kind), file: beside(path, file), line: location.line, message, advice };
        keyed.push(((location.file as usize, location.line), line));
    }
    keyed.sort_by_key(|(place, _)| *place);
    keyed.into_iter().map(|(_, line)| line).collect()
}

/// The fault of a scene that says the same as a warning of the import.
fn same_as(oddity: &Oddity) -> Option<FaultKind> {
    match oddity {
        Oddity::NoArea => Some(FaultKind::DegenerateSurface),
        Oddity::NotPlanar { .. } => Some(FaultKind::NonPlanarFace),
        Oddity::OutOfGamut => Some(FaultKind::OutOfGamut),
        Oddity::ChannelAboveOne { .. } => Some(FaultKind::EnergyGain),
        Oddity::Replaced { .. } => Some(FaultKind::DuplicateName),
        Oddity::UnknownEntity { .. }
        | Oddity::CrossesItself
        | Oddity::HoleOrientation
        | Oddity::LeftOpen { .. }
        | Oddity::NotTransformed { .. }
        | Oddity::Photometry { .. }
        | Oddity::TooBright { .. }
        | Oddity::NoTextureCoordinates { .. }
        | Oddity::Texture { .. }
        | Oddity::More { .. } => None,
    }
}

/// The name of a kind as in JSON.
fn kebab(kind: FaultKind) -> String {
    serde_json::to_value(kind).ok().and_then(|name| name.as_str().map(str::to_owned)).unwrap_or_default()
}

fn print(say: Say, report: &Report) {
    for Line { severity, file, line, message, advice, .. } in &report.faults {
        if say.quiet() && *severity != Severity::Error {
            continue;
        }
        let label = severity.to_string();
        let label = match severity {
            Severity::Error => say.bad(&label),
            Severity::Warning => say.doubtful(&label),
            Severity::Note => label,
        };
        let advice = if advice.is_empty() { String::new() } else { format!("; {advice}") };
        say.result(format!("{file}:{line}: {label}: {message}{advice}"));
    }
    if !say.quiet() {
        let count = |n: usize, noun| human::count(n as u64, noun);
        say.result(format!(
            "{}: {}, {}, {}",
            report.scene,
            count(report.errors, "error"),
            count(report.warnings, "warning"),
            count(report.notes, "note")
        ));
    }
}
