//! Which arguments are settings, and what a command line says of them.

use clap::{Arg, ArgMatches};

/// Commands that run until they are stopped: each of their settings has an environment variable and a key in the file.
pub const SERVICES: [&str; 2] = ["coordinator", "worker"];

/// Whether an argument says how something is to be done, and so may stand in a file.
pub fn is_setting(arg: &Arg) -> bool {
    arg.get_long().is_some_and(|long| !matches!(long, "help" | "version" | "config" | "print-config"))
}

/// What the matches of a command say of one of its arguments, as text; `None`: it is not set.
pub fn values(matches: &ArgMatches, arg: &Arg) -> Option<Vec<String>> {
    let raw = matches.get_raw(arg.get_id().as_str())?;
    Some(raw.map(|value| value.to_string_lossy().into_owned()).collect())
}
