//! `femc check SCENE`: what is wrong with a scene, and what is in it.

mod contents;
mod faults;
mod refusals;

use crate::args::FormatArgs;
use crate::exit::{Exit, Failure};
use crate::output::faults::{self as output, Detail, Kind, Line};
use crate::output::{Say, human, json};
use crate::request::load;
use clap::Args;
use contents::Contents;
use femc_scene::check::Severity;
use serde::Serialize;
use std::path::PathBuf;

/// List the faults of a scene with file and line, its size and its lamps; exit code 1 if a fault is an error
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
    /// Includes, textures and lamps of the scene may lie anywhere below DIR [default: the scene's folder]
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// A line for every fault, not for every kind
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

/// Load, check, list.
pub fn run(args: &CheckArgs, say: Say) -> Result<Exit, Failure> {
    let (root, loaded) = match load(&args.scene, args.root.as_deref()) {
        Ok(loaded) => loaded,
        Err(failure) => {
            if args.format.json && failure.exit == Exit::Failed {
                json::print(say, &Report::new(args, vec![faults::unreadable(&failure)], Contents::default()))?;
            }
            return Err(failure);
        }
    };
    let mut lines = faults::lines(&root, &loaded);
    lines.extend(refusals::refusals(&root, &loaded.scene));
    let report = Report::new(args, lines, Contents::of(&loaded.scene, &root));
    if args.format.json {
        json::print(say, &report)?;
    } else {
        print(say, &report, args.all);
    }
    Ok(if report.errors > 0 { Exit::Failed } else { Exit::Done })
}

fn print(say: Say, report: &Report, all: bool) {
    output::print(say, &report.faults, if all { Detail::All } else { Detail::Kinds });
    if say.quiet() {
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
