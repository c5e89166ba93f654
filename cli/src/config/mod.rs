//! The command line as typed, completed by the environment and `femc.toml`.
//!
//! Every setting has the same precedence: flag, environment, file, default. The file's values become clap's defaults, so that all
//! checks of clap (kinds, ranges, help) apply to them, too, and each setting is parsed in only one way.

mod file;
mod setting;
mod show;

use crate::command::Cli;
use crate::exit::Failure;
use clap::error::{ContextKind, ContextValue};
use clap::{Arg, ArgAction, Command, CommandFactory, FromArgMatches};
use file::ConfigFile;
use setting::{SERVICES, is_setting};
use std::any::TypeId;
use std::collections::BTreeSet;
use std::error::Error as _;
use std::ffi::OsString;
use std::num::{IntErrorKind, ParseFloatError, ParseIntError};
use std::path::PathBuf;

/// Result of parsing a command line.
pub enum ParsedArgs {
    /// A command to run.
    Command(Box<Cli>),
    /// The requested listing of the settings.
    Settings(String),
}

/// Reasons why a command line is not accepted.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// Wrong usage, or a request for help.
    #[error(transparent)]
    Usage(#[from] clap::Error),
    /// The settings file is wrong.
    #[error("{0}")]
    File(Failure),
}

/// Parses `args`. The first argument is the program's name.
pub fn parse(args: Vec<OsString>) -> Result<ParsedArgs, ConfigError> {
    let command = with_negative_numbers(with_environment(Cli::command()));
    let args = with_negative_values(&command, args);
    let file =
        ConfigFile::find(&args).map(|path| ConfigFile::read(&path, &command)).transpose().map_err(ConfigError::File)?;
    let mut command = file.iter().fold(command, |command, file| file.apply(command));
    let wants_listing = args.iter().skip(1).take_while(|arg| *arg != "--").any(|arg| arg == "--print-config");
    if wants_listing {
        command = without_required(command);
        let matches = command.clone().try_get_matches_from(args).map_err(clarify_number_error)?;
        return Ok(ParsedArgs::Settings(show::settings(&command, &matches, file.as_ref())?));
    }
    let matches = command.clone().try_get_matches_from(args).map_err(clarify_number_error)?;
    let cli = Cli::from_arg_matches(&matches).map_err(|error| error.format(&mut command))?;
    Ok(ParsedArgs::Command(Box::new(cli)))
}

/// Gives each setting of the services an environment variable: `FEMC_KEEP_ENDED` for `--keep-ended`.
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

/// Returns whether an argument takes a number, a range or another value with its own parser, and not a text or path.
fn is_parsed(arg: &Arg) -> bool {
    let kind = arg.get_value_parser().type_id();
    let texts = [TypeId::of::<String>(), TypeId::of::<OsString>(), TypeId::of::<PathBuf>()];
    matches!(arg.get_action(), ArgAction::Set | ArgAction::Append) && texts.iter().all(|text| kind != *text)
}

/// Lets positional numbers begin with `-`, so that they reach their own parser.
fn with_negative_numbers(command: Command) -> Command {
    let allowed =
        |arg: Arg| if arg.is_positional() && is_parsed(&arg) { arg.allow_negative_numbers(true) } else { arg };
    command.mut_args(allowed).mut_subcommands(with_negative_numbers)
}

/// Joins an option and a value that begins with `-` and a digit: `--frames -5..5` becomes `--frames=-5..5`. The parser of frames
/// can then explain the error. Otherwise clap would search for a flag `-5`. No flag is a digit.
fn with_negative_values(command: &Command, args: Vec<OsString>) -> Vec<OsString> {
    fn collect(command: &Command, all: &mut BTreeSet<String>) {
        let options = command.get_arguments().filter(|arg| is_parsed(arg));
        all.extend(options.filter_map(|arg| Some(format!("--{}", arg.get_long()?))));
        command.get_subcommands().for_each(|inner| collect(inner, all));
    }
    let mut options = BTreeSet::new();
    collect(command, &mut options);
    let is_value = |text: &str| {
        let rest = text.strip_prefix('-').map(|rest| rest.strip_prefix('.').unwrap_or(rest));
        rest.is_some_and(|rest| rest.starts_with(|first: char| first.is_ascii_digit()))
    };
    let mut all: Vec<OsString> = Vec::with_capacity(args.len());
    let mut is_over = false;
    for arg in args {
        let last = all.last().and_then(|last| last.to_str()).filter(|last| options.contains(*last));
        match (last, arg.to_str()) {
            (Some(option), Some(value)) if !is_over && is_value(value) => {
                let joined = format!("{option}={value}");
                all.pop();
                all.push(joined.into());
            }
            _ => {
                is_over |= arg == "--";
                all.push(arg);
            }
        }
    }
    all
}

