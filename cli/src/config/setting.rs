//! Definition of settings among the arguments, and their values on a command line.

use clap::{Arg, ArgMatches};

/// Commands that run until they are stopped: each of their settings has an environment variable and a key in the file.
pub const SERVICES: [&str; 2] = ["coordinator", "worker"];

/// Returns whether an argument is a setting, which may be in a file.
pub fn is_setting(arg: &Arg) -> bool {
    arg.get_long().is_some_and(|long| !matches!(long, "help" | "version" | "config" | "print-config"))
}

/// Returns the values of an argument in the matches of a command, as text; `None`: it is not set.
pub fn values(matches: &ArgMatches, arg: &Arg) -> Option<Vec<String>> {
    let raw = matches.get_raw(arg.get_id().as_str())?;
    Some(raw.map(|value| value.to_string_lossy().into_owned()).collect())
}
