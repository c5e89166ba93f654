//! `femc.toml`: settings by the long names of their flags.
//!
//! ```toml
//! server = "http://farm:7878"     # settings of many commands come first
//! [coordinator]
//! listen = "0.0.0.0:7878"
//! share = ["ann=3", "bob=1"]
//! [worker]
//! join = "http://farm:7878"
//! ```

use super::setting::{SERVICES, is_setting};
use crate::exit::{Failure, failed, usage};
use crate::values::TextPosition;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Arg, ArgAction, Command};
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use toml::de::{DeTable, DeValue};

/// Flags of many commands, which may be set at the top of the file.
const SHARED_KEYS: [&str; 6] = ["server", "identity", "color", "quiet", "verbose", "log-format"];
/// File that is tried last, after the current folder and the user's own settings.
const SYSTEM_FILE: &str = "/etc/femc/femc.toml";

/// A setting in a file.
#[derive(Debug)]
pub struct Setting {
    /// One value, or several if the flag is repeatable.
    values: Vec<String>,
    position: TextPosition,
}

/// A settings file.
#[derive(Debug)]
pub struct ConfigFile {
    path: PathBuf,
    shared: BTreeMap<String, Setting>,
    services: BTreeMap<&'static str, BTreeMap<String, Setting>>,
}

/// Byte offset and description of a fault in the text.
type ParseFault = (usize, String);

impl ConfigFile {
    /// Returns the settings file: `--config`, `FEMC_CONFIG`, or the first default location that exists.
    pub fn find(args: &[OsString]) -> Option<PathBuf> {
        let typed: Vec<&OsString> = args.iter().skip(1).take_while(|arg| *arg != "--").collect();
        let after = typed.iter().position(|arg| *arg == "--config").and_then(|at| typed.get(at + 1).copied());
        let joined = || typed.iter().find_map(|arg| arg.to_str()?.strip_prefix("--config="));
        let named = after.map(PathBuf::from).or_else(|| joined().map(PathBuf::from));
        let requested =
            named.or_else(|| std::env::var_os("FEMC_CONFIG").filter(|name| !name.is_empty()).map(Into::into));
        if requested.is_some() {
            return requested;
        }
        let own = std::env::var_os("XDG_CONFIG_HOME").map(PathBuf::from);
        let own = own.or_else(|| Some(PathBuf::from(std::env::var_os("HOME")?).join(".config")));
        let places = [Some("femc.toml".into()), own.map(|own| own.join("femc/femc.toml")), Some(SYSTEM_FILE.into())];
        places.into_iter().flatten().find(|path| path.is_file())
    }

    /// Reads and checks a file: each key must be a flag, each value one that the flag accepts.
    pub fn read(path: &Path, command: &Command) -> Result<Self, Failure> {
        let text = std::fs::read_to_string(path).map_err(|e| failed(format!("--config {}: {e}", path.display())))?;
        Self::parse(path.to_owned(), &text, command).map_err(|(offset, what)| {
            let TextPosition { line, column } = TextPosition::from_offset(&text, offset);
            usage(format!("{}:{line}:{column}: {what}", path.display()))
        })
    }

    /// Parses the settings in `text`.
    fn parse(path: PathBuf, text: &str, command: &Command) -> Result<Self, ParseFault> {
        let wrong = |e: toml::de::Error| (e.span().map_or(0, |span| span.start), e.message().replace('\n', " "));
        let table = DeTable::parse(text).map_err(wrong)?;
        let mut file = Self { path, shared: BTreeMap::new(), services: BTreeMap::new() };
        for (key, value) in table.get_ref() {
            let (name, start) = (key.get_ref().as_ref(), key.span().start);
            match (SERVICES.into_iter().find(|service| *service == name), value.get_ref()) {
                (Some(service), DeValue::Table(settings)) => {
                    let settings = read_table(settings, text, command, service)?;
                    file.services.insert(service, settings);
                }
                (Some(service), _) => return Err((start, format!("{service} must be a table: write [{service}]"))),
                (None, DeValue::Table(_)) => {
                    return Err((start, format!("unknown table [{name}]; known tables: [{}]", SERVICES.join("], ["))));
                }
                (None, value_here) => {
                    if !SHARED_KEYS.contains(&name) {
                        let known = SHARED_KEYS.join(", ");
                        return Err((start, format!("unknown key {name}; known keys outside of tables: {known}")));
                    }
                    let setting = Setting {
                        values: value_texts(value_here, start)?,
                        position: TextPosition::from_offset(text, start),
                    };
                    // The command `gc` has all of these flags and no required arguments.
                    check(command, "gc", name, &setting.values).map_err(|what| (value.span().start, what))?;
                    file.shared.insert(name.to_owned(), setting);
                }
            }
        }
        Ok(file)
    }

