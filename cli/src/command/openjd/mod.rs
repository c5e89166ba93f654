//! `femc openjd import` and `export`: sweeps from and for farms that use Open Job Description
//! (<https://github.com/OpenJobDescription>). docs/openjd.md has the table of supported features.
//!
//! The import depends on what the tasks of a template do, not on how the template is written. The crate `openjd-model` reads it,
//! checks it and iterates over its parameter space. Every task's command line is parsed like that of `femc render`, and settings
//! that differ from task to task become axes. So products, associations, expressions and chunks need no rules of their own here.
//! The price is that a template that runs other programs is refused.

mod export;
mod file_paths;
mod import;
mod positions;
mod task_command;
mod template;
#[cfg(test)]
mod tests;

use crate::args::{Method, SettingsArgs};
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::{Printer, human};
use crate::request::{ImportedScene, JobFile, ResolvedRequest};
use clap::{Args, Subcommand};
use export::FrameChunks;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use template::{Template, TemplateError};

/// Convert Open Job Description templates into sweeps, and jobs into templates
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc openjd export fog.toml -o fog.yaml --chunk 10   # each task renders 10 frames of a variant\n  \
    openjd run fog.yaml                                  # or submit it to any farm that supports the format\n  \
    femc openjd import fog.yaml -o fog.toml -p Scene=scenes/roundabout.mgf\n  \
    femc sweep fog.toml -o fog\n\n\
    docs/openjd.md lists what can be converted. Each part that is left out is printed on stderr, on one line.")]
pub struct OpenjdArgs {
    #[command(subcommand)]
    command: OpenjdCommand,
}

#[derive(Debug, Subcommand)]
enum OpenjdCommand {
    /// Write a job file that does the same as a template's tasks: they must run `femc render`
    #[command(after_help = "Examples:\n  femc openjd import fog.yaml -o fog.toml\n  \
        femc openjd import fog.yaml -o fog.toml -p Scene=scenes/roundabout.mgf -p Spp=64")]
    Import(ImportArgs),
    /// Write a job as a template whose tasks run `femc render`
    #[command(after_help = "Examples:\n  femc openjd export fog.toml -o fog.yaml\n  \
        femc openjd export fog.toml -o fog.json --chunk 10")]
    Export(ExportArgs),
}

#[derive(Debug, Args)]
struct ImportArgs {
    /// Job template of specification 2023-09, YAML or JSON
    #[arg(value_name = "TEMPLATE")]
    template: PathBuf,
    /// Job file to write
    #[arg(long, short, value_name = "JOB.toml")]
    out: PathBuf,
    /// Value of a job parameter, instead of its default (repeatable)
    #[arg(long = "param", short, value_name = "NAME=VALUE", value_parser = parse_parameter)]
    params: Vec<(String, String)>,
}

#[derive(Debug, Args)]
struct ExportArgs {
    /// Job file, with or without a `[sweep]`
    #[arg(value_name = "JOB.toml")]
    job: PathBuf,
    /// Template to write: JSON if it ends in .json, else YAML
    #[arg(long, short, value_name = "TEMPLATE")]
    out: PathBuf,
    /// Largest number of frames per task
    #[arg(long, value_name = "N", default_value = "1")]
    chunk: NonZeroUsize,
}

fn parse_parameter(text: &str) -> Result<(String, String), String> {
    let split = text.split_once('=').filter(|(name, _)| !name.is_empty());
    split.map(|(name, value)| (name.to_owned(), value.to_owned())).ok_or_else(|| "write NAME=VALUE".to_owned())
}

/// Runs `femc openjd`.
pub fn run(args: &OpenjdArgs, printer: Printer) -> Result<Exit, Failure> {
    match &args.command {
        OpenjdCommand::Import(args) => import(args, printer),
        OpenjdCommand::Export(args) => export(args, printer),
    }
}

fn import(args: &ImportArgs, printer: Printer) -> Result<Exit, Failure> {
    let template = Template::open(&args.template, &args.params).map_err(map_template_error)?;
    let imported = import::import(&template, &args.out).map_err(map_template_error)?;
    write(&args.out, &imported.text)?;
    imported.left_out.iter().for_each(|line| printer.note(format!("warning: {line}")));
    printer.note(format!("{}: {}", args.out.display(), human::counted_noun(imported.variants as u64, "variant")));
    Ok(Exit::Done)
}

fn export(args: &ExportArgs, printer: Printer) -> Result<Exit, Failure> {
    let mut job = JobFile::load(&args.job).map_err(usage)?;
    let imported = ImportedScene::open(&job.scene, job.settings.root.as_deref(), printer)?;
    let first = first_variant(&job, &imported)?;
    let frames = first.plan.frames.clone();
    if !job.sweep.iter().flat_map(|sweep| &sweep.axes).any(|axis| axis.name == "method") {
        // Tasks that chose for themselves could choose differently, and each would need a pilot.
        let chosen = first.choose_method(printer)?;
        chosen.explain_method(printer);
        if let Some(choice) = &chosen.choice {
            let guided = choice.method == femc_pipeline::Method::Femc;
            job.settings.method = Some(if guided { Method::Femc } else { Method::Pt });
        }
    }
    let frames = FrameChunks { all: &frames, chunk: args.chunk };
    let exported = export::export(&job, frames, &args.out).map_err(map_template_error)?;
    write(&args.out, &exported.text)?;
    exported.left_out.iter().for_each(|line| printer.note(format!("warning: {line}")));
    if let more @ 1.. = imported.other_file_count() {
        let files = human::counted_noun(more as u64, "further file");
        printer.note(format!(
            "warning: the scene has {files} that a template cannot list: tasks need them beside the scene"
        ));
    }
    Ok(Exit::Done)
}

/// Resolves the first variant. Resolves every variant, so that the template is as valid as its job.
fn first_variant(job: &JobFile, imported: &ImportedScene) -> Result<ResolvedRequest, Failure> {
    let resolve = |settings: &SettingsArgs| imported.resolve(settings, &|key| job.location(key));
    let Some(sweep) = &job.sweep else { return resolve(&job.settings) };
    let mut all =
        sweep.variants().iter().map(|variant| resolve(&variant.apply(&job.settings))).collect::<Result<Vec<_>, _>>()?;
    Ok(all.swap_remove(0))
}

fn write(path: &Path, text: &str) -> Result<(), Failure> {
    femc_film::file::write_atomic(path, text.as_bytes()).map_err(failed)
}

/// Maps an unreadable file to wrong usage, like all commands, and an unusable template to a found fault.
fn map_template_error(error: TemplateError) -> Failure {
    match error {
        TemplateError::Read { .. } => usage(error),
        TemplateError::Faults { .. } => failed(error),
    }
}
