//! `femc check SCENE`: lists the faults of a scene and its contents.

mod contents;
mod faults;
mod refusals;

use crate::args::FormatArgs;
use crate::exit::{Exit, Failure};
use crate::output::faults::{self as output, Detail, Kind, Line};
use crate::output::{Say, human, json};
use crate::request::locate;
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
struct Report {
    scene: String,
    errors: usize,
    warnings: usize,
    notes: usize,
    kinds: Vec<Kind>,
    faults: Vec<Line>,
    #[serde(flatten)]
    contents: Contents,
}

impl Report {
    fn new(args: &CheckArgs, faults: Vec<Line>, contents: Contents) -> Self {
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
pub fn run(args: &CheckArgs, say: Say) -> Result<Exit, Failure> {
    let root = locate(&args.scene, args.root.as_deref())?;
    let (report, imported) = match root.load_or_list() {
        Ok(loaded) => {
            let mut lines = faults::lines(&root, &loaded);
            lines.extend(refusals::refusals(&root, &loaded.scene));
            (Report::new(args, lines, Contents::of(&loaded.scene, &root)), Imported::Whole)
        }
        Err(ImportErrors { errors, complete }) => {
            let lines = errors.iter().map(|error| faults::unreadable(&root, error)).collect();
            let imported = if complete { Imported::Not } else { Imported::Partly };
            (Report::new(args, lines, Contents::default()), imported)
        }
    };
    if args.format.json {
        json::print(say, &report)?;
    } else {
        print(say, &report, args.all, imported);
    }
    Ok(if report.errors > 0 { Exit::Failed } else { Exit::Done })
}

/// Part of a scene that was imported.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Imported {
    /// The whole scene.
    Whole,
    /// Nothing: the scene has errors. All of its files were read, so the list of errors is complete.
    Not,
    /// Nothing, and the list of errors is incomplete: reading stopped before the end of the scene.
    Partly,
}

fn print(say: Say, report: &Report, all: bool, imported: Imported) {
    output::print(say, &report.faults, if all { Detail::All } else { Detail::Kinds });
    if say.quiet() {
        return;
    }
    if imported != Imported::Whole {
        let least = if imported == Imported::Partly { "at least " } else { "" };
        let errors = human::count(report.errors as u64, "error");
        say.result(format!("{}: {least}{errors}; warnings are listed only for scenes without errors", report.scene));
        return;
    }
    report.contents.print(say);
    let count = |n: usize, noun| human::count(n as u64, noun);
    say.result(format!(
        "{}: {}, {}, {}",
        report.scene,
        count(report.errors, "error"),
        count(report.warnings, "warning"),
        count(report.notes, "note")
    ));
}
