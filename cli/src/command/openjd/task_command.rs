//! A task's command line, parsed like that of `femc render`.

use crate::args::{CommonArgs, ExtrasArgs, SettingsArgs, StatsMode};
use crate::command::render::RenderArgs;
use crate::request::Change;
use crate::values::Frames;
use clap::error::ErrorKind;
use clap::{Parser, Subcommand};
use std::path::{Path, PathBuf};

/// Request of one task.
#[derive(Debug)]
pub struct TaskCommand {
    /// Scene, as written.
    pub scene: PathBuf,
    /// Frames; `None`: all.
    pub frames: Option<Frames>,
    /// All other settings of the image.
    pub changes: Vec<Change>,
    /// Settings that change no pixel.
    pub execution: ExecutionSettings,
    /// Flags that a sweep cannot express.
    pub left_out: Vec<&'static str>,
}

/// Settings that change no pixel.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ExecutionSettings {
    /// `--workers`
    pub workers: Option<u32>,
    /// `--threads`
    pub threads: Option<u32>,
    /// `--stats`
    pub stats: Option<StatsMode>,
}

/// The faulty part of a command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CommandPart {
    /// The program.
    Command,
    /// An argument.
    Arguments,
}

/// The command line of a task.
#[derive(Parser)]
#[command(name = "femc")]
struct Line {
    #[command(flatten)]
    _common: CommonArgs,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Render(RenderArgs),
}

impl TaskCommand {
    /// Parses a program and its arguments. The error says which of them is faulty, and why.
    pub fn parse(line: &[String]) -> Result<Self, (CommandPart, String)> {
        let program = line.first().map(String::as_str).unwrap_or_default();
        let name = Path::new(program).file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        if name.strip_suffix(".exe").unwrap_or(&name) != "femc" {
            return Err((
                CommandPart::Command,
                format!("only `femc render` can become a sweep, but this runs `{program}`"),
            ));
        }
        let wrong = |what: String| Err((CommandPart::Arguments, what));
        match Line::try_parse_from(line).map(|line| line.command) {
            Ok(Command::Render(RenderArgs { replay: Some(_), .. })) => wrong(
                "--replay renders one frame again with the settings in its file; a sweep cannot do this".to_owned(),
            ),
            Ok(Command::Render(args)) => Ok(Self::from_args(args)),
            Err(error) if error.kind() == ErrorKind::InvalidSubcommand => {
                wrong("only `femc render` can become a sweep, but this is another command of femc".to_owned())
            }
            Err(error) => {
                let message = error.to_string();
                let first = message.lines().next().unwrap_or_default();
                wrong(first.strip_prefix("error: ").unwrap_or(first).to_owned())
            }
        }
    }

    fn from_args(args: RenderArgs) -> Self {
        let RenderArgs { scene, out, exposure, report, fresh, painting, extras, format, settings, replay: _, watch: _ } =
            args;
        let ExtrasArgs { video, preview, contact_sheet } = extras;
        let flags = [
            ("--out", out.is_some()),
            ("--exposure", exposure.is_some()),
            ("--video", video.is_some()),
            ("--preview", preview),
            ("--contact-sheet", contact_sheet.is_some()),
            ("--report", report.is_some()),
            ("--fresh", fresh),
            ("--json", format.json),
            ("--root", settings.root.is_some()),
            ("--layer", !settings.layer.is_empty()),
            ("--layers", !settings.layers.is_empty()),
            ("--measure", settings.measure.is_some()),
            ("--style", painting.style.is_some()),
        ];
        let SettingsArgs { frames, workers, threads, stats, .. } = settings;
        let changes = Change::from_settings(&SettingsArgs { frames: None, ..settings });
        let left_out = flags.into_iter().filter(|(_, given)| *given).map(|(flag, _)| flag).collect();
        Self { scene, frames, changes, execution: ExecutionSettings { workers, threads, stats }, left_out }
    }
}
