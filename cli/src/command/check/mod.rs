//! `femc check SCENE`: lists the faults of a scene and its contents.

mod contents;
mod faults;
mod refusals;

use crate::args::FormatArgs;
use crate::exit::{Exit, Failure};
use crate::output::faults::{self as output, Detail, FaultGroup, FaultLine};
use crate::output::{Printer, human, json};
use crate::request::locate_scene;
use clap::Args;
use contents::Contents;
use femc_import::ImportErrors;
use femc_scene::check::Severity;
use serde::Serialize;
use std::path::PathBuf;

/// List the faults of a scene with file and line, its size and its lamps; the exit code is 1 if a fault is an error
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc check scenes/roundabout.mgf\n  \
    femc check scene.mgf --all\n  \
    femc check scene.mgf --json | jq '.faults[] | select(.severity == \"error\")'\n  \
    femc check scene.mgf --json | jq '.lamps[] | {name, count, lumens}'\n  \
    femc check scene.mgf --quiet && femc render scene.mgf")]
pub struct CheckArgs {
    /// Scene file
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// Folder that contains the includes, textures and lamps of the scene, at any depth [default: the scene's folder]
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// Print a line for every fault instead of every kind
    #[arg(long)]
    all: bool,
    #[command(flatten)]
    format: FormatArgs,
}

#[derive(Serialize)]
struct CheckReport {
    scene: String,
    errors: usize,
    warnings: usize,
    notes: usize,
    kinds: Vec<FaultGroup>,
    faults: Vec<FaultLine>,
    #[serde(flatten)]
    contents: Contents,
}

impl CheckReport {
    fn new(args: &CheckArgs, faults: Vec<FaultLine>, contents: Contents) -> Self {
        let count = |severity| faults.iter().filter(|line| line.severity == severity).count();
        Self {
            scene: args.scene.display().to_string(),
            errors: count(Severity::Error),
            warnings: count(Severity::Warning),
            notes: count(Severity::Note),
            kinds: output::kinds(&faults),
            faults,
            contents,
        }
    }
}

/// Runs `femc check`.
pub fn run(args: &CheckArgs, printer: Printer) -> Result<Exit, Failure> {
    let root = locate_scene(&args.scene, args.root.as_deref())?;
    let (report, imported) = match root.load_or_all_errors() {
        Ok(loaded) => {
            let mut lines = faults::fault_lines(&root, &loaded);
            lines.extend(refusals::plan_refusals(&root, &loaded.scene));
            (CheckReport::new(args, lines, Contents::from_scene(&loaded.scene, &root)), ImportOutcome::Complete)
        }
        Err(ImportErrors { errors, complete }) => {
            let lines = errors.iter().map(|error| faults::import_error_line(&root, error)).collect();
            let imported = if complete { ImportOutcome::Failed } else { ImportOutcome::Aborted };
            (CheckReport::new(args, lines, Contents::default()), imported)
        }
    };
    if args.format.json {
        json::print(printer, &report)?;
    } else {
        print(printer, &report, args.all, imported);
    }
    Ok(if report.errors > 0 { Exit::Failed } else { Exit::Done })
}

/// Part of a scene that was imported.
#[derive(Clone, Copy, PartialEq, Eq)]
enum ImportOutcome {
    /// The whole scene.
    Complete,
    /// Nothing: the scene has errors. All of its files were read, so the list of errors is complete.
    Failed,
    /// Nothing, and the list of errors is incomplete: reading stopped before the end of the scene.
    Aborted,
}

fn print(printer: Printer, report: &CheckReport, all: bool, imported: ImportOutcome) {
    output::print(printer, &report.faults, if all { Detail::All } else { Detail::Kinds });
    if printer.quiet() {
        return;
    }
    if imported != ImportOutcome::Complete {
        let least = if imported == ImportOutcome::Aborted { "at least " } else { "" };
        let errors = human::counted_noun(report.errors as u64, "error");
        printer
            .result(format!("{}: {least}{errors}; warnings are listed only for scenes without errors", report.scene));
        return;
    }
    report.contents.print(printer);
    let count = |n: usize, noun| human::counted_noun(n as u64, noun);
    printer.result(format!(
        "{}: {}, {}, {}",
        report.scene,
        count(report.errors, "error"),
        count(report.warnings, "warning"),
        count(report.notes, "note")
    ));
}
