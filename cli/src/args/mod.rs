//! Arguments that several commands share, as typed. Arguments of a single command are in its file under `command/`.

mod extras;
mod metrics;
mod notes;
mod select;
mod settings;
mod values;

pub use extras::ExtrasArgs;
pub use metrics::MetricsArgs;
pub use notes::{NotesArgs, job_name};
pub use select::{SelectArgs, glob_match};
pub use settings::{SettingsArgs, StatsMode};
pub use values::{Filter, Guide, Method};

use crate::exit::{Failure, failed};
use clap::{ArgAction, Args, ValueEnum};
use femc_proto::Dialer;
use femc_trust::{Identity, TokenFile};
use std::path::{Path, PathBuf};

/// Flags of every command.
#[derive(Clone, Debug, Args)]
#[command(next_display_order = 900)]
pub struct CommonArgs {
    /// Print less: no progress, no notes, only errors and the result
    #[arg(long, short, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Print more; up to three times
    #[arg(long, short, global = true, action = ArgAction::Count)]
    pub verbose: u8,
    /// Colors: on a terminal, always, or never (NO_COLOR is respected)
    #[arg(long, global = true, value_enum, default_value_t = ColorChoice::Auto, value_name = "WHEN")]
    pub color: ColorChoice,
    /// Format of the log on stderr: text for people, or one JSON object per line
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text, value_name = "FORMAT", env = "FEMC_LOG_FORMAT")]
    pub log_format: LogFormat,
    /// File of settings [default: the first of femc.toml here, in ~/.config/femc and in /etc/femc that exists]
    #[arg(long, global = true, value_name = "FILE", env = "FEMC_CONFIG")]
    pub config: Option<PathBuf>,
    /// Print the command's effective settings (flag, then environment, then file, then default) with their sources, and exit
    #[arg(long, global = true)]
    pub print_config: bool,
}

/// Format of the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// Text for people.
    Text,
    /// JSON for programs.
    Json,
}

/// Rule for the use of colors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ColorChoice {
    /// On a terminal, unless NO_COLOR is set.
    Auto,
    /// Always.
    Always,
    /// Never.
    Never,
}

/// Output format of a command that lists or measures.
#[derive(Clone, Copy, Debug, Args)]
pub struct FormatArgs {
    /// Print JSON on stdout
    #[arg(long)]
    pub json: bool,
}

/// Address of the farm, for every client command.
#[derive(Clone, Debug, Args)]
pub struct ServerArgs {
    /// URL of the farm's coordinator; several URLs with commas: the one that answers is used
    #[arg(long, env = "FEMC_SERVER", value_name = "URL,..", default_value = "http://127.0.0.1:7878")]
    pub server: String,
    #[command(flatten)]
    pub identity: IdentityArgs,
}

/// Credentials of this program.
#[derive(Clone, Debug, Args)]
pub struct IdentityArgs {
    /// Identity file, for addresses that begin with https://; `femc ca issue` makes one
    #[arg(long, env = "FEMC_IDENTITY", value_name = "FILE")]
    pub identity: Option<PathBuf>,
    /// Token file, instead of an identity; `femc ca token` makes one. The token is sent to https:// addresses and to this machine,
    /// nowhere else
    #[arg(long, env = "FEMC_TOKEN_FILE", value_name = "FILE", conflicts_with = "identity")]
    pub token_file: Option<PathBuf>,
}

impl IdentityArgs {
    /// Returns the way to connect to a coordinator with these credentials.
    pub fn dial(&self) -> Result<Dialer, Failure> {
        let dial = match &self.identity {
            None => Dialer::tcp(),
            Some(path) => Dialer::tcp().with_identity(read_identity(path)?),
        };
        let Some(path) = &self.token_file else { return Ok(dial) };
        let pass = TokenFile::read(path).map_err(|error| failed(format!("--token-file: {error}")))?;
        Ok(dial.with_token(pass))
    }
}

/// Reads an identity file.
pub fn read_identity(path: &Path) -> Result<Identity, Failure> {
    Identity::read(path).map_err(|error| failed(format!("--identity: {error}")))
}
