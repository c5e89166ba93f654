//! The command line as typed, with what the environment and `femc.toml` say where nothing was typed.
//!
//! One precedence for every setting: flag, environment, file, default. The file's values become clap's defaults, so that
//! all that clap knows (kinds, ranges, help) holds for them, too, and nobody reads a setting in two ways.

mod file;
mod setting;
mod show;

use crate::command::Cli;
use crate::exit::Failure;
use clap::{Arg, Command, CommandFactory, FromArgMatches};
use file::File;
use setting::{SERVICES, is_setting};
use std::ffi::OsString;

/// What comes of a command line.
pub enum Parsed {
    /// Something is to be done.
    Command(Box<Cli>),
    /// The settings were asked for, and are these.
    Shown(String),
}

/// Why nothing comes of it.
#[derive(Debug, thiserror::Error)]
pub enum Refused {
    /// Wrong usage, or help was asked for.
    #[error(transparent)]
    Usage(#[from] clap::Error),
    /// The file is wrong.
    #[error("{0}")]
    File(Failure),
}

/// Read `args`, the first of which is the program's name.
pub fn parse(args: Vec<OsString>) -> Result<Parsed, Refused> {
    let command = with_environment(Cli::command());
    let file = File::find(&args).map(|path| File::read(&path, &command)).transpose().map_err(Refused::File)?;
    let mut command = file.iter().fold(command, |command, file| file.apply(command));
    let is_asked = args.iter().skip(1).take_while(|arg| *arg != "--").any(|arg| arg == "--print-config");
    if is_asked {
        command = lenient(command);
        let matches = command.clone().try_get_matches_from(args)?;
        return Ok(Parsed::Shown(show::settings(&command, &matches, file.as_ref())?));
    }
    let matches = command.clone().try_get_matches_from(args)?;
    let cli = Cli::from_arg_matches(&matches).map_err(|error| error.format(&mut command))?;
    Ok(Parsed::Command(Box::new(cli)))
}

/// Gives each setting of the services a variable: `FEMC_KEEP_ENDED` for `--keep-ended`.
fn with_environment(command: Command) -> Command {
    let named = |arg: Arg| match arg.get_long() {
        Some(long) if is_setting(&arg) && arg.get_env().is_none() => {
            let name = format!("FEMC_{}", long.to_uppercase().replace('-', "_"));
            arg.env(name).hide_env_values(true)
        }
        _ => arg,
    };
    SERVICES.into_iter().fold(command, |command, service| command.mut_subcommand(service, |it| it.mut_args(named)))
}

/// The same, content with what is there: who wants to see the settings need not give them all.
fn lenient(command: Command) -> Command {
    let relaxed = |it: Command| it.subcommand_required(false).arg_required_else_help(false);
    relaxed(command).mut_subcommands(|it| relaxed(it).mut_args(|arg| arg.required(false)))
}