/// Replaces the messages of the standard library's number parsers ("invalid digit found in string") by messages that say what to
/// write.
fn clarify_number_error(error: clap::Error) -> clap::Error {
    let text = |kind| match error.get(kind) {
        Some(ContextValue::String(text)) => text.clone(),
        _ => String::new(),
    };
    let cause = error.source();
    let advice = if let Some(cause) = cause.and_then(|cause| cause.downcast_ref::<ParseIntError>()) {
        match cause.kind() {
            IntErrorKind::PosOverflow | IntErrorKind::NegOverflow => "it is too large; give a smaller number",
            _ => "it must be a whole number that is not negative, like 7",
        }
    } else if cause.is_some_and(|cause| cause.is::<ParseFloatError>()) {
        "it must be a number, like 0.5"
    } else {
        return error;
    };
    let (value, argument) = (text(ContextKind::InvalidValue), text(ContextKind::InvalidArg));
    let message =
        format!("invalid value '{value}' for '{argument}': {advice}\n\nFor more information, try '--help'.\n");
    clap::Error::raw(error.kind(), message)
}

/// Returns the command without required arguments: users who print the settings need not give all of them.
fn without_required(command: Command) -> Command {
    let relaxed = |it: Command| it.subcommand_required(false).arg_required_else_help(false);
    relaxed(command).mut_subcommands(|it| relaxed(it).mut_args(|arg| arg.required(false)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::error::ErrorKind;

    /// Collects every command with its full name.
    fn commands(command: &Command, path: &[String], all: &mut Vec<(Vec<String>, Command)>) {
        all.push((path.to_vec(), command.clone()));
        for inner in command.get_subcommands() {
            let path: Vec<String> = path.iter().cloned().chain([inner.get_name().to_owned()]).collect();
            commands(inner, &path, all);
        }
    }

    #[test]
    fn negative_values_reach_the_parser_of_every_option() {
        let command = with_negative_numbers(with_environment(Cli::command()));
        let mut all = Vec::new();
        commands(&command, &["femc".to_owned()], &mut all);
        let mut looked_at = 0;
        for (path, inner) in all {
            for arg in inner.get_arguments().filter(|arg| is_parsed(arg) && !arg.is_require_equals_set()) {
                for value in ["-5", "-5..5", "-1.5", "-9x9", "-3s"] {
                    let mut line = path.clone();
                    let place = match arg.get_long() {
                        Some(long) => {
                            line.push(format!("--{long}"));
                            format!("--{long}")
                        }
                        None if value == "-5" => {
                            let before =
                                inner.get_positionals().position(|it| it.get_id() == arg.get_id()).unwrap_or(0);
                            line.extend(std::iter::repeat_n("1".to_owned(), before));
                            arg.get_value_names().map_or(String::new(), |names| names[0].to_string())
                        }
                        None => continue,
                    };
                    line.push(value.to_owned());
                    looked_at += 1;
                    let words = with_negative_values(&command, line.iter().map(OsString::from).collect());
                    let Err(error) = command.clone().try_get_matches_from(words).map_err(clarify_number_error) else {
                        continue;
                    };
                    let text = error.to_string();
                    // If clap only misses other arguments, it has accepted the value.
                    if error.kind() == ErrorKind::MissingRequiredArgument {
                        continue;
                    }
                    assert!(text.contains(value) && text.contains(&place), "{line:?}: {text}");
                    for astray in ["tip:", "unexpected argument", "invalid digit", "invalid float", "cannot parse"] {
                        assert!(!text.contains(astray), "{line:?}: {text}");
                    }
                }
            }
        }
        assert!(looked_at > 300, "{looked_at}");
    }

    #[test]
    fn a_flag_behind_an_option_is_no_value_of_it() {
        let command = with_negative_numbers(with_environment(Cli::command()));
        let words = |line: &str| with_negative_values(&command, line.split(' ').map(OsString::from).collect());
        assert_eq!(words("femc plan a.mgf --spp -5 -q"), ["femc", "plan", "a.mgf", "--spp=-5", "-q"]);
        for line in ["femc plan a.mgf --frames --spp 4", "femc plan a.mgf -- --spp -5", "femc render a.mgf -o -5"] {
            assert_eq!(words(line), line.split(' ').collect::<Vec<_>>());
        }
        let error =
            command.clone().try_get_matches_from(words("femc plan a.mgf --frames --spp 4")).expect_err("no frames");
        assert!(error.to_string().contains("a value is required for '--frames"), "{error}");
    }
}