    /// Returns the command line with this file's settings as its defaults.
    pub fn apply(&self, command: Command) -> Command {
        let command = command.mut_args(|arg| self.with_default(arg, None));
        command.mut_subcommands(|it| {
            let name = it.get_name().to_owned();
            it.mut_args(|arg| self.with_default(arg, Some(&name)))
        })
    }

    fn with_default(&self, arg: Arg, command: Option<&str>) -> Arg {
        match self.setting(&arg, command) {
            Some(setting) => arg.required(false).default_values(setting.values.clone()),
            None => arg,
        }
    }

    fn setting(&self, arg: &Arg, command: Option<&str>) -> Option<&Setting> {
        let long = arg.get_long().filter(|_| is_setting(arg))?;
        let own = command.and_then(|command| self.services.get(command)?.get(long));
        own.or_else(|| self.shared.get(long))
    }

    /// Returns the location where the file sets an argument of a command: `femc.toml:3:1`.
    pub fn location(&self, arg: &Arg, command: Option<&str>) -> Option<String> {
        let TextPosition { line, column } = self.setting(arg, command)?.position;
        Some(format!("{}:{line}:{column}", self.path.display()))
    }

    /// Returns the path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

fn read_table(
    table: &DeTable<'_>,
    text: &str,
    command: &Command,
    service: &'static str,
) -> Result<BTreeMap<String, Setting>, ParseFault> {
    let mut settings = BTreeMap::new();
    let flags: Vec<&str> = command
        .find_subcommand(service)
        .into_iter()
        .flat_map(Command::get_arguments)
        .filter(|arg| is_setting(arg))
        .filter_map(Arg::get_long)
        .collect();
    for (key, value) in table {
        let (name, start) = (key.get_ref().as_ref(), key.span().start);
        if !flags.contains(&name) && !SHARED_KEYS.contains(&name) {
            return Err((start, format!("unknown key {name}; known keys of [{service}]: {}", flags.join(", "))));
        }
        let setting = Setting {
            values: value_texts(value.get_ref(), value.span().start)?,
            position: TextPosition::from_offset(text, start),
        };
        check(command, service, name, &setting.values).map_err(|what| (value.span().start, what))?;
        settings.insert(name.to_owned(), setting);
    }
    Ok(settings)
}

/// Returns a value as it would be typed.
fn value_texts(value: &DeValue<'_>, at: usize) -> Result<Vec<String>, ParseFault> {
    Ok(vec![match value {
        DeValue::String(text) => text.to_string(),
        DeValue::Integer(number) => number.to_string(),
        DeValue::Float(number) => number.to_string(),
        DeValue::Boolean(flag) => flag.to_string(),
        DeValue::Array(all) => {
            let each = all.iter().map(|one| value_texts(one.get_ref(), one.span().start));
            return Ok(each.collect::<Result<Vec<_>, _>>()?.concat());
        }
        DeValue::Datetime(_) | DeValue::Table(_) => {
            return Err((at, "give a string, a number, true, false or a list".into()));
        }
    }])
}

/// Checks that the command accepts these values for the flag. Returns the message if not.
fn check(command: &Command, name: &str, long: &str, values: &[String]) -> Result<(), String> {
    let mut command = command.clone();
    command.build();
    let args = command.find_subcommand(name).into_iter().flat_map(Command::get_arguments);
    let Some(arg) = args.into_iter().find(|arg| arg.get_long() == Some(long)) else { return Ok(()) };
    let takes_many = matches!(arg.get_action(), ArgAction::Append);
    if values.len() != 1 && !takes_many {
        return Err(format!("{long} takes one value"));
    }
    let typed: Vec<String> = match arg.get_action() {
        ArgAction::SetTrue => match values {
            [value] if value == "true" || value == "false" => Vec::new(),
            _ => return Err(format!("{long} must be true or false")),
        },
        ArgAction::Count => match values {
            [value] if value.parse::<u8>().is_ok() => Vec::new(),
            _ => return Err(format!("{long} must be a small number")),
        },
        _ => values.iter().map(|value| format!("--{long}={value}")).collect(),
    };
    let typed = ["femc".to_owned(), name.to_owned()].into_iter().chain(typed);
    match command.try_get_matches_from(typed) {
        Err(error) if is_value_error(&error, long) => {
            let said = error.to_string();
            let first = said.lines().next().unwrap_or_default();
            Err(first.trim_start_matches("error: ").to_owned())
        }
        Ok(_) | Err(_) => Ok(()),
    }
}

/// Returns whether a clap error is about the value of this flag, and not about other or missing arguments.
fn is_value_error(error: &clap::Error, long: &str) -> bool {
    let is_kind = matches!(error.kind(), ErrorKind::InvalidValue | ErrorKind::ValueValidation);
    let flag = format!("--{long} ");
    let is_flag =
        |value: &ContextValue| matches!(value, ContextValue::String(arg) if format!("{arg} ").starts_with(&flag));
    is_kind && error.get(ContextKind::InvalidArg).is_some_and(is_flag)
}
