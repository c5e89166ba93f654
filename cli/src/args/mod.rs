//! The arguments that commands share, as typed; what a command has alone is in its file under `command/`.

mod extras;
mod metrics;
mod notes;
mod select;
mod settings;
mod values;

pub use extras::ExtrasArgs;
pub use metrics::MetricsArgs;
pub use notes::{NotesArgs, job_name};
pub use select::{SelectArgs, fits};
pub use settings::{SettingsArgs, Stats};
pub use values::{Filter, Method};

use crate::exit::{Failure, failed};
use clap::{ArgAction, Args, ValueEnum};
use femc_proto::Dial;
use femc_trust::{Identity, Pass};
use std::path::{Path, PathBuf};

/// Flags of every command.
#[derive(Clone, Debug, Args)]
#[command(next_display_order = 900)]
pub struct CommonArgs {
    /// Say less: no progress, no notes, only errors and the result
    #[arg(long, short, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Say more; up to three times
    #[arg(long, short, global = true, action = ArgAction::Count)]
    pub verbose: u8,
    /// Colors: on a terminal, always, or never (NO_COLOR is heeded)
    #[arg(long, global = true, value_enum, default_value_t = ColorChoice::Auto, value_name = "WHEN")]
    pub color: ColorChoice,
    /// The log on stderr: text for people, or a JSON object a line
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text, value_name = "FORMAT", env = "FEMC_LOG_FORMAT")]
    pub log_format: LogFormat,
    /// File of settings [default: femc.toml here, in ~/.config/femc or in /etc/femc, the first that is there]
    #[arg(long, global = true, value_name = "FILE", env = "FEMC_CONFIG")]
    pub config: Option<PathBuf>,
    /// Print the command's settings as they hold (flag, then environment, then file, then default), each with where it comes
    /// from, and do nothing
    #[arg(long, global = true)]
    pub print_config: bool,
}

/// The form of the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// For people.
    Text,
    /// For machines.
    Json,
}

/// When to use colors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ColorChoice {
    /// On a terminal, unless NO_COLOR is set.
    Auto,
    /// Always.
    Always,
    /// Never.
    Never,
}

/// The output form of a command that lists or measures.
#[derive(Clone, Copy, Debug, Args)]
pub struct FormatArgs {
    /// Print JSON on stdout, for machines
    #[arg(long)]
    pub json: bool,
}

/// The address of the farm, for every client command.
#[derive(Clone, Debug, Args)]
pub struct ServerArgs {
    /// The farm's coordinator; of several, with commas between, the one that answers
    #[arg(long, env = "FEMC_SERVER", value_name = "URL,..", default_value = "http://127.0.0.1:7878")]
    pub server: String,
    #[command(flatten)]
    pub identity: IdentityArgs,
}

/// Who this program says that it is.
#[derive(Clone, Debug, Args)]
pub struct IdentityArgs {
    /// File that says who you are, for addresses that begin with https://; `femc ca issue` makes one
    #[arg(long, env = "FEMC_IDENTITY", value_name = "FILE")]
    pub identity: Option<PathBuf>,
    /// File with a token that says who you are, instead; `femc ca token` makes one. It is sent to https:// addresses and to
    /// this machine, nowhere else
    #[arg(long, env = "FEMC_TOKEN_FILE", value_name = "FILE", conflicts_with = "identity")]
    pub token_file: Option<PathBuf>,
}

impl IdentityArgs {
    /// How to reach a coordinator with it.
    pub fn dial(&self) -> Result<Dial, Failure> {
        let dial = match &self.identity {
            None => Dial::tcp(),
            Some(path) => Dial::tcp().with(identity(path)?),
        };
        let Some(path) = &self.token_file else { return Ok(dial) };
        let pass = Pass::read(path).map_err(|error| failed(format!("--token-file: {error}")))?;
        Ok(dial.bearing(pass))
    }
}

/// Read one.
pub fn identity(path: &Path) -> Result<Identity, Failure> {
    Identity::read(path).map_err(|error| failed(format!("--identity: {error}")))
}
