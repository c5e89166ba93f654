//! `--print-config`: prints the effective settings and their sources. The output can be saved as a `femc.toml`.

use super::file::ConfigFile;
use super::setting::{SERVICES, is_setting, values};
use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Command};
use std::fmt::Write as _;

/// Returns the settings of the typed command. Without a command, it returns the settings of the services.
pub fn settings(command: &Command, matches: &ArgMatches, file: Option<&ConfigFile>) -> Result<String, clap::Error> {
    let mut text = match file {
        Some(file) => format!("# from {}\n", file.path().display()),
        None => "# no femc.toml found\n".to_owned(),
    };
    match matches.subcommand() {
        Some((name, matches)) => append_table(&mut text, command, name, matches, file),
        None => {
            for service in SERVICES {
                let matches = command.clone().try_get_matches_from(["femc", service])?;
                let own = matches.subcommand_matches(service).unwrap_or(&matches);
                append_table(&mut text, command, service, own, file);
            }
        }
    }
    Ok(text)
}

fn append_table(text: &mut String, command: &Command, name: &str, matches: &ArgMatches, file: Option<&ConfigFile>) {
    let own = command.find_subcommand(name).into_iter().flat_map(Command::get_arguments);
    let args: Vec<&Arg> = own.chain(command.get_arguments()).filter(|arg| is_setting(arg)).collect();
    let lines = args.iter().map(|arg| setting_line(arg, name, matches, file));
    // Writing to a string does not fail.
    let _ = writeln!(text, "\n[{name}]");
    lines.for_each(|line| text.extend([line, "\n".to_owned()]));
}

/// Returns a line like `lease = "30s"  # FEMC_LEASE`.
fn setting_line(arg: &Arg, command: &str, matches: &ArgMatches, file: Option<&ConfigFile>) -> String {
    let long = arg.get_long().unwrap_or_default();
    let Some(values) = values(matches, arg) else { return format!("# {long} is not set") };
    let source = match matches.value_source(arg.get_id().as_str()) {
        Some(ValueSource::CommandLine) => "flag".to_owned(),
        Some(ValueSource::EnvVariable) => arg.get_env().unwrap_or_default().to_string_lossy().into_owned(),
        _ => file.and_then(|file| file.location(arg, Some(command))).unwrap_or_else(|| "default".to_owned()),
    };
    let values: Vec<String> = values.iter().map(|value| to_toml(&hide_password(value))).collect();
    let value = match (arg.get_action(), &values[..]) {
        (ArgAction::Append, values) => format!("[{}]", values.join(", ")),
        (_, [value]) => value.clone(),
        (_, values) => format!("[{}]", values.join(", ")),
    };
    format!("{long} = {value}  # {source}")
}

fn to_toml(value: &str) -> String {
    let is_bare = matches!(value, "true" | "false") || value.parse::<i64>().is_ok_and(|n| n.to_string() == value);
    if is_bare { value.to_owned() } else { toml::Value::String(value.to_owned()).to_string() }
}

/// Returns an address without its password.
fn hide_password(value: &str) -> String {
    let parts = || {
        let (scheme, rest) = value.split_once("://")?;
        let (who, host) = rest.split_once('@')?;
        let (user, _) = who.split_once(':')?;
        Some(format!("{scheme}://{user}:***@{host}"))
    };
    parts().unwrap_or_else(|| value.to_owned())
}
